"""Jobs: one method on one log with one seed each, many at once on any executor (executors.py).

This process alone writes the store of finished runs. A result is stored under a digest of everything that it depends
on: records, assumptions (so the configuration, too), truth, the method, its options, and the code of the filters.
"""

import functools
import hashlib
import json
import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, fields, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.drills.drill import Drill, damaged
from usbldr.io.reading.remote import is_url, local_log
from usbldr.io.stages import say
from usbldr.io.writing import writing
from usbldr_cli.options.log_options import read_request
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.options.verbosity import progress
from usbldr_cli.runs.job_store import JobResult, ScoringContext, Trace, store_result, stored_results
from usbldr_cli.runs.worker_checks import (
    Expected,
    UnfitWorkerError,
    code_digest,
    expected,
    require_digest,
    require_log,
    require_software,
    with_whole_paths,
)
from usbldr_cli.runs.workers import Executor, Job

if TYPE_CHECKING:
    from usbldr.filters.types import Timeline
    from usbldr.io.log import Log

DIVES_PER_WORKER = 8  # [dives] from which a worker runs a whole dive: waiting for the last one costs an eighth at most


class FinishedJob(NamedTuple):
    """The result from a worker: None if it is in the store; ``key`` is None if it is not to be stored."""

    outcome: JobResult | None
    trace: Trace | None = None
    key: str | None = None


def relevant_choices(method: str, choices: RunChoices) -> RunChoices:
    """Return the choices without those that the method does not use: ekf has no particles, cpf no gate."""
    from usbldr.filters.replay.methods import method_named

    able = method_named(method)
    return replace(
        choices,
        particles=choices.particles if able.draws else 2,
        gate=choices.gate if able.takes_gate else None,
        guard=choices.guard if able.multiple_hypotheses else None,
        smooth=choices.smooth and able.smoother_transform is not None,
        dr_from=choices.dr_from if able.anchored else "start",
    )


def run_job(job: Job, stored: frozenset[str] = frozenset(), digest: str | None = None) -> FinishedJob:
    """Run a job, unless its result is among those ``stored``, given by their keys; a fault is a sentence in its result.

    With a ``digest``, raises UnfitWorkerError for a log with another one.
    """
    selection = tuple(sorted(job.selection.items()))
    choices = relevant_choices(job.method, job.choices)
    try:
        seeds = choices.seed if job.simulated else 0, choices.seed if job.drill.draws else 0
        epochs = RunChoices(fast_hz=choices.fast_hz, slow_hz=choices.slow_hz, exclude=choices.exclude)
        source = _read(job.log, selection, job.drill, seeds, epochs, digest)
        if job.examine:
            return FinishedJob(JobResult(findings=_codes(source.log)))
        if job.bound:
            return FinishedJob(_bound(job, source, choices))
        key = _key(source, job.method, choices)
        if key in stored:
            return FinishedJob(None, key=key)
        return FinishedJob(*_score_job(source, job.method, choices), key)
    except UnfitWorkerError:
        raise
    except UsbldrError as fault:
        return FinishedJob(JobResult(fault=str(fault), exit_code=fault.exit_code))


class _Source(NamedTuple):
    """A log as the filters see it."""

    log: "Log"
    dive_timeline: "Timeline"
    digest: str


@functools.lru_cache(maxsize=2)
def _open(log: str, selection: tuple[tuple[str, Any], ...], seed: int, digest: str | None) -> "Log":
    """Read a log, whose bytes must have the digest; successive drills on the same log share it."""
    from usbldr.io.session import open_log

    request = read_request(**dict(selection))
    with local_log(log, request) as path:
        if digest is not None:
            require_digest(log, path, dict(selection), digest)
        found = open_log(path, request, seed)
    return replace(found, path=Path(log)) if is_url(log) else found


@functools.lru_cache(maxsize=2)
def _read(
    log: str,
    selection: tuple[tuple[str, Any], ...],
    drill: Drill,
    seeds: tuple[int, int],
    choices: RunChoices,
    digest: str | None,
) -> _Source:
    """Return a log with faults, and its timeline; successive jobs with the same choices of epochs share them.

    The seeds are of dive and faults.
    """
    from usbldr.io.conventions.shown_noise import examined
    from usbldr.io.reading.epochs import timeline

    of_dive, of_faults = seeds
    found = examined(damaged(_open(log, selection, of_dive, digest), drill, of_faults))
    found = choices.edited(found)
    dive_timeline = timeline(found, choices.fast_hz, choices.slow_hz)
    return _Source(found, dive_timeline, _digest(found, dive_timeline))


