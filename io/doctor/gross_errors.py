"""Gross configuration errors: another clock, another unit or sense, exchanged quantities. Uses no truth.

Units and clocks are corrected before the conventions are compared; otherwise no interpretation would fit.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError, listed
from usbldr.filters.identification.dr_usbl_fit import (
    MIN_FIXES,
    as_points,
    dead_reckoned,
    fit_rotation,
    fix_points,
    segment_numbers,
)
from usbldr.filters.replay.dead_reckoning import freed
from usbldr.filters.types import Array, Mask, Timeline
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    InterpretationResult,
    compare_interpretations,
    recorded_value,
    reinterpret,
    white_noise_m,
)
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_geodetic, to_plane
from usbldr.io.gps_time import LEAP_S
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline as timeline_of
from usbldr.io.settings.sensor_sections import MAX_SCALE_ERROR, MIN_SCALE_ERROR
from usbldr.io.units import MPS_PER_UNIT

AS_READ = (False, False, False)
MAX_TURN_DEG = 20.0  # a declination and a mount that nobody stated; the errors turn a track by multiples of 90
NOT_BY_KEYS = "correct them in the log"
MIN_RECORDS = 3  # fixed: with fewer no interval is usual


def correct_velocity_unit(
    log: Log, timeline: Timeline, result: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return DVL velocity over true velocity, 1 unless grossly wrong, with result and timeline once corrected.

    It is estimated from lengths of displacements, which no rotation or mirroring changes.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    later = np.searchsorted(timeline.fix_time_s, timeline.fix_time_s + THRESHOLDS.displacement_s)
    first = np.flatnonzero(later < len(group))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < THRESHOLDS.min_displacements:
        return 1.0, result, timeline
    track, fixes = dead_reckoned(timeline, timeline.fix_time_s), fix_points(timeline)
    dr_m, fix_m = (float(np.median(np.abs(p[later[first]] - p[first]))) for p in (track, fixes))
    limit = THRESHOLDS.gross_scale_factor
    if not min(dr_m, fix_m) > 0 or 1 / limit < dr_m / fix_m < limit:
        return 1.0, result, timeline
    standstill_m = fit_rotation(replace(timeline, dr_mps=np.zeros_like(timeline.dr_mps)), group).rms_m
    ratio, slower = dr_m / fix_m, _with_velocity_divided(timeline, dr_m / fix_m)
    corrected = compare_interpretations(log, slower, sources)
    if corrected is not None and (scale := corrected.best.fit.scale) > 0:
        ratio, slower = ratio * scale, _with_velocity_divided(slower, scale)
        corrected = compare_interpretations(log, slower, sources)
    most_m = THRESHOLDS.gross_residual_ratio * min(result.best.residual_m, standstill_m)
    if corrected is None or corrected.best.residual_m > most_m:
        return 1.0, result, timeline
    return ratio, corrected, slower


def _with_velocity_divided(timeline: Timeline, ratio: float) -> Timeline:
    return replace(timeline, dvl_mps=timeline.dvl_mps / ratio, dr_mps=timeline.dr_mps / ratio)


def velocity_unit_findings(log: Log, ratio: float, result: InterpretationResult) -> list[Finding]:
    """Report that velocities are far from m/s, and the unit, if one explains it."""
    read, (key, value) = recorded_value(log, "dvl", "unit"), unit_or_scale_key(log, ratio)
    unit = fitting_unit(log, ratio)
    text = (
        f"velocities, read in {read}, are {ratio:.3g} times those that fit the fixes; dead-reckoning-to-fix "
        f"residual once corrected: {result.best.residual_m:.2f} m RMS; "
        + (f"they are {unit}: " if unit and key != "unit" else "")
        + (f"state {key} = {value} under [dvl]" if key else "no unit explains it: check what its driver writes")
    )
    return [log.finding("DVL-UNIT", "dvl", text, None, ratio, "times")]


def fitting_unit(log: Log, ratio: float) -> str:
    """Return the unit that explains the ratio of velocities as read and true ones, empty if none does."""
    read_mps = MPS_PER_UNIT[str(log.convention("dvl", "unit").value)]
    error = {name: abs(ratio * mps / read_mps - 1) for name, mps in MPS_PER_UNIT.items()}
    nearest = min(error, key=lambda name: error[name])
    return nearest if error[nearest] < THRESHOLDS.unit_tolerance else ""


def unit_or_scale_key(log: Log, ratio: float) -> tuple[str, str]:
    """Return the key that corrects the velocities, and its value: unit, if one explains the ratio, else scale_error.

    A column's name states its unit, which only a scale error can correct then: that of the unit.
    """
    read, unit = log.convention("dvl", "unit"), fitting_unit(log, ratio)
    if unit and read.chosen_by != "column names":
        return "unit", f'"{unit}"'
    exact = MPS_PER_UNIT[str(read.value)] / MPS_PER_UNIT[unit] if unit else ratio
    scale = (1 + log.settings.dvl.scale_error) * exact - 1
    return ("scale_error", f"{scale:.4g}") if MIN_SCALE_ERROR <= scale <= MAX_SCALE_ERROR else ("", "")


def correct_clock_offset(
    log: Log, timeline: Timeline, result: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return the offset of the fixes' clock, 0 unless significant, with result and timeline once corrected.

    An offset longer than any acoustic delay is no latency; uncorrected, it looks like a rotated DVL.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    lines = [reinterpret(log, timeline, flips) for flips in {result.best.flips, result.as_read.flips}]
    limits = THRESHOLDS
    tried_s = np.arange(-limits.max_clock_offset_s, limits.max_clock_offset_s + 1.0, limits.clock_offset_step_s)
    tried_s = [float(s) for s in tried_s if abs(s) > limits.min_clock_offset_s]  # beyond the fixes' usual delays
    far = min((fit_rotation(line, group, tried_s) for line in lines), key=lambda turn: turn.rms_m)
    late_s, most_m = far.latency_s, limits.gross_residual_ratio * result.best.residual_m
    if not (far.rms_m < result.best.residual_m and abs(late_s) < limits.max_clock_offset_s):
        far_off = result.best.residual_m > limits.min_far_residual_m
        late_s, most_m = _far_clock_offset(lines) if far_off else (0.0, 0.0)
    shifted = replace(timeline, fix_time_s=timeline.fix_time_s - late_s)
    corrected = compare_interpretations(log, shifted, sources) if late_s else None
    if corrected is None or corrected.best.residual_m > most_m:
        return 0.0, result, timeline
    return late_s, corrected, shifted


def _far_clock_offset(lines: Sequence[Timeline]) -> tuple[float, float]:
    """Return the offset of the fixes' clock, beyond a minute, that explains most, and the most that it may leave, in m.

    Both are of the fixes that lie within dead reckoning with and without it; 0 if there are too few of them. Fixes that
    hardly move fit at any time.
    """
    limits = THRESHOLDS
    best_s, least_m, large_m = 0.0, np.inf, 0.0
    for line in lines:
        group = segment_numbers(line, line.fix_time_s)
        for late_s in np.arange(-limits.max_far_offset_s, limits.max_far_offset_s + 1, limits.far_offset_step_s):
            valid_s = line.fix_time_s - late_s
            inside = (valid_s >= line.time_s[0]) & (valid_s <= line.time_s[-1]) & (segment_numbers(line, valid_s) >= 0)
            there = np.where(inside, group, -1)
            if np.sum(there >= 0) < max(MIN_FIXES, len(group) // 4):
                continue
            there = np.unique(there, return_inverse=True)[1] - int(np.any(there < 0))
            rms_m = fit_rotation(line, there, [float(late_s)]).rms_m
            if rms_m < least_m:
                best_s, least_m = float(late_s), rms_m
                way_m = float(np.std(fix_points(line)[there >= 0]))
                large_m = min(fit_rotation(line, there, [0.0]).rms_m, way_m)
    return best_s, limits.far_residual_ratio * large_m


def clock_offset_findings(log: Log, late_s: float, truth_agrees: bool = False) -> list[Finding]:
    """Report an offset of the fixes' clock that is larger than any delay; the truth may agree with it."""
    stated = log.settings.usbl.latency_s
    advice = f"if that clock is right, state latency_s = {stated + late_s:.2f} under [usbl]"
    if truth_agrees:
        advice = f"the truth has the fixes' clock: state latency_s = {-late_s:.2f} under [dvl] and [compass]"
    text = (
        f"stamps are {abs(late_s):.2f} s {'after' if late_s > 0 else 'before'} the time of validity that fits "
        f"dead reckoning far better, by the DVL's clock{_leap_text(late_s)}; {advice}"
    )
    return [log.finding("CLOCK-OFFSET", "usbl", text, None, late_s, "s")]


