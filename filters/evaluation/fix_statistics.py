"""How good the fixes of a dive were, without any truth: shares, gaps, their noise and their scatter.

Fixes less the way that the estimated velocity gives are the errors of the fixes, an offset, and what a constant error
of heading, speed or current makes of the way. Without the last ones, `slow_noise` tells the part of the noise that is
new at each fix from that which lasts. The scatter is that around a track which leaves each fix out.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from usbldr.filters.evaluation.slow_noise import MOST, SlowNoise, slow_noise
from usbldr.filters.frames import rotated
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.types import Array, Mask, Trajectory, Vector
from usbldr.filters.updates import UpdateTable
from usbldr.filters.usbl_survey.verdict import Scatter, scatter_of
from usbldr.filters.windows import columns_at, integrated

MIN_FIXES = 20  # by judgement: three for each shape that is projected out
FALSE_SIGMAS = 4.0  # of a fix from the line between its neighbours: a false one, 6 in 100,000 of good ones
LEAST_OWN = 0.05  # [1] of a fix's variance: the least that a track may leave to it
NO_WEIGHT = 1e-6  # [1] of a fix that was left out: its variance is a million times larger
BINS = 3  # of slant or horizontal range, with equal numbers of fixes


class RangeShare(NamedTuple):
    """The share of good fixes within a span of horizontal range from the head."""

    from_m: float
    to_m: float
    fixes: int
    good_share: float


class FixStatistics(NamedTuple):
    """What the fixes of a dive were like."""

    fixes: int
    good_share: float  # neither rejected nor down-weighted
    outliers: int  # the others
    interval_s: float  # median
    longest_gap_s: float
    range_m: SlowNoise | None  # along the line from the head; None: too few fixes, or no known head
    bearing_deg: SlowNoise | None
    east_m: SlowNoise | None  # along the axes of the map
    north_m: SlowNoise | None
    by_range: tuple[RangeShare, ...]
    scatter: Scatter | None = None  # around a track that leaves each fix out; None: the track is not smoothed


def fix_statistics(
    time_s: Vector,
    position_m: Array,
    away_m: Array | None,
    good: Mask,
    track: Trajectory,
    cov_m2: Array | None = None,
    drop_m: Vector | float = 0.0,
) -> FixStatistics | None:
    """Return the statistics of fixes (n,) at east and north (n, 2) with a filter's track.

    ``away_m`` (n, 2) is where each lies from the head, if that is known; ``drop_m`` (n,) how deep below it; ``cov_m2``
    (n, 2, 2) the covariance that the filter assumed. None if there are fewer than two good fixes, or if the track has
    no velocity.
    """
    moved = _moved(track, time_s)
    inside = good & np.isfinite(position_m).all(axis=1)
    if moved is None or int(inside.sum()) < 2:
        return None
    step_s = np.diff(time_s[inside])
    judged = good | ((time_s >= track.time_s[0]) & (time_s <= track.time_s[-1]))
    east, north = (_noise(time_s, position_m, moved, inside, axis) for axis in np.eye(2))
    along, across, shares = None, None, ()
    if away_m is not None:
        # to the track: by its own line, no fix would have an error of bearing
        to_track = away_m - position_m + columns_at(time_s, track.time_s, track.position_m)
        reach, *axes = sight(to_track)
        along, across = (_noise(time_s, position_m, moved, inside, axis) for axis in axes)
        shares = _by_range(reach[judged], good[judged])
    residual = left_out_residuals(time_s, position_m, track, cov_m2) if track.smoothed and cov_m2 is not None else None
    return FixStatistics(
        fixes=int(judged.sum()),
        good_share=float(good[judged].mean()),
        outliers=int((judged & ~good).sum()),
        interval_s=float(np.median(step_s)),
        longest_gap_s=float(step_s.max()),
        range_m=along,
        bearing_deg=across,
        east_m=east,
        north_m=north,
        by_range=shares,
        scatter=None if residual is None else _scatter(residual, away_m, good, drop_m),
    )


def sight(away_m: Array) -> tuple[Vector, Array, Array]:
    """Return horizontal ranges (n,), and axes of range and of bearing in degrees per metre (n, 2), of places (n, 2)."""
    reach = np.maximum(np.hypot(away_m[:, 0], away_m[:, 1]), 1e-6)
    line = away_m / reach[:, None]
    return reach, line, np.degrees(line[:, ::-1] * [1, -1] / reach[:, None])


def left_out_residuals(time_s: Vector, position_m: Array, track: Trajectory, cov_m2: Array) -> Array | None:
    """Return fixes less a track that leaves each of them out, (n, 2); NaN where it does not reach.

    Of a smoothed track x with covariance P and a fix z = H x + noise of covariance R, the track without it is
    x - P H' (R - H P H')^-1 (z - H x): an update that takes the fix back. The R of a fix that was weighted down is
    larger by the probability of the nominal noise. Of a filter's own track it is the innovation, which leaves out later
    fixes, too. None if the track has neither.
    """
    fixes = UpdateTable.of(track.updates).of_sensor("usbl")
    if not track.smoothed or track.cov is None:
        found = np.full((len(time_s), 2), np.nan)
        found[fixes.row] = fixes.vectors("innovation")
        return found if len(fixes) else None
    place = np.array([track.names.index(name) for name in ("x", "y")])
    bias = [track.names.index(name) for name in STATES["usbl-bias"] if name in track.names]
    measured = [place, np.array(bias)] if bias else [place]
    rows = np.clip(np.searchsorted(track.time_s, time_s), 0, len(track.time_s) - 1)
    cov, mean = track.cov[rows], columns_at(time_s, track.time_s, track.mean)
    if track.open_cov_m2 is not None:
        cov[:, place[:, None], place] -= track.open_cov_m2[rows]
    of_place = sum(cov[:, place[:, None], of] for of in measured)  # (n, 2, 2) P H' of the position
    of_fix = sum(cov[:, one[:, None], of] for one in measured for of in measured)
    residual = position_m - sum(mean[:, of] for of in measured)
    weight = np.ones(len(time_s))
    weight[fixes.row] = np.where(fixes.outcome == "rejected", 0.0, fixes.nominal_probability)
    cov_m2 = cov_m2 / np.maximum(weight, NO_WEIGHT)[:, None, None]
    own = _at_least(cov_m2 - of_fix, LEAST_OWN * cov_m2)
    taken_back = np.einsum("nij,nj->ni", of_place, np.linalg.solve(own, residual[..., None])[..., 0])
    found = position_m - mean[:, place] + taken_back
    found[(time_s < track.time_s[0]) | (time_s > track.time_s[-1])] = np.nan
    return found


def _at_least(cov: Array, least: Array) -> Array:
    """Return covariances (n, 2, 2), in the axes of ``least`` no smaller than it."""
    root = np.linalg.cholesky(least)
    back = np.linalg.inv(root)
    size, axes = np.linalg.eigh(back @ cov @ np.swapaxes(back, 1, 2))
    return root @ (axes * np.maximum(size, 1.0)[:, None, :]) @ np.swapaxes(root @ axes, 1, 2)


def _scatter(residual_m: Array, away_m: Array | None, good: Mask, drop_m: Vector | float) -> Scatter | None:
    there = good & np.isfinite(residual_m).all(axis=1)
    if not there.any():
        return None
    flat_m = np.full(len(there), np.nan) if away_m is None else np.hypot(away_m[:, 0], away_m[:, 1])
    return scatter_of(residual_m[there], np.hypot(flat_m, np.nan_to_num(drop_m))[there])


def _moved(track: Trajectory, time_s: Vector) -> Array | None:
    """Return how far the vehicle has moved by its estimated velocity, east and north (n, 2), from the first epoch."""
    yaw, starboard, forward = (track.state(name) for name in ("psi", "u", "v"))
    if yaw is None or starboard is None or forward is None:
        return None
    velocity = rotated(yaw, np.column_stack([starboard, forward]))
    return columns_at(time_s, track.time_s, integrated(track.time_s, velocity))


def _noise(time_s: Vector, position_m: Array, moved_m: Array, used: Mask, axis: Array) -> SlowNoise | None:
    """Return the noise of fixes along an axis, (2,) or one for each fix (n, 2); None: too few, or too few times."""
    if int(used.sum()) < MIN_FIXES:
        return None
    axis = np.broadcast_to(axis, position_m.shape)[used]
    t, moved = time_s[used] - time_s[used][0], moved_m[used]
    error = position_m[used] - moved
    values = np.sum(error * axis, axis=1)
    turned = moved[:, ::-1] * [-1, 1]
    of_way = [np.sum(way * axis, axis=1) for way in (moved, turned)]
    shapes = np.column_stack([axis, *of_way, t[:, None] * axis])  # offset, errors of speed and heading, current
    share = ((t[1:-1] - t[:-2]) / np.maximum(t[2:] - t[:-2], 1e-9))[:, None]
    bend = np.sum((error[1:-1] - (1 - share) * error[:-2] - share * error[2:]) * axis[1:-1], axis=1)
    kept = np.abs(bend) <= FALSE_SIGMAS * TO_SD * np.median(np.abs(bend)) + 1e-12
    kept = np.concatenate([[True], kept, [True]])
    enough = int(kept.sum()) >= MIN_FIXES and np.any(np.diff(t[kept][:MOST]) > 0)
    return slow_noise(t[kept], values[kept], shapes[kept]) if enough else None


def _by_range(lengths_m: Vector, good: Mask) -> tuple[RangeShare, ...]:
    known = np.isfinite(lengths_m)
    lengths_m, good = lengths_m[known], good[known]
    if len(lengths_m) < BINS:
        return ()
    edges = np.quantile(lengths_m, np.linspace(0, 1, BINS + 1))
    of_span = np.minimum(np.searchsorted(edges, lengths_m, side="right") - 1, BINS - 1)
    spans = [(low, high, good[of_span == k]) for k, (low, high) in enumerate(pairwise(edges.tolist()))]
    return tuple(RangeShare(low, high, len(of), float(of.mean())) for low, high, of in spans if len(of))
