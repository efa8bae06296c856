"""The rows of a baseline run again, each metric beside its stored value."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from usbldr.filters.errors import CheckError, LogError
from usbldr.filters.replay.methods import METHODS
from usbldr.io.settings.regression_baseline import BaselineRow, RegressionBaseline
from usbldr_cli.runs import seed_table
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.run_jobs import run_jobs
from usbldr_cli.runs.workers import Executor, Job
from usbldr_cli.tables.check_verdicts import CheckedRow, compare_metric


def checked_rows(baseline: RegressionBaseline, jobs: Mapping[str, Sequence[Job]], where: Executor) -> list[CheckedRow]:
    """Run every row, ``jobs`` by row name, and compare its metrics with the stored ones."""
    outcomes = iter(run_jobs([job for cell in jobs.values() for job in cell], where))
    by_row = {name: [next(outcomes) for _ in cell] for name, cell in jobs.items()}
    return [_compared(baseline.file, row, jobs[row.name], by_row[row.name]) for row in baseline.rows]


def _compared(file: Path, row: BaselineRow, jobs: Sequence[Job], outcomes: Sequence[JobResult]) -> CheckedRow:
    if not jobs:
        return CheckedRow(row, (), f"{file.parent / row.log}: no such log or scenario", CheckError.exit_code)
    bad = [outcome for outcome in outcomes if outcome.fault is not None]
    if bad:
        return CheckedRow(row, (), bad[0].fault, max(outcome.exit_code for outcome in bad))
    seeds = tuple(job.choices.seed for job in jobs)
    dives = jobs[0].simulated
    run = seed_table.ComparisonRow(
        row.log, row.filter, row.filter, seeds, tuple(outcomes), METHODS[row.filter].draws, dives
    )
    found = seed_table.row_metrics(run)
    judged = outcomes[0].scored_against
    digest, lost = ("", ()) if judged is None else (judged.log_sha256, judged.lost)
    digest = "" if dives else digest  # the last bits of a simulated log depend on the machine
    other = bool(row.log_sha256 and digest) and row.log_sha256 != digest
    changes = tuple(compare_metric(name, metric, found.get(name), other) for name, metric in row.metrics.items())
    worst = max(range(len(seeds)), key=lambda k: outcomes[k].metrics.get("mean_horizontal_m", 0.0))
    return CheckedRow(row, changes, None, LogError.exit_code if lost else 0, lost, digest, worst_seed=seeds[worst])