def _leap_text(late_s: float) -> str:
    is_leap = abs(abs(late_s) - LEAP_S) < THRESHOLDS.leap_second_tolerance_s
    return f" (GPS time and UTC are {LEAP_S} s apart)" if is_leap else ""


def heading_unit_findings(log: Log, timeline: Timeline, result: InterpretationResult) -> list[Finding]:
    """Report headings within a span of 6.4 degrees that fit the fixes better as radians."""
    yaw = timeline.dr_yaw_rad
    if np.ptp(yaw) > np.radians(THRESHOLDS.max_radians_span) or recorded_value(log, "compass", "unit") != "deg":
        return []
    turned = np.unwrap(np.degrees(yaw))
    lines = [replace(timeline, dr_yaw_rad=sense * turned) for sense in (1.0, -1.0)]  # whichever way it counts
    residual_m = min(fit_rotation(line, segment_numbers(timeline, timeline.fix_time_s)).rms_m for line in lines)
    if residual_m > THRESHOLDS.clearly_better_ratio * result.as_read.residual_m:
        return []
    named = log.convention("compass", "unit").chosen_by == "column names"
    columns = 'columns = { time_ns = "time_ns", heading = "heading_deg" } and ' if named else ""
    text = (
        f"dead-reckoning-to-fix residual: {residual_m:.2f} m RMS with headings in radians, "
        f'{result.as_read.residual_m:.2f} m in degrees; state {columns}unit = "rad" under [compass]'
    )
    return [log.finding("HEADING-RADIANS", "compass", text, None, result.as_read.residual_m, "m")]


