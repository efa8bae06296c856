"""Filters of other libraries beside ours: the same dive, the same six-state model, one process on one thread.

    make peers

The dive is the scenario ``paper`` with seed 0. particles and ours take its mixture noise as it is; Kalman filters and
proposals take the Gaussian of the same variance. Each peer is used as its documentation says (kalman_peers.py). Times
are CPU times, the least of three runs, of all steps from measurements to estimates, without compilation. Ours run
without --guard, which the peers do not have. The table replaces what stands between the markers of docs/peers.md, and
peers.json has the numbers.
"""

import argparse
import importlib.util
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # speed is a package

from speed.kalman_peers import filterpy_ekf, stone_soup_ckf
from speed.peers_table import Row, compared, processor, table, write
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Noise
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.prior import prior
from usbldr.filters.replay.run import run
from usbldr.filters.replay.steps import steps
from usbldr.filters.simulation.simulate import leg_motion as true_motion
from usbldr.filters.types import Timeline
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.run_directory import write_atomically
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

WARM_UP = 50  # steps
RUNS = 3
POSITION = slice(4, 6)


class Modes(NamedTuple):
    """Noise of a scalar: a mixture of Gaussians."""

    probabilities: np.ndarray
    variances: np.ndarray


class Dive(NamedTuple):
    """The problem as arrays: T steps of psi, u, v, r, x, y."""

    log: Log
    line: Timeline
    dt_s: float
    mean: np.ndarray  # (6,) of the start
    sd: np.ndarray  # (6,)
    walk_sd: np.ndarray  # (6,) of the process noise of a step
    z: np.ndarray  # (T, 6) readings; NaN where a state was not read
    noise: dict[int, Modes]  # of each state that is read
    truth_m: np.ndarray  # (T, 2)

    @property
    def matched(self) -> dict[int, float]:
        """Variance of each state's readings."""
        return {row: float(one.probabilities @ one.variances) for row, one in self.noise.items()}


def dive(duration_s: float = 1000.0) -> Dive:
    scenario, layout = replace(find_scenario("paper"), duration_s=duration_s), StateLayout()
    log = simulated_log(scenario, seed=0)
    log = replace(log, parameters=replace(log.parameters, calibrate=()))
    line = timeline(log)
    start = prior(line, log.parameters, layout)
    z, noise = np.full((len(line.time_s), 6), np.nan), {}
    for step in steps(line, log.parameters, layout):
        for reading in step.measurements:
            rows = reading.model.rows
            assert rows is not None, "each scalar of this dive is of one state"
            z[step.epoch, rows] = reading.z
            for k, row in enumerate(range(rows.start, rows.stop)):
                noise[row] = marginal(reading.noise, k)
    dt_s = float(line.time_s[1] - line.time_s[0])
    walk_sd = np.sqrt(VehicleMotion(layout, log.parameters.process).noise(0.0, dt_s))
    sd = np.sqrt(start.cov.diagonal())
    return Dive(log, line, dt_s, start.mean, sd, walk_sd, z, noise, true_motion(scenario, line.time_s).position_m)


def marginal(noise: Noise, k: int) -> Modes:
    """Return the noise of one scalar of a reading, whose scalars are independent."""
    variances, place = np.unique(noise.cov[:, k, k], return_inverse=True)
    return Modes(np.bincount(place, noise.probabilities), variances)


def moved(x: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the states (6, N) a step later, without noise."""
    psi, u, v, r, east, north = x
    c, s = np.cos(psi + r * dt_s / 2), np.sin(psi + r * dt_s / 2)
    return np.stack([psi + r * dt_s, u, v, r, east + (u * c - v * s) * dt_s, north + (u * s + v * c) * dt_s])


def rmse_m(track: np.ndarray, truth: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.sum((track - truth[: len(track)]) ** 2, axis=1))))


def timed(name: str, work: Dive, particles: int, track: Callable[[], np.ndarray], runs: int = RUNS) -> Row:
    """Run a filter, which returns its positions (T, 2), and time it."""
    spent = []
    for _ in range(runs):
        began = time.process_time()
        found = track()
        spent.append(time.process_time() - began)
    return Row(name, particles, 1e9 * min(spent) / (particles * len(found)), rmse_m(found, work.truth_m))


def ours(work: Dive) -> Iterator[Row]:
    for name, count in (("cpf", 1000), ("cpf", 100), ("pf", 1000), ("ekf", 1), ("ckf", 1), ("adf", 1)):
        settings = FilterSettings(particles=count, guard=False)
        yield timed(name, work, count, lambda n=name, s=settings: run(n, work.line, work.log.parameters, s).position_m)


def of_kalman(work: Dive) -> Iterator[Row]:
    yield timed("filterpy ExtendedKalmanFilter", work, 1, lambda: filterpy_ekf(work, moved))
    count, steps = 100, 101
    name = "Stone Soup KalmanProposal, CKF"
    yield timed(name, work, count, lambda: stone_soup_ckf(work, moved, count, steps), runs=1)


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
                R = noise.variances
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--write", type=Path, nargs="*", default=[], help="pages whose markers take the table")
    options = parser.parse_args()
    if os.environ.get("OMP_NUM_THREADS") != "1":  # has to be said before NumPy is there
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OMP_NUM_THREADS": "1"})
    missing = [name for name in ("particles", "filterpy", "stonesoup") if importlib.util.find_spec(name) is None]
    if missing:
        sys.exit(
            f"peers.py: {', '.join(missing)} not installed, which this comparison is with: make peers installs them"
        )
    warnings.simplefilter("ignore")  # the libraries' own
    work = dive()
    found = compared([*ours(work), *of_particles(work), *of_kalman(work)])
    versions = {name: version(name) for name in ("usbldr", "numpy", "particles", "filterpy", "stonesoup")}
    reported = ", ".join(f"{name} {number}" for name, number in versions.items())
    made = f"{processor()}, kernel {KERNEL.name}, one thread; {reported}; `make peers`."
    print(f"{table(found, goals=True)}\n\n{made}")
    if options.json:
        content = {"processor": processor(), "kernel": KERNEL.name, "versions": versions, "rows": found}
        write_atomically(options.json, (json.dumps(content, indent=2) + "\n").encode())
    for file in options.write:
        write(file, f"{table(found, goals=False)}\n\n{made}")


if __name__ == "__main__":
    main()
