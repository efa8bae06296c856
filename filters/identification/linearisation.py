"""Fixes minus dead reckoning, linear in the sensor errors about a point: how each error moves each fix.

The position is that of the DVL. A lever arm from the transponder to the DVL moves the fix by -R(psi) arm, which is
linear and free of the noise of the turn rate. A DVL or compass whose stamps are late by c has what it read at t in its
record of t + c. An error that is not linear is freed of its value at the point first: a heading that is wrong by
20 degrees would else look like a scale error of 6 %.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.models.calibration import REPORTED_QUANTITIES, SENSOR_ERRORS, STATES, prior_sd
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import DEGREES, Parameters
from usbldr.filters.models.quantities import ReportedQuantity
from usbldr.filters.replay.dead_reckoning import displacement_m, drift_rates, freed, ship_axes, until, velocity_mps
from usbldr.filters.types import Array, Mask, Timeline, Vector
from usbldr.filters.windows import columns_at, integrated

Point: TypeAlias = tuple[float, ...]  # a value for each of STEPS

LEVER, HEAD, RANGE, ARM = "dvl-lever", "usbl-heading", "usbl-range", "usbl-arm"
DVL_CLOCK, COMPASS_CLOCK = "dvl-clock", "compass-clock"
STEEP = 1 / 3  # [-] horizontal by vertical distance, below which that derivative is not linear within metres
CLOCKS = ("dvl_clock", "compass_clock")
MARGIN_S = 5.0  # of epochs behind the last fix, beyond what clocks and their steps need
CLOCK_STEPS_S = 0.5, -0.5  # of the central difference of the displacement by a clock
KEYS: Mapping[str, tuple[str, ...]] = {
    "scale": STATES["scale"],
    "heading": STATES["heading"],
    "deviation": STATES["deviation"],
    "latency": STATES["latency"],
    LEVER: ("dvl_lever_starboard", "dvl_lever_forward"),
    DVL_CLOCK: ("dvl_clock",),
    COMPASS_CLOCK: ("compass_clock",),
    HEAD: ("usbl_heading",),
    RANGE: ("usbl_range",),
    ARM: ("usbl_arm_starboard", "usbl_arm_forward"),
}
"""Sensor errors that a log may have or not, and their states in the pass."""
HEAD_ERRORS = (HEAD, RANGE, ARM)  # those of a USBL head
FIELDS: Mapping[str, str] = {
    **{error.key: field for field, error in SENSOR_ERRORS.items() if error.key in KEYS},
    LEVER: "dvl_lever_m",
    DVL_CLOCK: "dvl_clock_s",
    COMPASS_CLOCK: "compass_clock_s",
    HEAD: "usbl_heading_rad",
    RANGE: "usbl_range",
    ARM: "usbl_arm_m",
}
"""Their fields of SensorErrors."""
REPORTED: Mapping[str, ReportedQuantity] = {
    **REPORTED_QUANTITIES,
    "dvl_lever_starboard": ReportedQuantity("dvl_lever_starboard_m", "m", 1.0),
    "dvl_lever_forward": ReportedQuantity("dvl_lever_forward_m", "m", 1.0),
    "dvl_clock": ReportedQuantity("dvl_clock_s", "s", 1.0),
    "compass_clock": ReportedQuantity("compass_clock_s", "s", 1.0),
    "usbl_heading": ReportedQuantity("usbl_heading_deg", "deg", -DEGREES),
    "usbl_range": ReportedQuantity("usbl_range_scale", "", 1.0),
    "usbl_arm_starboard": ReportedQuantity("usbl_arm_starboard_m", "m", 1.0),
    "usbl_arm_forward": ReportedQuantity("usbl_arm_forward_m", "m", 1.0),
}
BIAS_STATES = STATES["usbl-bias"]
CURRENT_STATES = STATES["current"]
OFFSET_STATES = ("cluster_east", "cluster_north")  # of false fixes in a row, see clusters.py
OF_HEAD = tuple(name for key in HEAD_ERRORS for name in KEYS[key])
OF_USBL = (*BIAS_STATES, *OFFSET_STATES, *STATES["latency"], *OF_HEAD)  # which no GPS fix has
ERROR_STATES = tuple(name for names in KEYS.values() for name in names)
PASS_STATES = ("x", "y", *BIAS_STATES, *CURRENT_STATES, *ERROR_STATES, *OFFSET_STATES)
STEPS: Mapping[str, float] = {
    "dvl_scale": 0.02,
    "heading_bias": math.radians(2.0),
    "deviation_sin": math.radians(2.0),
    "deviation_cos": math.radians(2.0),
    "usbl_latency": 0.5,
    "usbl_heading": math.radians(2.0),
    "dvl_clock": 0.5,
    "compass_clock": 0.5,
}
"""States that are not linear, and the step of the points that members share: what half of it leaves is below 2e-4 of
the distance, or 3 mm in a turn."""
NO_ERROR: Point = (0.0,) * len(STEPS)
UNKNOWN_DIRECTION = 0.5  # fixed: variance of each axis of a unit vector in any direction


@dataclass(frozen=True, slots=True)
class Linearised:
    """F fixes minus dead reckoning, linear in n states about a point."""

    residual_m: Array  # (F, 2) fix minus dead reckoning
    measurement_matrix: Array  # (F, 2, n) H of each fix


def prior_sds(parameters: Parameters) -> Mapping[str, float]:
    """Return state -> prior 1-sigma of every sensor error that may exist."""
    errors = parameters.errors
    return prior_sd(errors) | {s: getattr(errors, field) for key, field in FIELDS.items() for s in KEYS[key]}


def keys_of(timeline: Timeline, parameters: Parameters) -> tuple[str, ...]:
    """Return the keys of the errors that the fixes of a timeline can have, but for those with a prior sigma of 0."""
    known = prior_sds(parameters)
    unknown = {HEAD, RANGE} if timeline.fix_away_m is None else set[str]()
    unknown |= {ARM} if timeline.fix_ship_yaw_rad is None else set[str]()
    return tuple(key for key, states in KEYS.items() if known[states[0]] > 0 and key not in unknown)


def near(value: Mapping[str, float]) -> Point:
    """Return the point next to the values of some states; 0 for the others."""
    return tuple(round(value.get(state, 0.0) / step) * step for state, step in STEPS.items())


def linearised(timeline: Timeline, lever_m: tuple[float, float], fixes: int, point: Point) -> Linearised:
    """Return the first fixes minus dead reckoning, linear in PASS_STATES about the point.

    ``lever_m`` is that of the transponder from the DVL, starboard and forward.
    """
    states = PASS_STATES
    about = dict(zip(STEPS, point, strict=True))
    latest_s = float(timeline.fix_time_s[:fixes].max(initial=0.0)) - min(about["usbl_latency"], 0.0)
    timeline = until(timeline, latest_s + MARGIN_S + sum(abs(about[clock]) for clock in CLOCKS))
    line, latency_s = freed(timeline, about), about["usbl_latency"]
    gps = np.zeros(len(line.fix_time_s[:fixes]), dtype=np.bool_) if line.fix_is_gps is None else line.fix_is_gps[:fixes]
    valid_s = np.where(gps, timeline.fix_time_s[:fixes], line.fix_time_s[:fixes])
    drift = {state: integrated(line.time_s, rate) for state, rate in drift_rates(line).items() if state in states}
    for clock in CLOCKS:
        late, early = (displacement_m(freed(timeline, about | {clock: about[clock] + step})) for step in CLOCK_STEPS_S)
        drift[clock] = (late - early) / (CLOCK_STEPS_S[0] - CLOCK_STEPS_S[1])
    drift["dvl_scale"] = drift["dvl_scale"] / (1 + about["dvl_scale"])
    at_point = sum((drift[state] * value for state, value in about.items() if value and state in drift), np.zeros(2))
    H = np.zeros((len(valid_s), 2, len(states)))
    for state, columns in drift.items():
        H[:, :, states.index(state)] = columns_at(valid_s, line.time_s, columns)
    V_at = columns_at(valid_s, line.time_s, velocity_mps(line))
    yaw = np.interp(valid_s, line.time_s, line.dr_yaw_rad)
    stamped, valid = (t - np.clip(t, line.time_s[0], line.time_s[-1]) for t in (timeline.fix_time_s[:fixes], valid_s))
    from_point_s = np.where(gps, 0.0, latency_s) + valid - stamped  # of a fix of the log that was valid beyond its ends
    reckoned_m = columns_at(valid_s, line.time_s, displacement_m(line) - at_point) + V_at * from_point_s[:, None]
    for names in (("x", "y"), BIAS_STATES, OFFSET_STATES):
        for axis, name in enumerate(names):
            H[:, axis, states.index(name)] = 1.0
    H[:, :, states.index("usbl_latency")] = -V_at
    for name, unit in zip(KEYS[LEVER], np.eye(2), strict=True):
        H[:, :, states.index(name)] = -rotated(yaw, unit)
    residual_m = line.fix_m[:fixes] - reckoned_m - rotated(yaw, np.array(lever_m))
    if line.fix_away_m is not None:
        # from the head to dead reckoning and not to the fix: an outlier would explain itself by its own length
        away_m = line.fix_away_m[:fixes] - residual_m + np.median(residual_m, axis=0)
        H[:, :, states.index("usbl_heading")] = np.column_stack([-away_m[:, 1], away_m[:, 0]])
        H[:, :, states.index("usbl_range")] = away_m
        if timeline.fix_levelled_by_m is not None:  # of h² = r² - z² the derivative is r² / h
            z_m2, h_m2 = timeline.fix_levelled_by_m[:fixes] ** 2, np.sum(away_m**2, axis=1)
            H[:, :, states.index("usbl_range")] *= (1 + z_m2 / np.maximum(h_m2, STEEP**2 * z_m2 + 1e-9))[:, None]
    if line.fix_ship_yaw_rad is not None:
        H[:, :, [states.index(name) for name in KEYS[ARM]]] = -ship_axes(line.fix_ship_yaw_rad[:fixes])
    for name in OF_USBL:
        H[gps, :, states.index(name)] = 0.0
    residual_m += H[:, :, states.index("usbl_heading")] * about["usbl_heading"]
    return Linearised(residual_m, H)


def has_dead_reckoning(timeline: Timeline, time_s: Vector) -> Mask:
    """Return at which times, (T,), DVL and compass were there: without them the vehicle's motion looks like noise."""
    silent = [
        (time_s > gap.start_s) & (time_s <= gap.end_s) for gap in timeline.outages if gap.sensor in ("dvl", "compass")
    ]
    return ~np.any([np.zeros(len(time_s), dtype=np.bool_), *silent], axis=0)


