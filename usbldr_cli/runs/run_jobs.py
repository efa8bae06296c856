"""Many runs at once, on any executor (executors.py); this process alone writes the store of finished runs."""

from collections.abc import Sequence
from contextlib import closing
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from usbldr.io.stages import say
from usbldr.io.writing import writing
from usbldr_cli.options.verbosity import progress
from usbldr_cli.runs.job_store import JobResult, JobStore
from usbldr_cli.runs.jobs import FinishedJob, run_job
from usbldr_cli.runs.worker_checks import Expected, expected, require_log, require_software, with_whole_paths
from usbldr_cli.runs.workers import Executor, Job

DIVES_PER_WORKER = 8  # [dives] from which a worker runs a whole dive: waiting for the last one costs an eighth at most


class Order(NamedTuple):
    """Runs that one worker makes one after the other."""

    jobs: tuple[Job, ...]
    expected: Expected | None = None  # what a worker elsewhere has to have


def run_jobs(jobs: Sequence[Job], where: Executor, store: Path | None = None) -> list[JobResult]:
    """Run the jobs and return their results in the same order.

    A fault of a job is a sentence in its result and does not stop the others. With a ``store``, an existing folder,
    finished jobs are written there and read from there later, also after an interruption. Raises UsbldrError if workers
    are lost again and again, UnfitWorkerError for a worker elsewhere with other code or files, StorageError for a
    full disk.
    """
    kept = JobStore(store) if store is not None else None
    stored = kept.read_all() if kept is not None else {}
    outcomes: dict[int, JobResult] = {}
    places = _shares(jobs, where.workers)
    orders = (_order([jobs[k] for k in share], where.elsewhere) for share in places)
    finished = where.finished(run_order, orders, frozenset(stored))
    with progress("runs", len(jobs)) as advance, closing(finished):
        for share, found in finished:
            for k, (outcome, trace, key) in zip(places[share], found, strict=True):
                if outcome is None:
                    outcome = stored[str(key)]
                elif kept is not None and key is not None:
                    with writing(kept.folder, "choose another --output"):
                        outcome = kept.write(key, outcome, trace)
                outcomes[k] = outcome
                say(_outcome_text(jobs[k], outcome))
                advance(len(outcomes))
    return [outcomes[k] for k in range(len(jobs))]


def _shares(jobs: Sequence[Job], workers: int) -> list[list[int]]:
    """Return the places of the jobs that go to one worker together.

    With many dives for each worker these are all successive jobs of a dive, which is read once; else one job.
    """

    def dive(k: int) -> tuple[Any, ...]:
        job = jobs[k]
        return job.log, sorted(job.selection.items()), job.choices.seed if job.simulated else 0

    dives = [list(group) for _, group in groupby(range(len(jobs)), key=dive)]
    return dives if len(dives) >= DIVES_PER_WORKER * workers else [[k] for k in range(len(jobs))]


def _order(jobs: Sequence[Job], elsewhere: bool) -> Order:
    if not elsewhere:
        return Order(tuple(jobs))
    return Order(tuple(with_whole_paths(job) for job in jobs), expected(jobs[0]))


def _outcome_text(job: Job, outcome: JobResult) -> str:
    """Return what became of a job: of which method, log and seed, and what it gave."""
    what = f"{'doctor' if job.examine else job.method} on {job.log}, seed {job.choices.seed}"
    drilled = f", {job.drill.name}" if job.drill.faults else ""
    if outcome.fault is not None:
        return f"{what}{drilled}: {outcome.fault}"
    mean_m = outcome.metrics.get("mean_horizontal_m")
    error = "" if mean_m is None else f": mean horizontal error {mean_m:.2f} m"
    return f"{what}{drilled}{error}{' (finished before)' if outcome.reused else ''}"


def run_order(order: Order, stored: frozenset[str]) -> list[FinishedJob]:
    """Run the jobs of an order on a worker; ``stored`` are the keys of the results that the client has."""
    digest = None
    if order.expected is not None:
        require_software(order.expected)
        require_log(order.jobs[0].log, order.expected)
        digest = order.expected.digest
    return [run_job(job, stored, digest) for job in order.jobs]
