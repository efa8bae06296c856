"""Slips so large that they hide all else: another clock, velocities or headings in another unit. Uses no truth.

What is found is taken off before the conventions are judged; else none of them would fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import (
    dead_reckoned,
    fit_rotation,
    fit_sensor_errors,
    fix_points,
    segment_numbers,
)
from usbldr.filters.types import Timeline
from usbldr.io.conventions.dvl_depth import MPS_PER_UNIT
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    InterpretationResult,
    compare_interpretations,
    recorded_value,
    reinterpret,
    topic_of,
)
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.settings.sensor_sections import MAX_SCALE_ERROR, MIN_SCALE_ERROR

LEAP_SECONDS = 18.0  # fixed: GPS time minus UTC since 2017


def correct_velocity_unit(
    log: Log, timeline: Timeline, verdict: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return by how many times the DVL reads too much, 1 unless it is far off beyond doubt, and what is left of that.

    Lengths of moves tell it, whatever is turned or mirrored; without it, no reading of the conventions would fit.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    later = np.searchsorted(timeline.fix_time_s, timeline.fix_time_s + THRESHOLDS.displacement_s)
    first = np.flatnonzero(later < len(group))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < THRESHOLDS.min_displacements:
        return 1.0, verdict, timeline
    track, fixes = dead_reckoned(timeline, timeline.fix_time_s), fix_points(timeline)
    dr_m, fix_m = (float(np.median(np.abs(p[later[first]] - p[first]))) for p in (track, fixes))
    limit = THRESHOLDS.gross_scale_factor
    if not min(dr_m, fix_m) > 0 or 1 / limit < dr_m / fix_m < limit:
        return 1.0, verdict, timeline
    still_m = fit_rotation(replace(timeline, dr_mps=np.zeros_like(timeline.dr_mps)), group).rms_m
    times, slower = dr_m / fix_m, _with_velocity_divided(timeline, dr_m / fix_m)
    again = compare_interpretations(log, slower, sources)
    if again is not None and (
        c := fit_sensor_errors(reinterpret(log, slower, again.best.flips), again.best.fit.rotation_rad)
    ):
        times, slower = times * (1 + c.scale), _with_velocity_divided(slower, 1 + c.scale)
        again = compare_interpretations(log, slower, sources)
    if again is None or again.best.residual_m > THRESHOLDS.gross_residual_ratio * min(verdict.best.residual_m, still_m):
        return 1.0, verdict, timeline
    return times, again, slower


def _with_velocity_divided(timeline: Timeline, times: float) -> Timeline:
    return replace(timeline, dvl_mps=timeline.dvl_mps / times, dr_mps=timeline.dr_mps / times)


def velocity_unit_findings(log: Log, times: float, verdict: InterpretationResult) -> list[Finding]:
    """Say that velocities are far from m/s, and in which unit they are, where one explains it."""
    dvl, read = topic_of(log, "dvl"), recorded_value(log, "dvl", "unit")
    key, value = unit_or_scale_key(log, times)
    text = (
        f"{dvl}: with velocities divided by {times:.3g}, dead reckoning lies {verdict.best.residual_m:.2f} m rms from "
        f"the fixes, and far off as they were read ({read}); "
        + (f"state {key} = {value} under [dvl]" if key else "no unit explains it: see how its driver writes them")
    )
    return [Finding("DVL-UNIT", text, dvl, None, times, "times")]


def unit_or_scale_key(log: Log, times: float) -> tuple[str, str]:
    """Return the key that takes off what a DVL reads too much and its value, its unit before its scale; "" for none."""
    read = log.convention("dvl", "unit")
    off = {name: abs(times * mps / MPS_PER_UNIT[str(read.value)] - 1) for name, mps in MPS_PER_UNIT.items()}
    nearest = min(off, key=lambda name: off[name])
    if off[nearest] < THRESHOLDS.unit_tolerance and read.chosen_by != "column names":
        return "unit", f'"{nearest}"'
    scale = (1 + log.settings.dvl.scale_error) * times - 1
    return ("scale_error", f"{scale:.4g}") if MIN_SCALE_ERROR <= scale <= MAX_SCALE_ERROR else ("", "")


def correct_clock_offset(
    log: Log, timeline: Timeline, verdict: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return how far the fixes' clock is off, 0 unless beyond doubt, with verdict and timeline once that is taken off.

    A clock that is off by more than any sound takes is no latency: as it stands, it passes for a turned DVL.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    lines = [reinterpret(log, timeline, flips) for flips in {verdict.best.flips, verdict.as_read.flips}]
    far = min((fit_rotation(line, group, _clock_offsets_s()) for line in lines), key=lambda turn: turn.rms_m)
    moved = replace(timeline, fix_time_s=timeline.fix_time_s - far.latency_s)
    again = compare_interpretations(log, moved, sources) if far.rms_m < verdict.best.residual_m else None
    if again is None or again.best.residual_m > THRESHOLDS.gross_residual_ratio * verdict.best.residual_m:
        return 0.0, verdict, timeline
    return far.latency_s, again, moved


def _clock_offsets_s() -> list[float]:
    """Return the offsets of a clock to try, beyond the fixes' usual delays."""
    limits = THRESHOLDS
    offsets_s = np.arange(-limits.max_clock_offset_s, limits.max_clock_offset_s + 1.0, limits.clock_offset_step_s)
    return [float(s) for s in offsets_s if abs(s) > limits.min_clock_offset_s]


