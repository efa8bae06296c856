"""``usbldr replay``: run a filter over a log and write a run directory."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import CheckError, LogError, UsageError
from usbldr_cli.options.completion import FILE, FILTER, LOG
from usbldr_cli.options.log_options import request_and_inputs, selection_options
from usbldr_cli.options.option import (
    GroupedCommand,
    filter_option,
    log_option,
    option,
    scoring_option,
    warn_of_unused_options,
)
from usbldr_cli.options.output_files import (
    folder_option,
    json_option,
    name_of,
    refuse_file,
    require_free,
    toml_option,
    write_file,
)
from usbldr_cli.options.run_options import RunChoices, run_options
from usbldr_cli.options.verbosity import progress_option, verbose_option
from usbldr_cli.run_output import RunOutputs, print_run, run_outputs, say_findings, write_run

if TYPE_CHECKING:
    from usbldr.filters.identification.identification import Identification
    from usbldr.filters.replay.methods import Method
    from usbldr.filters.types import Timeline
    from usbldr.io.reports.run import Run


@click.command(cls=GroupedCommand)
@click.argument("log", metavar="LOG", type=LOG, required=False)
@selection_options
@filter_option(
    "--filter", "-f", "method", default="cpf", type=FILTER, metavar="NAME", help="Method, see Filters below."
)
@run_options
@folder_option("Run directory.  [default: LOG-FILTER]")
@option("--force", is_flag=True, help="Replace an existing run directory.")
@json_option("report")
@toml_option("--write-calibration", help="Write the estimated sensor errors as a configuration.", rare=True)
@scoring_option(
    "--leave-one-out",
    type=click.IntRange(min=1),
    metavar="N",
    help="Repeat the run without each of the N most influential fixes.",
    rare=True,
)
@scoring_option("--bound", is_flag=True, help="Scenarios only: add the Cramér-Rao bound of the error.", rare=True)
@run_outputs
@scoring_option(
    "--verify",
    type=FILE,
    metavar="RUN",
    help="Repeat a run by its directory or report.json; exit 1 if not the same.",
    rare=True,
)
@log_option("--strict", is_flag=True, help="Write nothing if a part of LOG cannot be read.", rare=True)
@option("--quiet", "-q", is_flag=True, help="Print only the last line.")
@verbose_option
@progress_option
def replay(
    method: str,
    choices: RunChoices,
    output: Path | None,
    force: bool,
    json_to: str | None,
    write_calibration: Path | None,
    leave_one_out: int | None,
    bound: bool,
    outputs: RunOutputs,
    verify: str | None,
    strict: bool,
    quiet: bool,
    log: str | None,
    **selection: Any,
) -> int:
    """Run a filter over LOG and report its east and north errors against the truth.

    Prints a table and writes a run directory with reports, tables, tracks and figures.

    \b
    $ usbldr replay dive.mcap --filter cpf
    """
    from usbldr.filters.replay.methods import method_named
    from usbldr.io.reports.run_directory import run_directory
    from usbldr.io.session import is_simulated, open_log, require_scenario
    from usbldr_cli.runs.one_run import RunPlan, finish_run, prepare_run

    if verify is not None:
        return _verify(Path(verify), log, quiet)
    if log is None:
        raise click.MissingParameter(ctx=click.get_current_context(), param_type="argument", param_hint="'LOG'")
    chosen = method_named(method)
    choices.settings()  # refuses wrong texts before the log is read
    request, read = request_and_inputs(log, **selection)
    if output is not None:
        require_free(output, read, force)
    refuse_file("--json", json_to, force, read, output)
    refuse_file("--write-calibration", write_calibration, force, read, output)
    if bound:
        require_scenario(log)
    warn_of_unused_options([method], is_simulated(log))
    plan = RunPlan(log, method, choices, selection, leave_one_out, bound)
    outputs.require_fitting(Path(log))
    opened = choices.edited(open_log(log, request, choices.seed))
    lost = [finding.text for finding in opened.findings if finding.lost_data]
    say_findings(opened, opened.findings, quiet)
    if strict and lost:
        raise LogError(lost[0])
    ready = prepare_run(plan, opened).without_headings()
    say_findings(opened, ready.log.findings[len(opened.findings) :], quiet)
    opened = ready.log
    if write_calibration is not None:
        _refuse_without_errors(chosen, ready.identification)
    if leave_one_out is not None:
        _refuse_without_shifts(chosen, ready.timeline)
    target = output or Path(f"{name_of(opened.path)}-{method}{'-smoothed' if choices.smooth else ''}")
    require_free(target, read, force)
    with run_directory(target, force) as folder:
        run = finish_run(plan, request, ready)
        write_run(folder, run, outputs)
        if write_calibration is not None:
            _write_calibration(write_calibration, run)
    print_run(run, target, json_to, quiet)
    if write_calibration is not None and not quiet and json_to != "-":
        click.echo(f"configuration for the next dive written to {write_calibration}")
    return LogError.exit_code if lost else 0


def _verify(report: Path, log: str | None, quiet: bool) -> int:
    """Repeat the run of a report and say whether it is the same."""
    from usbldr_cli.runs.repeat_run import verify

    ctx = click.get_current_context()
    for param in ctx.command.params:
        given = ctx.get_parameter_source(str(param.name)) is click.core.ParameterSource.COMMANDLINE
        if given and param.name not in ("log", "verify", "quiet", "plugin"):
            raise UsageError(f"--verify repeats the run of its report as it was: leave {param.opts[0]} out")
    found = verify(report, log)
    if found.differences and not quiet and found.environment_text:
        click.echo(found.environment_text)
    click.echo(found.verdict)
    return 0 if found.passed else CheckError.exit_code


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


def _write_calibration(file: Path, run: "Run") -> None:
    from usbldr.io.reports.calibration_config import calibrated_configuration

    text = calibrated_configuration(run.log, run.identification, run.scored.trajectory)
    write_file("--write-calibration", file, text)
