"""The first baseline of some logs: a row for each log and method, with the metrics that its run has."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import tomlkit

from usbldr.filters.replay.methods import METHODS, Method
from usbldr.io.settings.regression_baseline import Option
from usbldr_cli.options.unused_options import unused_options
from usbldr_cli.runs.baseline_rows import FILES, options_of_row, today, tool_text
from usbldr_cli.runs.job_store import JobResult, common_fault
from usbldr_cli.runs.run_jobs import run_jobs
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
