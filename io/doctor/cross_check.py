"""What DVL, heading and fixes say of each other: conventions, mounting, delays, scale, gross fixes. Uses no truth.

GPS is looked at for one bit only, which of two mirror images the map is. Angles are degrees clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import GROSS_SIGMAS, STRETCH_S, Calibration, calibrate
from usbldr.filters.types import Timeline
from usbldr.io.doctor.findings import Diagnosis, diagnosis
from usbldr.io.doctor.gross_errors import (
    far_clock,
    far_scale,
    in_metres_per_second,
    in_radians,
    late,
    on_the_dvls_clock,
)
from usbldr.io.doctor.interpretations import Reading, Source, Verdict, configuration_of, judge, reread, topic_of
from usbldr.io.log import Finding, Log

MOUNT_DEG = 3.0  # a smaller offset is the compass's business
LATENCY_S = 0.3
DELAY_S = 0.3
SCALE = 0.02
SIGMAS = 4.0  # an error is claimed beyond as many of its standard deviations
GROSS_M = 3.0  # and no residual below is called gross


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
        return CrossCheck((diagnosis("CONVENTION-UNOBSERVABLE", text, topic_of(log, "usbl")),))
    times, verdict, timeline = in_metres_per_second(log, timeline, verdict, sources)
    far_s, verdict, timeline = on_the_dvls_clock(log, timeline, verdict, sources)
    found = [*convention_findings(log, verdict), *_offset(log, verdict), *in_radians(log, timeline, verdict)]
    calibration = calibrate(reread(log, timeline, verdict.best.flips), verdict.best.turn.rotation_rad)
    late_s = far_s + (calibration.latency_s if calibration is not None else verdict.best.turn.latency_s)
    found += far_clock(log, late_s) if far_s else ()
    found += far_scale(log, times, verdict) if times != 1.0 else ()
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
    times, verdict, line = in_metres_per_second(log, timeline, verdict, ())
    far_s, verdict, line = on_the_dvls_clock(log, line, verdict, ())
    found = [*convention_findings(log, verdict), *_offset(log, verdict), *in_radians(log, line, verdict)]
    found += far_clock(log, far_s + verdict.best.turn.latency_s) if far_s else ()
    found += far_scale(log, times, verdict) if times != 1.0 else ()
    return [Finding(d.code, d.text) for d in found if d.code in WORTH_A_WARNING]


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
        for topic in [topic_of(log, role)]
    ]
    usbl = topic_of(log, "usbl")
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
    topic = topic_of(log, "compass" if stated else "dvl")
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
    usbl, compass = topic_of(log, "usbl"), topic_of(log, "compass")
    if clear_latency(c):
        stated = configuration_of(log).usbl.latency_s
        text = (
            f"{usbl}: fixes fit dead reckoning best where their stamps lie {late(c.latency_s)} the time at which they "
            f"were true (+-{c.latency_sd_s:.2f} s), by the DVL's clock; if that is so, state latency_s = "
            f"{stated + c.latency_s:.2f} under [usbl]; a transponder ahead or astern of the vehicle's "
            "middle looks alike (lever_arm_m)"
        )
        found.append(diagnosis("USBL-LATENCY", text, usbl, None, c.latency_s, "s"))
    clear = abs(c.heading_delay_s) > max(DELAY_S, SIGMAS * c.heading_delay_sd_s)
    if clear and c.sd_m < 0.97 * c.sd_without_delay_m:
        text = (
            f"{compass}: headings fit DVL and fixes better where their stamps lie {late(c.heading_delay_s)} the DVL's "
            f"(+-{c.heading_delay_sd_s:.2f} s): a delay, or a DVL that sits ahead or astern of the vehicle's middle "
            "(lever_arm_m under [dvl]); part of it may be the fixes' latency"
        )
        found.append(diagnosis("HEADING-DELAY", text, compass, None, c.heading_delay_s, "s"))
    return found


def _scale(log: Log, c: Calibration) -> list[Diagnosis]:
    if not clear_scale(c):
        return []
    dvl = topic_of(log, "dvl")
    text = (
        f"{dvl}: reads {100 * c.scale:+.1f} % of the distance between fixes too much (+-{100 * c.scale_sd:.1f} %); "
        f"if the fixes are right, state scale_error = {c.scale:.3f} under [dvl]"
    )
    return [diagnosis("DVL-SCALE", text, dvl, None, 100 * c.scale, "%")]


def _fixes(log: Log, timeline: Timeline, c: Calibration) -> list[Diagnosis]:
    """Count the gross fixes, and compare the scatter of the others with what they claim."""
    found: list[Diagnosis] = []
    usbl = topic_of(log, "usbl")
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


def wrapped(angle_deg: float) -> float:
    """Return the angle between -180 and 180 degrees."""
    return (angle_deg + 180.0) % 360.0 - 180.0
