"""Check DVL, heading and fixes against each other: conventions, mounting, sensor errors, noise.

GPS decides which of two mirror images the map is, and the truth's clock is compared with the fixes; no other check uses
either. Angles are degrees clockwise.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsbldrError
from usbldr.filters.evaluation.time_offset import TimeOffset, time_offset
from usbldr.filters.frames import wrapped
from usbldr.filters.identification.evidence import Explained
from usbldr.filters.identification.identification import STRONG_ODDS, Identification
from usbldr.filters.replay.dead_reckoning import without_smoothing
from usbldr.filters.types import Timeline, Vector
from usbldr.io.conventions.usbl import AWAY_COLUMNS
from usbldr.io.doctor.clocks import clock_by_evidence, clock_offset_findings, clock_step_findings, correct_clock_offset
from usbldr.io.doctor.fix_noise import fix_noise_findings, motion_findings
from usbldr.io.doctor.gross_errors import (
    correct_velocity_unit,
    heading_unit_findings,
    single_error_findings,
    single_errors,
    velocity_unit_findings,
)
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    Interpretation,
    InterpretationResult,
    compare_interpretations,
    flipped,
)
from usbldr.io.doctor.message_evidence import message_evidence
from usbldr.io.doctor.sensor_errors import (
    change_findings,
    explained_by,
    false_fix_findings,
    log_odds_text,
    sensor_error_findings,
    smoothing_findings,
)
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.messages.roles import SENSORS
from usbldr.io.reading.epochs import timeline as timeline_of

CONVENTION_CODES = {"dvl": "DVL-AXES", "compass": "HEADING-CONVENTION", "usbl": "MAP-FRAME"}
"""By the sensor whose convention it is."""
REPLAY_WARNING_CODES = (
    *CONVENTION_CODES.values(),
    "DVL-EARTH",
    "HEADING-RADIANS",
    "DVL-MOUNT",
    "HEADING-BIAS",
    "CLOCK-OFFSET",
    "CLOCK-STEP",
    "DVL-UNIT",
    "CONVENTION-DEFAULT",
    "USBL-MOTION",
    "USBL-TURNS",
)
"""What replay reports, too: it would compute with a wrong axis, frame, unit or clock."""


class CrossCheck(NamedTuple):
    """How the sensors fit each other, in words and in numbers."""

    findings: tuple[Finding, ...]
    result: InterpretationResult | None = None  # None: too few fixes, or they are of another vehicle
    identification: Identification | None = None  # by the best interpretation


def cross_check(
    log: Log, timeline: Timeline, sources: Sequence[HandednessEvidence] = (), with_errors: bool = True
) -> CrossCheck:
    """Compare DVL, heading and fixes, and identify sensor errors; ``sources`` as of `compare_interpretations`."""
    result = compare_interpretations(log, timeline, sources)
    if result is None:
        text = "too few fixes within valid dead reckoning, or too far from the map's origin, to check the conventions"
        return CrossCheck((Finding("CONVENTION-UNOBSERVABLE", text, log.topic_of("usbl")),))
    errors, rms_m = single_errors(log, timeline, result)
    if in_radians := heading_unit_findings(log, timeline, result):
        return CrossCheck(tuple(in_radians), result)
    if errors:
        found = single_error_findings(log, result, errors, rms_m)
        return CrossCheck(tuple(found), result, _identified(log, errors[0].line, result) if with_errors else None)
    steps = clock_step_findings(log, timeline, {result.best.flips, result.as_read.flips})
    unit_ratio, clock_offset_s, result, timeline = _corrected(log, timeline, result, sources)
    line = flipped(log, timeline, result.best.flips)
    identification = _identified(log, line, result) if with_errors else None
    moving = motion_findings(log, timeline, result, identification)
    if any(one.code == "USBL-MOTION" for one in moving):
        return CrossCheck((*steps, *moving))
    if identification is not None:
        result, there = _by_evidence(log, timeline, result, result.best, identification)
        identification = there.conclude()
        if not clock_offset_s and (clock := clock_by_evidence(log, timeline, result, identification)):
            named, there, line = clock
            return CrossCheck((*steps, *named), compare_interpretations(log, line, sources), there.conclude())
        line = flipped(log, timeline, result.best.flips)
    findings = [*steps, *_fit_findings(log, timeline, result, identification)]
    delay_s = result.best.fit.latency_s
    if identification is not None:
        latency = identification.estimates.get("usbl_latency_s")
        delay_s = latency.value if latency else 0.0
        timeline = without_smoothing(timeline, identification.parameters.smoothing)
    valid_s = timeline.fix_time_s - delay_s  # by the DVL's clock
    by_fixes = _truth_offset(log, timeline, result, valid_s + clock_offset_s) if clock_offset_s else None
    as_fixes = by_fixes is not None and not by_fixes.notable
    findings += clock_offset_findings(log, clock_offset_s + delay_s, as_fixes) if clock_offset_s else ()
    findings += velocity_unit_findings(log, unit_ratio, result) if unit_ratio != 1.0 else ()
    truth_late = [] if as_fixes else _truth_clock_findings(log, _truth_offset(log, timeline, result, valid_s))
    findings += truth_late or moving
    if identification is not None:
        axes = sorted({one.axes for one in result.plausible} - {log.convention("dvl", "axes").value})
        findings += sensor_error_findings(log, identification, axes, clock_known=not clock_offset_s)
        findings += smoothing_findings(log, line, identification)
        findings += change_findings(log, line, identification)
        findings += false_fix_findings(log, identification)
        findings += fix_noise_findings(log, line, identification)
    return CrossCheck(tuple(findings), result, identification)


def moves_alike(log: Log) -> bool:
    """Return whether nothing shows that dead reckoning, fixes and truth are of different vehicles."""
    if not {*SENSORS} <= log.tables.keys():
        return True
    try:
        line = timeline_of(log)
    except UsbldrError:
        return True  # which another finding reports
    sources = message_evidence(log)
    result = compare_interpretations(log, line, sources)
    if result is None:
        return True
    *_, result, line = _corrected(log, line, result, sources)
    return not motion_findings(log, line, result)


def _truth_offset(log: Log, timeline: Timeline, result: InterpretationResult, valid_s: Vector) -> TimeOffset | None:
    """Return the offset of the truth's stamps against fixes that were valid at times, (F,), without outliers."""
    if log.truth is None:
        return None
    apart_m = result.best.fit.residual_m
    sound = ~(apart_m > THRESHOLDS.gross_sigmas * np.nanmedian(apart_m))
    return time_offset(valid_s[sound], timeline.fix_m[sound], log.truth)