def _codes(log: "Log") -> tuple[str, ...]:
    from usbldr.io.doctor.doctor import examine_log

    return tuple(dict.fromkeys(finding.code for finding in examine_log(log).findings))


def _bound(job: Job, source: _Source, choices: RunChoices) -> JobResult:
    from usbldr.io.session import bound, resolve

    used = resolve(source.log, source.dive_timeline, job.method, choices.settings()).parameters
    known = replace(source.log.parameters, calibrate=used.calibrate, aid=used.aid)
    return JobResult(bound(job.log, source.dive_timeline, known, choices.seed).metrics(job.choices.smooth))


def _score_job(source: _Source, method: str, choices: RunChoices) -> tuple[JobResult, Trace]:
    from usbldr.filters.replay.methods import method_named
    from usbldr.io.reading.read import require
    from usbldr.io.session import evaluate, replay

    log, dive_timeline = source.log, source.dive_timeline
    require(log, method_named(method).sensors)
    settings = choices.settings(log.start_ns)
    if log.truth is None:
        other = "or replay each log and compare their fixes: usbldr compare --fixes RUN..."
        raise LogError(f"{log.path}: no truth to measure errors against: name one with --truth FILE|TOPIC, {other}")
    trajectory = replay(log, dive_timeline, method, settings)
    report = evaluate(log, dive_timeline, trajectory, settings)
    context = ScoringContext(
        log=log.path.name,
        log_format=log.format,
        log_sha256=log.sha256,
        configuration=log.configuration.name if log.configuration else "",
        truth_kind=report.truth_kind,
        truth_source=report.truth_source,
        window_start_s=report.window.start_s if math.isfinite(report.window.start_s) else None,
        window_end_s=report.window.end_s if math.isfinite(report.window.end_s) else None,
        align=report.alignment.name,
        aid=report.aid,
        order=choices.order,
        lost=tuple(finding.text for finding in log.findings if finding.lost_data),
    )
    metrics = {name: value for name, value in report.flat().items() if value is not None and math.isfinite(value)}
    trace = Trace(report.time_s, report.estimate_m, report.truth_m, report.cov_m2)
    warnings, seconds = (*trajectory.warnings, *report.warnings), trajectory.seconds
    time_s = seconds if math.isfinite(seconds) else None
    return JobResult(metrics, warnings, scored_against=context, filter_time_s=time_s), trace


def _key(source: _Source, method: str, choices: RunChoices) -> str:
    """Return the digest of all that a result depends on; a deterministic method does not depend on the seed."""
    from usbldr.filters.replay.methods import method_named

    options = asdict(choices) | ({} if method_named(method).draws else {"seed": None})
    text = json.dumps([source.digest, source.log.path.name, method, options, code_digest()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _digest(log: "Log", dive_timeline: "Timeline") -> str:
    """Return the digest of records, truth, assumptions and the file that they come from."""
    digest = hashlib.sha256(repr((log.sha256, log.origin, log.parameters)).encode())
    for part in (dive_timeline, log.truth):
        for name, value in [] if part is None else [(f.name, getattr(part, f.name)) for f in fields(part)]:
            digest.update(name.encode())
            digest.update(value.tobytes() if hasattr(value, "tobytes") else repr(value).encode())
    return digest.hexdigest()


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
    stored = stored_results(store) if store is not None else {}
    outcomes: dict[int, JobResult] = {}
    places = _shares(jobs, where.workers)
    orders = (_order([jobs[k] for k in share], where.elsewhere) for share in places)
    finished = where.finished(run_order, orders, frozenset(stored))
    with progress("runs", len(jobs)) as advance, closing(finished):
        for share, found in finished:
            for k, (outcome, trace, key) in zip(places[share], found, strict=True):
                if outcome is None:
                    outcome = stored[str(key)]
                elif store is not None and key is not None:
                    with writing(store, "choose another --output"):
                        outcome = store_result(store, key, outcome, trace)
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
