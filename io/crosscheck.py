"""What DVL, heading and fixes say of each other: conventions, mounting, delays, scale, gross fixes. Uses no truth.

GPS is looked at for one bit only, which of two mirror images the map is. Angles are degrees clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.crossfit import (
    GROSS_SIGMAS,
    STRETCH_S,
    Calibration,
    calibrate,
    fit_turn,
    fix_points,
    groups,
    reckoned,
)
from usbldr.filters.types import Timeline
from usbldr.io.conventions import TO_MPS
from usbldr.io.diagnosis import Diagnosis, diagnosis
from usbldr.io.log import Finding, Log
from usbldr.io.readings import CLEARLY, Reading, Source, Verdict, configuration_of, convention, judge, reread

MOUNT_DEG = 3.0  # a smaller offset is the compass's business
LATENCY_S = 0.3
DELAY_S = 0.3
SCALE = 0.02
SIGMAS = 4.0  # an error is claimed beyond as many of its standard deviations
GROSS_M = 3.0  # and no residual below is called gross
FAR_S = tuple(float(s) for s in range(-60, 61, 2) if abs(s) > 4)  # offsets of a clock, beyond the fixes' usual delays
FAR_BETTER = 0.5  # another clock is claimed where less than this share of the residual is left
MOVE_S = 60.0  # long enough for a vehicle to go further than its fixes scatter
LEAST_MOVES = 10
FAR_SCALE = 1.5  # times or parts: nearer to 1, turning and shifting tell the scale
UNITS = {1.944: "knots", 3.281: "ft/s", 3.6: "km/h", 100.0: "cm/s", 1000.0: "mm/s"}  # of each in 1 m/s
SURELY = 0.05  # that near to a unit's size it is this unit
LEAP_SECONDS = 18.0  # GPS time minus UTC since 2017


WORTH_A_WARNING = (
    "DVL-AXES",
    "HEADING-CONVENTION",
    "MAP-FRAME",
    "HEADING-RADIANS",
    "DVL-MOUNT",
    "HEADING-BIAS",
    "CLOCK-OFFSET",
    "DVL-UNIT",
)
"""What replay says, too: it would compute with a wrong axis, frame, unit or clock."""


@dataclass(frozen=True, slots=True)
class CrossCheck:
    """What the sensors say of each other, in words and in numbers."""

    diagnoses: tuple[Diagnosis, ...]
    verdict: Verdict | None = None  # None: too few fixes
    calibration: Calibration | None = None  # by the verdict's best reading; None: nothing can be claimed


def cross_check(log: Log, timeline: Timeline, sources: Sequence[Source] = ()) -> CrossCheck:
    """Hold DVL, heading and fixes against each other; ``sources`` as of `readings.judge`."""
    verdict = judge(log, timeline, sources)
    if verdict is None:
        text = "too few fixes beside valid dead reckoning to check conventions against the data"
        return CrossCheck((diagnosis("CONVENTION-UNOBSERVABLE", text, _topic(log, "usbl")),))
    times, verdict, timeline = _in_metres_per_second(log, timeline, verdict, sources)
    far_s, verdict, timeline = _on_the_dvls_clock(log, timeline, verdict, sources)
    found = [*convention_findings(log, verdict), *_offset(log, verdict), *_unit(log, timeline, verdict)]
    calibration = calibrate(reread(log, timeline, verdict.best.flips), verdict.best.turn.rotation_rad)
    late_s = far_s + (calibration.latency_s if calibration is not None else verdict.best.turn.latency_s)
    found += _clock(log, late_s) if far_s else ()
    found += _far_scale(log, times, verdict) if times != 1.0 else ()
    if calibration is None or not verdict.trusted:
        return CrossCheck(tuple(found), verdict)
    if not far_s:
        found += _delays(log, calibration)
    found += [*_scale(log, calibration), *_fixes(log, timeline, calibration)]
    scale, latency_s = times * (1 + calibration.scale) - 1, late_s if far_s else calibration.latency_s
    return CrossCheck(tuple(found), verdict, replace(calibration, scale=scale, latency_s=latency_s))


def better_readings(log: Log, timeline: Timeline) -> list[Finding]:
    """Return a finding for each convention, mounting or clock that another clearly beats; nothing is changed by it."""
    verdict = judge(log, timeline) if len(timeline.fix_time_s) else None
    if verdict is None:
        return []
    times, verdict, line = _in_metres_per_second(log, timeline, verdict, ())
    far_s, verdict, line = _on_the_dvls_clock(log, line, verdict, ())
    found = [*convention_findings(log, verdict), *_offset(log, verdict), *_unit(log, line, verdict)]
    found += _clock(log, far_s + verdict.best.turn.latency_s) if far_s else ()
    found += _far_scale(log, times, verdict) if times != 1.0 else ()
    return [Finding(d.code, d.text) for d in found if d.code in WORTH_A_WARNING]


def _in_metres_per_second(
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


def _far_scale(log: Log, times: float, verdict: Verdict) -> list[Diagnosis]:
    """Say that velocities are far from m/s, and as which unit they were taken, where one explains it."""
    dvl, stated = _topic(log, "dvl"), configuration_of(log).dvl
    advice = f"scale_error = {(1 + stated.scale_error) * times - 1:.4g}"
    unit, like = convention(log, "dvl", "unit"), ""
    for size, name in UNITS.items():
        for really, taken, ratio in ((name, "m/s", size), ("m/s", name, 1 / size)):
            if abs(times / ratio - 1) < SURELY:
                like = f", as if {really} were taken for {taken}"
                free = really in TO_MPS and unit[0] == taken and unit[1] != "by column names"
                advice = f'unit = "{really}"' if free else advice
    text = (
        f"{dvl}: reads {times:.3g} times the distance between fixes{like}; with that taken off, dead reckoning lies "
        f"{verdict.best.residual_m:.2f} m rms from the fixes; state {advice} under [dvl]"
    )
    return [diagnosis("DVL-UNIT", text, dvl, None, times, "times")]


def _on_the_dvls_clock(
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


def _clock(log: Log, late_s: float) -> list[Diagnosis]:
    """Say that the fixes' clock is off by more than a delay could be."""
    usbl = _topic(log, "usbl")
    leap = f" (GPS time and UTC are {LEAP_SECONDS:g} s apart)" if abs(abs(late_s) - LEAP_SECONDS) < 1.5 else ""
    stated = configuration_of(log).usbl.latency_s
    text = (
        f"{usbl}: fixes fit dead reckoning far better where their stamps lie {_late(late_s)} the time at which they "
        f"were true, by the DVL's clock{leap}; if that is right, state latency_s = {stated + late_s:.2f} under [usbl]"
    )
    return [diagnosis("CLOCK-OFFSET", text, usbl, None, late_s, "s")]


