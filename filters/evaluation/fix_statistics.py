"""How good the fixes of a dive were, without any truth: shares, gaps, and their noise in range and bearing.

Between two fixes the vehicle moves by what its estimated velocity says, far better known than a fix. The displacement
from fix to fix less that motion is the difference of two errors: it holds the white part of the noise twice, and
nothing of an error that lasts. Differences beyond three sigmas, those of false fixes, are left out.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.types import Array, Mask, Trajectory, Vector

TO_SD = 1.4826  # fixed: 1-sigma over the median of the size, of a normal error
LONGEST_STEP = 3.0  # [1] times the median interval: fixes further apart are no pair
MIN_PAIRS = 20  # by judgement: sigmas to 25 %
TRIMMED_SIGMAS = 3.0  # of a difference: a larger one is a false fix
TRIMMED_VARIANCE = 0.9733  # fixed: of a normal error within TRIMMED_SIGMAS
RELATIVE_SD = 0.87  # [1] fixed: sqrt(1.5 / 2), of a sigma by n differences that share a fix each, times 1 / sqrt(n)
BINS = 3  # of slant or horizontal range, with equal numbers of fixes


NOISE_PARTS = ("range_m", "bearing_deg", "east_m", "north_m", "scatter")  # of FixStatistics, with fields of their own


class NoisePart(NamedTuple):
    """The 1-sigma of the white part of the noise, and its own 1-sigma."""

    sd: float
    sd_of_sd: float


class RangeShare(NamedTuple):
    """The share of good fixes within a span of horizontal range from the head."""

    from_m: float
    to_m: float
    fixes: int
    good_share: float


class FixScatter(NamedTuple):
    """Horizontal distances of the good fixes from a smoothed track, without what the track follows each fix."""

    drms_m: float
    cep50_m: float
    cep95_m: float
    drms_percent: float  # of the horizontal range; NaN without a known head


class FixStatistics(NamedTuple):
    """What the fixes of a dive were like."""

    fixes: int
    good_share: float  # neither rejected nor false
    interval_s: float  # median
    longest_gap_s: float
    range_m: NoisePart | None  # along the line from the head; None: too few pairs, or no known head
    bearing_deg: NoisePart | None
    east_m: NoisePart | None  # along the axes of the map
    north_m: NoisePart | None
    by_range: tuple[RangeShare, ...]
    scatter: FixScatter | None = None  # None: the track is not smoothed


def fix_statistics(
    time_s: Vector, position_m: Array, away_m: Array | None, good: Mask, track: Trajectory
) -> FixStatistics | None:
    """Return the statistics of fixes (n,) at east and north (n, 2) with a filter's track.

    ``away_m`` (n, 2) is where each lies from the head, if that is known. None if there are fewer than two good fixes,
    or if the track has no velocity.
    """
    moved = _moved(track, time_s)
    inside = good & np.isfinite(position_m).all(axis=1)
    if moved is None or int(inside.sum()) < 2:
        return None
    t = time_s[inside]
    step_s = np.diff(t)
    near = step_s <= LONGEST_STEP * np.median(step_s)
    error = (np.diff(position_m[inside], axis=0) - np.diff(moved[inside], axis=0))[near]
    east, north = (_white(axis) for axis in error.T)
    along = across = None
    shares: tuple[RangeShare, ...] = ()
    if away_m is not None:
        lengths = np.hypot(away_m[:, 0], away_m[:, 1])
        line = away_m[inside][1:][near]
        reach = np.maximum(lengths[inside][1:][near], 1e-6)
        unit = line / reach[:, None]
        along = _white(error[:, 0] * unit[:, 0] + error[:, 1] * unit[:, 1])
        across = _white(np.degrees((error[:, 0] * unit[:, 1] - error[:, 1] * unit[:, 0]) / reach))
        shares = _by_range(lengths, good)
    return FixStatistics(
        fixes=len(time_s),
        good_share=float(good.mean()),
        interval_s=float(np.median(step_s)),
        longest_gap_s=float(step_s.max()),
        range_m=along,
        bearing_deg=across,
        east_m=east,
        north_m=north,
        by_range=shares,
        scatter=_scatter(t, position_m[inside], None if away_m is None else away_m[inside], track),
    )


def _scatter(time_s: Vector, position_m: Array, away_m: Array | None, track: Trajectory) -> FixScatter | None:
    cov = track.position_cov_m2
    if not track.smoothed or cov is None:
        return None

    def at(values: Vector) -> Vector:
        return np.interp(time_s, track.time_s, values)

    x, y = track.position_m.T
    east, north = position_m[:, 0] - at(x), position_m[:, 1] - at(y)
    squared = east**2 + north**2
    # a smoothed track follows each fix: the residual has the fix's covariance less that of the track
    followed = 1 + float(np.mean(at(cov[:, 0, 0] + cov[:, 1, 1]))) / max(float(np.mean(squared)), 1e-12)
    away = np.sqrt(squared * followed)
    percent = float("nan")
    if away_m is not None:
        reach = np.maximum(np.hypot(away_m[:, 0], away_m[:, 1]), 1e-6)
        percent = 100 * float(np.sqrt(np.mean((away / reach) ** 2)))
    cep50, cep95 = np.quantile(away, [0.5, 0.95])
    return FixScatter(float(np.sqrt(np.mean(away**2))), float(cep50), float(cep95), percent)


def _moved(track: Trajectory, time_s: Vector) -> Array | None:
    """Return how far the vehicle has moved by its estimated velocity, east and north (n, 2), from the first epoch."""
    yaw, starboard, forward = (track.state(name) for name in ("psi", "u", "v"))
    if yaw is None or starboard is None or forward is None:
        return None
    velocity = rotated(yaw, np.column_stack([starboard, forward]))
    steps = (velocity[1:] + velocity[:-1]) / 2 * np.diff(track.time_s)[:, None]
    path = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moved = np.empty((len(time_s), 2))
    for axis in range(2):
        moved[:, axis] = np.interp(time_s, track.time_s, path[:, axis])
    return moved


def _white(difference: Vector) -> NoisePart | None:
    """Return the white part of the noise by differences of neighbours."""
    if len(difference) < MIN_PAIRS:
        return None
    kept = difference[np.abs(difference) <= TRIMMED_SIGMAS * TO_SD * float(np.median(np.abs(difference)))]
    sd = math.sqrt(float(np.mean(kept**2)) / TRIMMED_VARIANCE / 2)
    return NoisePart(sd, sd * RELATIVE_SD / math.sqrt(len(kept)))


def _by_range(lengths_m: Vector, good: Mask) -> tuple[RangeShare, ...]:
    known = np.isfinite(lengths_m)
    if int(known.sum()) < BINS:
        return ()
    edges = np.quantile(lengths_m[known], np.linspace(0, 1, BINS + 1))
    found: list[RangeShare] = []
    for k, (low, high) in enumerate(pairwise(edges)):
        here = known & (lengths_m >= low) & ((lengths_m < high) if k < BINS - 1 else (lengths_m <= high))
        if here.any():
            found.append(RangeShare(float(low), float(high), int(here.sum()), float(good[here].mean())))
    return tuple(found)
