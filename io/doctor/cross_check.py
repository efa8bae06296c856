"""Check DVL, heading and fixes against each other: conventions, mounting, delays, scale, outliers. Uses no truth.

GPS decides one thing only: which of two mirror images the map is. Angles are degrees clockwise.
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
from usbldr.io.doctor.message_evidence import message_evidence
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
"""What replay reports, too: it would compute with a wrong axis, frame, unit or clock."""


@dataclass(frozen=True, slots=True)
class CrossCheck:
    """How the sensors fit each other, in words and in numbers."""

    findings: tuple[Finding, ...]
    result: InterpretationResult | None = None  # None: too few fixes
    calibration: DrUsblFit | None = None  # by the best interpretation; None: not observable


def cross_check(log: Log, timeline: Timeline, sources: Sequence[HandednessEvidence] = ()) -> CrossCheck:
    """Compare DVL, heading and fixes; ``sources`` as of `compare_interpretations`."""
    result = compare_interpretations(log, timeline, sources)
    if result is None:
        text = "too few fixes within valid dead reckoning to check the conventions"
        return CrossCheck((Finding("CONVENTION-UNOBSERVABLE", text, topic_of(log, "usbl")),))
    unit_ratio, clock_offset_s, result, timeline = _corrected(log, timeline, result, sources)
    found = _fit_findings(log, timeline, result)
    calibration = fit_sensor_errors(reinterpret(log, timeline, result.best.flips), result.best.fit.rotation_rad)
    late_s = clock_offset_s + (calibration.latency_s if calibration is not None else result.best.fit.latency_s)
    found += clock_offset_findings(log, late_s) if clock_offset_s else ()
    found += velocity_unit_findings(log, unit_ratio, result) if unit_ratio != 1.0 else ()
    if calibration is None or not result.heading_sense_known:
        return CrossCheck(tuple(found), result)
    if not clock_offset_s:
        found += _delays(log, calibration)
    found += [*_scale(log, calibration), *_fix_noise_findings(log, timeline, calibration)]
    scale, latency_s = unit_ratio * (1 + calibration.scale) - 1, late_s if clock_offset_s else calibration.latency_s
    return CrossCheck(tuple(found), result, replace(calibration, scale=scale, latency_s=latency_s))


def convention_warnings(log: Log, timeline: Timeline) -> list[Finding]:
    """Return a finding for each convention, mounting or clock if another fits clearly better; change nothing."""
    sources = message_evidence(log)
    result = compare_interpretations(log, timeline, sources) if len(timeline.fix_time_s) else None
    if result is None:
        return []
    unit_ratio, clock_offset_s, result, corrected = _corrected(log, timeline, result, sources)
    found = _fit_findings(log, corrected, result)
    found += clock_offset_findings(log, clock_offset_s + result.best.fit.latency_s) if clock_offset_s else ()
    found += velocity_unit_findings(log, unit_ratio, result) if unit_ratio != 1.0 else ()
    return [d for d in found if d.code in REPLAY_WARNING_CODES]


def _corrected(
    log: Log, timeline: Timeline, result: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, float, InterpretationResult, Timeline]:
    """Return the factor of the velocities and the offset of the fixes' clock, and the result without both."""
    unit_ratio, result, timeline = correct_velocity_unit(log, timeline, result, sources)
    return unit_ratio, *correct_clock_offset(log, timeline, result, sources)


def _fit_findings(log: Log, timeline: Timeline, result: InterpretationResult) -> list[Finding]:
    found = [*convention_findings(log, result), *_heading_offset_findings(log, result)]
    return [*found, *heading_unit_findings(log, timeline, result)]


