"""Many runs at once: each job is one method on one log with one seed, and finished jobs are stored.

Jobs run in processes of their own, one BLAS thread each, so that the number of parallel jobs does not change a result.
A result is stored under a digest of everything that it depends on: records, assumptions (so the configuration, too),
truth, the method, its options, and the code of the filters.
"""

import functools
import hashlib
import json
import math
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.drills.drill import UNDAMAGED, Drill, damaged
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.code_digest import code_digest
from usbldr_cli.runs.job_store import JobResult, JobStore, ScoringContext, Trace

if TYPE_CHECKING:
    from usbldr.filters.types import Timeline
    from usbldr.io.log import Log

MAX_DEATHS = 3  # of processes in succession, with no run finished between them: then the command ends
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@dataclass(frozen=True, slots=True)
class Job:
    """One run. The seed in ``choices`` is that of the filter and, for a scenario, of the dive."""

    log: str  # as the user gave it: a file, a folder, or else a scenario
    method: str
    choices: RunChoices
    selection: Mapping[str, Any] = field(default_factory=dict[str, Any])  # values of options.selection_options
    bound: bool = False  # compute the least error of a filter that estimates the same states, and run nothing
    drill: Drill = UNDAMAGED  # faults that are put into the log, by the same seed
    examine: bool = False  # list the findings of the doctor, and run nothing

    @property
    def simulated(self) -> bool:
        """Whether each seed is a dive of its own."""
        from usbldr.io.session import is_simulated

        return is_simulated(self.log)


class _FinishedJob(NamedTuple):
    """The result from a worker; ``key`` is None if it is not to be stored."""

    outcome: JobResult
    trace: Trace | None
    key: str | None


def relevant_choices(method: str, choices: RunChoices) -> RunChoices:
    """Return the choices without those that the method does not use: ekf has no particles, cpf no gate."""
    from usbldr.filters.replay.methods import METHODS

    able = METHODS[method]
    return replace(
        choices,
        particles=choices.particles if able.draws else 2,
        gate=choices.gate if able.takes_gate else None,
        guard=choices.guard if able.multiple_hypotheses else None,
        smooth=choices.smooth and able.smoother_transform is not None,
        dr_from=choices.dr_from if able.anchored else "start",
    )


