"""What a run writes beside its reports and tables, if asked for."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.html_option import html_option
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


def run_outputs(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options; the command gets them as one RunOutputs, ``outputs``."""
    names = [field.name for field in fields(RunOutputs)]

    @functools.wraps(command)
    def packed(**given: Any) -> Any:
        return command(outputs=RunOutputs(**{name: given.pop(name) for name in names}), **given)

    decorated: Callable[..., Any] = packed

    options = (
        plots_option("in the run directory and report.html, the page with them"),
        plot_format_option,
        html_option,
        click.option(
            "--mcap",
            type=click.Choice(["alone", "merge"]),
            help="Write track.mcap for Foxglove, Lichtblick or PlotJuggler: alone, or with a copy of LOG.",
        ),
        click.option("--fnv", is_flag=True, help="Write track.fnv, navigation for MB-System."),
        click.option("--parquet", is_flag=True, help="Write every CSV table as Parquet, too."),
    )
    for option in reversed(options):
        decorated = option(decorated)
    return decorated