def convention_findings(log: Log, result: InterpretationResult) -> list[Finding]:
    """Report which other interpretation of axes, yaw or map fits clearly better, and what is not observable."""
    read, best = result.as_read, result.best
    found: list[Finding] = []
    for code, role, key, old, new in (
        ("DVL-AXES", "dvl", "axes", read.axes, best.axes),
        ("HEADING-CONVENTION", "compass", "convention", read.convention, best.convention),
        ("MAP-FRAME", "usbl", "frame", read.frame, best.frame),
    ):
        if old != new:
            topic, text = topic_of(log, role), _interpretation_text(read, best, key, old, new, result)
            found.append(Finding(code, f"{topic}: {text}", topic, None, read.residual_m, "m"))
    usbl = topic_of(log, "usbl")
    if result.contradicting and result.decided_by is not None:
        others = "; ".join(source.name for source in result.contradicting)
        text = f"sources disagree on the mirror image; followed: {result.decided_by.name}; contradicting: {others}"
        found.append(Finding("CONVENTION-CONTRADICTED", text, usbl))
    if result.decided_by is None and result.mirror_image is not None:
        text = (
            f"{best.description} and its mirror image ({result.mirror_image.description}) fit the fixes equally well "
            f"({best.residual_m:.2f} m RMS), and nothing in the log decides; "
            "state frame under [usbl] and convention under [compass]"
        )
        found.append(Finding("CONVENTION-UNDECIDED", text, usbl, None, best.residual_m, "m"))
    if not result.observable:
        fits = "; ".join(f"{r.description}: RMS residual {r.residual_m:.2f} m" for r in result.plausible)
        text = f"the log does not distinguish these interpretations: {fits}"
        found.append(Finding("CONVENTION-UNOBSERVABLE", text, usbl, None, read.residual_m, "m"))
    if best == read and result.decided_by is not None and result.observable:
        worse = next(r for r in result.interpretations if r.mirror_class != best.mirror_class)
        text = (
            f"dead-reckoning-to-fix residual: {best.residual_m:.2f} m RMS with {best.description}, "
            f"{worse.residual_m:.2f} m with the next best; mirror image excluded by: {result.decided_by.name}"
        )
        found.append(Finding("CONVENTION-CHECKED", text, usbl, None, best.residual_m, "m"))
    return found


def _interpretation_text(
    read: Interpretation, best: Interpretation, key: str, old: str, new: str, result: InterpretationResult
) -> str:
    section = {"axes": "dvl", "convention": "compass", "frame": "usbl"}[key]
    by = result.decided_by
    mirrored = f"mirror image excluded by: {by.name}" if by else "its mirror image fits equally well, not excluded"
    return (
        f"read as {key} {old}, but {new} fits better; dead-reckoning-to-fix residual: {read.residual_m:.2f} m RMS as "
        f"read, {best.residual_m:.2f} m with {best.description}; {mirrored}; "
        f'state {key} = "{new}" under [{section}]'
    )


def _heading_offset_findings(log: Log, result: InterpretationResult) -> list[Finding]:
    best, offset, sd = result.best, result.best.offset_deg, result.offset_sd_deg
    if not result.heading_sense_known or not sd < THRESHOLDS.max_offset_sd_deg:
        return []
    settings = log.settings
    mount, bias = settings.dvl.mount_deg, settings.compass.bias_deg
    stated = mount != 0 or bias != 0
    code = "HEADING-BIAS" if stated else "DVL-MOUNT"
    far = heading_offset_is_significant(result)
    topic = topic_of(log, "compass" if stated else "dvl")
    by = "" if best == result.as_read and result.observable else f", with {best.description}"
    text = f"{topic}: rotating dead reckoning by {offset:+.1f} deg (clockwise, ±{max(sd, 0.1):.1f}) fits the fixes{by}"
    if far:
        text += (
            f"; state mount_deg = {wrapped(mount + offset, 180.0):.1f} under [dvl] if the DVL is mounted so, or "
            f"bias_deg = {wrapped(bias - offset, 180.0):.1f} under [compass] if the heading is biased"
        )
    return [Finding(code if far else "HEADING-CHECKED", text, topic, None, offset, "deg")]


def latency_is_significant(c: DrUsblFit) -> bool:
    """Tell whether the latency of the fixes is significant."""
    return abs(c.latency_s) > max(THRESHOLDS.min_latency_s, THRESHOLDS.significance_sigmas * c.latency_sd_s)


def scale_is_significant(c: DrUsblFit) -> bool:
    """Tell whether the scale error of the DVL is significant."""
    return abs(c.scale) > max(THRESHOLDS.min_scale_error, THRESHOLDS.significance_sigmas * c.scale_sd)


