"""Tracks without a filter: dead reckoning, raw USBL fixes, and dead reckoning shifted to the fixes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.frames import rotated
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.models.parameters import NOT_SMOOTHED, Parameters, SensorChange, Smoothing
from usbldr.filters.types import Array, Mask, Outage, Timeline, Trajectory, Vector
from usbldr.filters.windows import columns_at, integrated

COLUMNS: Mapping[str, tuple[str, str, str, str]] = {
    "dvl": ("dvl_mps", "dr_mps", "dvl_count", "dvl_sd_mps"),
    "compass": ("yaw_rad", "dr_yaw_rad", "yaw_count", "yaw_sd_rad"),
}
"""Those of a timeline by sensor: its records, what dead reckoning takes of them, how many, and their sigmas."""
OF_EPOCHS = ("time_s", *(name for names in COLUMNS.values() for name in names))
START_FIXES = 5  # whose median tolerates two outliers
MAJORITY = 4.0  # [-] by judgement, a power: a third of the fixes is right in one log of 17, a half in one of two
LEAST_START_SD_M = 3.0  # by judgement: a gross first fix must not look certain


class Anchor(NamedTuple):
    """A known position of dead reckoning."""

    position_m: Vector  # (2,) east, north
    time_s: float
    description: str  # "the first five fixes"


def dr(timeline: Timeline, start_m: Vector, start_time_s: float = 0.0) -> Trajectory:
    """Integrate DVL and compass by the trapezoidal rule on the fast grid, so that the track meets start_m.

    ``start_m`` (2,) is east, north at ``start_time_s``, any time of the log; the track also extends before it.
    States psi, u, v, x, y at all K epochs; no covariance.
    """
    moved = displacement_m(timeline)
    position = moved - columns_at(np.array([start_time_s]), timeline.time_s, moved) + np.asarray(start_m, dtype=float)
    mean = np.column_stack([timeline.dr_yaw_rad, timeline.dr_mps, position])
    return Trajectory("dr", ("psi", "u", "v", "x", "y"), timeline.time_s, mean, cov=None)


def nudge(timeline: Timeline) -> Trajectory:
    """Return dead reckoning shifted by the offset of the fixes, interpolated in time: what seabed mapping often does.

    It passes through every fix, outliers included; before the first and after the last fix the offset is constant.
    States as in `dr`. Raises LogError if there is no fix.
    """
    if not len(timeline.fix_time_s):
        raise LogError("the log has no USBL fix to nudge dead reckoning by")
    reckoned = dr(timeline, np.zeros(2))
    stamps, first = np.unique(timeline.fix_time_s, return_index=True)
    offset: Array = (timeline.fix_m - columns_at(timeline.fix_time_s, timeline.time_s, reckoned.position_m))[first]
    shift = columns_at(timeline.time_s, stamps, offset)
    mean = np.column_stack([reckoned.mean[:, :3], reckoned.position_m + shift])
    return Trajectory("nudge", reckoned.names, timeline.time_s, mean, cov=None)


def usbl(timeline: Timeline) -> Trajectory:
    """Return the raw fixes at their own times of validity; raises LogError if there is none."""
    if not len(timeline.fix_time_s):
        raise LogError("the log has no USBL fix, so there is no raw USBL track")
    return Trajectory("usbl", ("x", "y"), timeline.fix_time_s, timeline.fix_m, cov=None)


def start_position(timeline: Timeline, time_s: Vector, fix_m: Array) -> tuple[Vector, float]:
    """Return the position at time 0 from the first fixes, (2,), and its 1-sigma per axis.

    Each fix is carried back by the dead-reckoned displacement since time 0; the median tolerates two outliers in five.
    The sigma is the median absolute deviation of the fixes (of the wider axis), at least LEAST_START_SD_M: with a plain
    standard deviation one outlier would widen the start so far that a filter accepts the next one.
    """
    begin = _until_first_fixes(timeline, time_s)
    carried = fix_m[:START_FIXES] - columns_at(time_s[:START_FIXES], begin.time_s, displacement_m(begin))
    position = np.median(carried, axis=0)
    spread_m = TO_SD * np.median(np.abs(carried - position), axis=0).max()
    return position, float(max(LEAST_START_SD_M, spread_m))


def start_sensitivity(timeline: Timeline, time_s: Vector, names: Sequence[str], of_usbl: bool) -> Array:
    """Return the derivative of the start position by each state, (2, n); 0 except for errors of sensors.

    ``time_s`` (F,) are those of the fixes. A first fix after minutes is carried back by hundreds of metres of dead
    reckoning, whose error enters the start; so does an error that the fixes share, and their latency, if they are those
    ``of_usbl``: they tell the sum of position and error, x = z - c + latency V.
    """
    begin, derivative = _until_first_fixes(timeline, time_s), np.zeros((2, len(names)))
    for name, rate in drift_rates(begin).items():
        if name in names:
            drift_m = columns_at(time_s[:START_FIXES], begin.time_s, integrated(begin.time_s, rate))
            derivative[:, names.index(name)] = -drift_m.mean(axis=0)
    if of_usbl:
        V: Vector = columns_at(time_s[:START_FIXES], begin.time_s, velocity_mps(begin)).mean(axis=0)
        derivative += fix_sensitivity(V, names)
    return derivative


def _until_first_fixes(timeline: Timeline, time_s: Vector) -> Timeline:
    """Return dead reckoning up to the epoch behind the last of the first fixes: the rest does not move the start."""
    return until(timeline, float(np.max(time_s[:START_FIXES])))


def until(timeline: Timeline, time_s: float) -> Timeline:
    """Return dead reckoning and records up to the epoch behind a time; the slow grid is unchanged."""
    epochs = slice(int(np.searchsorted(timeline.time_s, time_s)) + 1)
    return replace(timeline, **{name: getattr(timeline, name)[epochs] for name in OF_EPOCHS})


def fix_sensitivity(V_mps: Vector, names: Sequence[str]) -> Array:
    """Return the derivative of the position that a USBL fix gives, by each state, (2, n): x = z - c + latency V.

    ``V_mps`` (2,) is the velocity east and north.
    """
    of_fixes = {"usbl_bias_east": (-1.0, 0.0), "usbl_bias_north": (0.0, -1.0), "usbl_latency": V_mps}
    return np.column_stack([of_fixes.get(name, np.zeros(2)) for name in names])


def displacement_m(timeline: Timeline) -> Array:
    """Return the displacement of dead reckoning east and north since the first epoch, m, (K, 2)."""
    return integrated(timeline.time_s, velocity_mps(timeline))


def velocity_mps(timeline: Timeline) -> Array:
    """Return V_E and V_N of eq. (1) at all epochs, (K, 2)."""
    return rotated(timeline.dr_yaw_rad, timeline.dr_mps)


def drift_rates(timeline: Timeline) -> Mapping[str, Array]:
    """Return state -> the correction of the dead-reckoned velocity per unit of it, (K, 2): see sensors.py."""
    V, yaw = velocity_mps(timeline), timeline.dr_yaw_rad
    turned_V = np.column_stack([-V[:, 1], V[:, 0]])
    return {
        "dvl_scale": -V,
        "dvl_mount": turned_V,
        "heading_bias": -turned_V,
        "deviation_sin": -np.sin(yaw)[:, None] * turned_V,
        "deviation_cos": -np.cos(yaw)[:, None] * turned_V,
        "current_east": np.tile([1.0, 0.0], (len(V), 1)),
        "current_north": np.tile([0.0, 1.0], (len(V), 1)),
    }


def freed(timeline: Timeline, error: Mapping[str, float]) -> Timeline:
    """Return the timeline with dead reckoning, compass, DVL and fixes freed of errors, state -> value."""
    line = replace(timeline, fix_time_s=timeline.fix_time_s - error.get("usbl_latency", 0.0))
    if line.fix_away_m is not None:
        scale, level_m2 = 1 + error.get("usbl_range", 0.0), np.sum(line.fix_away_m**2, axis=1)
        shorter = np.full(len(level_m2), 1 / scale)
        if line.fix_levelled_by_m is not None:  # h² = r² - z²
            left_m2 = (level_m2 + line.fix_levelled_by_m**2) / scale**2 - line.fix_levelled_by_m**2
            shorter = np.sqrt(np.maximum(left_m2, 0.0) / np.maximum(level_m2, 1e-12))
        away_m = rotated(-error.get("usbl_heading", 0.0), line.fix_away_m) * shorter[:, None]
        line = replace(line, fix_m=line.fix_m + away_m - line.fix_away_m, fix_away_m=away_m)
    arm_m = np.array([error.get("usbl_arm_starboard", 0.0), error.get("usbl_arm_forward", 0.0)])
    if line.fix_ship_yaw_rad is not None and arm_m.any():
        line = replace(line, fix_m=line.fix_m + ship_axes(line.fix_ship_yaw_rad) @ arm_m)
    for sensor, columns in COLUMNS.items():
        if clock_s := error.get(f"{sensor}_clock", 0.0):
            line = _with_earlier_records(line, clock_s, *columns)
    names = ("heading_bias", "deviation_sin", "deviation_cos", "dvl_scale")
    constant, of_sin, of_cos, scale = (error.get(name, 0.0) for name in names)
    yaws: list[Vector] = []
    for reading in (line.yaw_rad - constant, line.dr_yaw_rad - constant):
        yaw = reading
        for _ in range(3 if of_sin or of_cos else 0):  # the deviation is that of the true yaw: converges by its size
            yaw = reading - of_sin * np.sin(yaw) - of_cos * np.cos(yaw)
        yaws.append(yaw)
    mps = {"dvl_mps": line.dvl_mps / (1 + scale), "dr_mps": line.dr_mps / (1 + scale)}
    return replace(line, yaw_rad=yaws[0], dr_yaw_rad=yaws[1], **mps)


def ship_axes(ship_yaw_rad: Vector) -> Array:
    """Return starboard and forward of a ship, east and north of each in a column, (F, 2, 2); 0 if psi is unknown."""
    return np.nan_to_num(np.stack([rotated(ship_yaw_rad, unit) for unit in np.eye(2)], axis=2))


def _with_earlier_records(
    timeline: Timeline, clock_s: float, measured: str, reckoned: str, count: str, sd: str
) -> Timeline:
    """Return the timeline with records that are true earlier by ``clock_s``; those of an epoch stay together."""
    t, at_epochs = timeline.time_s, getattr(timeline, reckoned)
    if len(t) < 2:  # a single epoch has no earlier one
        return timeline
    earlier = columns_at(t + clock_s, timeline.time_s, at_epochs.reshape(len(t), -1)).reshape(at_epochs.shape)
    rows = np.arange(len(t)) + round(clock_s / float(t[1] - t[0]))
    inside, rows = (rows >= 0) & (rows < len(t)), np.clip(rows, 0, len(t) - 1)
    columns: dict[str, Any] = {
        measured: getattr(timeline, measured)[rows] + earlier - at_epochs[rows],
        reckoned: earlier,
        count: np.where(inside, getattr(timeline, count)[rows], 0),
        sd: getattr(timeline, sd)[rows],
    }
    return replace(timeline, **columns)


def corrected(timeline: Timeline, parameters: Parameters) -> Timeline:
    """Return the timeline without the smoothing of its fixes, read as before the first change."""
    return without_changes(without_smoothing(timeline, parameters.smoothing), parameters.changes)


def without_smoothing(timeline: Timeline, smoothing: Smoothing) -> Timeline:
    """Return the timeline with the fixes from which software made those recorded; the first one is as it is."""
    if smoothing == NOT_SMOOTHED:
        return timeline
    fix_m = _before_mean(timeline, smoothing.last) if smoothing.last else _before_filter(timeline, smoothing)
    away_m = None if timeline.fix_away_m is None else timeline.fix_away_m + fix_m - timeline.fix_m
    return replace(timeline, fix_m=fix_m, fix_away_m=away_m)


def _before_filter(timeline: Timeline, smoothing: Smoothing) -> Array:
    """Return the fixes, (F, 2), from which a filter with constant gains made those recorded; the first is as it is."""
    alpha, beta, _ = smoothing
    recorded, dt_s = timeline.fix_m @ [1, 1j], np.diff(timeline.fix_time_s)
    position, mps = complex(recorded[0]), 0j
    fixes = [position]
    for output, after_s in zip(recorded[1:].tolist(), dt_s.tolist(), strict=True):
        predicted = position + mps * after_s
        innovation = (output - predicted) / alpha
        fixes.append(predicted + innovation)
        position = output
        mps += beta * innovation / after_s if after_s else 0.0
    return np.array(fixes).view(np.float64).reshape(-1, 2)


def _before_mean(timeline: Timeline, last: int) -> Array:
    """Return the fixes, (F, 2), of which each recorded one is the mean of the last ones.

    The means leave open the place of every n-th fix: it is where each of these n series lies around dead reckoning as
    the others do.
    """
    if len(timeline.fix_m) < 2 * last:
        return timeline.fix_m
    fix_m = timeline.fix_m.copy()
    fix_m[last - 1] = last * fix_m[last - 1] - fix_m[: last - 1].sum(axis=0)
    fix_m[last:] = last * np.diff(timeline.fix_m[last - 1 :], axis=0)
    for series in range(last):
        fix_m[series::last] = np.cumsum(fix_m[series::last], axis=0)
    off_m = fix_m - columns_at(timeline.fix_time_s, timeline.time_s, displacement_m(timeline))
    summed_m = np.cumsum(np.vstack([np.zeros(2), off_m]), axis=0)
    around_m = (summed_m[last:] - summed_m[:-last]) / last
    middle = (last - 1) // 2
    aside_m = off_m[middle : middle + len(around_m)] - around_m
    of_series = np.array([np.median(aside_m[(series - middle) % last :: last], axis=0) for series in range(last)])
    return fix_m - (of_series - of_series.mean(axis=0))[np.arange(len(fix_m)) % last]


def without_changes(timeline: Timeline, changed: Sequence[SensorChange]) -> Timeline:
    """Return the timeline with all read as before the first change; a sensor that is lost has an outage."""
    since = np.searchsorted([one.start_s for one in changed], timeline.time_s, side="right")
    for sensor in COLUMNS:
        lost = np.array([False, *(sensor in one.lost for one in changed)])[since]
        if lost.any() and not lost.all():
            timeline = _without_sensor(timeline, lost, *COLUMNS[sensor][:3])
    gaps = [Outage(name, one.start_s, end.start_s) for one, end in pairwise(changed) for name in one.lost]
    turned = _turned_rad(timeline, changed)
    scale = np.array([0.0, *(one.dvl_scale for one in changed)])[since][:, None]
    current_mps = np.array([(0.0, 0.0), *(one.current_mps for one in changed)])[since]
    added_mps = rotated(turned - timeline.dr_yaw_rad, current_mps)  # along the vehicle's axes
    added_mps -= np.array([(0.0, 0.0), *(one.dvl_bias_mps for one in changed)])[since]
    since = np.searchsorted([one.start_s for one in changed], timeline.fix_time_s, side="right")
    shift_m = np.array([(0.0, 0.0), *(one.fix_shift_m for one in changed)])[since]
    late_s = np.array([0.0, *(one.fix_late_s for one in changed)])[since]
    sd_scale = np.array([1.0, *(one.fix_sd_scale for one in changed)])[since][:, None, None]
    return replace(
        timeline,
        outages=(*timeline.outages, *gaps),
        fix_time_s=np.maximum.accumulate(timeline.fix_time_s - late_s),  # those of a step back are at once
        fix_m=timeline.fix_m - shift_m,
        fix_cov_m2=timeline.fix_cov_m2 * sd_scale**2,
        fix_away_m=None if timeline.fix_away_m is None else timeline.fix_away_m - shift_m,
        yaw_rad=timeline.yaw_rad - turned,
        dr_yaw_rad=timeline.dr_yaw_rad - turned,
        dvl_mps=timeline.dvl_mps / (1 + scale) + added_mps,
        dr_mps=timeline.dr_mps / (1 + scale) + added_mps,
    )


def _turned_rad(timeline: Timeline, changed: Sequence[SensorChange]) -> Vector:
    """Return by how much headings read too far anticlockwise by the changes, (K,)."""
    if not changed:
        return np.zeros(len(timeline.time_s))
    known_s, turned = list[float](), [0.0]
    for one in changed:
        if not one.gradual:
            known_s.append(math.nextafter(one.start_s, -math.inf))
            turned.append(turned[-1])
        known_s.append(one.start_s)
        turned.append(one.heading_bias_rad)
    since = np.searchsorted([one.start_s for one in changed], timeline.time_s, side="right")
    twice = np.array([(0.0, 0.0), *(one.twice_per_turn_rad for one in changed)])[since]
    of_turn = np.column_stack([np.sin(2 * timeline.dr_yaw_rad), np.cos(2 * timeline.dr_yaw_rad)])
    return np.interp(timeline.time_s, known_s, turned[1:]) + np.sum(twice * of_turn, axis=1)


def _without_sensor(timeline: Timeline, lost: Mask, measured: str, reckoned: str, count: str) -> Timeline:
    """Return the timeline without a sensor's records in the lost epochs; dead reckoning goes on between their ends."""
    t, values, records = timeline.time_s, getattr(timeline, reckoned), getattr(timeline, measured).copy()
    kept = values.reshape(len(t), -1)[~lost]
    between = columns_at(t, t[~lost], kept).reshape(values.shape)
    records[lost] = np.nan
    columns: dict[str, Any] = {measured: records, reckoned: between, count: np.where(lost, 0, getattr(timeline, count))}
    return replace(timeline, **columns)