def convention_findings(log: Log, verdict: Verdict) -> list[Diagnosis]:
    """Say where another reading of axes, yaw or map fits clearly better, and what cannot be told."""
    read, best = verdict.read, verdict.best
    found = [
        diagnosis(code, f"{topic}: {_other(read, best, key, old, new, verdict)}", topic, None, read.residual_m, "m")
        for code, role, key, old, new in (
            ("DVL-AXES", "dvl", "axes", read.axes, best.axes),
            ("HEADING-CONVENTION", "compass", "convention", read.convention, best.convention),
            ("MAP-FRAME", "usbl", "frame", read.frame, best.frame),
        )
        if old != new
        for topic in [_topic(log, role)]
    ]
    usbl = _topic(log, "usbl")
    if verdict.against and verdict.decided_by is not None:
        others = "; ".join(source.name for source in verdict.against)
        text = f"sources disagree: {verdict.decided_by.name}; against it: {others}"
        found.append(diagnosis("CONVENTION-CONTRADICTED", text, usbl))
    if verdict.decided_by is None and verdict.mirror is not None:
        text = (
            f"{best.sentence} and its mirror image ({verdict.mirror.sentence}) fit the fixes equally well "
            f"({best.residual_m:.2f} m), and nothing in the log decides; state frame under [usbl] and convention under "
            "[compass]"
        )
        found.append(diagnosis("CONVENTION-UNDECIDED", text, usbl, None, best.residual_m, "m"))
    if not verdict.observable:
        fits = "; ".join(f"{r.sentence}: {r.residual_m:.2f} m" for r in verdict.plausible)
        text = f"the fixes do not tell readings apart that differ in more than a mirror image: {fits}"
        found.append(diagnosis("CONVENTION-UNOBSERVABLE", text, usbl, None, read.residual_m, "m"))
    if best == read and verdict.decided_by is not None and verdict.observable:
        worse = next(r for r in verdict.readings if r.mirror_class != best.mirror_class)
        text = (
            f"{best.sentence} fits the fixes to {best.residual_m:.2f} m rms, the next other reading to "
            f"{worse.residual_m:.2f} m; the mirror image is ruled out by this: {verdict.decided_by.name}"
        )
        found.append(diagnosis("CONVENTION-CHECKED", text, usbl, None, best.residual_m, "m"))
    return found


