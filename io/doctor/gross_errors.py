"""Slips so large that they hide all else: another clock, velocities or headings in another unit. Uses no truth.

What is found is taken off before the conventions are judged; else none of them would fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import calibrate, fit_turn, fix_points, groups, reckoned
from usbldr.filters.types import Timeline
from usbldr.io.conventions.dvl_depth import TO_MPS
from usbldr.io.doctor.findings import Diagnosis, diagnosis
from usbldr.io.doctor.interpretations import (
    CLEARLY,
    Source,
    Verdict,
    configuration_of,
    convention,
    judge,
    reread,
    topic_of,
)
from usbldr.io.log import Log
from usbldr.io.settings.sensor_sections import LEAST_SCALE, MOST_SCALE

FAR_S = tuple(float(s) for s in range(-60, 61, 2) if abs(s) > 4)  # offsets of a clock, beyond the fixes' usual delays
FAR_BETTER = 0.5  # another clock is claimed where less than this share of the residual is left
MOVE_S = 60.0  # long enough for a vehicle to go further than its fixes scatter
LEAST_MOVES = 10
FAR_SCALE = 1.5  # times or parts: nearer to 1, turning and shifting tell the scale
SURELY = 0.05  # that near to a unit's size it is this unit
LEAP_SECONDS = 18.0  # GPS time minus UTC since 2017


def in_metres_per_second(
    log: Log, timeline: Timeline, verdict: Verdict, sources: Sequence[Source]
) -> tuple[float, Verdict, Timeline]:
    """Return by how many times the DVL reads too much, 1 unless it is far off beyond doubt, and what is left of that.

    Lengths of moves tell it, whatever is turned or mirrored; without it, no reading of the conventions would fit.
    """
    group = groups(timeline, timeline.fix_time_s)
    later = np.searchsorted(timeline.fix_time_s, timeline.fix_time_s + MOVE_S)
    first = np.flatnonzero(later < len(group))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < LEAST_MOVES:
        return 1.0, verdict, timeline
    track, fixes = reckoned(timeline, timeline.fix_time_s), fix_points(timeline)
    dr_m, fix_m = (float(np.median(np.abs(p[later[first]] - p[first]))) for p in (track, fixes))
    if not min(dr_m, fix_m) > 0 or 1 / FAR_SCALE < dr_m / fix_m < FAR_SCALE:
        return 1.0, verdict, timeline
    still_m = fit_turn(replace(timeline, dr_mps=np.zeros_like(timeline.dr_mps)), group).rms_m
    times, slower = dr_m / fix_m, _slower(timeline, dr_m / fix_m)
    again = judge(log, slower, sources)
    if again is not None and (c := calibrate(reread(log, slower, again.best.flips), again.best.turn.rotation_rad)):
        times, slower = times * (1 + c.scale), _slower(slower, 1 + c.scale)
        again = judge(log, slower, sources)
    if again is None or again.best.residual_m > FAR_BETTER * min(verdict.best.residual_m, still_m):
        return 1.0, verdict, timeline
    return times, again, slower


def _slower(timeline: Timeline, times: float) -> Timeline:
    return replace(timeline, dvl_mps=timeline.dvl_mps / times, dr_mps=timeline.dr_mps / times)


def far_scale(log: Log, times: float, verdict: Verdict) -> list[Diagnosis]:
    """Say that velocities are far from m/s, and in which unit they are, where one explains it."""
    dvl, read, key = topic_of(log, "dvl"), convention(log, "dvl", "unit")[0], unit_or_scale(log, times)
    text = (
        f"{dvl}: with velocities divided by {times:.3g}, dead reckoning lies {verdict.best.residual_m:.2f} m rms from "
        f"the fixes, and far off as they were read ({read}); "
        + (f"state {key} under [dvl]" if key else "no unit explains it: see how its driver writes them")
    )
    return [diagnosis("DVL-UNIT", text, dvl, None, times, "times")]


def unit_or_scale(log: Log, times: float) -> str:
    """Return the key that takes off what a DVL reads too much, its unit before its scale; empty for none."""
    unit, who = convention(log, "dvl", "unit")
    off = {name: abs(times * mps / TO_MPS[unit] - 1) for name, mps in TO_MPS.items()}
    nearest = min(off, key=lambda name: off[name])
    if off[nearest] < SURELY and who != "by column names":
        return f'unit = "{nearest}"'
    scale = (1 + configuration_of(log).dvl.scale_error) * times - 1
    return f"scale_error = {scale:.4g}" if LEAST_SCALE <= scale <= MOST_SCALE else ""


def on_the_dvls_clock(
    log: Log, timeline: Timeline, verdict: Verdict, sources: Sequence[Source]
) -> tuple[float, Verdict, Timeline]:
    """Return how far the fixes' clock is off, 0 unless beyond doubt, with verdict and timeline once that is taken off.

    A clock that is off by more than any sound takes is no latency: as it stands, it passes for a turned DVL.
    """
    group = groups(timeline, timeline.fix_time_s)
    lines = [reread(log, timeline, flips) for flips in {verdict.best.flips, verdict.read.flips}]
    far = min((fit_turn(line, group, FAR_S) for line in lines), key=lambda turn: turn.rms_m)
    moved = replace(timeline, fix_time_s=timeline.fix_time_s - far.latency_s)
    again = judge(log, moved, sources) if far.rms_m < verdict.best.residual_m else None
    if again is None or again.best.residual_m > FAR_BETTER * verdict.best.residual_m:
        return 0.0, verdict, timeline
    return far.latency_s, again, moved


def far_clock(log: Log, late_s: float) -> list[Diagnosis]:
    """Say that the fixes' clock is off by more than a delay could be."""
    usbl = topic_of(log, "usbl")
    leap = f" (GPS time and UTC are {LEAP_SECONDS:g} s apart)" if abs(abs(late_s) - LEAP_SECONDS) < 1.5 else ""
    stated = configuration_of(log).usbl.latency_s
    text = (
        f"{usbl}: fixes fit dead reckoning far better where their stamps lie {late(late_s)} the time at which they "
        f"were true, by the DVL's clock{leap}; if that is right, state latency_s = {stated + late_s:.2f} under [usbl]"
    )
    return [diagnosis("CLOCK-OFFSET", text, usbl, None, late_s, "s")]


def late(delay_s: float) -> str:
    """Return a delay in words."""
    return f"{abs(delay_s):.2f} s {'after' if delay_s > 0 else 'before'}"


def in_radians(log: Log, timeline: Timeline, verdict: Verdict) -> list[Diagnosis]:
    """Headings that never leave 6.3 degrees may be radians: the fixes tell."""
    yaw = timeline.dr_yaw_rad
    if np.ptp(yaw) > np.radians(6.4) or convention(log, "compass", "unit")[0] != "deg":
        return []
    wider = replace(timeline, dr_yaw_rad=np.unwrap(np.degrees(yaw)))
    residual_m = fit_turn(wider, groups(timeline, timeline.fix_time_s)).rms_m
    if residual_m > CLEARLY * verdict.read.residual_m:
        return []
    topic = topic_of(log, "compass")
    named = convention(log, "compass", "unit")[1] == "by column names"
    columns = 'columns = { time_ns = "time_ns", heading = "heading_deg" } and ' if named else ""
    text = (
        f"{topic}: as radians, dead reckoning lies {residual_m:.2f} m rms from the fixes, as degrees "
        f'{verdict.read.residual_m:.2f} m; state {columns}unit = "rad" under [compass]'
    )
    return [diagnosis("HEADING-RADIANS", text, topic, None, verdict.read.residual_m, "m")]