class SingleError(NamedTuple):
    """An error, and the timeline without it."""

    code: str
    role: str
    what: str
    advice: str
    line: Timeline


def single_errors(log: Log, timeline: Timeline, result: InterpretationResult) -> tuple[list[SingleError], float]:
    """Return the errors that alone explain the fixes clearly better, and the RMS that is left, in metres.

    The eight interpretations, with any rotation, also fit a log whose headings have the wrong sign, whose velocities
    are exchanged, or whose latitudes and longitudes are; but they take two or three of them. An error that alone makes
    dead reckoning fit the fixes, hardly rotated, is the likelier cause. None if an interpretation explains as much by
    one change. Several fit alike if the vehicle hardly drifts sideways.
    """
    read, best = result.as_read, result.best
    group = segment_numbers(timeline, timeline.fix_time_s)
    largest_rad = np.radians(MAX_TURN_DEG)
    changes = sum(best.flips) + (abs(best.offset_deg) > MAX_TURN_DEG)
    better = THRESHOLDS.clearly_better_ratio
    most_m = min(better * read.residual_m, best.residual_m * (better if changes < 2 else 1 / better))
    found = [(fit_rotation(reinterpret(log, one.line, AS_READ), group), one) for one in _candidates(log, timeline)]
    fitting = [(fit.rms_m, one) for fit, one in found if fit.rms_m <= most_m and abs(fit.rotation_rad) < largest_rad]
    if not fitting:
        return [], best.residual_m
    least_m = min(rms_m for rms_m, _ in fitting)
    alike = [(rms_m, one) for rms_m, one in fitting if rms_m * better <= least_m]
    return [one for _, one in sorted(alike, key=lambda pair: pair[0])], least_m


