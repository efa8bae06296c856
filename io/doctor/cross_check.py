"""What DVL, heading and fixes say of each other: conventions, mounting, delays, scale, gross fixes. Uses no truth.

GPS is looked at for one bit only, which of two mirror images the map is. Angles are degrees clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.identification.dr_usbl_fit import GROSS_SIGMAS, SEGMENT_S, DrUsblFit, fit_sensor_errors
from usbldr.filters.types import Timeline
from usbldr.io.doctor.gross_errors import (
    clock_offset_findings,
    correct_clock_offset,
    correct_velocity_unit,
    delay_text,
    heading_unit_findings,
    velocity_unit_findings,
)
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    Interpretation,
    InterpretationResult,
    compare_interpretations,
    reinterpret,
    topic_of,
)
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log

REPLAY_WARNING_CODES = (
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

    findings: tuple[Finding, ...]
    result: InterpretationResult | None = None  # None: too few fixes
    calibration: DrUsblFit | None = None  # by the verdict's best reading; None: nothing can be claimed


def cross_check(log: Log, timeline: Timeline, sources: Sequence[HandednessEvidence] = ()) -> CrossCheck:
    """Hold DVL, heading and fixes against each other; ``sources`` as of `readings.judge`."""
    verdict = compare_interpretations(log, timeline, sources)
    if verdict is None:
        text = "too few fixes beside valid dead reckoning to check conventions against the data"
        return CrossCheck((Finding("CONVENTION-UNOBSERVABLE", text, topic_of(log, "usbl")),))
    times, verdict, timeline = correct_velocity_unit(log, timeline, verdict, sources)
    far_s, verdict, timeline = correct_clock_offset(log, timeline, verdict, sources)
    found = [
        *convention_findings(log, verdict),
        *_heading_offset_findings(log, verdict),
        *heading_unit_findings(log, timeline, verdict),
    ]
    calibration = fit_sensor_errors(reinterpret(log, timeline, verdict.best.flips), verdict.best.fit.rotation_rad)
    late_s = far_s + (calibration.latency_s if calibration is not None else verdict.best.fit.latency_s)
    found += clock_offset_findings(log, late_s) if far_s else ()
    found += velocity_unit_findings(log, times, verdict) if times != 1.0 else ()
    if calibration is None or not verdict.heading_sense_known:
        return CrossCheck(tuple(found), verdict)
    if not far_s:
        found += _delays(log, calibration)
    found += [*_scale(log, calibration), *_fix_noise_findings(log, timeline, calibration)]
    scale, latency_s = times * (1 + calibration.scale) - 1, late_s if far_s else calibration.latency_s
    return CrossCheck(tuple(found), verdict, replace(calibration, scale=scale, latency_s=latency_s))


def convention_warnings(log: Log, timeline: Timeline) -> list[Finding]:
    """Return a finding for each convention, mounting or clock that another clearly beats; nothing is changed by it."""
    verdict = compare_interpretations(log, timeline) if len(timeline.fix_time_s) else None
    if verdict is None:
        return []
    times, verdict, corrected = correct_velocity_unit(log, timeline, verdict, ())
    far_s, verdict, corrected = correct_clock_offset(log, corrected, verdict, ())
    found = [
        *convention_findings(log, verdict),
        *_heading_offset_findings(log, verdict),
        *heading_unit_findings(log, corrected, verdict),
    ]
    found += clock_offset_findings(log, far_s + verdict.best.fit.latency_s) if far_s else ()
    found += velocity_unit_findings(log, times, verdict) if times != 1.0 else ()
    return [d for d in found if d.code in REPLAY_WARNING_CODES]


def convention_findings(log: Log, verdict: InterpretationResult) -> list[Finding]:
    """Say where another reading of axes, yaw or map fits clearly better, and what cannot be told."""
    read, best = verdict.as_read, verdict.best
    found = [
        Finding(
            code,
            f"{topic}: {_interpretation_text(read, best, key, old, new, verdict)}",
            topic,
            None,
            read.residual_m,
            "m",
        )
        for code, role, key, old, new in (
            ("DVL-AXES", "dvl", "axes", read.axes, best.axes),
            ("HEADING-CONVENTION", "compass", "convention", read.convention, best.convention),
            ("MAP-FRAME", "usbl", "frame", read.frame, best.frame),
        )
        if old != new
        for topic in [topic_of(log, role)]
    ]
    usbl = topic_of(log, "usbl")
    if verdict.contradicting and verdict.decided_by is not None:
        others = "; ".join(source.name for source in verdict.contradicting)
        text = f"sources disagree: {verdict.decided_by.name}; against it: {others}"
        found.append(Finding("CONVENTION-CONTRADICTED", text, usbl))
    if verdict.decided_by is None and verdict.mirror_image is not None:
        text = (
            f"{best.description} and its mirror image ({verdict.mirror_image.description}) fit the fixes equally well "
            f"({best.residual_m:.2f} m), and nothing in the log decides; state frame under [usbl] and convention under "
            "[compass]"
        )
        found.append(Finding("CONVENTION-UNDECIDED", text, usbl, None, best.residual_m, "m"))
    if not verdict.observable:
        fits = "; ".join(f"{r.description}: {r.residual_m:.2f} m" for r in verdict.plausible)
        text = f"the fixes do not tell readings apart that differ in more than a mirror image: {fits}"
        found.append(Finding("CONVENTION-UNOBSERVABLE", text, usbl, None, read.residual_m, "m"))
    if best == read and verdict.decided_by is not None and verdict.observable:
        worse = next(r for r in verdict.interpretations if r.mirror_class != best.mirror_class)
        text = (
            f"{best.description} fits the fixes to {best.residual_m:.2f} m rms, the next other reading to "
            f"{worse.residual_m:.2f} m; the mirror image is ruled out by this: {verdict.decided_by.name}"
        )
        found.append(Finding("CONVENTION-CHECKED", text, usbl, None, best.residual_m, "m"))
    return found


def _interpretation_text(
    read: Interpretation, best: Interpretation, key: str, old: str, new: str, verdict: InterpretationResult
) -> str:
    section = {"axes": "dvl", "convention": "compass", "frame": "usbl"}[key]
    decided = "; so does its mirror image, and nothing that was looked at decides"
    if verdict.decided_by:
        decided = f"; its mirror image is ruled out by this: {verdict.decided_by.name}"
    return (
        f"read as {key} {old}, but {new} fits: with {best.description}, dead reckoning lies {best.residual_m:.2f} m "
        "rms "
        f'from the fixes, as it was read {read.residual_m:.2f} m{decided}; state {key} = "{new}" under [{section}]'
    )


def _heading_offset_findings(log: Log, verdict: InterpretationResult) -> list[Finding]:
    """Say by how much DVL and heading are turned against the map of the fixes."""
    best, offset, sd = verdict.best, verdict.best.offset_deg, verdict.offset_sd_deg
    if not verdict.heading_sense_known or not sd < THRESHOLDS.max_offset_sd_deg:
        return []
    settings = log.settings
    mount, bias = settings.dvl.mount_deg, settings.compass.bias_deg
    stated = mount != 0 or bias != 0
    code = "HEADING-BIAS" if stated else "DVL-MOUNT"
    far = heading_offset_is_significant(verdict)
    topic = topic_of(log, "compass" if stated else "dvl")
    reading = "" if best == verdict.as_read and verdict.observable else f", read with {best.description}"
    turned = f"dead reckoning has to be turned by {offset:+.1f} deg (clockwise, +-{max(sd, 0.1):.1f})"
    said = f"{turned} to lie on the fixes{reading}"
    if far:
        said += (
            f"; state mount_deg = {wrapped(mount + offset, 180.0):.1f} under [dvl] if the DVL is mounted so, or "
            f"bias_deg = {wrapped(bias - offset, 180.0):.1f} under [compass] if the heading errs"
        )
    found = Finding(code if far else "HEADING-CHECKED", f"{topic}: {said}", topic, None, offset, "deg")
    return [found]


def latency_is_significant(c: DrUsblFit) -> bool:
    """Tell whether a latency of the fixes is beyond doubt."""
    return abs(c.latency_s) > max(THRESHOLDS.min_latency_s, THRESHOLDS.significance_sigmas * c.latency_sd_s)


def scale_is_significant(c: DrUsblFit) -> bool:
    """Tell whether a scale error of the DVL is beyond doubt."""
    return abs(c.scale) > max(THRESHOLDS.min_scale_error, THRESHOLDS.significance_sigmas * c.scale_sd)


def heading_offset_is_significant(verdict: InterpretationResult) -> bool:
    """Tell whether DVL and heading are turned against the fixes beyond doubt."""
    sure = verdict.heading_sense_known and verdict.offset_sd_deg < THRESHOLDS.max_offset_sd_deg
    return sure and abs(verdict.best.offset_deg) > max(
        THRESHOLDS.min_offset_deg, THRESHOLDS.offset_sigmas * verdict.offset_sd_deg
    )


def _delays(log: Log, c: DrUsblFit) -> list[Finding]:
    found: list[Finding] = []
    usbl, compass = topic_of(log, "usbl"), topic_of(log, "compass")
    if latency_is_significant(c):
        stated = log.settings.usbl.latency_s
        text = (
            f"{usbl}: fixes fit dead reckoning best where their stamps lie {delay_text(c.latency_s)} the time at "
            f"which they were true (+-{c.latency_sd_s:.2f} s), by the DVL's clock; if that is so, state latency_s = "
            f"{stated + c.latency_s:.2f} under [usbl]; a transponder ahead or astern of the vehicle's "
            "middle looks alike (lever_arm_m)"
        )
        found.append(Finding("USBL-LATENCY", text, usbl, None, c.latency_s, "s"))
    least_s = max(THRESHOLDS.min_heading_delay_s, THRESHOLDS.significance_sigmas * c.heading_delay_sd_s)
    better = c.sd_m < THRESHOLDS.max_delayed_residual_ratio * c.sd_without_delay_m
    if abs(c.heading_delay_s) > least_s and better:
        text = (
            f"{compass}: headings fit DVL and fixes better where their stamps lie {delay_text(c.heading_delay_s)} the "
            f"DVL's (+-{c.heading_delay_sd_s:.2f} s): a delay, or a DVL that sits ahead or astern of the vehicle's "
            "middle (lever_arm_m under [dvl]); part of it may be the fixes' latency"
        )
        found.append(Finding("HEADING-DELAY", text, compass, None, c.heading_delay_s, "s"))
    return found


def _scale(log: Log, c: DrUsblFit) -> list[Finding]:
    if not scale_is_significant(c):
        return []
    dvl = topic_of(log, "dvl")
    text = (
        f"{dvl}: reads {100 * c.scale:+.1f} % of the distance between fixes too much (+-{100 * c.scale_sd:.1f} %); "
        f"if the fixes are right, state scale_error = {c.scale:.3f} under [dvl]"
    )
    return [Finding("DVL-SCALE", text, dvl, None, 100 * c.scale, "%")]


def _fix_noise_findings(log: Log, timeline: Timeline, c: DrUsblFit) -> list[Finding]:
    """Count the gross fixes, and compare the scatter of the others with what they claim."""
    found: list[Finding] = []
    usbl = topic_of(log, "usbl")
    gross = c.outlier_rows[c.residual_m[c.outlier_rows] > THRESHOLDS.min_outlier_m]
    if len(gross):
        worst = int(gross[np.argmax(c.residual_m[gross])])
        time_s, worst_m = float(timeline.fix_time_s[worst]), float(c.residual_m[worst])
        far_m = max(GROSS_SIGMAS * c.sd_m, THRESHOLDS.min_outlier_m)
        text = (
            f"{usbl}: {len(gross)} of {len(c.residual_m)} fixes lie more than {far_m:.1f} m from where the others and "
            f"dead reckoning put them, the worst {worst_m:.1f} m at {time_s:.1f} s; a filter with a robust noise (the "
            "default) or a gate is needed"
        )
        found.append(Finding("USBL-OUTLIERS", text, usbl, time_s, worst_m, "m"))
    stated_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    if not 1 / THRESHOLDS.noise_ratio < c.sd_m / stated_m < THRESHOLDS.noise_ratio:
        text = (
            f"{usbl}: fixes scatter by {c.sd_m:.2f} m a coordinate within {SEGMENT_S:.0f} s, their stated sd is "
            f"{stated_m:.2f} m; slower errors do not show here"
        )
        found.append(Finding("USBL-NOISE", text, usbl, None, c.sd_m, "m"))
    return found