def _truth_clock_findings(log: Log, offset: TimeOffset | None) -> list[Finding]:
    if log.truth is None or offset is None or not offset.notable:
        return []
    text = offset.sentence(log.truth, f"the fixes of {log.topic_of('usbl')}")
    return [Finding("TRUTH-CLOCK", text, log.truth.source, None, offset.late_s, "s")]


def _identified(log: Log, line: Timeline, result: InterpretationResult) -> Identification | None:
    """Return what the log settles about sensor errors and noise; None without a start."""
    return found.conclude() if (found := explained_by(log, line, result)) else None


def _rivals(log: Log, result: InterpretationResult, by: Interpretation, found: Identification) -> list[Interpretation]:
    """Return the interpretations between which and an identified one the evidence decides; none is its mirror image.

    Sensor errors may bend dead reckoning, and a convention that is only the default may be another. If one of them
    leaves far larger residuals and no error bends it, no sensor error is the cause.
    """
    bent = found.parameters.changes or any(one.key == "deviation" and one.exists for one in found.evidence)
    by_default = {one[:2] for one in result.best.conventions if log.convention(*one[:2]).chosen_by == "default"}
    read, residuals_m = {result.best.flips, result.as_read.flips}, (by.residual_m, result.best.residual_m)
    as_read = set(result.as_read.conventions)
    most_m = math.inf if bent else THRESHOLDS.max_rival_residual * min(residuals_m)
    possible = [
        one
        for one in (*result.plausible, result.best, result.as_read)
        if one.residual_m < most_m
        and (bent or one.flips in read or {key[:2] for key in set(one.conventions) - as_read} <= by_default)
    ]
    by_class = {one.mirror_class: one for one in sorted(possible, key=lambda one: -sum(one.flips))}
    by_class.pop(by.mirror_class, None)
    return list(by_class.values()) if found.evidence and max(residuals_m) < most_m else []