def sensor_clock_error(log: Log, timeline: Timeline, result: InterpretationResult) -> tuple[SingleError, float] | None:
    """Return the clock of DVL or compass that explains the fixes best if it is off, and the RMS that is left, metres.

    GPS time beside UTC is off by more than want of synchronisation, and bends dead reckoning in each turn or change of
    speed. None if no clock fits clearly better; a deviation or a lost bottom lock may fit better still.
    """
    most_m, limits = THRESHOLDS.clearly_better_ratio * result.interpretations[0].residual_m, THRESHOLDS
    if most_m < white_noise_m(timeline):
        return None
    group = segment_numbers(timeline, timeline.fix_time_s)

    def best(tried: Iterable[tuple[str, float]]) -> tuple[float, str, float]:
        lines = ((sensor, late_s, freed(timeline, {f"{sensor}_clock": late_s})) for sensor, late_s in tried)
        return min(
            (fit_rotation(reinterpret(log, line, AS_READ), group, [0.0]).rms_m, sensor, late_s)
            for sensor, late_s, line in lines
        )

    tried_s = np.arange(-limits.max_clock_offset_s, limits.max_clock_offset_s + 1, limits.clock_offset_step_s).tolist()
    far_s = [late_s for late_s in tried_s if abs(late_s) > limits.min_clock_offset_s]
    _, sensor, about_s = best(product(("dvl", "compass"), far_s))
    near_s = np.arange(-limits.clock_offset_step_s, limits.clock_offset_step_s, float(np.diff(timeline.time_s[:2])[0]))
    rms_m, _, late_s = best((sensor, about_s + float(s)) for s in near_s)
    if rms_m > most_m:
        return None
    stated_s = (log.settings.dvl if sensor == "dvl" else log.settings.compass).latency_s
    what = f"its stamps are {abs(late_s):.1f} s {'late' if late_s > 0 else 'early'} against the other sensors"
    advice = f"state latency_s = {stated_s + late_s:.1f} under [{sensor}]"
    line = freed(timeline, {f"{sensor}_clock": late_s})
    return SingleError(f"{sensor.upper()}-CLOCK", sensor, what + _leap_text(late_s), advice, line), rms_m


def single_error_findings(
    log: Log, result: InterpretationResult, errors: list[SingleError], rms_m: float
) -> list[Finding]:
    """Report the errors of `single_errors`, one of which the log has."""
    rivals = [f"{log.topic_of(one.role)}, {one.what}" for one in errors[1:]]
    or_else = f"; or else: of {listed(rivals, len(rivals))}" if rivals else ""
    first, read_m = errors[0], result.as_read.residual_m
    text = (
        f"{first.what}: with this corrected, dead reckoning fits the fixes within "
        f"{rms_m:.2f} m RMS, as read and rotated within {read_m:.2f} m; {first.advice}{or_else}"
    )
    return [log.finding(first.code, first.role, text, None, read_m, "m")]


def _candidates(log: Log, timeline: Timeline) -> Iterator[SingleError]:
    sense, axes = recorded_value(log, "compass", "convention"), recorded_value(log, "dvl", "axes")
    if sense:
        other = "NED" if sense == "ENU" else "ENU"
        key = f'state convention = "{other}" and bias_deg = {log.settings.compass.bias_deg + 90:g} under [compass]'
        advice = NOT_BY_KEYS if log.convention("compass", "convention").chosen_by == "column names" else key
        turned = replace(timeline, dr_yaw_rad=-timeline.dr_yaw_rad)
        yield SingleError("HEADING-CONVENTION", "compass", "its headings have the wrong sign", advice, turned)
    if axes and not log.settings.dvl.mount_deg:
        sign = -1.0 if axes[1] in "LP" or axes[0] in "LP" else 1.0
        key = f'state axes = "{axes[1]}{axes[0]}{axes[2:]}" under [dvl]'
        advice = "exchange their columns" if log.convention("dvl", "axes").chosen_by == "column names" else key
        exchanged = replace(timeline, dr_mps=sign * timeline.dr_mps[:, ::-1])
        yield SingleError("DVL-AXES", "dvl", "its first two velocities are exchanged", advice, exchanged)
    velocity = as_points(timeline.dr_mps)
    for east_north in (turn * one for turn in (1, 1j, -1, -1j) for one in (velocity, velocity.conj())):  # of any axes
        components = np.column_stack([east_north.real, east_north.imag])
        what = "its velocities are along east and north, not along axes of the vehicle or instrument"
        along = replace(timeline, dr_mps=components, dr_yaw_rad=np.zeros(len(timeline.time_s)))
        yield SingleError("DVL-EARTH", "dvl", what, "record them in instrument axes", along)
    if recorded_value(log, "usbl", "kind") == "latlon" and log.origin is not None:
        lat_deg, lon_deg = to_geodetic(log.origin, *timeline.fix_m.T)
        for what, lat, lon in (
            ("its longitudes have the wrong sign", lat_deg, -lon_deg),
            ("its latitudes have the wrong sign", -lat_deg, lon_deg),
            ("latitude and longitude are exchanged", np.clip(lon_deg, -90, 90), lat_deg),
        ):
            there = Origin(float(np.median(lat)), float(np.median(lon)), log.origin.kind)
            moved = replace(timeline, fix_m=np.column_stack(to_plane(there, lat, lon)))
            yield SingleError("MAP-FRAME", "usbl", what, NOT_BY_KEYS, moved)


