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
from usbldr.io.doctor.findings import GradedFinding, graded_finding
from usbldr.io.doctor.interpretations import (
    CLEARLY_BETTER_RATIO,
    HandednessEvidence,
    InterpretationResult,
    compare_interpretations,
    configuration_of,
    recorded_convention,
    reinterpret,
    topic_of,
)
from usbldr.io.log import Log
from usbldr.io.settings.sensor_sections import MAX_SCALE_ERROR, MIN_SCALE_ERROR

CLOCK_OFFSETS_S = tuple(
    float(s) for s in range(-60, 61, 2) if abs(s) > 4
)  # offsets of a clock, beyond the fixes' usual delays
GROSS_RESIDUAL_RATIO = 0.5  # another clock is claimed where less than this share of the residual is left
DISPLACEMENT_S = 60.0  # long enough for a vehicle to go further than its fixes scatter
MIN_DISPLACEMENTS = 10
GROSS_SCALE_FACTOR = 1.5  # times or parts: nearer to 1, turning and shifting tell the scale
UNIT_TOLERANCE = 0.05  # that near to a unit's size it is this unit
LEAP_SECONDS = 18.0  # GPS time minus UTC since 2017


def correct_velocity_unit(
    log: Log, timeline: Timeline, verdict: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return by how many times the DVL reads too much, 1 unless it is far off beyond doubt, and what is left of that.

    Lengths of moves tell it, whatever is turned or mirrored; without it, no reading of the conventions would fit.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    later = np.searchsorted(timeline.fix_time_s, timeline.fix_time_s + DISPLACEMENT_S)
    first = np.flatnonzero(later < len(group))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < MIN_DISPLACEMENTS:
        return 1.0, verdict, timeline
    track, fixes = dead_reckoned(timeline, timeline.fix_time_s), fix_points(timeline)
    dr_m, fix_m = (float(np.median(np.abs(p[later[first]] - p[first]))) for p in (track, fixes))
    if not min(dr_m, fix_m) > 0 or 1 / GROSS_SCALE_FACTOR < dr_m / fix_m < GROSS_SCALE_FACTOR:
        return 1.0, verdict, timeline
    still_m = fit_rotation(replace(timeline, dr_mps=np.zeros_like(timeline.dr_mps)), group).rms_m
    times, slower = dr_m / fix_m, _with_velocity_divided(timeline, dr_m / fix_m)
    again = compare_interpretations(log, slower, sources)
    if again is not None and (
        c := fit_sensor_errors(reinterpret(log, slower, again.best.flips), again.best.fit.rotation_rad)
    ):
        times, slower = times * (1 + c.scale), _with_velocity_divided(slower, 1 + c.scale)
        again = compare_interpretations(log, slower, sources)
    if again is None or again.best.residual_m > GROSS_RESIDUAL_RATIO * min(verdict.best.residual_m, still_m):
        return 1.0, verdict, timeline
    return times, again, slower


def _with_velocity_divided(timeline: Timeline, times: float) -> Timeline:
    return replace(timeline, dvl_mps=timeline.dvl_mps / times, dr_mps=timeline.dr_mps / times)


def velocity_unit_findings(log: Log, times: float, verdict: InterpretationResult) -> list[GradedFinding]:
    """Say that velocities are far from m/s, and in which unit they are, where one explains it."""
    dvl, read, key = topic_of(log, "dvl"), recorded_convention(log, "dvl", "unit")[0], unit_or_scale_key(log, times)
    text = (
        f"{dvl}: with velocities divided by {times:.3g}, dead reckoning lies {verdict.best.residual_m:.2f} m rms from "
        f"the fixes, and far off as they were read ({read}); "
        + (f"state {key} under [dvl]" if key else "no unit explains it: see how its driver writes them")
    )
    return [graded_finding("DVL-UNIT", text, dvl, None, times, "times")]


def unit_or_scale_key(log: Log, times: float) -> str:
    """Return the key that takes off what a DVL reads too much, its unit before its scale; empty for none."""
    unit, who = recorded_convention(log, "dvl", "unit")
    off = {name: abs(times * mps / MPS_PER_UNIT[unit] - 1) for name, mps in MPS_PER_UNIT.items()}
    nearest = min(off, key=lambda name: off[name])
    if off[nearest] < UNIT_TOLERANCE and who != "by column names":
        return f'unit = "{nearest}"'
    scale = (1 + configuration_of(log).dvl.scale_error) * times - 1
    return f"scale_error = {scale:.4g}" if MIN_SCALE_ERROR <= scale <= MAX_SCALE_ERROR else ""


def correct_clock_offset(
    log: Log, timeline: Timeline, verdict: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return how far the fixes' clock is off, 0 unless beyond doubt, with verdict and timeline once that is taken off.

    A clock that is off by more than any sound takes is no latency: as it stands, it passes for a turned DVL.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    lines = [reinterpret(log, timeline, flips) for flips in {verdict.best.flips, verdict.as_read.flips}]
    far = min((fit_rotation(line, group, CLOCK_OFFSETS_S) for line in lines), key=lambda turn: turn.rms_m)
    moved = replace(timeline, fix_time_s=timeline.fix_time_s - far.latency_s)
    again = compare_interpretations(log, moved, sources) if far.rms_m < verdict.best.residual_m else None
    if again is None or again.best.residual_m > GROSS_RESIDUAL_RATIO * verdict.best.residual_m:
        return 0.0, verdict, timeline
    return far.latency_s, again, moved


def clock_offset_findings(log: Log, late_s: float) -> list[GradedFinding]:
    """Say that the fixes' clock is off by more than a delay could be."""
    usbl = topic_of(log, "usbl")
    leap = f" (GPS time and UTC are {LEAP_SECONDS:g} s apart)" if abs(abs(late_s) - LEAP_SECONDS) < 1.5 else ""
    stated = configuration_of(log).usbl.latency_s
    text = (
        f"{usbl}: fixes fit dead reckoning far better where their stamps lie {delay_text(late_s)} the time at which "
        f"they were true, by the DVL's clock{leap}; if that is right, state latency_s = {stated + late_s:.2f} under "
        "[usbl]"
    )
    return [graded_finding("CLOCK-OFFSET", text, usbl, None, late_s, "s")]


def delay_text(delay_s: float) -> str:
    """Return a delay in words."""
    return f"{abs(delay_s):.2f} s {'after' if delay_s > 0 else 'before'}"


def heading_unit_findings(log: Log, timeline: Timeline, verdict: InterpretationResult) -> list[GradedFinding]:
    """Headings that never leave 6.3 degrees may be radians: the fixes tell."""
    yaw = timeline.dr_yaw_rad
    if np.ptp(yaw) > np.radians(6.4) or recorded_convention(log, "compass", "unit")[0] != "deg":
        return []
    wider = replace(timeline, dr_yaw_rad=np.unwrap(np.degrees(yaw)))
    residual_m = fit_rotation(wider, segment_numbers(timeline, timeline.fix_time_s)).rms_m
    if residual_m > CLEARLY_BETTER_RATIO * verdict.as_read.residual_m:
        return []
    topic = topic_of(log, "compass")
    named = recorded_convention(log, "compass", "unit")[1] == "by column names"
    columns = 'columns = { time_ns = "time_ns", heading = "heading_deg" } and ' if named else ""
    text = (
        f"{topic}: as radians, dead reckoning lies {residual_m:.2f} m rms from the fixes, as degrees "
        f'{verdict.as_read.residual_m:.2f} m; state {columns}unit = "rad" under [compass]'
    )
    return [graded_finding("HEADING-RADIANS", text, topic, None, verdict.as_read.residual_m, "m")]
