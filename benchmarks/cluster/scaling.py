"""How a fleet of dives scales with the workers of a cluster: times measured here, the cluster simulated.

    python benchmarks/cluster/scaling.py --picture docs/cluster.png

Measured: reading a dive and running six filters on it (the recorded dive of `paper`, scaled to the length of each
dive); a task that does nothing, on a real Dask scheduler with one worker; storing a result. Simulated: the queue. The
scheduler gives out one task after the other, each worker makes one at a time, and the client stores one result after
the other.
"""

import argparse
import heapq
import operator
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import write_scenario
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs import jobs
from usbldr_cli.runs.cluster import connected
from usbldr_cli.runs.job_store import store_result
from usbldr_cli.runs.workers import Job

FILTERS = ("dr", "usbl", "ekf", "adf", "cpf", "upf")
CHOICES = RunChoices(100, None, 0, None, None, "auto", "start", 5.0, 1.0)
WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
HOURS = (0.5, 2.0)  # length of a dive, uniformly distributed
EMPTY = 500  # tasks that do nothing
RUNS = 3  # of each measurement; the least counts


class Costs(NamedTuple):
    """Seconds."""

    read: float  # of a dive of 1000 s
    filters: tuple[float, ...]  # over a dive of 1000 s
    task: float  # that the scheduler and the client spend on a task, one after the other
    store: float  # of a result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dives", type=int, default=1000)
    parser.add_argument("--picture", type=Path, help="PNG to write")
    options = parser.parse_args()
    costs = measured()
    print(
        f"reading a dive of 1000 s {costs.read:.3f} s; filters {sum(costs.filters):.2f} s "
        f"({', '.join(f'{name} {s:.3f}' for name, s in zip(FILTERS, costs.filters, strict=True))}); "
        f"an empty task {1e3 * costs.task:.1f} ms; storing a result {1e3 * costs.store:.1f} ms\n"
    )
    hours = np.random.default_rng(0).uniform(*HOURS, options.dives)
    by_dive = [makespan(costs, hours, count, whole_dives=True) for count in WORKERS]
    one_by_one = [makespan(costs, hours, count, whole_dives=False) for count in WORKERS]
    print("| workers | a dive per task | speed-up | a run per task | speed-up |\n|---|---|---|---|---|")
    for count, dive_s, run_s in zip(WORKERS, by_dive, one_by_one, strict=True):
        first = by_dive[0]
        print(f"| {count} | {reported(dive_s)} | {first / dive_s:.1f} | {reported(run_s)} | {first / run_s:.1f} |")
    if options.picture:
        draw(options.picture, by_dive, one_by_one, options.dives)


def reported(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def measured() -> Costs:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "dive.mcap"
        write_scenario(find_scenario("paper"), 0, log)
        units = [Job(str(log), name, CHOICES) for name in FILTERS]
        filters_s = tuple(least(lambda unit=unit: jobs.run_job(unit)) for unit in units)  # the dive is read already
        read_s = least(lambda: (jobs._open.cache_clear(), jobs._read.cache_clear(), jobs.run_job(units[0])))
        read_s -= filters_s[0]
        done = jobs.run_job(units[-1])
        assert done.outcome is not None
        outcome = done.outcome
        store_s = least(lambda: store_result(Path(folder), "key", outcome, done.trace))
    return Costs(read_s, filters_s, empty_task(), store_s)


def least(call: Callable[[], object]) -> float:
    found = []
    for _ in range(RUNS):
        began = time.process_time()
        call()
        found.append(time.process_time() - began)
    return min(found)


def empty_task() -> float:
    """Return the seconds that a task costs scheduler and client, beside what it does."""
    with scheduler() as address, connected(address) as where:
        for _ in where.finished(operator.eq, range(10), None):
            pass
        began = time.perf_counter()
        for _ in where.finished(operator.eq, range(EMPTY), None):
            pass
        return (time.perf_counter() - began) / EMPTY


@contextmanager
def scheduler() -> Iterator[str]:
    """Give the address of a scheduler of this machine with one worker."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    program = [sys.executable, "-m"]
    started = [
        subprocess.Popen([*program, "distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"], **quiet),
        subprocess.Popen([*program, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"], **quiet),
    ]
    try:
        yield address
    finally:
        for one in started:
            one.kill()
            one.wait()


def makespan(costs: Costs, hours: np.ndarray, workers: int, *, whole_dives: bool) -> float:
    """Return the seconds from the first task to the last stored result."""
    scale = hours * 3.6  # thousands of seconds
    runs = [[sum(costs.filters)]] if whole_dives else [[one] for one in costs.filters]
    tasks = [(k * costs.read + k * sum(filters), len(FILTERS) // len(runs)) for k in scale for filters in runs]
    free = [0.0] * workers
    ends = []
    for place, (seconds, results) in enumerate(tasks):
        begins = max(heapq.heappop(free), place * costs.task)
        heapq.heappush(free, begins + seconds)
        ends.append((begins + seconds, results))
    stored = 0.0
    for end, results in sorted(ends):
        stored = max(stored, end) + results * costs.store
    return stored


def draw(file: Path, by_dive: list[float], one_by_one: list[float], dives: int) -> None:
    from usbldr_cli.figures.style import in_style, save

    with in_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.2))
        axes = figure.subplots()
        axes.loglog(WORKERS, WORKERS, color="0.6", linestyle="--", label="as many times as fast as workers")
        axes.loglog(WORKERS, [by_dive[0] / s for s in by_dive], "o-", label="a dive per task (from 8 dives a worker)")
        axes.loglog(WORKERS, [by_dive[0] / s for s in one_by_one], "s-", label="a run per task")
        axes.set_xticks(WORKERS, [str(count) for count in WORKERS])
        axes.minorticks_off()
        axes.set_xlabel("workers")
        axes.set_ylabel("speed-up over one worker")
        axes.set_title(f"{dives:,} dives, {len(FILTERS)} filters")
        axes.legend()
        save(figure, file)


if __name__ == "__main__":
    main()
