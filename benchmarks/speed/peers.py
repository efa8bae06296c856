"""The particle filters of the library `particles` beside ours: the same dive, the same six-state model, one thread.

The dive is the scenario ``paper`` with seed 0, its mixture noise taken as it is. Times are CPU times of one process
with one BLAS thread.

    pip install . numba joblib scikit-learn && pip install --no-deps particles
    python benchmarks/speed/peers.py

(`particles` 0.4 asks for a NumPy below 2, which it does not need: hence --no-deps.) It is no dependency of usbldr.
"""

import importlib.util
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # paper is a package

from paper.readings import ROWS
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Noise
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.simulation.simulate import leg_motion as true_motion
from usbldr.filters.types import Timeline
from usbldr.io.log import Log
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.timeline import timeline

WARM_UP = 50  # steps
POSITION = slice(4, 6)


class Dive(NamedTuple):
    """The problem as arrays: T steps of psi, u, v, r, x, y."""

    log: Log
    line: Timeline
    dt_s: float
    mean: np.ndarray  # (6,) of the start
    sd: np.ndarray  # (6,)
    walk_sd: np.ndarray  # (6,) of the process noise of a step
    z: np.ndarray  # (T, 6) readings; NaN where a state was not read
    noise: dict[int, Noise]  # of the reading of each state that is read
    truth_m: np.ndarray  # (T, 2)

    @property
    def matched(self) -> dict[int, float]:
        """Variance of each state's readings."""
        return {row: float(noise.mixture_cov[0, 0]) for row, noise in self.noise.items()}


class Row(NamedTuple):
    """A line of the table."""

    name: str
    particles: int
    ns: float  # per particle and step
    rmse_m: float  # horizontal


def dive() -> Dive:
    scenario, layout = find_scenario("paper"), StateLayout()
    log = simulated_log(scenario, seed=0)
    line = timeline(log)
    start = prior(line, log.parameters, layout)
    z, noise = np.full((len(line.time_s), 6), np.nan), {}
    for step in steps(line, log.parameters, layout):
        for reading in step.measurements:
            rows = reading.model.rows
            assert rows is not None, "each reading of this dive is of one state"
            z[step.epoch, rows.start], noise[rows.start] = reading.z[0], reading.noise
    dt_s = float(line.time_s[1] - line.time_s[0])
    walk_sd = np.sqrt(VehicleMotion(layout, log.parameters.process).noise(0.0, dt_s))
    sd = np.sqrt(start.cov.diagonal())
    return Dive(log, line, dt_s, start.mean, sd, walk_sd, z, noise, true_motion(scenario, line.time_s).position_m)


def moved(x: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the states (6, N) a step later, without noise."""
    psi, u, v, r, east, north = x
    c, s = np.cos(psi + r * dt_s / 2), np.sin(psi + r * dt_s / 2)
    return np.stack([psi + r * dt_s, u, v, r, east + (u * c - v * s) * dt_s, north + (u * s + v * c) * dt_s])


def rmse_m(track: np.ndarray, truth: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.sum((track - truth[: len(track)]) ** 2, axis=1))))


def timed(name: str, work: Dive, particles: int, track: Callable[[], np.ndarray]) -> Row:
    """Run a filter, which returns its positions (T, 2), and time it."""
    began = time.process_time()
    found = track()
    spent = time.process_time() - began
    return Row(name, particles, 1e9 * spent / (particles * len(found)), rmse_m(found, work.truth_m))


def ours(work: Dive) -> Iterator[Row]:
    METHODS.update(ROWS)
    for label, name, count in (
        ("usbldr cpf", "cpf", 100),
        ("usbldr cpf", "cpf", 1000),
        ("usbldr cpf-gaussian", "cpf-gaussian", 1000),
        ("usbldr cpf-literal", "cpf-literal", 100),
        ("usbldr pf (bootstrap)", "pf", 1000),
        ("usbldr adf (no particles)", "adf", 1),
    ):
        settings = FilterSettings(particles=count)
        yield timed(label, work, count, lambda n=name, s=settings: run(n, work.line, work.log.parameters, s).position_m)


def of_particles(work: Dive) -> Iterator[Row]:
    """The bootstrap filter, and the guided one whose proposal is optimal for the matched Gaussian."""
    import particles
    from particles import distributions as dists
    from particles import state_space_models as models

    class Reading(dists.ProbDist):
        """Density of one epoch's readings at each particle's states x, (N, 6)."""

        dim = 6

        def __init__(self, x: np.ndarray) -> None:
            self.x = x

        def logpdf(self, z: np.ndarray) -> np.ndarray:
            total = np.zeros(len(self.x))
            for row in np.flatnonzero(np.isfinite(z)):
                e, noise = z[row] - self.x[:, row], work.noise[row]
                R = noise.cov[:, 0, 0]
                modes = np.log(noise.probabilities / np.sqrt(2 * np.pi * R))[:, None] - e * e / (2 * R[:, None])
                total += np.logaddexp.reduce(modes, axis=0)
            return total

    class Vehicle(models.StateSpaceModel):
        def PX0(self):  # noqa: N802 - the library's name
            return dists.MvNormal(loc=work.mean, scale=work.sd)

        def PX(self, t, xp):  # noqa: N802
            return dists.MvNormal(loc=moved(xp.T, work.dt_s).T, scale=work.walk_sd)

        def PY(self, t, xp, x):  # noqa: N802
            return Reading(x)

        def proposal0(self, data):
            return self._guided(work.mean[None], work.sd, data[0])

        def proposal(self, t, xp, data):
            return self._guided(moved(xp.T, work.dt_s).T, work.walk_sd, data[t])

        def _guided(self, mean, sd, z):
            """Every reading is of one state, so each state is updated alone."""
            information = np.zeros(6)
            for row in np.flatnonzero(np.isfinite(z)):
                information[row] = 1 / work.matched[row]
            variance = 1 / (1 / sd**2 + information)
            return dists.MvNormal(
                loc=mean + variance * information * (np.nan_to_num(z) - mean), scale=np.sqrt(variance)
            )

    def track(made: type, count: int, length: int) -> np.ndarray:
        np.random.seed(0)  # noqa: NPY002 - the library draws from the global generator
        algorithm = particles.SMC(fk=made(ssm=Vehicle(), data=work.z[:length]), N=count)
        return np.array([algorithm.W @ algorithm.X[:, POSITION] for _ in algorithm])

    track(models.Bootstrap, 1000, WARM_UP)  # compiles the resampling
    for name, made in (("bootstrap", models.Bootstrap), ("guided", models.GuidedPF)):
        yield timed(f"particles {name}", work, 1000, lambda m=made: track(m, 1000, len(work.z)))


def main() -> None:
    if os.environ.get("OMP_NUM_THREADS") != "1":  # has to be said before NumPy is there
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OMP_NUM_THREADS": "1"})
    if importlib.util.find_spec("particles") is None:
        sys.exit(
            "peers.py: particles is not installed, which this comparison is with: "
            "pip install numba joblib scikit-learn && pip install --no-deps particles"
        )
    warnings.simplefilter("ignore")  # the library's own
    work = dive()
    rows = [*ours(work), *of_particles(work)]
    unit = rows[1].ns
    print(f"{'filter':32} {'particles':>9} {'ns/particle/step':>17} {'of our cpf':>11} {'rmse m':>7}")
    for row in rows:
        print(f"{row.name:32} {row.particles:9} {row.ns:17,.0f} {row.ns / unit:10,.2f}x {row.rmse_m:7.3f}")
    print(f"our cpf: that of {rows[1].particles} particles; rmse: horizontal")


if __name__ == "__main__":
    main()