def _by_evidence(
    log: Log, timeline: Timeline, result: InterpretationResult, by: Interpretation, found: Identification
) -> tuple[InterpretationResult, Explained]:
    """Return the rival interpretation with the largest evidence, each with its sensor errors, if that is strong.

    Else the result and what was ``found``, the identification by one of them, ``by``.
    """
    tried = [(by, Explained(found.log_evidence, lambda: found))]
    for one in _rivals(log, result, by, found):
        other = explained_by(log, flipped(log, timeline, one.flips), replace(result, best=one))
        tried += [(one, other)] if other else []
    best, there = max(tried, key=lambda each: each[1].log_evidence)
    others = (one.log_evidence for rival, one in tried if rival.mirror_class != best.mirror_class)
    log_odds = there.log_evidence - max(others, default=there.log_evidence)
    if log_odds <= math.log(STRONG_ODDS) or (best.flips == result.best.flips and result.observable):
        return result, tried[0][1]
    fitting = tuple(one for one in result.plausible if one.mirror_class == best.mirror_class) or (best,)
    return replace(result, best=best, plausible=fitting, log_odds=log_odds), there


FIXED_ADVICE = "the names of its columns say how it was read; check them, and the signs of their values"


def convention_warnings(log: Log, timeline: Timeline, identification: Identification | None = None) -> list[Finding]:
    """Return a finding for each convention, mounting or clock if another fits clearly better; change nothing.

    An identification says which rotation is evident beside other sensor errors, if the log is read right.
    """
    if not {*SENSORS} <= log.tables.keys():
        return []
    sources = message_evidence(log)
    result = compare_interpretations(log, timeline, sources) if len(timeline.fix_time_s) else None
    if result is None:
        return []
    errors, rms_m = single_errors(log, timeline, result)
    if in_radians := heading_unit_findings(log, timeline, result):
        return in_radians
    if errors:
        return single_error_findings(log, result, errors, rms_m)
    steps = clock_step_findings(log, timeline, {result.best.flips, result.as_read.flips})
    unit_ratio, clock_offset_s, result, corrected = _corrected(log, timeline, result, sources)
    if (moving := motion_findings(log, corrected, result, identification)) and moving[0].code == "USBL-MOTION":
        return moving
    if identification is not None and result.best != result.as_read:  # else only doctor asks, as it takes time
        result, _ = _by_evidence(log, corrected, result, result.as_read, identification)
    clock = clock_by_evidence(log, corrected, result, identification) if not clock_offset_s else None
    if clock is not None:
        return [*steps, *clock[0]]
    asked = result.best == result.as_read
    found = [*steps, *moving, *_fit_findings(log, corrected, result, identification if asked else None)]
    found += clock_offset_findings(log, clock_offset_s + result.best.fit.latency_s) if clock_offset_s else ()
    found += velocity_unit_findings(log, unit_ratio, result) if unit_ratio != 1.0 else ()
    return [d for d in found if d.code in REPLAY_WARNING_CODES]


def _corrected(
    log: Log, timeline: Timeline, result: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, float, InterpretationResult, Timeline]:
    """Return the factor of the velocities and the offset of the fixes' clock, and the result without both."""
    unit_ratio, result, timeline = correct_velocity_unit(log, timeline, result, sources)
    return unit_ratio, *correct_clock_offset(log, timeline, result, sources)


def _fit_findings(
    log: Log, timeline: Timeline, result: InterpretationResult, identification: Identification | None
) -> list[Finding]:
    found = [*convention_findings(log, result), *_heading_offset_findings(log, result, identification)]
    return [*found, *heading_unit_findings(log, timeline, result)]


