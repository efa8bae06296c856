"""``usbldr check``: runs the rows of a baseline again and compares each metric with its stored value, for CI."""

import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import CheckError, LogError, UsageError
from usbldr_cli.options.log_options import inputs, read_request, selection_options
from usbldr_cli.options.output_files import json_option, refuse_file, write_file, write_json
from usbldr_cli.options.run_options import RunChoices, run_options

if TYPE_CHECKING:
    from usbldr.io.settings.regression_baseline import BaselineRow, Option, RegressionBaseline
    from usbldr_cli.runs.job_store import JobResult
    from usbldr_cli.runs.jobs import Job
    from usbldr_cli.tables.check_verdicts import CheckedRow

FILES = ("config", "truth", "with", "msg_path")  # options whose value may be a file or folder beside the baseline


@click.command()
@click.argument("baseline", type=click.Path(path_type=Path))
@click.option("--update", is_flag=True, help="Show the differences and store the new values.")
@click.option("--jobs", "-j", type=click.IntRange(min=1), help="Runs in parallel.  [default: one per core]")
@json_option("result")
@click.option(
    "--markdown", "markdown_to", metavar="FILE", help="Write the result as a page for the summary of a CI run."
)
@click.option("--force", is_flag=True, help="Replace the files of --json and --markdown.")
@click.option("--quiet", "-q", is_flag=True, help="Print only the last line.")
def check(
    baseline: Path,
    update: bool,
    jobs: int | None,
    json_to: str | None,
    markdown_to: str | None,
    force: bool,
    quiet: bool,
) -> int:
    """Run the rows of BASELINE again; exit 1 if a metric is missing or worse than its limit allows.

    A missing row or log is a failure. A metric that is better by more than its limit passes, and is reported because
    the baseline is stale.

    \b
    $ usbldr check sample_logs/baseline.toml
    """
    from usbldr.io.settings.regression_baseline import read_baseline
    from usbldr_cli.tables.check_verdicts import as_json, markdown

    wanted = read_baseline(baseline)
    units = {row.name: _units(wanted.file, row) for row in wanted.rows}
    for option, target in (("--json", json_to), ("--markdown", markdown_to)):
        if target is not None and (option, target) != ("--json", "-"):
            _refuse(option, Path(target), force, wanted, units)
    checked = _checked(wanted, units, jobs or os.cpu_count() or 1)
    failed = not all(one.passed for one in checked)
    code = max(one.exit_code for one in checked) or (CheckError.exit_code if failed else 0)
    if markdown_to is not None:
        write_file("--markdown", Path(markdown_to), markdown(baseline.name, checked))
    if json_to is not None:
        write_json(json_to, as_json(baseline.name, checked, code))
    if json_to != "-":
        _print_result(checked, quiet, update)
    return _update(wanted, checked, show=json_to != "-") if update else code


def _refuse(
    option: str, file: Path, force: bool, baseline: "RegressionBaseline", units: "Mapping[str, Sequence[Job]]"
) -> None:
    """Refuse a file that is the baseline or an input of a row, or that is not empty."""
    if file.resolve() == baseline.file.resolve():
        raise UsageError(f"{file} is the baseline: choose another file for {option}")
    for unit in {unit.log: unit for cell in units.values() for unit in cell}.values():
        refuse_file(option, file, force, inputs(unit.log, read_request(**unit.selection)))
    refuse_file(option, file, force, ())


def _checked(baseline: "RegressionBaseline", units: "Mapping[str, Sequence[Job]]", jobs: int) -> "list[CheckedRow]":
    from usbldr_cli.runs.jobs import run_jobs

    outcomes = iter(run_jobs([unit for cell in units.values() for unit in cell], jobs))
    by_row = {name: [next(outcomes) for _ in cell] for name, cell in units.items()}
    return [_compared(baseline.file, row, units[row.name], by_row[row.name]) for row in baseline.rows]