class _Fit(NamedTuple):
    """Dead reckoning turned and shifted to F fixes."""

    covered: Mask  # (F,) the fixes within its time
    rms_m: float  # of these; 0 without any
    fix_m: Array  # (F, 2)

    @classmethod
    def of(cls, log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> "_Fit":
        """Return the best fit under some interpretations."""
        group = segment_numbers(timeline, timeline.fix_time_s)
        rms_m = 0.0
        if np.any(group >= 0):
            rms_m = min(fit_rotation(reinterpret(log, timeline, each), group).rms_m for each in flips)
        return cls(group >= 0, rms_m, timeline.fix_m)

    def left_m(self, rows: Mask) -> float:
        """Return what is left of these fixes (F,), RMS: of one that is not covered, its distance from their mean."""
        lost_m = self.fix_m[rows & ~self.covered]
        scatter_m2 = float(np.sum((lost_m - lost_m.mean(axis=0)) ** 2)) if len(lost_m) else 0.0
        return float(np.sqrt(((rows.sum() - len(lost_m)) * self.rms_m**2 + scatter_m2) / max(rows.sum(), 1)))


def clock_step_findings(log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> list[Finding]:
    """Return a finding for each sensor whose longest gap is a step of its clock, under one of some interpretations.

    A clock that was set forward leaves a gap as long as the step, as an outage does. Dead reckoning distinguishes the
    two: with the step taken off, it fits the fixes better, and after an outage far worse. Fixes that the step moves out
    of its time are left as far off as they scatter.
    """
    settings, before, found = log.settings, _Fit.of(log, timeline, flips), list[Finding]()
    for sensor, section in (("dvl", settings.dvl), ("compass", settings.compass), ("usbl", settings.usbl)):
        time_s = log.tables[sensor]["time_s"].to_numpy()
        if len(time_s) < MIN_RECORDS:
            continue
        gaps_s = np.diff(time_s)
        last = int(np.argmax(gaps_s))
        step_s = float(gaps_s[last] - np.median(gaps_s))
        if step_s < THRESHOLDS.min_clock_step_s or section.clock_step_s:
            continue
        table = log.tables[sensor].assign(time_s=time_s - np.where(np.arange(len(time_s)) > last, step_s, 0.0))
        try:
            undone = timeline_of(replace(log, tables={**log.tables, sensor: table}))
            after = _Fit.of(log, undone, flips)
        except LogError:
            continue
        covered = before.covered | after.covered
        before_m, after_m = before.left_m(covered), after.left_m(covered)
        if not after_m <= THRESHOLDS.clock_step_residual_ratio * before_m:
            continue
        text = (
            f"stamps jump by {step_s:.2f} s at {time_s[last]:.1f} s; without the jump dead reckoning fits the "
            f"fixes within {after_m:.2g} m, not {before_m:.2g} m, so its clock was set forward: state "
            f"clock_step_s = {step_s:.2f} under [{sensor}]"
        )
        found.append(log.finding("CLOCK-STEP", sensor, text, float(time_s[last]), step_s, "s"))
    return found
