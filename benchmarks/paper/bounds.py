"""How good any filter and any smoother could be on a simulated dive: metres, east before north."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.bounds.dive_bounds import dive_bounds
from usbldr.filters.models.calibration import layout_for
from usbldr.filters.simulation.scenario import Scenario
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.types import Array, Vector
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.timeline import timeline

OF_SIGMA = math.sqrt(2 / math.pi)  # the mean |error| of a Gaussian


@dataclass(frozen=True, slots=True)
class Limits:
    """The least sigma at the M epochs at which errors are taken."""

    time_s: Vector  # (M,)
    filter_sd_m: Array  # (M, 2)
    smoother_sd_m: Array  # (M, 2)

    @property
    def filter_m(self) -> list[float]:
        """The least mean |east| and |north| of a filter."""
        return (OF_SIGMA * self.filter_sd_m.mean(axis=0)).tolist()

    @property
    def smoother_m(self) -> list[float]:
        """The least mean |east| and |north| of a smoother."""
        return (OF_SIGMA * self.smoother_sd_m.mean(axis=0)).tolist()


def limits(scenario: Scenario, calibrate: Sequence[str], seeds: Sequence[int]) -> Limits:
    """Return the bounds for the model that the filters are told, averaged over some dives (docs/studies/bounds.md)."""
    found = [_of_dive(scenario, calibrate, seed) for seed in seeds]
    return Limits(
        found[0].time_s,
        np.mean([one.filter_sd_m for one in found], axis=0),
        np.mean([one.smoother_sd_m for one in found], axis=0),
    )


def _of_dive(scenario: Scenario, calibrate: Sequence[str], seed: int) -> Limits:
    log = simulated_log(scenario, seed)
    line = timeline(log)
    bounds = dive_bounds(simulate(scenario, seed), line, replace(log.assumptions, calibrate=tuple(calibrate)))
    rows = layout_for(calibrate).rows("x", "y")
    filter_sd_m, smoother_sd_m = (np.sqrt(cov[line.slow][:, rows, rows]) for cov in bounds)
    return Limits(line.time_s[line.slow], filter_sd_m, smoother_sd_m)
