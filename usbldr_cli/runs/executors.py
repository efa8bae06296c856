"""Where runs are made: in processes of this machine, or on the workers of a Dask scheduler (cluster.py).

An executor makes any function of a task in another process. It repeats the tasks of a process that was lost, and
passes an exception of the function on.
"""

import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from usbldr.filters.errors import UsageError, UsbldrError
from usbldr_cli.options.blas_threads import ONE_THREAD
from usbldr_cli.options.worker_options import WorkerChoices
from usbldr_cli.runs.workers import KEPT, Executor, Result, Shared, Task

MAX_DEATHS = 3  # of processes in succession, with no run finished between them: then the command ends
ENVIRONMENT = {**ONE_THREAD, "PYTHONSAFEPATH": "1"}  # nothing is imported from the current folder


@contextmanager
def executor(asked: WorkerChoices) -> "Generator[Executor]":
    """Give the workers that the options ask for; raise UsageError if they cannot be had."""
    if asked.scheduler is None:
        yield LocalProcesses(asked.jobs or os.cpu_count() or 1)
        return
    if asked.jobs is not None:
        raise UsageError("--jobs counts processes of this machine: leave it out with --scheduler")
    from usbldr_cli.runs.cluster import connected

    with connected(asked.scheduler) as cluster:
        yield cluster


@dataclass(frozen=True, slots=True)
class LocalProcesses:
    """Processes of this machine, one BLAS thread each, so that their number does not change a result."""

    workers: int
    elsewhere: bool = False

    def finished(
        self, call: Callable[[Task, Shared], Result], tasks: Iterable[Task], shared: Shared
    ) -> Generator[tuple[int, Result]]:
        """Yield results as `Executor.finished` says.

        If a process is killed from outside, the tasks left run again, half as many in parallel.
        """
        left, jobs, deaths = dict(enumerate(tasks)), self.workers, 0
        while left:
            done = 0
            with suppress(BrokenProcessPool), _pool(min(jobs, len(left)), shared) as submit:
                waiting = {submit(call, task): place for place, task in left.items()}
                for future in as_completed(waiting):
                    if not isinstance(future.exception(), BrokenProcessPool):
                        place, done = waiting.pop(future), done + 1
                        del left[place]
                        yield place, future.result()
            if left:
                deaths = 1 if done else deaths + 1
                jobs = max(1, jobs // 2)  # most likely memory ran out
            if deaths == MAX_DEATHS:
                raise UsbldrError(
                    f"a run was killed from outside {MAX_DEATHS} times, probably because memory ran out: try fewer "
                    f"--jobs or --particles; {KEPT}"
                )


@contextmanager
def _pool(jobs: int, shared: object) -> Generator[Callable[..., Future[Any]]]:
    """Give a function that submits to a pool; an interruption ends its processes without waiting."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)  # which a spawned process, and Python's resource tracker, take over
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _start, (shared,))
    try:
        yield functools.partial(pool.submit, _call)
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


_SHARED: list[Any] = []  # of a spawned process


def _start(shared: object) -> None:
    """Keep what all tasks share, ignore Ctrl-C, and end when the parent ends."""
    _SHARED[:] = [shared]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None  # this is a spawned process
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _call(call: Callable[[Task, Any], Result], task: Task) -> Result:
    return call(task, _SHARED[0])
