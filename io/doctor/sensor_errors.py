"""Findings on the sensor errors for which the log has evidence, and on rival explanations of the same fixes.

evidence.py finds both. Log odds are natural logarithms: 0 is undecided, and 3 are odds of 20 to 1. Angles are degrees
clockwise. All errors are relative: the log cannot show which of two sensors is wrong.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.identification.evidence import Explained, explained
from usbldr.filters.identification.identification import LEVER_OR_LATENCY, ErrorEstimate, Explanation, Identification
from usbldr.filters.identification.linearisation import (
    ARM,
    COMPASS_CLOCK,
    DVL_CLOCK,
    HEAD,
    KEYS,
    LEVER,
    RANGE,
    REPORTED,
)
from usbldr.filters.replay.dead_reckoning import displacement_m, without_changes, without_smoothing
from usbldr.filters.types import Array, Timeline
from usbldr.filters.windows import columns_at
from usbldr.io.doctor.interpretations import InterpretationResult
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log

WorstAndAdvice: TypeAlias = tuple[float, str]
LIKE_WRONG_AXES = ("USBL-LATENCY", "DVL-LEVER", "LEVER-OR-LATENCY")
"""Findings that another sign of a velocity across would explain, too."""


def explained_by(log: Log, line: Timeline, result: InterpretationResult) -> Explained | None:
    """Return the evidence for the best interpretation, and what concludes its sensor errors; None without a start."""
    *_, mirrored = result.best.flips
    try:
        return explained(line, replace(log.parameters, aid=(), start=None if mirrored else log.parameters.start))
    except LogError:
        return None


def sensor_error_findings(
    log: Log, found: Identification, axes: Sequence[str] = (), clock_known: bool = True
) -> list[Finding]:
    """Report each error that exists by every explanation, which replay corrects, then what is contested.

    The heading bias has findings of its own. ``axes``: others of the DVL that the log does not exclude. Without
    ``clock_known`` the latency is part of a clock's offset.
    """
    apart = {*found.contested, *(pair.head for pair in found.open_pairs), *(() if clock_known else ("latency",))}
    findings = [one for key in ERROR_FINDINGS if key not in apart and (one := _finding(log, found, key)) is not None]
    findings += [Finding("RIVAL-EXPLANATIONS", pair.text, log.topic_of("usbl")) for pair in found.open_pairs]
    if found.contested:
        code = "LEVER-OR-LATENCY" if found.contested <= LEVER_OR_LATENCY else "RIVAL-EXPLANATIONS"
        texts = "; or ".join(explanation_text(one) for one in found.explanations)
        findings.append(Finding(code, f"explanations that the log does not decide between: {texts}"))
    rival = f"; or the axes of the DVL are {' or '.join(axes)}: in turns wrong axes look like it" * bool(axes)
    return [replace(one, text=one.text + rival) if one.code in LIKE_WRONG_AXES else one for one in findings]


def change_findings(log: Log, timeline: Timeline, found: Identification) -> list[Finding]:
    """Report when sensors changed; worst: how far all changes move the fixes against dead reckoning, RMS."""
    changes = found.parameters.changes
    moved_m = _off_m(timeline) - _off_m(without_changes(timeline, changes))
    effect_m = float(np.hypot(*moved_m.std(axis=0)))
    ending = f"; the changes move the fixes against dead reckoning by {effect_m:.2g} m RMS, and replay takes them off"
    if not effect_m:
        ending = "; replay scales the sigmas of the fixes"
    of_fixes = any(any(one.fix_shift_m) or one.fix_late_s or one.fix_sd_scale != 1 for one in changes)
    topic = log.topic_of("usbl" if of_fixes else "compass")
    rival = found.rival_shift_text
    return [
        Finding("SENSOR-CHANGE", text + ending, topic, start_s, effect_m, "m")
        for start_s, text in found.change_texts.items()
    ] + ([Finding("RIVAL-EXPLANATIONS", rival, log.topic_of("usbl"))] if rival else [])


def smoothing_findings(log: Log, timeline: Timeline, found: Identification) -> list[Finding]:
    """Report that software smoothed the fixes; worst: how far it moved them, RMS."""
    if not (text := found.smoothing_text):
        return []
    before_m = without_smoothing(timeline, found.parameters.smoothing).fix_m
    rms_m = float(np.linalg.norm(timeline.fix_m - before_m) / math.sqrt(len(before_m)))
    return [log.finding("USBL-SMOOTHED", "usbl", text, None, rms_m, "m")]


def _off_m(timeline: Timeline) -> Array:
    """Return the fixes minus dead reckoning, (F, 2)."""
    return timeline.fix_m - columns_at(timeline.fix_time_s, timeline.time_s, displacement_m(timeline))


def false_fix_findings(log: Log, found: Identification) -> list[Finding]:
    """Report the fixes in a row that replay leaves out; worst: the longest run."""
    if not found.false_runs:
        return []
    longest = max(found.false_runs, key=lambda run: run.fixes)
    return [log.finding("FALSE-FIXES", "usbl", found.false_runs_text, longest.start_s, longest.fixes, "fixes")]


def explanation_text(one: Explanation) -> str:
    """Return the errors of an explanation in words, with its log odds against the best."""
    value = {estimate.name: estimate for estimate in one.estimates}
    errors = " and ".join(error_text(key, value) for key in one.keys) or "no error"
    if one.log_odds == -math.inf:
        return f"{errors} (far more than is usual)"
    return errors + (f" (log odds {one.log_odds:+.1f} against the likeliest)" if one.log_odds else "")


def error_text(key: str, value: Mapping[str, ErrorEstimate]) -> str:
    """Return an error of usbl_likelihood.KEYS in words, each number with its sigma."""

    def number(name: str, factor: float = 1.0, digits: int = 2) -> str:
        return f"{factor * value[name].value:z.{digits}f} ± {abs(factor) * value[name].sd:.{digits}f}"

    def signed(name: str, factor: float = 1.0) -> tuple[str, bool]:
        positive = value[name].value > 0
        return number(name, factor if positive else -factor), positive

    def further(sensor: str) -> str:
        (forward, ahead), (across, starboard) = signed(f"{sensor}_forward_m"), signed(f"{sensor}_starboard_m")
        side = "starboard" if starboard else "port"
        return f"{forward} m further {'ahead' if ahead else 'astern'} and {across} m further to {side} of"

    if key == "scale":
        percent, much = signed("dvl_scale", 100.0)
        return f"the DVL reads {percent} % too {'much' if much else 'little'}"
    if key == "heading":
        degrees, large = signed("heading_bias_deg")
        return f"headings are {degrees} deg too {'large' if large else 'small'}"
    if key == "deviation":
        sine, cosine = number("deviation_sin_deg", 1.0, 1), number("deviation_cos_deg", 1.0, 1)
        return f"the compass has a deviation of ({sine}) sin H + ({cosine}) cos H deg at heading H"
    if key == "latency":
        seconds, late = signed("usbl_latency_s")
        return f"fixes were valid {seconds} s {'before' if late else 'after'} their stamps, by DVL and compass"
    if key == LEVER:
        return f"the DVL is {further('dvl_lever')} the transponder than stated"
    if key == HEAD:
        degrees, large = signed("usbl_heading_deg")
        return f"the heading of the USBL head is {degrees} deg too {'large' if large else 'small'}"
    if key == RANGE:
        percent, long = signed("usbl_range_scale", 100.0)
        return f"ranges of the USBL are {percent} % too {'long' if long else 'short'}"
    if key == ARM:
        return f"the USBL head is {further('usbl_arm')} the ship's antenna than stated"
    sensor, others = ("DVL", "compass") if key == DVL_CLOCK else ("compass", "DVL")
    seconds, late = signed(f"{sensor.lower()}_clock_s")
    return f"stamps of the {sensor} are {seconds} s {'late' if late else 'early'} against those of {others} and fixes"


def log_odds_text(found: Identification, key: str) -> str:
    """Return the evidence for an error."""
    return f"log odds {next(one.log_odds for one in found.evidence if one.key == key):+.1f}"


def stated_lever_m(found: Identification) -> str:
    """Return the lever arm of the DVL that the log has evidence for, as in a configuration."""
    return "[" + ", ".join(f"{metres:z.2f}" for metres in found.parameters.dvl_lever_m) + "]"


def _finding(log: Log, found: Identification, key: str) -> Finding | None:
    """Return the finding on an error that exists, None if it does not."""
    kind, names = ERROR_FINDINGS[key], [REPORTED[state].name for state in KEYS[key]]
    if not found.estimates.keys() >= set(names):
        return None
    worst, advice = kind.worst_and_advice(log, found, *(found.estimates[name].value for name in names))
    effect_m = next(one.effect_m for one in found.evidence if one.key == key)
    moves = f"{log_odds_text(found, key)}, moves fixes by {effect_m:.2g} m RMS"
    text = f"{error_text(key, found.estimates)} ({moves}); {advice}"
    return log.finding(kind.code, kind.role, text, None, worst, kind.unit)


def _scale(log: Log, _: Identification, scale: float) -> WorstAndAdvice:
    return 100 * scale, f"if the fixes are right, state scale_error = {stated_scale(log, scale):.3f} under [dvl]"


def _head(log: Log, _: Identification, heading: float) -> WorstAndAdvice:
    mount_deg = log.settings.usbl.mount_deg - heading
    return heading, f"check how the head is mounted; if so, state mount_deg = {mount_deg:z.2f} under [usbl]"


def _range(log: Log, _: Identification, scale: float) -> WorstAndAdvice:
    stated = log.settings.usbl.sound_speed_scale / (1 + scale)
    return 100 * scale, f"check the speed of sound; if so, state sound_speed_scale = {stated:.4f} under [usbl]"


def _arm(log: Log, _: Identification, starboard_m: float, forward_m: float) -> WorstAndAdvice:
    head = log.settings.usbl.head
    starboard, forward, up = head.lever_arm_m if head is not None else (0.0, 0.0, 0.0)
    stated = f"[{starboard + starboard_m:z.2f}, {forward + forward_m:z.2f}, {up:z.2f}]"
    return math.hypot(starboard_m, forward_m), (
        f"measure it on the ship; if so, state lever_arm_m = {stated} in head of [usbl], or in the USBL's own software "
        "if its fixes do not count from the head"
    )


def stated_scale(log: Log, scale: float) -> float:
    """Return the scale error to state: relative errors multiply."""
    return (1 + log.settings.dvl.scale_error) * (1 + scale) - 1


def _deviation(_log: Log, _: Identification, sine: float, cosine: float) -> WorstAndAdvice:
    advice = "state deviation_sin_deg and deviation_cos_deg under [compass], or compensate the compass"
    return float(np.hypot(sine, cosine)), advice


def _latency(log: Log, found: Identification, late_s: float) -> WorstAndAdvice:
    side = "early" if late_s > 0 else "late"
    rival = (
        f"or the fixes' stamps are right, and those of DVL and compass {side}: then "
        f"latency_s = {-late_s:.2f} under both [dvl] and [compass]"
    )
    stated, arrival = log.settings.usbl.latency_s + late_s, _arrival_text(log, found.estimates["usbl_latency_s"])
    return late_s, f"state latency_s = {stated:.2f} under [usbl], {rival}{arrival}"


def _arrival_text(log: Log, latency: ErrorEstimate) -> str:
    """Return what the arrival of fixes excludes: none can arrive before it is valid."""
    table = log.tables["usbl"]
    delays_s = (table["received_s"] - table["time_s"]).dropna().to_numpy(dtype=float)
    delay_s = float(np.median(delays_s)) if len(delays_s) else np.inf
    early_s = -latency.value - delay_s
    if early_s < THRESHOLDS.significance_sigmas * latency.sd:
        return ""
    return (
        f"; fixes arrive {delay_s:.2f} s after their stamps (median), so that, unless a lever arm is wrong, DVL and "
        f"compass are late by {early_s:.2f} s at least"
    )


def _lever(_: Log, found: Identification, starboard_m: float, forward_m: float) -> WorstAndAdvice:
    return math.hypot(starboard_m, forward_m), (
        f"state lever_arm_m = {stated_lever_m(found)} under [dvl], or the opposite change under [usbl]: the log shows "
        "only their difference; replay takes the transponder's place as stated, with a larger sigma"
    )


def _clock(log: Log, _: Identification, late_s: float, sensor: str) -> WorstAndAdvice:
    return late_s, f"state latency_s = {log.settings.section(sensor).latency_s + late_s:.2f} under [{sensor}]"


class _ErrorFinding(NamedTuple):
    """How a sensor error is reported."""

    code: str
    role: str
    unit: str  # of the worst value
    worst_and_advice: Callable[..., WorstAndAdvice]  # from log, identification and the values of KEYS


ERROR_FINDINGS: Mapping[str, _ErrorFinding] = {
    "scale": _ErrorFinding("DVL-SCALE", "dvl", "%", _scale),
    "deviation": _ErrorFinding("COMPASS-DEVIATION", "compass", "deg", _deviation),
    DVL_CLOCK: _ErrorFinding("DVL-CLOCK", "dvl", "s", partial(_clock, sensor="dvl")),
    COMPASS_CLOCK: _ErrorFinding("COMPASS-CLOCK", "compass", "s", partial(_clock, sensor="compass")),
    LEVER: _ErrorFinding("DVL-LEVER", "dvl", "m", _lever),
    HEAD: _ErrorFinding("USBL-HEADING", "usbl", "deg", _head),
    RANGE: _ErrorFinding("USBL-RANGE", "usbl", "%", _range),
    ARM: _ErrorFinding("USBL-ARM", "usbl", "m", _arm),
    "latency": _ErrorFinding("USBL-LATENCY", "usbl", "s", _latency),
}
"""By the keys of linearisation.KEYS, in the order of the findings."""