def convention_findings(log: Log, result: InterpretationResult) -> list[Finding]:
    """Report which other interpretation of axes, yaw or map fits clearly better, and what is not observable."""
    read, best = result.as_read, result.best
    found: list[Finding] = []
    by = result.decided_by
    mirrored = f"mirror image excluded by: {by.name}" if by else "its mirror image fits equally well, not excluded"
    for (role, key, old), (*_, new) in zip(read.conventions, best.conventions, strict=True):
        if old != new:
            by_columns = log.convention(role, key).chosen_by == "column names"
            advice = FIXED_ADVICE if by_columns else f'state {key} = "{new}" under [{role}]'
            fits = (
                f"dead-reckoning-to-fix residual: {read.residual_m:.2f} m RMS as read, {best.residual_m:.2f} m with "
                f"{best.description}"
            )
            if result.log_odds is not None:
                fits = f"with the sensor errors that each needs, the fixes say so by log odds {result.log_odds:+.1f}"
            text = f"read as {key} {old}, but {new} fits better; {fits}; {mirrored}; {advice}"
            found.append(log.finding(CONVENTION_CODES[role], role, text, None, read.residual_m, "m"))
    usbl = log.topic_of("usbl")
    if result.contradicting and by is not None:
        others = "; ".join(source.name for source in result.contradicting)
        text = f"sources disagree on the mirror image; followed: {by.name}; contradicting: {others}"
        found.append(Finding("CONVENTION-CONTRADICTED", text, usbl))
    if by is None and result.mirror_image is not None:
        text = (
            f"{best.description} and its mirror image ({result.mirror_image.description}) fit the fixes equally well "
            f"({best.residual_m:.2f} m RMS), and nothing in the log decides; "
            "state frame under [usbl] and convention under [compass]"
        )
        found.append(Finding("CONVENTION-UNDECIDED", text, usbl, None, best.residual_m, "m"))
    for role, key, _ in best.conventions:
        fitting = sorted({str(getattr(one, key)) for one in result.plausible})
        read_as = log.convention(role, key)
        if len(fitting) > 1 and read_as.value and read_as.chosen_by == "default":
            text = (
                f"{key} = {read_as.value} is only the default, and the log "
                f"fits {' and '.join(fitting)} alike (too straight, or too few fixes); state {key} under [{role}]"
            )
            text += ", before any latency or lever arm: in turns wrong axes look like one" * (role == "dvl")
            found.append(log.finding("CONVENTION-DEFAULT", role, text))
    if not result.observable:
        fits = "; ".join(f"{r.description}: RMS residual {r.residual_m:.2f} m" for r in result.plausible)
        text = f"the log does not distinguish these interpretations: {fits}"
        found.append(Finding("CONVENTION-UNOBSERVABLE", text, usbl, None, read.residual_m, "m"))
    if best == read and by is not None and result.observable:
        worse = next(r for r in result.interpretations if r.mirror_class != best.mirror_class)
        text = (
            f"dead-reckoning-to-fix residual: {best.residual_m:.2f} m RMS with {best.description}, "
            f"{worse.residual_m:.2f} m with the next best; mirror image excluded by: {by.name}"
        )
        found.append(Finding("CONVENTION-CHECKED", text, usbl, None, best.residual_m, "m"))
    return found


def _heading_offset_findings(
    log: Log, result: InterpretationResult, identification: Identification | None
) -> list[Finding]:
    best = result.best
    offset, sd, far = heading_offset(result, identification)
    if not result.heading_sense_known or not sd < THRESHOLDS.max_offset_sd_deg:
        return []
    mount, bias = log.settings.dvl.mount_deg, log.settings.compass.bias_deg
    code, role = ("HEADING-BIAS", "compass") if mount or bias else ("DVL-MOUNT", "dvl")
    by = "" if best == result.as_read and result.observable else f", with {best.description}"
    odds, found = "", identification
    if found is not None and "heading" not in found.contested and "heading_bias_deg" in found.estimates:
        odds = f", {log_odds_text(found, 'heading')}"
    turn = f"{offset:+.1f} deg (clockwise, ±{max(sd, 0.1):.1f}{odds})"
    text = f"rotating dead reckoning by {turn} fits the fixes{by}"
    if far:
        text += (
            f"; state mount_deg = {wrapped(mount + offset, 180.0):.1f} under [dvl] if the DVL is mounted so, or "
            f"bias_deg = {wrapped(bias - offset, 180.0):.1f} under [compass] if the heading is biased"
        )
        if not {*AWAY_COLUMNS} <= {*log.tables["usbl"]}:
            text += '; if the USBL head is turned instead, state its place (head, relative_to = "map" under [usbl])'
    return [log.finding(code if far else "HEADING-CHECKED", role, text, None, offset, "deg")]


def heading_offset(result: InterpretationResult, identification: Identification | None) -> tuple[float, float, bool]:
    """Return how far dead reckoning is to be rotated to fit the fixes, its sigma, and whether it is significant.

    Both in degrees, clockwise. It is significant if the log has evidence for it beside other sensor errors; without an
    identification, by its sigma.
    """
    offset, sd = result.best.offset_deg, result.offset_sd_deg
    if identification is None or not identification.evidence or "heading" in identification.contested:
        observable = result.heading_sense_known and sd < THRESHOLDS.max_offset_sd_deg
        return offset, sd, observable and abs(offset) > max(THRESHOLDS.min_offset_deg, THRESHOLDS.offset_sigmas * sd)
    if (bias := identification.estimates.get("heading_bias_deg")) is None:
        return offset, sd, False
    return -bias.value, bias.sd, result.heading_sense_known and abs(bias.value) > THRESHOLDS.min_bias_deg
