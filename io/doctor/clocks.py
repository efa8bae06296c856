"""Clocks that differ: a constant offset of the fixes, a sensor that is far off, and steps. Uses no truth."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.identification.dr_usbl_fit import (
    MIN_FIXES,
    as_points,
    fit_at_latency,
    fit_rotation,
    fix_points,
    segment_numbers,
)
from usbldr.filters.identification.evidence import Explained
from usbldr.filters.identification.identification import STRONG_ODDS, Identification
from usbldr.filters.models.parameters import NOT_SMOOTHED
from usbldr.filters.replay.dead_reckoning import displacement_m, freed, without_smoothing
from usbldr.filters.types import Array, Mask, Timeline
from usbldr.io.doctor.gross_errors import AS_READ, SingleError, single_error_findings
from usbldr.io.doctor.interpretations import (
    HandednessEvidence,
    InterpretationResult,
    compare_interpretations,
    flipped,
    reinterpret,
    white_noise_m,
)
from usbldr.io.doctor.sensor_errors import explained_by
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.gps_time import LEAP_S
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline as timeline_of

MIN_RECORDS = 3  # fixed: with fewer no interval is usual


def correct_clock_offset(
    log: Log, timeline: Timeline, result: InterpretationResult, sources: Sequence[HandednessEvidence]
) -> tuple[float, InterpretationResult, Timeline]:
    """Return the offset of the fixes' clock, 0 unless significant, with result and timeline once corrected.

    An offset longer than any acoustic delay is no latency; uncorrected, it looks like a rotated DVL. Fixes that
    software smoothed are late without one: then the result is by the fixes before.
    """
    group = segment_numbers(timeline, timeline.fix_time_s)
    lines = [reinterpret(log, timeline, flips) for flips in {result.best.flips, result.as_read.flips}]
    limits = THRESHOLDS
    tried_s = np.arange(-limits.max_clock_offset_s, limits.max_clock_offset_s + 1.0, limits.clock_offset_step_s)
    tried_s = [float(s) for s in tried_s if abs(s) > limits.min_clock_offset_s]  # beyond the fixes' usual delays
    far = min((fit_rotation(line, group, tried_s) for line in lines), key=lambda turn: turn.rms_m)
    late_s, most_m = far.latency_s, limits.gross_residual_ratio * result.best.residual_m
    if not (far.rms_m < result.best.residual_m and abs(late_s) < limits.max_clock_offset_s):
        far_off = result.best.residual_m > limits.min_far_residual_m
        late_s, most_m = _far_clock_offset(lines) if far_off else (0.0, 0.0)
    shifted = replace(timeline, fix_time_s=timeline.fix_time_s - late_s)
    corrected = compare_interpretations(log, shifted, sources) if late_s else None
    if corrected is None or corrected.best.residual_m > most_m:
        return 0.0, result, timeline
    there = explained_by(log, flipped(log, timeline, corrected.best.flips), corrected) if late_s > 0 else None
    smoothing = there.conclude().parameters.smoothing if there else NOT_SMOOTHED
    if smoothing != NOT_SMOOTHED:
        return 0.0, compare_interpretations(log, without_smoothing(timeline, smoothing), sources) or result, timeline
    return late_s, corrected, shifted


def _far_clock_offset(lines: Sequence[Timeline]) -> tuple[float, float]:
    """Return the offset of the fixes' clock, beyond a minute, that explains most, and the most that it may leave, in m.

    Both are of the fixes that lie within dead reckoning with and without it; 0 if there are too few of them. Fixes that
    hardly move fit at any time.
    """
    limits = THRESHOLDS
    best_s, least_m, large_m = 0.0, np.inf, 0.0
    for line in lines:
        group, reckoned = segment_numbers(line, line.fix_time_s), as_points(displacement_m(line))
        for late_s in np.arange(-limits.max_far_offset_s, limits.max_far_offset_s + 1, limits.far_offset_step_s):
            valid_s = line.fix_time_s - late_s
            inside = (valid_s >= line.time_s[0]) & (valid_s <= line.time_s[-1]) & (segment_numbers(line, valid_s) >= 0)
            there = np.where(inside, group, -1)
            if np.sum(there >= 0) < max(MIN_FIXES, len(group) // 4):
                continue
            there = np.unique(there, return_inverse=True)[1] - int(np.any(there < 0))
            rms_m = fit_at_latency(line, reckoned, there, float(late_s)).rms_m
            if rms_m < least_m:
                best_s, least_m = float(late_s), rms_m
                way_m = float(np.std(fix_points(line)[there >= 0]))
                large_m = min(fit_at_latency(line, reckoned, there, 0.0).rms_m, way_m)
    return best_s, limits.far_residual_ratio * large_m


def clock_offset_findings(log: Log, late_s: float, truth_agrees: bool = False) -> list[Finding]:
    """Report an offset of the fixes' clock that is larger than any delay; the truth may agree with it."""
    stated = log.settings.usbl.latency_s
    advice = f"if that clock is right, state latency_s = {stated + late_s:.2f} under [usbl]"
    if truth_agrees:
        advice = f"the truth has the fixes' clock: state latency_s = {-late_s:.2f} under [dvl] and [compass]"
    text = (
        f"stamps are {abs(late_s):.2f} s {'after' if late_s > 0 else 'before'} the time of validity that fits "
        f"dead reckoning far better, by the DVL's clock{_leap_text(late_s)}; {advice}"
    )
    return [log.finding("CLOCK-OFFSET", "usbl", text, None, late_s, "s")]