def clock_offset_findings(log: Log, late_s: float) -> list[Finding]:
    """Say that the fixes' clock is off by more than a delay could be."""
    usbl = topic_of(log, "usbl")
    is_leap = abs(abs(late_s) - LEAP_SECONDS) < THRESHOLDS.leap_second_tolerance_s
    leap = f" (GPS time and UTC are {LEAP_SECONDS:g} s apart)" if is_leap else ""
    stated = log.settings.usbl.latency_s
    text = (
        f"{usbl}: fixes fit dead reckoning far better where their stamps lie {delay_text(late_s)} the time at which "
        f"they were true, by the DVL's clock{leap}; if that is right, state latency_s = {stated + late_s:.2f} under "
        "[usbl]"
    )
    return [Finding("CLOCK-OFFSET", text, usbl, None, late_s, "s")]


def delay_text(delay_s: float) -> str:
    """Return a delay in words."""
    return f"{abs(delay_s):.2f} s {'after' if delay_s > 0 else 'before'}"


def heading_unit_findings(log: Log, timeline: Timeline, verdict: InterpretationResult) -> list[Finding]:
    """Headings that never leave 6.3 degrees may be radians: the fixes tell."""
    yaw = timeline.dr_yaw_rad
    if np.ptp(yaw) > np.radians(THRESHOLDS.max_radians_span) or recorded_value(log, "compass", "unit") != "deg":
        return []
    wider = replace(timeline, dr_yaw_rad=np.unwrap(np.degrees(yaw)))
    residual_m = fit_rotation(wider, segment_numbers(timeline, timeline.fix_time_s)).rms_m
    if residual_m > THRESHOLDS.clearly_better_ratio * verdict.as_read.residual_m:
        return []
    topic = topic_of(log, "compass")
    named = log.convention("compass", "unit").chosen_by == "column names"
    columns = 'columns = { time_ns = "time_ns", heading = "heading_deg" } and ' if named else ""
    text = (
        f"{topic}: as radians, dead reckoning lies {residual_m:.2f} m rms from the fixes, as degrees "
        f'{verdict.as_read.residual_m:.2f} m; state {columns}unit = "rad" under [compass]'
    )
    return [Finding("HEADING-RADIANS", text, topic, None, verdict.as_read.residual_m, "m")]
