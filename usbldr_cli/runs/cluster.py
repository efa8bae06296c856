"""Runs on the workers of a Dask scheduler: docs/cluster.md says how to set one up.

The client sends tasks and takes results, and only the client writes. The scheduler gives the tasks of a lost worker to
another one; a task that ends four workers (Dask's allowed-failures) ends the command.
"""

import logging
import re
import warnings
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from usbldr.filters.errors import UsageError, UsbldrError
from usbldr_cli.runs.workers import KEPT, Result, Shared, Task

CONNECT_S = 10.0  # [s] to wait for a scheduler: a network that works answers within one
WORKERS_S = 60.0  # [s] to wait while there is no worker, as batch systems start and replace them
ADDRESS = re.compile(r"(tcp|tls)://[^/\s]+:\d+")


@contextmanager
def connected(address: str) -> "Generator[DaskCluster]":
    """Give the workers of a scheduler; raise UsageError without Dask, without an answer, or without a worker."""
    try:
        from distributed import Client
    except ImportError as err:
        raise UsageError("--scheduler needs Dask: pip install 'usbldr[cluster]'") from err
    if not ADDRESS.fullmatch(address):
        raise UsageError(f"--scheduler {address} is not an address such as tcp://host:8786")
    for name in ("distributed.client", "distributed.batched", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # the command says in a sentence what went wrong
    try:
        with warnings.catch_warnings(action="ignore"):  # Dask compares versions, which the workers do themselves
            client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as err:
        raise UsageError(
            f"--scheduler {address}: no Dask scheduler answered within {CONNECT_S:g} s: start one with `dask scheduler`"
            ", or check address and firewall"
        ) from err
    try:
        cluster = DaskCluster(client, address)
        cluster.require_workers()
        yield cluster
    finally:
        client.close(timeout=CONNECT_S)


@dataclass(frozen=True, slots=True)
class DaskCluster:
    """The workers of a scheduler, as a `workers.Executor`."""

    client: Any
    address: str
    elsewhere: bool = True

    @property
    def workers(self) -> int:
        """How many workers there are now."""
        return len(self.client.nthreads())

    def require_workers(self) -> None:
        """Wait for a worker; raise UsageError if none comes."""
        try:
            self.client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as err:
            raise UsageError(
                f"--scheduler {self.address}: has no workers, also after {WORKERS_S:g} s: start some with "
                f"`PYTHONSAFEPATH=1 dask worker {self.address} --nthreads 1 --death-timeout 60`, where this usbldr "
                f"is installed; {KEPT}"
            ) from err

    def finished(
        self, call: Callable[[Task, Shared], Result], tasks: Iterable[Task], shared: Shared
    ) -> Generator[tuple[int, Result]]:
        """Yield results as `Executor.finished` says, the first of them while later tasks are still sent."""
        done: SimpleQueue[Any] = SimpleQueue()
        common = self.client.submit(_itself, shared, pure=False)  # computed anew if its worker is lost
        waiting: dict[str, tuple[int, Any]] = {}  # the scheduler forgets a task that nobody holds
        for place, task in enumerate(tasks):
            future = self.client.submit(call_on_worker, call, task, common, pure=False)
            waiting[future.key] = place, future
            future.add_done_callback(done.put)
            while not done.empty():
                future = done.get()
                yield waiting.pop(future.key)[0], self._result(future, call)
        while waiting:
            try:
                future = done.get(timeout=CONNECT_S)
            except Empty:
                self._require_connection()
                self.require_workers()
                continue
            yield waiting.pop(future.key)[0], self._result(future, call)

    def _result(self, future: Any, call: Callable[..., Any]) -> Any:
        """Return the result of a finished task, or raise what ended it."""
        from distributed import CancelledError, KilledWorker

        try:
            return future.result(timeout=WORKERS_S)
        except KilledWorker as err:
            raise UsbldrError(
                f"a run ended {err.allowed_failures + 1} workers, probably because memory ran out: try fewer "
                f"--particles, or workers with more --memory-limit; {KEPT}"
            ) from err
        except (CancelledError, TimeoutError, OSError) as err:
            raise UsbldrError(self._lost) from err
        except (ImportError, RuntimeError) as err:  # the latter of a scheduler, which reads the tasks, too
            missing = err if isinstance(err, ImportError) else err.__cause__
            if not isinstance(missing, ImportError) or not call.__module__.startswith(missing.name or "-"):
                raise
            raise UsageError(
                f"--scheduler {self.address}: scheduler or workers cannot import {missing.name}: install this "
                "version of usbldr for all of them"
            ) from err

    def _require_connection(self) -> None:
        if self.client.status != "running":
            raise UsbldrError(self._lost)

    @property
    def _lost(self) -> str:
        return f"--scheduler {self.address}: the connection to the scheduler was lost; {KEPT}"


def _itself(shared: Shared) -> Shared:
    return shared


def call_on_worker(call: Callable[[Task, Shared], Result], task: Task, shared: Shared) -> Result:
    """Make a task on a worker; raise UsageError on one with several threads, which would wait for each other."""
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise UsageError(
            f"worker {worker.address} has {worker.state.nthreads} threads, which slow each other down: start workers "
            "with --nthreads 1, and as many of them with --nworkers"
        )
    return call(task, shared)
