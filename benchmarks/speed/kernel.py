"""What a step of each filter costs on NumPy and in the compiled kernel, in one process on one thread.

    python benchmarks/speed/kernel.py

Minutes of the scenario ``paper``. "Filter": from measurements to estimates and updates, everything that `run` does;
"kernel alone": inside the compiled code, for each variant that this machine runs. CPU times, the least of three runs.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.estimators import compiled
from usbldr.filters.kernel import KERNEL, Kernel
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

SECONDS = 120.0
SEVEN_ERRORS = ("scale", "misalignment", "heading", "deviation", "usbl-bias")  # 13 states with those of the motion
RUNS = 3
NUMPY = Kernel("numpy", "for comparison")


class Work(NamedTuple):
    """A filter to time."""

    name: str
    particles: int
    calibrate: tuple[str, ...]

    @property
    def label(self) -> str:
        of = f", {self.particles} particles" if self.particles > 1 else ""
        return f"{self.name}{of}, {13 if self.calibrate else 6} states"


WORK = [
    *(Work(name, 1, ()) for name in ("ekf", "ckf", "adf")),
    Work("adf", 1, SEVEN_ERRORS),
    *(Work("cpf", count, errors) for errors in ((), SEVEN_ERRORS) for count in (100, 1000)),
]


class Timed:
    """A function that adds up its own CPU time."""

    def __init__(self, call: Callable[..., int]) -> None:
        self.call, self.seconds = call, 0.0

    def __call__(self, *arguments: Any) -> int:
        began = time.process_time()
        status = self.call(*arguments)
        self.seconds += time.process_time() - began
        return status


def seconds(work: Work, kernel: Kernel, line: Timeline, parameters: Parameters) -> tuple[float, float]:
    """Return the CPU seconds of the filter, and those inside the kernel."""
    settings = FilterSettings(particles=work.particles, guard=False)
    parameters = replace(parameters, calibrate=work.calibrate)
    found: list[tuple[float, float]] = []
    for _ in range(RUNS):
        inside = Timed(kernel.advance) if kernel.advance is not None else None
        compiled.KERNEL = kernel._replace(advance=inside)
        began = time.process_time()
        run(work.name, line, parameters, settings)
        found.append((time.process_time() - began, inside.seconds if inside else 0.0))
    whole, alone = (min(column) for column in zip(*found, strict=True))
    return whole, alone


def rows(variants: list[Kernel], line: Timeline, parameters: Parameters) -> Iterator[list[str]]:
    for work in WORK:
        unit = 1e9 / (len(line.time_s) * work.particles) if work.particles > 1 else 1e6 / len(line.time_s)
        numpy_s, _ = seconds(work, NUMPY, line, parameters)
        each = [seconds(work, variant, line, parameters) for variant in variants]
        digits = 0 if work.particles > 1 else 1
        alone = [f"{unit * inside:,.{digits}f}" for _, inside in each]
        of_unit = "ns per particle and step" if work.particles > 1 else "µs per step"
        ratio = f"{numpy_s / each[0][0]:.1f}"
        yield [work.label, of_unit, f"{unit * numpy_s:,.0f}", f"{unit * each[0][0]:,.{digits}f}", ratio, *alone]


def main() -> None:
    """Print a table."""
    if os.environ.get("OMP_NUM_THREADS") != "1":  # has to be said before NumPy is there
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OMP_NUM_THREADS": "1"})
    if KERNEL.advance is None:
        sys.exit(f"kernel.py: {KERNEL.reason}")
    from usbldr.filters.kernel import _kernel

    log = simulated_log(replace(find_scenario("paper"), duration_s=SECONDS), seed=0)
    line = timeline(log)
    variants = [KERNEL._replace(name=name, variant=index) for name, index in _kernel.VARIANTS]
    heads = ["filter", "unit", "NumPy", f"kernel ({variants[0].name})", "ratio"]
    heads += [f"{variant.name} alone" for variant in variants]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for row in rows(variants, line, log.parameters):
        print("| " + " | ".join(row) + " |", flush=True)
    print(f"\n{np.round(len(line.time_s)):,} steps; NumPy {np.__version__}")


if __name__ == "__main__":
    main()