def _other(read: Reading, best: Reading, key: str, old: str, new: str, verdict: Verdict) -> str:
    section = {"axes": "dvl", "convention": "compass", "frame": "usbl"}[key]
    decided = "; so does its mirror image, and nothing that was looked at decides"
    if verdict.decided_by:
        decided = f"; its mirror image is ruled out by this: {verdict.decided_by.name}"
    return (
        f"read as {key} {old}, but {new} fits: with {best.sentence}, dead reckoning lies {best.residual_m:.2f} m rms "
        f'from the fixes, as it was read {read.residual_m:.2f} m{decided}; state {key} = "{new}" under [{section}]'
    )


def _offset(log: Log, verdict: Verdict) -> list[Diagnosis]:
    """Say by how much DVL and heading are turned against the map of the fixes."""
    best, offset, sd = verdict.best, verdict.best.offset_deg, verdict.offset_sd_deg
    if not verdict.trusted or not sd < 10.0:
        return []
    settings = configuration_of(log)
    mount, bias = settings.dvl.mount_deg, settings.compass.bias_deg
    stated = mount != 0 or bias != 0
    code = "HEADING-BIAS" if stated else "DVL-MOUNT"
    far = clear_offset(verdict)
    topic = _topic(log, "compass" if stated else "dvl")
    reading = "" if best == verdict.read and verdict.observable else f", read with {best.sentence}"
    turned = f"dead reckoning has to be turned by {offset:+.1f} deg (clockwise, +-{max(sd, 0.1):.1f})"
    said = f"{turned} to lie on the fixes{reading}"
    if far:
        said += (
            f"; state mount_deg = {wrapped(mount + offset):.1f} under [dvl] if the DVL is mounted so, or bias_deg = "
            f"{wrapped(bias - offset):.1f} under [compass] if the heading errs"
        )
    found = diagnosis(code if far else "HEADING-CHECKED", f"{topic}: {said}", topic, None, offset, "deg")
    return [found]


def _unit(log: Log, timeline: Timeline, verdict: Verdict) -> list[Diagnosis]:
    """Headings that never leave 6.3 degrees may be radians: the fixes tell."""
    yaw = timeline.dr_yaw_rad
    if np.ptp(yaw) > np.radians(6.4) or convention(log, "compass", "unit")[0] != "deg":
        return []
    wider = replace(timeline, dr_yaw_rad=np.unwrap(np.degrees(yaw)))
    residual_m = fit_turn(wider, groups(timeline, timeline.fix_time_s)).rms_m
    if residual_m > CLEARLY * verdict.read.residual_m:
        return []
    topic = _topic(log, "compass")
    named = convention(log, "compass", "unit")[1] == "by column names"
    columns = 'columns = { time_ns = "time_ns", heading = "heading_deg" } and ' if named else ""
    text = (
        f"{topic}: as radians, dead reckoning lies {residual_m:.2f} m rms from the fixes, as degrees "
        f'{verdict.read.residual_m:.2f} m; state {columns}unit = "rad" under [compass]'
    )
    return [diagnosis("HEADING-RADIANS", text, topic, None, verdict.read.residual_m, "m")]


def clear_latency(c: Calibration) -> bool:
    """Tell whether a latency of the fixes is beyond doubt."""
    return abs(c.latency_s) > max(LATENCY_S, SIGMAS * c.latency_sd_s)


def clear_scale(c: Calibration) -> bool:
    """Tell whether a scale error of the DVL is beyond doubt."""
    return abs(c.scale) > max(SCALE, SIGMAS * c.scale_sd)


