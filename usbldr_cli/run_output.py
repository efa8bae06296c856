"""What a run leaves: its folder, and what is printed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from usbldr.filters.errors import UsageError, printable
from usbldr.io.stages import stage
from usbldr_cli.options.option import option, packed_options
from usbldr_cli.options.output_files import html_option, plot_format_option, plots_option, print_result, write_json

if TYPE_CHECKING:
    from usbldr.io.findings import Finding
    from usbldr.io.log import Log
    from usbldr.io.reports.page import Picture
    from usbldr.io.reports.run import Run


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


def say_findings(log: "Log", findings: "Sequence[Finding]", quiet: bool) -> None:
    """Print findings on stderr; remarks are left out of a quiet run."""
    for finding in findings:
        if not (quiet and finding.level == "info"):
            click.echo(f"usbldr: {printable(log.path.name)}: {finding.text} [{finding.code}]", err=True)


@stage("write the results")
def write_run(folder: Path, run: "Run", outputs: RunOutputs) -> None:
    """Write everything of the run, and what else is asked for; report.json, which names all files, comes last."""
    from usbldr.io.reports.report_json import write_json, write_tables
    from usbldr.io.reports.run_page import run_page, write_markdown

    write_tables(folder, run)
    pictures: list[Picture] = []
    if outputs.plots != "none":
        from usbldr_cli.figures.run_figures import run_pictures  # imports matplotlib
        from usbldr_cli.pages.html_page import draw_page

        pictures = draw_page(folder, run_pictures(run), partial(run_page, run), outputs.plot_format)
    write_markdown(folder, run, pictures)
    if outputs.fnv:
        _write_fnv(folder, run)
    if outputs.mcap is not None:
        from usbldr.io.reports.run_mcap import TRACK_MCAP, write_run_mcap  # imports rosbags

        write_run_mcap(folder / TRACK_MCAP, run, outputs.mcap == "merge")
    if outputs.parquet:
        _write_parquet(folder)
    write_json(folder, run)


def _write_fnv(folder: Path, run: "Run") -> None:
    from usbldr.io.reports.tracks import write_fnv

    if run.log.origin is None or run.log.map_unknown:
        raise UsageError("--fnv needs latitudes: state origin_lat_deg and origin_lon_deg under [map]")
    write_fnv(folder / "track.fnv", run.scored.trajectory, run.log.origin, run.log.start_ns)


def _write_parquet(folder: Path) -> None:
    """Write the tables again, with the numbers of their CSV files."""
    import pandas as pd

    for table in sorted(folder.glob("*.csv")):
        pd.read_csv(table).to_parquet(table.with_suffix(".parquet"), engine="pyarrow", index=False)


def print_run(run: "Run", target: Path, json_to: str | None, quiet: bool) -> None:
    """Print the table or the last line of a run, and write its JSON."""
    from usbldr.io.reports.report_json import json_values, report_content
    from usbldr_cli.tables.run_table import render

    if json_to is not None:
        write_json(json_to, json_values(report_content(run)))
    if json_to == "-":
        return
    for warning in run.warnings if quiet else ():
        click.echo(f"usbldr: {warning}", err=True)
    print_result(partial(render, run), run.verdict, target, quiet)


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
