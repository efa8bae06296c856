"""Fit dead reckoning to the USBL fixes, without truth: rotation, scale, delays and outliers.

The turn and shift between the two tracks are the closed form of S. Umeyama, IEEE Trans. PAMI 13(4), 1991,
doi:10.1109/34.88573, with P. J. Huber's weights against outliers. The small errors come from one regression, with
J. W. Tukey's biweight; standard deviations come from leaving out parts of the log (B. Efron's jackknife).

Positions are complex numbers here, east + i north, in metres: a counter-clockwise rotation is a factor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.replay.dead_reckoning import displacement_m
from usbldr.filters.types import Array, Indices, Timeline, Vector

Points: TypeAlias = NDArray[np.complex128]  # (n,) east + i north

SEGMENT_S = 120.0  # drift within a segment is small against the motion
JACKKNIFE_BLOCKS = 8  # of the log, left out one by one
TRIED_LATENCIES_S = tuple(float(s) for s in range(-4, 5))  # delays of fixes are seconds; the fit refines the best
MIN_FIXES = 20  # with fewer there is no fit
MOST_DELAY_S = 10.0  # by judgement: later fixes are not used (MAX_FIX_DELAY_S)
GROSS_SIGMAS = 6.0  # of the scatter of all residuals: a normal error is as large once in 10^8 fixes
RAYLEIGH_MEDIAN = 1.1774  # fixed: median of a Rayleigh distribution
STEPS = np.array([1e-4, 1e-4, 1.0, 1.0])  # of central differences: rad, 1, s, s; a DVL's noise hides in a second
PRIOR_SD = np.array([np.pi, 0.1, 5.0, 2.0])
MIN_EIGENVALUE = 0.01  # of the correlations of the columns; below it they are not separable
LIMITS = np.array([np.inf, 0.5, MOST_DELAY_S, MOST_DELAY_S])


@dataclass(frozen=True, slots=True)
class RotationFit:
    """Dead reckoning rotated and shifted to F fixes: fix(t) = rotation * dr(t - latency) + shift of its group."""

    latency_s: float  # the best of those tried
    rotation_rad: float  # counter-clockwise
    residual_m: Vector  # (F,) distance of each fix from the track
    rms_m: float  # of the residuals, outliers at their reduced weight
    shift_m: Points  # (groups,)


@dataclass(frozen=True, slots=True)
class DrUsblFit:
    """Sensor errors from a robust regression of fixes on dead reckoning, each with its 1-sigma.

    A sigma is NaN if the error is not observable. Rotation, scale and latency assume headings valid at their stamps.
    """

    rotation_rad: float  # counter-clockwise, from dead reckoning to the fixes
    rotation_sd_rad: float
    scale: float  # the DVL reads (1 + scale) times the truth
    scale_sd: float
    latency_s: float  # stamp of a fix minus the time at which it was true
    latency_sd_s: float
    heading_delay_s: float  # stamp of a heading minus the time at which it was true, both by the DVL's clock
    heading_delay_sd_s: float
    residual_m: Vector  # (F,) with headings at the time at which they were true; NaN outside of all stretches
    sd_m: float  # per axis, of the inliers
    sd_without_delay_m: float  # the same with headings at their stamps
    stretches: int

    @property
    def outlier_rows(self) -> Indices:
        """Rows of the fixes with residuals above GROSS_SIGMAS."""
        return np.flatnonzero(self.residual_m > GROSS_SIGMAS * self.sd_m)


def as_points(position_m: Array) -> Points:
    """Return east and north, (n, 2), as complex numbers."""
    return position_m[:, 0] + 1j * position_m[:, 1]


def fix_points(timeline: Timeline) -> Points:
    """Return the fixes, (F,)."""
    return as_points(timeline.fix_m)


def dead_reckoned(timeline: Timeline, time_s: Vector) -> Points:
    """Return dead reckoning from the origin, (n,) at any times."""
    return np.interp(time_s, timeline.time_s, as_points(displacement_m(timeline)))


def segment_numbers(timeline: Timeline, time_s: Vector, longest_s: float = np.inf) -> Indices:
    """Return the segment number of each time, (n,): cut at outages of DVL or compass; -1 inside them.

    Dead reckoning is only valid within a segment; ``longest_s`` limits its length.
    """
    number = np.zeros(len(time_s), dtype=np.intp) if np.isinf(longest_s) else (time_s // longest_s).astype(np.intp)
    inside = np.zeros(len(time_s), dtype=np.bool_)
    cuts = np.zeros(len(time_s), dtype=np.intp)
    for outage in timeline.outages:
        if outage.sensor != "usbl":
            inside |= (time_s > outage.start_s) & (time_s < outage.end_s)
            cuts += time_s >= outage.end_s
    _, number = np.unique(np.column_stack([cuts, number])[~inside], axis=0, return_inverse=True)
    result = np.full(len(time_s), -1, dtype=np.intp)
    result[~inside] = number.ravel()
    return result


def fit_rotation(timeline: Timeline, group: Indices, latencies_s: Sequence[float] = TRIED_LATENCIES_S) -> RotationFit:
    """Rotate and shift dead reckoning to the F fixes, one shift per group, (F,); fixes of group -1 are left out.

    The best latency is chosen: without it a late fix beside a track looks like a mirrored DVL.
    """
    tried = [
        _fit_at_latency(dead_reckoned(timeline, timeline.fix_time_s - s), fix_points(timeline), group, s)
        for s in latencies_s
    ]
    return min(tried, key=lambda fit: fit.rms_m)


def _fit_at_latency(track: Points, fixes: Points, group: Indices, latency_s: float) -> RotationFit:
    used = group >= 0
    rotation, weights = _huber_rotation(track[used], fixes[used], group[used])
    shift = _means(fixes[used] - np.exp(1j * rotation) * track[used], weights, group[used])
    residual = np.full(len(fixes), np.nan)
    residual[used] = np.abs(fixes[used] - np.exp(1j * rotation) * track[used] - shift[group[used]])
    rms = np.sqrt(np.average(residual[used] ** 2, weights=weights))
    return RotationFit(latency_s, rotation, residual, float(rms), shift)


def _huber_rotation(track: Points, fixes: Points, group: Indices) -> tuple[float, Vector]:
    weights = np.ones(len(fixes))
    rotation = 0.0
    for _ in range(10):
        a = track - _means(track, weights, group)[group]
        b = fixes - _means(fixes, weights, group)[group]
        rotation = float(np.angle(np.sum(weights * b * np.conj(a))))
        distance = np.abs(b - np.exp(1j * rotation) * a)
        weights = np.minimum(1.0, 2 * _scale(distance) / np.maximum(distance, 1e-12))
    return rotation, weights


def jackknife_rotation_sd_rad(timeline: Timeline, group: Indices, latency_s: float) -> float:
    """Return the 1-sigma of the rotation of `fit_rotation`, leaving out an eighth of the fixes at a time."""
    used = np.flatnonzero(group >= 0)
    track, fixes = dead_reckoned(timeline, timeline.fix_time_s - latency_s), fix_points(timeline)
    full, _ = _huber_rotation(track[used], fixes[used], group[used])
    deviations: list[float] = []
    for part in np.array_split(used, min(JACKKNIFE_BLOCKS, len(used))):
        remaining = np.setdiff1d(used, part)
        rotation, _ = _huber_rotation(track[remaining], fixes[remaining], group[remaining])
        deviations.append(float(np.angle(np.exp(1j * (rotation - full)))))
    return (
        float(np.sqrt((len(deviations) - 1) * np.mean(np.square(deviations)))) if len(deviations) > 1 else float("nan")
    )


def fit_sensor_errors(timeline: Timeline, rotation_rad: float = 0.0) -> DrUsblFit | None:
    """Regress fixes on dead reckoning in short segments, starting at ``rotation_rad``.

    None if there are too few fixes or segments.
    """
    group = segment_numbers(timeline, timeline.fix_time_s, SEGMENT_S)
    used = group >= 0
    stretches = len(np.unique(group[used]))
    if np.sum(used) < MIN_FIXES or stretches < 4:
        return None
    start = np.array([rotation_rad, 0.0, 0.0, 0.0])
    first = _regress(timeline, start, 3, group)
    whole = _regress(timeline, first.values, 4, group)
    sd = [*_jackknife_sd(timeline, first, 3, group), _jackknife_sd(timeline, whole, 4, group)[3]]
    residual = np.full(len(group), np.nan)
    residual[used] = whole.residual_m
    return DrUsblFit(
        *(float(number) for pair in zip([*first.values[:3], whole.values[3]], sd, strict=True) for number in pair),
        residual_m=residual,
        sd_m=whole.sd_m,
        sd_without_delay_m=first.sd_m,
        stretches=stretches,
    )


class _Regression(NamedTuple):
    values: Vector  # (4,) rotation, scale, latency, heading delay
    separable: bool
    residual_m: Vector
    sd_m: float


class _Solution(NamedTuple):
    step: Vector  # (k,)
    separable: bool  # False: two columns are nearly equal, as latency and heading delay at constant speed
    error: Points  # (n,)
    weights: Vector  # (n,)


def _jackknife_sd(timeline: Timeline, full: _Regression, free: int, group: Indices) -> Vector:
    """Return the 1-sigma of each value, (free,), leaving out an eighth of the segments; NaN if not separable.

    Drift is correlated within a segment and heavy-tailed, so a formula would be over-confident.
    """
    if not full.separable:
        return np.full(free, np.nan)
    used = group[group >= 0]
    slopes, y = _linear(timeline, full.values, free, group)
    deviations: list[Vector] = []
    stretches = np.unique(used)
    for part in np.array_split(stretches, min(JACKKNIFE_BLOCKS, len(stretches))):
        remaining = ~np.isin(used, part)
        solution = _reweighted_solve(
            slopes[remaining], y[remaining], np.ones(int(remaining.sum())), used[remaining], full.values[:free]
        )
        deviations.append(solution.step)
    return np.sqrt((len(deviations) - 1) * np.mean(np.square(deviations), axis=0))


def _regress(timeline: Timeline, start: Vector, free: int, group: Indices) -> _Regression:
    """Find the first ``free`` of rotation, scale, latency and heading delay by Gauss-Newton steps."""
    used = group[group >= 0]
    q, weights = start, np.ones(len(used))
    for _ in range(7):
        solution = _reweighted_solve(*_linear(timeline, q, free, group), weights, used, q[:free])
        limit = LIMITS[:free]
        q = np.concatenate([np.clip(q[:free] + solution.step, -limit, limit), q[free:]])
        weights = solution.weights
    solution = _reweighted_solve(*_linear(timeline, q, free, group), weights, used, q[:free])
    distance = np.abs(solution.error)
    sd_m = float(np.sqrt(np.average(distance**2, weights=solution.weights) / 2))
    return _Regression(q, solution.separable, distance, sd_m)


def _linear(timeline: Timeline, q: Vector, free: int, group: Indices) -> tuple[Points, Points]:
    """Return columns (n, free) and residuals (n,) of the used fixes at q."""
    used = group >= 0
    wings = [(_predicted(timeline, q + step), _predicted(timeline, q - step)) for step in np.diag(STEPS)[:free]]
    slopes = np.column_stack([(a - b)[used] / (2 * step) for (a, b), step in zip(wings, STEPS[:free], strict=True)])
    return slopes, (fix_points(timeline) - _predicted(timeline, q))[used]


def _reweighted_solve(slopes: Points, y: Points, weights: Vector, group: Indices, q: Vector) -> _Solution:
    """Solve with weights iterated from the residuals."""
    for _ in range(9):
        weights = _solve(slopes, y, weights, group, q).weights
    return _solve(slopes, y, weights, group, q)


def _solve(slopes: Points, y: Points, weights: Vector, group: Indices, q: Vector) -> _Solution:
    """Solve y = slopes x + shift of its group, (n, k) and (n,), for real x; q + x has a weak prior at 0."""
    columns = np.column_stack([slopes, y])
    columns = columns - np.column_stack([_means(column, weights, group) for column in columns.T])[group]
    A, b = columns[:, :-1], columns[:, -1]
    information = np.real(A.conj().T * weights @ A)
    prior_information = _scale(np.abs(b)) ** 2 / PRIOR_SD[: len(q)] ** 2
    inverse = np.linalg.pinv(information + np.diag(prior_information), hermitian=True)
    step = inverse @ (np.real(A.conj().T * weights @ b) - prior_information * q)
    error = b - A @ step
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    separable = bool(np.linalg.eigvalsh(information / np.outer(size, size))[0] >= MIN_EIGENVALUE)
    distance = np.abs(error)
    return _Solution(step, separable, error, (1 - np.minimum(distance / (4.7 * _scale(distance)), 1.0) ** 2) ** 2)


def _predicted(timeline: Timeline, q: Vector) -> Points:
    """Return the predicted fixes, up to a shift, (F,)."""
    rotation, scale, latency_s, delay_s = q.tolist()
    yaw = cast(Vector, np.interp(timeline.time_s + delay_s, timeline.time_s, timeline.dr_yaw_rad)) + rotation
    moved = replace(timeline, dr_yaw_rad=yaw, dr_mps=timeline.dr_mps / (1 + scale))
    return dead_reckoned(moved, timeline.fix_time_s - latency_s)


def _means(values: Points, weights: Vector, group: Indices) -> Points:
    """Return the weighted mean of each group."""
    total = np.maximum(np.bincount(group, weights), 1e-12)
    return (np.bincount(group, weights * values.real) + 1j * np.bincount(group, weights * values.imag)) / total


def _scale(distance: Array) -> float:
    return float(np.median(distance)) / RAYLEIGH_MEDIAN + 1e-9
