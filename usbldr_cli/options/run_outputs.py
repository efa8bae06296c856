"""What a run writes beside its reports and tables, if asked for."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.html_option import html_option
from usbldr_cli.options.option import option, packed_options
from usbldr_cli.options.output_files import plot_format_option, plots_option


@dataclass(frozen=True, slots=True)
class RunOutputs:
    """The options of more files in the run directory, as given."""

    plots: str = "all"
    plot_format: str = "png"
    mcap: str | None = None  # "alone" or "merge"
    fnv: bool = False
    parquet: bool = False

    def require_fitting(self, log: Path) -> None:
        """Raise UsageError for a file that cannot be made of this log, or with the packages installed."""
        if self.parquet and find_spec("pyarrow") is None:
            raise UsageError("--parquet needs pyarrow: install it with pip install 'usbldr[parquet]'")
        if self.mcap == "merge":
            from usbldr.io.reports.run_mcap import require_mergeable

            require_mergeable(log)


run_outputs = packed_options(
    RunOutputs,
    "outputs",
    (
        plots_option("in the run directory and report.html, the page with them"),
        plot_format_option,
        html_option,
        option(
            "--mcap",
            type=click.Choice(["alone", "merge"]),
            help="Write track.mcap for Foxglove, Lichtblick or PlotJuggler: alone, or with a copy of LOG.",
        ),
        option("--fnv", is_flag=True, help="Write track.fnv, navigation for MB-System.", rare=True),
        option("--parquet", is_flag=True, help="Write every CSV table as Parquet, too.", rare=True),
    ),
)
"""Add the options; the command gets them as one RunOutputs, ``outputs``."""
