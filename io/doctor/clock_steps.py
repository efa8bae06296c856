"""A clock that was set forward within the log: from then on the stamps of one sensor are late.

Its stamps have a gap as long as the step, as an outage has. Dead reckoning distinguishes the two: with the step taken
off, it fits the fixes better, and after an outage far worse. Fixes that the step moves out of its time are left as far
off as they scatter. Uses no truth.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.identification.dr_usbl_fit import fit_rotation, segment_numbers
from usbldr.filters.types import Array, Mask, Timeline
from usbldr.io.doctor.interpretations import reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline as timeline_of

MIN_RECORDS = 3  # fixed: with fewer no interval is usual


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
    """Return a finding for each sensor whose longest gap is a step of its clock, under one of some interpretations."""
    settings, before, found = log.settings, _Fit.of(log, timeline, flips), list[Finding]()
    for sensor, section in (("dvl", settings.dvl), ("compass", settings.compass), ("usbl", settings.usbl)):
        time_s = log.tables[sensor]["time_s"].to_numpy()
        if len(time_s) < MIN_RECORDS:
            continue
        gaps_s = np.diff(time_s)
        last = int(np.argmax(gaps_s))
        step_s = float(gaps_s[last] - np.median(gaps_s))
        if step_s < THRESHOLDS.min_clock_offset_s or section.clock_step_s:
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