def drift_variances_m2(
    timeline: Timeline, time_s: Vector, members: Sequence[Parameters], scaled: Sequence[bool]
) -> Array:
    """Return the variance of each axis of dead reckoning from time to time, (T, N), ascending, from 0 to the first.

    ``scaled`` says of each of N members whether the DVL's scale error is one of its states.
    """
    process = [p.process for p in members]
    measured, held, turned = open_by_records(timeline, process[0].turn_rate_radps)
    # of the modes, what grows with R: records that contamination stands for do not enter dead reckoning
    dvl = BankNoise([p.dvl for p in members], [p.dvl_sd_scale for p in members])
    noise_m2 = _gained(time_s, measured) * (dvl.probabilities * dvl.gain).sum(axis=0)
    held_m2 = _gained(time_s, held) * [q.velocity_mps**2 for q in process]
    walk_m2 = [
        q.position_m**2 + (0.0 if known else q.uncalibrated_m**2) for q, known in zip(process, scaled, strict=True)
    ]
    dt_s = np.maximum(np.diff(time_s, prepend=0.0), 0.0)[:, None]
    return dt_s * walk_m2 + noise_m2 + held_m2 + _gained(time_s, turned)


class _Gain(NamedTuple):
    """A quantity that grows linearly between edges."""

    edges_s: Vector  # (n,)
    total: Vector  # (n,) at the edges


