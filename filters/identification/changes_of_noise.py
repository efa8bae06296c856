"""Find when the fixes begin to scatter otherwise: the ship's thrusters, a layer, or a vehicle that turns away."""

import math
from collections.abc import Sequence

import numpy as np

from usbldr.filters.identification.blocks import off_neighbours_m
from usbldr.filters.identification.changes import FoundChanges
from usbldr.filters.identification.identification import STRONG_ODDS
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.types import Timeline

LEAST_FIXES = 25  # before and after a change, for a median of each
NOTABLE_FACTOR = 1.5  # of the scatter of the fixes: the squares of their sigmas are then wrong by more than 2


def change_of_noise(timeline: Timeline, given: Parameters) -> FoundChanges:
    """Return the likeliest time from which on the fixes scatter otherwise, by their sigmas, with Laplace's tails.

    How far fixes lie from their neighbours has Laplace's tails, whose scale is a mean: outliers are no change of it.
    """
    if len(timeline.fix_time_s) < 2 * LEAST_FIXES:
        return FoundChanges()
    off = np.linalg.solve(np.linalg.cholesky(timeline.fix_cov_m2), off_neighbours_m(timeline, given)[..., None])
    size, count = np.linalg.norm(off[..., 0].astype(np.float64), axis=1), len(off)
    first = np.arange(LEAST_FIXES, count - LEAST_FIXES + 1)  # of those after
    before, tiny = np.cumsum(size)[first - 1], np.finfo(float).tiny  # fixes without noise
    mean = np.maximum([before / first, (size.sum() - before) / (count - first)], tiny)
    fix = int(first[np.argmin(first * np.log(mean[0]) + (count - first) * np.log(mean[1]))])
    usual = [float(np.median(part)) for part in (size[:fix], size[fix:])]
    if max(usual) < NOTABLE_FACTOR * min(usual) or not all(usual):
        return FoundChanges()
    factor = usual[1] / usual[0]
    start_s = float(timeline.fix_time_s[fix])
    return FoundChanges((SensorChange(start_s, 0.0, 0.0, fix_sd_scale=factor),), math.log(STRONG_ODDS * count))


def with_noise(changed: Sequence[SensorChange], of_noise: Sequence[SensorChange]) -> tuple[SensorChange, ...]:
    """Return changes with those of the noise of the fixes among them."""
    found = list[SensorChange]()
    for start_s in sorted({one.start_s for one in (*changed, *of_noise)}):
        of_sensors, of_fixes = (
            max((one for one in some if one.start_s <= start_s), default=SensorChange(start_s, 0.0, 0.0))
            for some in (changed, of_noise)
        )
        found.append(of_sensors._replace(start_s=start_s, fix_sd_scale=of_fixes.fix_sd_scale))
    return tuple(found)