def heading_offset_is_significant(result: InterpretationResult) -> bool:
    """Tell whether the rotation of DVL and heading against the fixes is significant."""
    observable = result.heading_sense_known and result.offset_sd_deg < THRESHOLDS.max_offset_sd_deg
    return observable and abs(result.best.offset_deg) > max(
        THRESHOLDS.min_offset_deg, THRESHOLDS.offset_sigmas * result.offset_sd_deg
    )


def _delays(log: Log, c: DrUsblFit) -> list[Finding]:
    found: list[Finding] = []
    usbl, compass = topic_of(log, "usbl"), topic_of(log, "compass")
    if latency_is_significant(c):
        stated = log.settings.usbl.latency_s
        side = "before" if c.latency_s > 0 else "after"
        text = (
            f"{usbl}: fixes fit best if valid {abs(c.latency_s):.2f} s {side} their stamps "
            f"(±{c.latency_sd_s:.2f} s, by the DVL's clock); if that clock is right, state "
            f"latency_s = {stated + c.latency_s:.2f} under [usbl]; a transponder mounted forward or aft looks the "
            "same (lever_arm_m)"
        )
        found.append(Finding("USBL-LATENCY", text, usbl, None, c.latency_s, "s"))
    least_s = max(THRESHOLDS.min_heading_delay_s, THRESHOLDS.significance_sigmas * c.heading_delay_sd_s)
    better = c.sd_m < THRESHOLDS.max_delayed_residual_ratio * c.sd_without_delay_m
    if abs(c.heading_delay_s) > least_s and better:
        text = (
            f"{compass}: stamps are {delay_text(c.heading_delay_s)} those that fit DVL and fixes best "
            f"(±{c.heading_delay_sd_s:.2f} s): a delay, or a DVL mounted forward or aft (lever_arm_m under [dvl]); "
            "part of it may be the fixes' latency"
        )
        found.append(Finding("HEADING-DELAY", text, compass, None, c.heading_delay_s, "s"))
    return found


def _scale(log: Log, c: DrUsblFit) -> list[Finding]:
    if not scale_is_significant(c):
        return []
    dvl = topic_of(log, "dvl")
    text = (
        f"{dvl}: distance travelled differs by {100 * c.scale:+.1f} % from the fixes (±{100 * c.scale_sd:.1f} %); "
        f"if the fixes are right, state scale_error = {c.scale:.3f} under [dvl]"
    )
    return [Finding("DVL-SCALE", text, dvl, None, 100 * c.scale, "%")]


def _fix_noise_findings(log: Log, timeline: Timeline, c: DrUsblFit) -> list[Finding]:
    found: list[Finding] = []
    usbl = topic_of(log, "usbl")
    outliers = c.outlier_rows[c.residual_m[c.outlier_rows] > THRESHOLDS.min_outlier_m]
    if len(outliers):
        worst = int(outliers[np.argmax(c.residual_m[outliers])])
        time_s, worst_m = float(timeline.fix_time_s[worst]), float(c.residual_m[worst])
        far_m = max(GROSS_SIGMAS * c.sd_m, THRESHOLDS.min_outlier_m)
        text = (
            f"{usbl}: {len(outliers)} of {len(c.residual_m)} fixes are gross outliers, more than {far_m:.1f} m from "
            f"dead reckoning fitted to the others (worst: {worst_m:.1f} m at {time_s:.1f} s); "
            "use a robust noise family (the default) or a gate"
        )
        found.append(Finding("USBL-OUTLIERS", text, usbl, time_s, worst_m, "m"))
    stated_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    if not 1 / THRESHOLDS.noise_ratio < c.sd_m / stated_m < THRESHOLDS.noise_ratio:
        text = (
            f"{usbl}: fixes scatter by {c.sd_m:.2f} m per axis within {SEGMENT_S:.0f} s, but their stated sd is "
            f"{stated_m:.2f} m; slower errors are not included"
        )
        found.append(Finding("USBL-NOISE", text, usbl, None, c.sd_m, "m"))
    return found