def open_covariance_m2(timeline: Timeline, position_m: Array, yaw_rad: Vector, parameters: Parameters) -> Array:
    """Return what the settled numbers leave open at the positions of K epochs, (K, 2): (K, 2, 2).

    ``yaw_rad``, (K,), turns lever arms; errors of a USBL head count from where it was.
    """
    starboard, forward = (rotated(yaw_rad, unit) for unit in np.eye(2))
    by_error = {"dvl_lever_starboard": starboard, "dvl_lever_forward": forward}
    by_error |= {"usbl_latency": rotated(yaw_rad, timeline.dr_mps)}
    if timeline.fix_away_m is not None:
        t, fix_s, head_m = timeline.time_s, timeline.fix_time_s, timeline.fix_m - timeline.fix_away_m
        away_m: Array = position_m - columns_at(t, fix_s, head_m)
        by_error |= {"usbl_heading": np.column_stack([-away_m[:, 1], away_m[:, 0]]), "usbl_range": away_m}
    if timeline.fix_ship_yaw_rad is not None:
        axes = columns_at(timeline.time_s, timeline.fix_time_s, ship_axes(timeline.fix_ship_yaw_rad).reshape(-1, 4))
        by_error |= {"usbl_arm_starboard": -axes[:, ::2], "usbl_arm_forward": -axes[:, 1::2]}
    cov_m2 = np.zeros((len(position_m), 2, 2))
    half = {(name, name): one_sigma**2 / 2 for name, one_sigma in parameters.settled_sd.items()}
    for (one, other), covariance in (half | dict(parameters.settled_cov)).items():
        product = covariance * by_error[one][:, :, None] * by_error[other][:, None]
        cov_m2 += product + product.swapaxes(1, 2)
    return cov_m2


def shift_covariance_m2(fix_time_s: Vector, changed: Sequence[SensorChange]) -> Array:
    """Return what shifts of the fixes leave open of a track, (2, 2): perhaps those that were taken as false are right.

    The more fixes lie in one place, the likelier is it right. ``fix_time_s`` (F,) are those of all fixes.
    """
    since = np.searchsorted([one.start_s for one in changed], fix_time_s, side="right")
    shift_m = np.array([(0.0, 0.0), *(one.fix_shift_m for one in changed)])
    weight = np.bincount(since, minlength=len(shift_m)) ** MAJORITY
    return np.einsum("n,ni,nj->ij", weight / max(weight.sum(), 1.0), shift_m, shift_m)


def rival_share(rivals: int, others: int) -> float:
    """Return the share of the logs in which the rivals are right, of fixes that lie together in two places."""
    return 1 / (1 + (others / rivals) ** MAJORITY)
