"""Find when the fixes begin to scatter otherwise: the ship's thrusters, a layer, or a vehicle that turns away."""

import math
from collections.abc import Sequence

import numpy as np

from usbldr.filters.identification.blocks import off_neighbours_m
from usbldr.filters.identification.changes import FoundChanges
from usbldr.filters.identification.identification import STRONG_ODDS
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.types import Timeline, Vector

LEAST_FIXES = 25  # before and after a change, for a median of each
NOTABLE_FACTOR = 1.5  # of the scatter of the fixes: the squares of their sigmas are then wrong by more than 2


def changes_of_noise(timeline: Timeline, given: Parameters) -> FoundChanges:
    """Return the times from which on the fixes scatter otherwise, by their sigmas, with Laplace's tails.

    How far fixes lie from their neighbours has Laplace's tails, whose scale is a mean: outliers are no change of it.
    """
    if len(timeline.fix_time_s) < 2 * LEAST_FIXES:
        return FoundChanges()
    off = np.linalg.solve(np.linalg.cholesky(timeline.fix_cov_m2), off_neighbours_m(timeline, given)[..., None])
    size = np.linalg.norm(off[..., 0].astype(np.float64), axis=1)
    each = math.log(STRONG_ODDS * len(size))
    begins = _begins(size, 0, each)
    parts = np.split(size, begins)
    changes = tuple(
        SensorChange(
            float(timeline.fix_time_s[fix]), 0.0, 0.0, fix_sd_scale=float(np.median(part) / np.median(parts[0]))
        )
        for fix, part in zip(begins, parts[1:], strict=True)
    )
    return FoundChanges(changes, len(changes) * each)


def _begins(size: Vector, first: int, log_odds: float) -> list[int]:
    """Return the fixes with which parts begin, ascending, of fixes (n,) from ``first`` on.

    Parts are parted again where the likelihood is larger by what is against a change, at the likeliest fix.
    """
    count = len(size)
    if count < 2 * LEAST_FIXES:
        return []
    before, tiny = np.cumsum(size), np.finfo(float).tiny  # fixes without noise
    n = np.arange(LEAST_FIXES, count - LEAST_FIXES + 1)
    mean = np.maximum([before[n - 1] / n, (before[-1] - before[n - 1]) / (count - n)], tiny)
    cost = n * np.log(mean[0]) + (count - n) * np.log(mean[1])
    fix = int(n[np.argmin(cost)])
    usual = [float(np.median(part)) for part in (size[:fix], size[fix:])]
    gained = count * math.log(max(size.mean(), tiny)) - float(cost.min())
    if max(usual) < NOTABLE_FACTOR * min(usual) or not all(usual) or gained < log_odds:
        return []
    return [*_begins(size[:fix], first, log_odds), first + fix, *_begins(size[fix:], first + fix, log_odds)]


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
