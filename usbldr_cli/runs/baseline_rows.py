"""The rows of a baseline as jobs, and the first baseline of some logs: a row for each log and method."""

import datetime
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import tomlkit

from usbldr.filters.errors import UsageError
from usbldr.filters.replay.methods import METHODS, Method, method_named
from usbldr.io.reading.remote import is_url
from usbldr.io.scenarios.shipped import scenario_names
from usbldr.io.settings.regression_baseline import BaselineRow, Option
from usbldr_cli.options.log_options import selection_options
from usbldr_cli.options.option import unused_options
from usbldr_cli.options.run_options import RunChoices, run_options
from usbldr_cli.runs.job_store import JobResult, common_fault
from usbldr_cli.runs.jobs import run_jobs
from usbldr_cli.runs.workers import Executor, Job

HEAD = """\
# `usbldr check` runs these rows again; `--update` stores new values.
# limit = abs + rel |value|. Errors fail if they grow beyond it, consistency if it moves beyond it either way.
schema = 1
"""
ERRORS = ("mean_abs_east_m", "mean_abs_north_m", "rmse_horizontal_m", "p95_horizontal_m")
EXACT = "rel = 0.001, abs = 0.0005"  # tracks without a filter repeat to the last bits of floating point
FILTERED = "rel = 0.01, abs = 0.001"  # without chance, but with the rounding of another machine
SAMPLED = "rel = 0.03, abs = 0.002"  # on another machine a draw may fall to the other side
CONSISTENCY = {"nees_mean": "rel = 0.05", "nis_mean_usbl": "rel = 0.02"}
COUNTED = "abs = 0"
FILES = ("config", "truth", "with", "msg_path")  # options whose value may be a file or folder beside the baseline


def first_baseline(
    file: Path, logs: Sequence[Job], methods: Sequence[str], given: Mapping[str, Option], where: Executor
) -> tuple[str, list[str]]:
    """Return the text of a baseline, and a sentence for each row that is left out because its run failed.

    ``logs`` have the choices of all rows, and ``given`` those that the rows state.
    Raises the error of its runs if all runs of a log fail.
    """
    jobs = [replace(log, method=name) for log in logs for name in methods]
    results = run_jobs(jobs, where)
    for first in range(0, len(jobs), len(methods)):
        of_log = results[first : first + len(methods)]
        if all(one.fault is not None for one in of_log):
            raise common_fault([one.fault for one in of_log], max(one.exit_code for one in of_log))
    rows = [_row(file, job, given, one) for job, one in zip(jobs, results, strict=True) if one.fault is None]
    signed = f"{HEAD}tool = {_text(tool_text())}\ndate = {today().isoformat()}\n"
    pairs = zip(jobs, results, strict=True)
    left_out = [f"{job.method} is left out: {one.fault}" for job, one in pairs if one.fault is not None]
    return "\n".join([signed, *rows]), left_out


def _row(file: Path, job: Job, given: Mapping[str, Option], result: JobResult) -> str:
    """Return the text of a row; the log and other files are named relative to the file's folder."""
    log = _beside(file, job.log)
    judged = result.scored_against
    digest = "" if judged is None or job.simulated else judged.log_sha256
    stated = {"name": f"{log} {job.method}", "log": log, "log_sha256": digest, "filter": job.method}
    lines = ["[[row]]", *(f"{key} = {_text(value)}" for key, value in stated.items() if value)]
    for key, value in given.items():
        if not unused_options(options_of_row([key]), [job.method], job.simulated):
            lines.append(f"{key} = {tomlkit.item(_stated(file, key, value)).as_string()}")
    lines.append("[row.metrics]")
    for name, limit in _limits(METHODS[job.method]).items():
        if name in result.metrics:
            lines.append(f"{name} = {{ value = {result.metrics[name]:.6g}, {limit} }}")
    return "\n".join(lines) + "\n"


def _stated(file: Path, key: str, value: Option) -> Option:
    """Return an option as the row states it."""
    if key not in FILES:
        return value
    return [_beside(file, one) for one in value] if isinstance(value, list) else _beside(file, str(value))


def _beside(file: Path, name: str) -> str:
    return Path(os.path.relpath(name, file.parent)).as_posix() if Path(name).exists() else name


def _text(value: str) -> str:
    return tomlkit.string(value).as_string()


def _limits(method: Method) -> dict[str, str]:
    """Return the tolerance of each metric of a row."""
    of_errors = SAMPLED if method.draws else FILTERED if method.is_filter else EXACT
    return dict.fromkeys(ERRORS, of_errors) | (CONSISTENCY if method.is_filter else {}) | {"matched": COUNTED}


def jobs_of_row(file: Path, row: BaselineRow) -> list[Job]:
    """Return a job for each seed of a row; none if there is no such log. Raise UsageError for a wrong row."""
    try:
        method_named(row.filter)
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err
    choices, selection = _choices(file, row)
    beside = file.parent / row.log
    if not (beside.exists() or is_url(row.log) or row.log in scenario_names()):
        return []
    log = str(beside) if beside.exists() else row.log
    seeds = range(choices.seed, choices.seed + row.seeds)
    return [Job(log, row.filter, replace(choices, seed=seed), selection) for seed in seeds]


def _choices(file: Path, row: BaselineRow) -> tuple[RunChoices, Mapping[str, Any]]:
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in stated_options(file.parent, row.options)]
    try:
        return _run_of_a_row.main(arguments, prog_name="row", standalone_mode=False)
    except click.ClickException as err:
        raise UsageError(f"{file}: row {row.name!r}: {err.format_message()}") from err
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err


def stated_options(folder: Path, options: Mapping[str, Option]) -> list[tuple[str, Option]]:
    """Return each option and value; a file is sought beside the baseline."""
    found: list[tuple[str, Option]] = []
    for name, stated in options.items():
        for value in stated if isinstance(stated, list) else [stated]:
            beside = folder / str(value)
            found.append((name, str(beside) if name.replace("-", "_") in FILES and beside.exists() else value))
    return found


def options_of_row(keys: Iterable[str]) -> list[click.Parameter]:
    """Return the options that a row states by these keys."""
    wanted = {f"--{key.replace('_', '-')}" for key in keys}
    return [param for param in _run_of_a_row.params if wanted & set(param.opts)]


def given_options() -> dict[str, Option]:
    """Return the options of a row that the command line states, as a row states them.

    Raises UsageError for a flag, which a row cannot hold.
    """
    ctx, found = click.get_current_context(), dict[str, Option]()
    for option in (param for param in _run_of_a_row.params if isinstance(param, click.Option)):
        name = str(option.name)
        if name not in ctx.params or ctx.get_parameter_source(name) is not click.core.ParameterSource.COMMANDLINE:
            continue
        key = option.opts[0].lstrip("-").replace("-", "_")
        if option.is_flag:
            raise UsageError(f"--{key} is a flag, which the row of a baseline cannot hold")
        value: Any = ctx.params[name]
        found[key] = list(value) if option.multiple else value
    return found


def tool_text() -> str:
    """Return who makes the values of a baseline."""
    return f"usbldr {version('usbldr')}"


def today() -> datetime.date:
    """Return the date in UTC."""
    return datetime.datetime.now(datetime.UTC).date()


@click.command(add_help_option=False)
@selection_options
@run_options
def _run_of_a_row(choices: RunChoices, **selection: Any) -> tuple[RunChoices, Mapping[str, Any]]:
    return choices, selection
