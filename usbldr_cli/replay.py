"""``usbldr replay``: run a filter over a log and write a run directory."""

import math
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import LogError, UsageError, printable
from usbldr_cli.options.help_groups import GroupedCommand
from usbldr_cli.options.log_options import log_options, request_and_inputs
from usbldr_cli.options.output_files import json_option, refuse_file, write_file
from usbldr_cli.options.run_options import RunChoices, run_options
from usbldr_cli.run_output import print_run, write_run

if TYPE_CHECKING:
    from usbldr.filters.evaluation.influence import LeaveOneOut
    from usbldr.filters.identification.identification import Identification
    from usbldr.filters.replay.methods import Method
    from usbldr.filters.types import Timeline
    from usbldr.io.log import Log
    from usbldr.io.opening import Request
    from usbldr.io.reports.report_json import Run, ScoredTrack
    from usbldr.io.session import RunSettings


@click.command(cls=GroupedCommand)
@log_options
@click.option(
    "--filter",
    "-f",
    "method",
    default="cpf",
    show_default=True,
    metavar="NAME",
    help="Method, see Filters below.",
)
@run_options
@click.option("--output", "-o", type=click.Path(path_type=Path), help="Run directory.  [default: LOG-FILTER]")
@click.option("--force", is_flag=True, help="Replace an existing run directory.")
@json_option("report")
@click.option("--write-calibration", metavar="FILE", help="Write the estimated sensor errors as a configuration.")
@click.option(
    "--leave-one-out",
    type=click.IntRange(min=1),
    metavar="N",
    help="Repeat the run without each of the N most influential fixes.",
)
@click.option("--bound", is_flag=True, help="Scenarios only: add the Cramér-Rao bound of the error.")
@click.option(
    "--plots",
    type=click.Choice(["all", "none"]),
    default="all",
    show_default=True,
    help="Figures in the run directory; none saves about a second.",
)
@click.option("--strict", is_flag=True, help="Write nothing if a part of LOG cannot be read.")
@click.option("--quiet", "-q", is_flag=True, help="Print only the last line.")
def replay(
    method: str,
    choices: RunChoices,
    output: Path | None,
    force: bool,
    json_to: str | None,
    write_calibration: str | None,
    leave_one_out: int | None,
    bound: bool,
    plots: str,
    strict: bool,
    quiet: bool,
    **selection: Any,
) -> int:
    """Run a filter over LOG and report its east and north errors against the truth.

    Prints a table and writes a run directory with reports, tables, tracks and figures.

    \b
    $ usbldr replay dive.mcap --filter cpf
    """
    from usbldr.filters.replay.methods import method_named
    from usbldr.io.doctor.cross_check import convention_warnings
    from usbldr.io.inputs import output_conflict
    from usbldr.io.read import require
    from usbldr.io.reports.run_directory import run_directory
    from usbldr.io.session import not_a_filter, open_log, require_scenario, resolve
    from usbldr.io.timeline import timeline

    chosen = method_named(method)
    request, read = request_and_inputs(**selection)
    for option, file in (("--json", json_to), ("--write-calibration", write_calibration)):
        if file is not None and (option, file) != ("--json", "-"):
            refuse_file(option, Path(file), force, read, output)
    if bound:
        require_scenario(selection["log"])
    log = open_log(selection["log"], request, choices.seed)
    lost = [finding.text for finding in log.findings if finding.lost_data]
    for finding in log.findings:
        click.echo(f"usbldr: {printable(log.path.name)}: {finding.text} [{finding.code}]", err=True)
    if strict and lost:
        raise LogError(lost[0])
    require(log, chosen.sensors)
    if choices.aid is not None and not chosen.is_filter:
        raise UsageError(f"--aid {not_a_filter(method)}")
    dive_timeline = timeline(log, choices.fast_hz, choices.slow_hz)
    settings = choices.settings(log.start_ns)
    found = resolve(log, dive_timeline, method, settings)
    warnings = convention_warnings(log, dive_timeline)
    for finding in warnings:
        click.echo(f"usbldr: {printable(log.path.name)}: {finding.text} [{finding.code}]", err=True)
    log = replace(log, findings=(*log.findings, *warnings))
    if write_calibration is not None:
        _refuse_without_errors(chosen, found)
    if leave_one_out is not None:
        _refuse_without_shifts(chosen, dive_timeline)
    name = log.path.name if log.path.is_dir() else log.path.stem
    target = output or Path(f"{name}-{method}{'-smoothed' if choices.smooth else ''}")
    if what := output_conflict(target, read, inside=False):
        raise UsageError(f"{target} {what}: choose another --output")
    with run_directory(target, force) as folder:
        run = _run(method, log, dive_timeline, found, choices, settings, request)
        if bound:
            run = _with_bound(selection["log"], run)
        if leave_one_out is not None:
            run = _with_left_out(method, run, settings, leave_one_out)
        write_run(folder, run, plots)
        if write_calibration is not None:
            _write_calibration(Path(write_calibration), run)
    print_run(run, target, json_to, quiet)
    if write_calibration is not None and not quiet and json_to != "-":
        click.echo(f"configuration for the next dive written to {write_calibration}")
    return LogError.exit_code if lost else 0