def _units(file: Path, row: "BaselineRow") -> "list[Job]":
    from usbldr.filters.replay.methods import method_named
    from usbldr.io.scenarios.shipped import scenario_names
    from usbldr_cli.runs.jobs import Job

    try:
        method_named(row.filter)
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err
    choices, selection = _choices(file, row)
    beside = file.parent / row.log
    if not beside.exists() and row.log not in scenario_names():
        return []
    log = str(beside) if beside.exists() else row.log
    seeds = range(choices.seed, choices.seed + row.seeds)
    return [Job(log, row.filter, replace(choices, seed=seed), selection) for seed in seeds]


def _choices(file: Path, row: "BaselineRow") -> tuple[RunChoices, Mapping[str, Any]]:
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in _stated(file.parent, row.options)]
    try:
        return _run_of_a_row.main(arguments, prog_name="row", standalone_mode=False)
    except click.ClickException as err:
        raise UsageError(f"{file}: row {row.name!r}: {err.format_message()}") from err
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err


def _stated(folder: Path, options: "Mapping[str, Option]") -> "list[tuple[str, Option]]":
    """Return each option and value; a file is sought beside the baseline."""
    found: list[tuple[str, Option]] = []
    for name, stated in options.items():
        for value in stated if isinstance(stated, list) else [stated]:
            beside = folder / str(value)
            found.append((name, str(beside) if name.replace("-", "_") in FILES and beside.exists() else value))
    return found


@click.command(add_help_option=False)
@selection_options
@run_options
def _run_of_a_row(choices: RunChoices, **selection: Any) -> tuple[RunChoices, Mapping[str, Any]]:
    return choices, selection


def _compared(file: Path, row: "BaselineRow", units: "Sequence[Job]", outcomes: "Sequence[JobResult]") -> "CheckedRow":
    from usbldr.filters.replay.methods import METHODS
    from usbldr_cli.runs import seed_table
    from usbldr_cli.tables.check_verdicts import CheckedRow, compare_metric

    if not units:
        return CheckedRow(row, (), f"{file.parent / row.log}: no such log or scenario", CheckError.exit_code)
    bad = [outcome for outcome in outcomes if outcome.fault is not None]
    if bad:
        return CheckedRow(row, (), bad[0].fault, max(outcome.exit_code for outcome in bad))
    seeds = tuple(unit.choices.seed for unit in units)
    dives = units[0].simulated
    run = seed_table.ComparisonRow(
        row.log, row.filter, row.filter, seeds, tuple(outcomes), METHODS[row.filter].draws, dives
    )
    found = seed_table.row_metrics(run)
    lost = run.scored_against.lost if run.scored_against is not None else ()
    changes = tuple(compare_metric(name, metric, found.get(name)) for name, metric in row.metrics.items())
    return CheckedRow(row, changes, None, LogError.exit_code if lost else 0, lost)


def _print_result(checked: "Sequence[CheckedRow]", quiet: bool, update: bool) -> None:
    """Print the table and the last line, which is left out if the values are about to be replaced."""
    from usbldr_cli.tables.check_verdicts import notes, summary, table
    from usbldr_cli.tables.run_table import WIDTH, aligned, pairs

    if not quiet:
        click.echo(aligned(table(checked)) + "\n")
        if lines := notes(checked):
            click.echo(pairs(lines) + "\n")
    if not update:
        click.echo(textwrap.fill(summary(checked), WIDTH, break_long_words=False, break_on_hyphens=False))


def _update(baseline: "RegressionBaseline", checked: "Sequence[CheckedRow]", show: bool) -> int:
    from usbldr.io.settings.regression_baseline import with_new_values
    from usbldr_cli.tables.check_verdicts import MISSING

    absent = [
        one.row.name for one in checked if one.fault or one.lost or any(c.verdict == MISSING for c in one.changes)
    ]
    if absent:
        codes = [one.exit_code for one in checked]
        click.echo(f"usbldr: {baseline.file}: unchanged, because a metric is missing in {', '.join(absent)}", err=True)
        return max(*codes, CheckError.exit_code)
    text = with_new_values(baseline, [{c.metric: c.new for c in one.changes if c.new is not None} for one in checked])
    if text != baseline.text:
        write_file("--update", baseline.file, text)
    if show:
        click.echo(f"{baseline.file}: {'updated' if text != baseline.text else 'is up to date'}")
    return 0
