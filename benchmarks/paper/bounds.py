"""How good any filter and any smoother could be on a simulated dive: metres, east before north."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usbldr.filters.bounds.dive_bounds import PositionBound, position_bound
from usbldr.filters.simulation.scenario import Scenario
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.simulated_log import simulated_log


def limits(scenario: Scenario, calibrate: Sequence[str], seeds: Sequence[int]) -> PositionBound:
    """Return the bounds for the model that the filters assume, averaged over some dives (docs/studies/bounds.md)."""
    found = [_of_dive(scenario, calibrate, seed) for seed in seeds]
    return PositionBound(
        found[0].time_s,
        np.mean([one.filter_sd_m for one in found], axis=0),
        np.mean([one.smoother_sd_m for one in found], axis=0),
    )


def _of_dive(scenario: Scenario, calibrate: Sequence[str], seed: int) -> PositionBound:
    log = simulated_log(scenario, seed)
    parameters = replace(log.parameters, calibrate=tuple(calibrate))
    return position_bound(simulate(scenario, seed), timeline(log), parameters)
