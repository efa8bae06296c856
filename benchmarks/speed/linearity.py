"""How time grows with the number of particles and with the length of a log: both must be linear.

    python benchmarks/speed/linearity.py [--output docs/studies/speed]

CPU seconds of the filter alone, from its first measurement to its table of updates, on one thread: `cpf` with 100 to
100,000 particles over 1000 steps, and `adf` and `cpf` with 100 particles over 1000 s to 24 h at 5 Hz; the scenario
``paper`` and its noise. Writes linearity.png and prints a table. A day of `cpf` takes some minutes.
"""

import argparse
import os
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

STEPS_S = 200.0  # 1000 steps
PARTICLES = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000)
LENGTHS_S = (1_000.0, 3_600.0, 10_800.0, 28_800.0, 86_400.0)
PASSES_S = 1.0  # [s] the shortest runs are repeated for so long, so that the clock tells them


def dive(seconds: float) -> tuple[Log, Timeline]:
    """Return a log of the scenario ``paper`` of this length."""
    paper = find_scenario("paper")
    (leg,) = paper.legs
    log = simulated_log(replace(paper, duration_s=seconds, legs=(replace(leg, duration_s=seconds),)), seed=0)
    return log, timeline(log)


def seconds(method: str, log: Log, line: Timeline, particles: int = 100) -> float:
    """Return the CPU seconds of a run."""
    began, count = time.process_time(), 0
    while count == 0 or time.process_time() - began < PASSES_S:
        run(method, line, replace(log.parameters, calibrate=()), FilterSettings(particles=particles))
        count += 1
    return (time.process_time() - began) / count


def main() -> None:
    """Print a table, and write the figure."""
    if os.environ.get("OMP_NUM_THREADS") != "1":  # has to be said before NumPy is there
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OMP_NUM_THREADS": "1"})
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/studies/speed"), help="folder of the figure")
    parser.add_argument("--longest", type=float, default=LENGTHS_S[-1], help="longest log, seconds")
    parser.add_argument("--most", type=int, default=PARTICLES[-1], help="most particles")
    chosen = parser.parse_args()

    log, line = dive(STEPS_S)
    steps = len(line.time_s)
    counts = [count for count in PARTICLES if count <= chosen.most]
    of_count = [seconds("cpf", log, line, count) for count in counts]
    print("| cpf, particles | s | ns per particle and step |\n|---|---|---|")
    for count, taken in zip(counts, of_count, strict=True):
        print(f"| {count:,} | {taken:.3g} | {1e9 * taken / count / steps:.0f} |", flush=True)
    lengths = [length for length in LENGTHS_S if length <= chosen.longest]
    of_length: dict[str, list[float]] = {"adf": [], "cpf": []}
    print("\n| length | epochs | adf, s | cpf, s | µs per epoch | memory so far, MB |\n|---|---|---|---|---|---|")
    for length in lengths:
        log, line = dive(length)
        for method, taken in of_length.items():
            taken.append(seconds(method, log, line))
        last = [taken[-1] for taken in of_length.values()]
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        each = ", ".join(f"{1e6 * one / len(line.time_s):.1f}" for one in last)
        print(
            f"| {length:g} s | {len(line.time_s):,} | {last[0]:.3g} | {last[1]:.3g} | {each} | {peak:.0f} |", flush=True
        )
    figure(chosen.output, counts, of_count, lengths, of_length)


def figure(
    folder: Path, counts: list[int], of_count: list[float], lengths: list[float], of_length: dict[str, list[float]]
) -> None:
    """Draw both on logarithmic axes, with the straight line through the middle point of each."""
    import matplotlib.pyplot as plt

    drawn, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    curves = [(left, "cpf", [float(count) for count in counts], of_count)]
    curves += [(right, method, lengths, taken) for method, taken in of_length.items()]
    for axes, method, x, taken in curves:
        middle = len(x) // 2
        marks = axes.loglog(x, taken, "o", label=method)
        axes.loglog(
            x,
            [taken[middle] * one / x[middle] for one in x],
            color=marks[0].get_color(),
            lw=1,
            label=f"{method}, linear",
        )
    left.set(xlabel="particles", ylabel="CPU time of the filter (s)", title="1000 steps")
    right.set(xlabel="length of the log (s)", ylabel="CPU time of the filter (s)", title="5 Hz; cpf with 100 particles")
    for axes in (left, right):
        axes.legend()
        axes.grid(alpha=0.3)
    folder.mkdir(parents=True, exist_ok=True)
    drawn.savefig(folder / "linearity.png", dpi=130)


if __name__ == "__main__":
    main()