def _leap_text(late_s: float) -> str:
    is_leap = abs(abs(late_s) - LEAP_S) < THRESHOLDS.leap_second_tolerance_s
    return f" (GPS time and UTC are {LEAP_S} s apart)" if is_leap else ""


class _Fit(NamedTuple):
    """Dead reckoning turned and shifted to F fixes."""

    covered: Mask  # (F,) the fixes within its time
    rms_m: float  # of these; 0 without any
    fix_m: Array  # (F, 2)

    @classmethod
    def of(cls, log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> "_Fit":
        """Return the best fit under some interpretations."""
        group = segment_numbers(timeline, timeline.fix_time_s)
        rms_m = 0.0
        if np.any(group >= 0):
            rms_m = min(fit_rotation(reinterpret(log, timeline, each), group).rms_m for each in flips)
        return cls(group >= 0, rms_m, timeline.fix_m)

    def left_m(self, rows: Mask) -> float:
        """Return what is left of these fixes (F,), RMS: of one that is not covered, its distance from their mean."""
        lost_m = self.fix_m[rows & ~self.covered]
        scatter_m2 = float(np.sum((lost_m - lost_m.mean(axis=0)) ** 2)) if len(lost_m) else 0.0
        return float(np.sqrt(((rows.sum() - len(lost_m)) * self.rms_m**2 + scatter_m2) / max(rows.sum(), 1)))


def clock_step_findings(log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> list[Finding]:
    """Return a finding for each sensor whose longest gap is a step of its clock, under one of some interpretations.

    A clock that was set forward leaves a gap as long as the step, as an outage does. Dead reckoning distinguishes the
    two: with the step taken off, it fits the fixes better, and after an outage far worse. Fixes that the step moves out
    of its time are left as far off as they scatter.
    """
    settings, before, found = log.settings, _Fit.of(log, timeline, flips), list[Finding]()
    for sensor, section in (("dvl", settings.dvl), ("compass", settings.compass), ("usbl", settings.usbl)):
        time_s = log.tables[sensor]["time_s"].to_numpy()
        gaps_s = np.diff(time_s)
        if len(time_s) < MIN_RECORDS or not gaps_s.any():
            continue
        last = int(np.argmax(gaps_s))
        step_s = float(gaps_s[last] - np.median(gaps_s[gaps_s > 0]))  # some fixes may have one time
        if step_s < THRESHOLDS.min_clock_step_s or section.clock_step_s:
            continue
        table = log.tables[sensor].assign(time_s=time_s - np.where(np.arange(len(time_s)) > last, step_s, 0.0))
        try:
            undone = timeline_of(replace(log, tables={**log.tables, sensor: table}))
            after = _Fit.of(log, undone, flips)
        except LogError:
            continue
        covered = before.covered | after.covered
        before_m, after_m = before.left_m(covered), after.left_m(covered)
        if not after_m <= THRESHOLDS.clock_step_residual_ratio * before_m:
            continue
        text = (
            f"stamps jump by {step_s:.2f} s at {time_s[last]:.1f} s; without the jump dead reckoning fits the "
            f"fixes within {after_m:.2g} m, not {before_m:.2g} m, so its clock was set forward: state "
            f"clock_step_s = {step_s:.2f} under [{sensor}]"
        )
        found.append(log.finding("CLOCK-STEP", sensor, text, float(time_s[last]), step_s, "s"))
    return found


def sensor_clock_error(log: Log, timeline: Timeline, result: InterpretationResult) -> tuple[SingleError, float] | None:
    """Return the clock of DVL or compass that explains the fixes best if it is off, and the RMS that is left, metres.

    GPS time beside UTC is off by more than want of synchronisation, and bends dead reckoning in each turn or change of
    speed. None if no clock fits clearly better; a deviation or a lost bottom lock may fit better still.
    """
    most_m, limits = THRESHOLDS.clearly_better_ratio * result.interpretations[0].residual_m, THRESHOLDS
    if most_m < white_noise_m(timeline):
        return None
    group = segment_numbers(timeline, timeline.fix_time_s)

    def best(tried: Iterable[tuple[str, float]]) -> tuple[float, str, float]:
        lines = ((sensor, late_s, freed(timeline, {f"{sensor}_clock": late_s})) for sensor, late_s in tried)
        return min(
            (fit_rotation(reinterpret(log, line, AS_READ), group, [0.0]).rms_m, sensor, late_s)
            for sensor, late_s, line in lines
        )

    tried_s = np.arange(-limits.max_clock_offset_s, limits.max_clock_offset_s + 1, limits.clock_offset_step_s).tolist()
    far_s = [late_s for late_s in tried_s if abs(late_s) > limits.min_clock_offset_s]
    _, sensor, about_s = best(product(("dvl", "compass"), far_s))
    near_s = np.arange(-limits.clock_offset_step_s, limits.clock_offset_step_s, float(np.diff(timeline.time_s[:2])[0]))
    rms_m, _, late_s = best((sensor, about_s + float(s)) for s in near_s)
    if rms_m > most_m:
        return None
    stated_s = (log.settings.dvl if sensor == "dvl" else log.settings.compass).latency_s
    what = f"its stamps are {abs(late_s):.1f} s {'late' if late_s > 0 else 'early'} against the other sensors"
    advice = f"state latency_s = {stated_s + late_s:.1f} under [{sensor}]"
    line = freed(timeline, {f"{sensor}_clock": late_s})
    return SingleError(f"{sensor.upper()}-CLOCK", sensor, what + _leap_text(late_s), advice, line, late_s), rms_m


def clock_by_evidence(
    log: Log, timeline: Timeline, result: InterpretationResult, found: Identification | None
) -> tuple[list[Finding], Explained, Timeline] | None:
    """Return the clock of DVL or compass that is far off, if the evidence for it is strong, and what is found then."""
    clock = sensor_clock_error(log, timeline, result) if found else None
    there = explained_by(log, clock[0].line, result) if clock else None
    if not (found and clock and there) or there.log_evidence - found.log_evidence < math.log(STRONG_ODDS):
        return None
    error, rms_m = clock
    return single_error_findings(log, result, [error], rms_m), there, error.line
