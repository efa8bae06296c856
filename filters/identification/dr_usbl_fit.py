"""Rotate and shift dead reckoning onto the USBL fixes, without truth: what is left shows gross errors.

Rotation, scale and shift between the two tracks are the closed form of S. Umeyama, IEEE Trans. PAMI 13(4), 1991,
doi:10.1109/34.88573, with P. J. Huber's weights against outliers; the sigma of the rotation comes from leaving out
parts of the log (B. Efron's jackknife). evidence.py identifies small errors.

Positions are complex numbers here, east + i north, in metres: a counter-clockwise rotation is a factor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.frames import rotated
from usbldr.filters.identification.identification import Identification
from usbldr.filters.identification.linearisation import REPORTED
from usbldr.filters.replay.dead_reckoning import corrected, displacement_m, freed
from usbldr.filters.types import Array, Indices, Mask, Timeline, Vector

Points: TypeAlias = NDArray[np.complex128]  # (n,) east + i north

SEGMENT_S = 120.0  # drift within a segment is small against the motion
WIDE_LATENCIES_S = tuple(float(s) for s in range(-20, 21))  # tried for the start of the search
JACKKNIFE_BLOCKS = 8  # of the log, left out one by one
TRIED_LATENCIES_S = tuple(float(s) for s in range(-4, 5))  # delays of fixes are seconds; the fit refines the best
GROSS = 100.0  # [-] of the median residual, at least 100 m: such a fix is of another place, not of another noise
MIN_FIXES = 20  # with fewer there is no fit
RAYLEIGH_MEDIAN = 1.1774  # fixed: median of a Rayleigh distribution


@dataclass(frozen=True, slots=True)
class RotationFit:
    """Dead reckoning rotated and shifted to F fixes: fix(t) = rotation * dr(t - latency) + shift of its group."""

    latency_s: float  # the best of those tried
    rotation_rad: float  # counter-clockwise
    residual_m: Vector  # (F,) distance of each fix from the track
    rms_m: float  # of the residuals, outliers at their reduced weight
    shift_m: Points  # (groups,)
    scale: float  # of distances by dead reckoning to those between fixes; NaN if either is at rest


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
    result = np.full(len(time_s), -1, dtype=np.intp)
    sums = (cuts + number)[~inside]  # both ascend with time: they are equal where their sum is
    result[~inside] = np.unique(sums, return_inverse=True)[1]
    return result


def fit_rotation(timeline: Timeline, group: Indices, latencies_s: Sequence[float] = TRIED_LATENCIES_S) -> RotationFit:
    """Rotate and shift dead reckoning to the F fixes, one shift per group, (F,); fixes of group -1 are left out.

    The best latency is chosen: without it a late fix beside a track looks like a mirrored DVL. Nothing is rotated if
    all fixes are left out.
    """
    track = as_points(displacement_m(timeline))
    tried = (fit_at_latency(timeline, track, group, latency_s) for latency_s in latencies_s)
    return min(tried, key=lambda fit: fit.rms_m)


def fit_at_latency(timeline: Timeline, reckoned: Points, group: Indices, latency_s: float) -> RotationFit:
    """Return `fit_rotation` at one latency; ``reckoned`` (K,) is dead reckoning at the epochs."""
    track = np.interp(timeline.fix_time_s - latency_s, timeline.time_s, reckoned)
    return _turned_onto(track, fix_points(timeline), group, latency_s)


def _turned_onto(track: Points, fixes: Points, group: Indices, latency_s: float) -> RotationFit:
    used = group >= 0
    if not used.any():
        return RotationFit(latency_s, 0.0, np.full(len(fixes), np.nan), 0.0, np.zeros(0, complex), np.nan)
    rotation, weights = _huber_rotation(track[used], fixes[used], group[used])
    shift = _means(fixes[used] - np.exp(1j * rotation) * track[used], weights, group[used])
    residual = np.full(len(fixes), np.nan)
    residual[used] = np.abs(fixes[used] - np.exp(1j * rotation) * track[used] - shift[group[used]])
    rms = np.sqrt(np.average(residual[used] ** 2, weights=weights))
    a = np.exp(1j * rotation) * (track[used] - _means(track[used], weights, group[used])[group[used]])
    moved, together = np.sum(weights * np.abs(a) ** 2), np.sum(weights * np.real(fixes[used] * np.conj(a)))
    scale = moved / together if together > 0 else np.nan
    return RotationFit(latency_s, rotation, residual, float(rms), shift, float(scale))


def _huber_rotation(track: Points, fixes: Points, group: Indices) -> tuple[float, Vector]:
    weights = np.ones(len(fixes))
    rotation = 0.0
    first = np.flatnonzero(np.diff(group, prepend=-1))  # of each group: fixes ascend in time, and so do groups
    count = np.diff(first, append=len(group))

    def centred(values: Points) -> Points:
        return values - np.repeat(np.add.reduceat(weights * values, first) / total, count)

    for _ in range(10):
        total = np.maximum(np.add.reduceat(weights, first), 1e-12)
        a, b = centred(track), centred(fixes)
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


def without_errors(timeline: Timeline, found: Identification) -> Timeline:
    """Return the timeline with dead reckoning and fixes freed of what was identified, lever arms included."""
    value = {
        state: found.estimates[one.name].value / one.factor
        for state, one in REPORTED.items()
        if one.name in found.estimates
    }
    line = freed(corrected(timeline, found.parameters), value)
    lever_m = np.array(found.parameters.usbl_lever_m[:2]) - np.array(found.parameters.dvl_lever_m[:2])
    yaw = np.interp(line.fix_time_s, line.time_s, line.dr_yaw_rad)
    return replace(line, fix_m=line.fix_m - rotated(yaw, lever_m))


def gross(timeline: Timeline) -> Mask:
    """Return which fixes lie GROSS times as far from dead reckoning turned onto the fixes as half of them do, (F,)."""
    group = segment_numbers(timeline, timeline.fix_time_s)
    if not np.any(group >= 0):
        return np.zeros(len(group), np.bool_)
    residual_m = fit_rotation(timeline, group).residual_m
    return residual_m > GROSS * max(1.0, float(np.nanmedian(residual_m)))


def residuals_m(timeline: Timeline) -> Vector:
    """Return the distance of each fix from dead reckoning rotated and shifted to the fixes about it, (F,).

    Each segment of SEGMENT_S is shifted on its own, by the median, which a third of false fixes on one side hardly
    moves; NaN during an outage of DVL or compass.
    """
    group = segment_numbers(timeline, timeline.fix_time_s, SEGMENT_S)
    turned = np.exp(1j * fit_rotation(timeline, group, [0.0]).rotation_rad)
    off: Points = fix_points(timeline) - turned * dead_reckoned(timeline, timeline.fix_time_s)
    for number in range(int(group.max(initial=-1)) + 1):
        there = group == number
        off[there] -= np.median(off.real[there]) + 1j * np.median(off.imag[there])
    return np.where(group < 0, np.nan, np.abs(off))


def _means(values: Points, weights: Vector, group: Indices) -> Points:
    """Return the weighted mean of each group."""
    total = np.maximum(np.bincount(group, weights), 1e-12)
    return (np.bincount(group, weights * values.real) + 1j * np.bincount(group, weights * values.imag)) / total


def _scale(distance: Array) -> float:
    return float(np.median(distance)) / RAYLEIGH_MEDIAN + 1e-9