def _refuse_without_errors(method: "Method", found: "Identification") -> None:
    if not method.is_filter:
        raise UsageError(f"--write-calibration: {method.name} is not a filter, so it estimates no sensor errors")
    if not found.parameters.calibrate:
        hint = "add --calibrate auto, or --calibrate with their names if it finds none"
        raise UsageError(f"--write-calibration: no sensor errors are estimated; {hint}")


def _refuse_without_shifts(method: "Method", dive_timeline: "Timeline") -> None:
    """Refuse --leave-one-out without fixes, or for a filter that does not report the effect of each fix."""
    from usbldr.filters.replay.methods import methods_that

    if method.smoother_transform is None:
        able = methods_that(lambda m: m.smoother_transform)
        raise UsageError(
            f"--leave-one-out: {method.name} does not report the effect of each fix (filters that do: {able})"
        )
    if not len(dive_timeline.fix_time_s):
        raise UsageError("--leave-one-out: the log has no USBL fix to leave out")


def _run(
    method: str,
    log: "Log",
    dive_timeline: "Timeline",
    found: "Identification",
    choices: RunChoices,
    settings: "RunSettings",
    request: "Request",
) -> "Run":
    from usbldr.io.opening import ConfigurationFile
    from usbldr.io.reports.report_json import Run
    from usbldr.io.session import reference_tracks

    references = reference_tracks(log, dive_timeline, method, settings, found)
    scored = _score(method, log, dive_timeline, found, settings)
    content = request.configuration.content if isinstance(request.configuration, ConfigurationFile) else None
    return Run(log, dive_timeline, found, scored, references, choices.order, choices.seed, asdict(choices), content)


def _score(
    method: str, log: "Log", dive_timeline: "Timeline", found: "Identification", settings: "RunSettings"
) -> "ScoredTrack":
    """Compute and score a track, with a progress bar if stderr is a terminal."""
    from usbldr.io.session import score

    with _bar(method, len(dive_timeline.time_s)) as progress:
        return score(log, dive_timeline, method, settings, found, progress)


@contextmanager
def _bar(label: str, total: int) -> "Generator[Callable[[int, int], None]]":
    with click.progressbar(length=total, label=label, file=sys.stderr, hidden=not sys.stderr.isatty()) as bar:
        yield lambda done, _: bar.update(done - bar.pos)


def _with_bound(scenario: str, run: "Run") -> "Run":
    """Return the run with the bound for the noise of the scenario and the states that the run estimated."""
    from usbldr.io.session import bound

    used = run.identification.parameters
    parameters = replace(run.log.parameters, calibrate=used.calibrate, aid=used.aid)
    return replace(run, bound=bound(scenario, run.timeline, parameters, run.seed))


def _with_left_out(method: str, run: "Run", settings: "RunSettings", count: int) -> "Run":
    from usbldr.filters.evaluation.influence import compare_without, most_influential, without_fix

    log, dive_timeline, (whole, report) = run.log, run.timeline, run.scored
    found: list[LeaveOneOut] = []
    for fix in most_influential(whole, count):
        try:
            other = _score(method, log, without_fix(dive_timeline, fix.row), run.identification, settings)
        except LogError as err:
            raise LogError(f"--leave-one-out, without the fix at {fix.time_s:.1f} s: {err}") from err
        change_m = math.nan
        if report is not None and other.report is not None:
            change_m = other.report.horizontal.mean_m - report.horizontal.mean_m
        found.append(compare_without(fix, whole, other.trajectory, change_m))
    return replace(run, without_fixes=tuple(found))


def _write_calibration(file: Path, run: "Run") -> None:
    from usbldr.io.reports.calibration_config import calibrated_configuration

    text = calibrated_configuration(run.log, run.identification, run.scored.trajectory)
    write_file("--write-calibration", file, text)