def clear_offset(verdict: Verdict) -> bool:
    """Tell whether DVL and heading are turned against the fixes beyond doubt."""
    sure = verdict.trusted and verdict.offset_sd_deg < 10.0
    return sure and abs(verdict.best.offset_deg) > max(MOUNT_DEG, 2 * verdict.offset_sd_deg)


def _delays(log: Log, c: Calibration) -> list[Diagnosis]:
    found: list[Diagnosis] = []
    usbl, compass = _topic(log, "usbl"), _topic(log, "compass")
    if clear_latency(c):
        stated = configuration_of(log).usbl.latency_s
        text = (
            f"{usbl}: fixes fit dead reckoning best where their stamps lie {_late(c.latency_s)} the time at which they "
            f"were true (+-{c.latency_sd_s:.2f} s), by the DVL's clock; if that is so, state latency_s = "
            f"{stated + c.latency_s:.2f} under [usbl]; a transponder ahead or astern of the vehicle's "
            "middle looks alike (lever_arm_m)"
        )
        found.append(diagnosis("USBL-LATENCY", text, usbl, None, c.latency_s, "s"))
    clear = abs(c.heading_delay_s) > max(DELAY_S, SIGMAS * c.heading_delay_sd_s)
    if clear and c.sd_m < 0.97 * c.sd_without_delay_m:
        text = (
            f"{compass}: headings fit DVL and fixes better where their stamps lie {_late(c.heading_delay_s)} the DVL's "
            f"(+-{c.heading_delay_sd_s:.2f} s): a delay, or a DVL that sits ahead or astern of the vehicle's middle "
            "(lever_arm_m under [dvl]); part of it may be the fixes' latency"
        )
        found.append(diagnosis("HEADING-DELAY", text, compass, None, c.heading_delay_s, "s"))
    return found


def _scale(log: Log, c: Calibration) -> list[Diagnosis]:
    if not clear_scale(c):
        return []
    dvl = _topic(log, "dvl")
    text = (
        f"{dvl}: reads {100 * c.scale:+.1f} % of the distance between fixes too much (+-{100 * c.scale_sd:.1f} %); "
        f"if the fixes are right, state scale_error = {c.scale:.3f} under [dvl]"
    )
    return [diagnosis("DVL-SCALE", text, dvl, None, 100 * c.scale, "%")]


def _fixes(log: Log, timeline: Timeline, c: Calibration) -> list[Diagnosis]:
    """Count the gross fixes, and compare the scatter of the others with what they claim."""
    found: list[Diagnosis] = []
    usbl = _topic(log, "usbl")
    gross = c.gross[c.residual_m[c.gross] > GROSS_M]
    if len(gross):
        worst = int(gross[np.argmax(c.residual_m[gross])])
        time_s, worst_m = float(timeline.fix_time_s[worst]), float(c.residual_m[worst])
        far_m = max(GROSS_SIGMAS * c.sd_m, GROSS_M)
        text = (
            f"{usbl}: {len(gross)} of {len(c.residual_m)} fixes lie more than {far_m:.1f} m from where the others and "
            f"dead reckoning put them, the worst {worst_m:.1f} m at {time_s:.1f} s; a filter with a robust noise (the "
            "default) or a gate is needed"
        )
        found.append(diagnosis("USBL-OUTLIERS", text, usbl, time_s, worst_m, "m"))
    stated_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    if not 1 / 3 < c.sd_m / stated_m < 3:
        text = (
            f"{usbl}: fixes scatter by {c.sd_m:.2f} m a coordinate within {STRETCH_S:.0f} s, their stated sd is "
            f"{stated_m:.2f} m; slower errors do not show here"
        )
        found.append(diagnosis("USBL-NOISE", text, usbl, None, c.sd_m, "m"))
    return found


def _late(delay_s: float) -> str:
    return f"{abs(delay_s):.2f} s {'after' if delay_s > 0 else 'before'}"


def wrapped(angle_deg: float) -> float:
    """Return the angle between -180 and 180 degrees."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _topic(log: Log, role: str) -> str:
    return log.provenance[role].topic if role in log.provenance else role