def run_jobs(units: Sequence[Job], jobs: int, store: Path | None = None) -> list[JobResult]:
    """Run the jobs, ``jobs`` in parallel, and return their results in the same order.

    A fault of a job is a sentence in its result and does not stop the others. With a ``store``, an existing folder,
    finished jobs are written there and read from there later, also after an interruption. If a process is killed from
    outside, the jobs left run again, half as many in parallel; raises UsbldrError if that does not help.
    """
    kept = JobStore(store) if store is not None else None
    outcomes: dict[int, JobResult] = {}
    deaths = 0
    with _bar(len(units)) as advance:
        while left := [k for k in range(len(units)) if k not in outcomes]:
            with suppress(BrokenProcessPool), _workers(min(jobs, len(left))) as submit:
                waiting = {submit(units[k], kept): k for k in left}
                for future in as_completed(waiting):
                    if isinstance(future.exception(), BrokenProcessPool):
                        continue
                    done = future.result()
                    outcomes[waiting[future]] = done.outcome
                    if kept is not None and done.key is not None:
                        outcomes[waiting[future]] = kept.write(done.key, done.outcome, done.trace)
                    advance()
            if len(outcomes) < len(units):
                deaths = deaths + 1 if len(outcomes) + len(left) == len(units) else 1
                jobs = max(1, jobs // 2)  # most likely memory ran out
            if deaths == MAX_DEATHS:
                raise UsbldrError(
                    f"a run was killed from outside {MAX_DEATHS} times, probably because memory ran out: try fewer "
                    "--jobs or --particles; with --output, finished runs are kept"
                )
    return [outcomes[k] for k in range(len(units))]


@contextmanager
def _workers(jobs: int) -> "Generator[Callable[[Job, JobStore | None], Future[_FinishedJob]]]":
    """Give a function that submits to a pool; an interruption ends its processes without waiting."""
    if jobs < 1:
        yield lambda unit, kept: Future()
        return
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by the BLAS of a spawned process
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _init_worker)
    try:
        yield functools.partial(pool.submit, _run)
    except BaseException:  # also on Ctrl-C: end the workers before the error goes on
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _init_worker() -> None:
    """Ignore Ctrl-C, and end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None  # this is a spawned process
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


@contextmanager
def _bar(total: int) -> Generator[Callable[[], None]]:
    """Show how many runs are done, if stderr is a terminal."""
    hidden = total < 2 or not sys.stderr.isatty()
    with click.progressbar(length=total, label="runs", file=sys.stderr, hidden=hidden, show_pos=True) as bar:
        bar.update(0)
        yield lambda: bar.update(1)


def _run(unit: Job, kept: JobStore | None) -> _FinishedJob:
    selection = tuple(sorted(unit.selection.items()))
    choices = relevant_choices(unit.method, unit.choices)
    try:
        seeds = choices.seed if unit.simulated else 0, choices.seed if unit.drill.draws else 0
        source = _read(unit.log, selection, unit.drill, seeds, choices.fast_hz, choices.slow_hz)
        if unit.examine:
            return _FinishedJob(JobResult(findings=_codes(source.log)), None, None)
        if unit.bound:
            return _FinishedJob(_bound(unit, source, choices), None, None)
        key = _key(source, unit.method, choices)
        if kept is not None and (outcome := kept.read(key)) is not None:
            return _FinishedJob(outcome, None, None)
        return _FinishedJob(*_score_job(source, unit.method, choices), key)
    except UsbldrError as fault:
        return _FinishedJob(JobResult(fault=str(fault), exit_code=fault.exit_code), None, None)


class _Source(NamedTuple):
    """A log as the filters see it."""

    log: "Log"
    dive_timeline: "Timeline"
    digest: str


@functools.lru_cache(maxsize=2)
def _open(log: str, selection: tuple[tuple[str, Any], ...], seed: int) -> "Log":
    """Read a log; successive drills on the same log share it."""
    from usbldr.io.session import open_log
    from usbldr_cli.options.log_options import read_request

    return open_log(log, read_request(**dict(selection)), seed)


@functools.lru_cache(maxsize=2)
def _read(
    log: str,
    selection: tuple[tuple[str, Any], ...],
    drill: Drill,
    seeds: tuple[int, int],
    fast_hz: float,
    slow_hz: float,
) -> _Source:
    """Return a log with faults, and its timeline; successive jobs share them. The seeds are of dive and faults."""
    from usbldr.io.conventions.implausible import without_implausible
    from usbldr.io.timeline import timeline

    of_dive, of_faults = seeds
    found = without_implausible(damaged(_open(log, selection, of_dive), drill, of_faults))
    dive_timeline = timeline(found, fast_hz, slow_hz)
    return _Source(found, dive_timeline, _digest(found, dive_timeline))


def _codes(log: "Log") -> tuple[str, ...]:
    from usbldr.io.doctor.doctor import examine_log

    return tuple(dict.fromkeys(finding.code for finding in examine_log(log).findings))


def _bound(unit: Job, source: _Source, choices: RunChoices) -> JobResult:
    from usbldr.io.session import bound, resolve

    used = resolve(source.log, source.dive_timeline, unit.method, choices.settings()).parameters
    known = replace(source.log.parameters, calibrate=used.calibrate, aid=used.aid)
    return JobResult(bound(unit.log, source.dive_timeline, known, choices.seed).metrics(unit.choices.smooth))


def _score_job(source: _Source, method: str, choices: RunChoices) -> tuple[JobResult, Trace]:
    from usbldr.filters.replay.methods import METHODS
    from usbldr.io.read import require
    from usbldr.io.session import evaluate, replay

    log, dive_timeline = source.log, source.dive_timeline
    require(log, METHODS[method].sensors)
    settings = choices.settings(log.start_ns)
    if log.truth is None:
        raise LogError(f"{log.path}: no truth to measure errors against: name one with --truth FILE|TOPIC")
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
    from usbldr.filters.replay.methods import METHODS

    options = asdict(choices) | ({} if METHODS[method].draws else {"seed": None})
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