@lru_cache(maxsize=1)  # a search asks for the same timeline again and again
def open_by_records(timeline: Timeline, turn_radps: float) -> tuple[_Gain, _Gain, _Gain]:
    """Return the variances of dead reckoning by noise of the DVL, by a random walk of 1 m/s/√s, and by turns."""
    # each record holds from its time to the next, the first one also before it
    dvl_rows = np.flatnonzero(timeline.dvl_count)
    dvl_s = np.concatenate([timeline.time_s[: len(dvl_rows)][:1], timeline.time_s[dvl_rows], timeline.time_s[-1:]])
    spacing_s, dvl_rows = np.diff(dvl_s), np.append(dvl_rows[:1], dvl_rows)
    R = timeline.dvl_sd_mps[dvl_rows] ** 2 / timeline.dvl_count[dvl_rows]
    yaw_s = np.append(timeline.time_s[timeline.yaw_count > 0], timeline.time_s[-1])
    moved_m2 = np.sum(np.diff(columns_at(yaw_s, timeline.time_s, displacement_m(timeline)), axis=0) ** 2, axis=1)
    # a random walk of the turn rate q, interpolated over s seconds: the integral of yaw has the variance q^2 s^5 / 120
    turned = np.minimum(turn_radps**2 * np.diff(yaw_s) ** 3 / 120, UNKNOWN_DIRECTION)
    steps = (dvl_s, R * spacing_s**2), (dvl_s, spacing_s**3 / 3), (yaw_s, moved_m2 * turned)
    measured, held, turns = (_Gain(edges_s, np.append(0.0, np.cumsum(gained))) for edges_s, gained in steps)
    return measured, held, turns


def _gained(time_s: Vector, gain: _Gain) -> Array:
    """Return what is gained from time to time, (T, 1)."""
    return np.diff(np.interp(time_s, gain.edges_s, gain.total), prepend=0.0)[:, None]
