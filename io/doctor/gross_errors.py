"""Gross configuration errors: another unit or sense, exchanged quantities. Uses no truth.

Units, and clocks (clocks.py), are corrected before the conventions are compared; otherwise no interpretation would fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import listed
from usbldr.filters.identification.dr_usbl_fit import (
    as_points,
    dead_reckoned,
    fit_rotation,
    fix_points,
    segment_numbers,
)
from usbldr.filters.types import Timeline
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    InterpretationResult,
    compare_interpretations,
    recorded_value,
    reinterpret,
)
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_geodetic, to_plane
from usbldr.io.log import Log
from usbldr.io.settings.sensor_sections import MAX_SCALE_ERROR, MIN_SCALE_ERROR
from usbldr.io.units import MPS_PER_UNIT

AS_READ = (False, False, False)
MAX_TURN_DEG = 20.0  # a declination and a mount that nobody stated; the errors turn a track by multiples of 90
NOT_BY_KEYS = "correct them in the log"


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
    late_s: float = 0.0  # its stamps, if its clock is the error


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
    worst = (first.late_s, "s") if first.late_s else (read_m, "m")
    return [log.finding(first.code, first.role, text, None, *worst)]


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
