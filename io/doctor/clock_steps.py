"""A clock that was set forward within the log: from then on the stamps of one sensor are late.

Its stamps have a gap as long as the step, as an outage has. Dead reckoning distinguishes the two: with the step taken
off, it fits the fixes better, and after an outage far worse. Uses no truth.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.identification.dr_usbl_fit import fit_rotation, segment_numbers
from usbldr.filters.types import Timeline
from usbldr.io.doctor.interpretations import reinterpret, topic_of
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline as timeline_of

MIN_RECORDS = 3  # fixed: with fewer no interval is usual


def clock_step_findings(log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> list[Finding]:
    """Return a finding for each sensor whose longest gap is a step of its clock, under one of some interpretations."""
    settings, before_m, found = log.settings, _rms_m(log, timeline, flips), list[Finding]()
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
            after_m = _rms_m(log, undone, flips)
        except LogError:
            continue
        if after_m > THRESHOLDS.clock_step_residual_ratio * before_m:
            continue
        topic = topic_of(log, sensor)
        text = (
            f"{topic}: stamps jump by {step_s:.2f} s at {time_s[last]:.1f} s; without the jump dead reckoning fits the "
            f"fixes within {after_m:.2g} m, not {before_m:.2g} m, so its clock was set forward: state "
            f"clock_step_s = {step_s:.2f} under [{sensor}]"
        )
        found.append(Finding("CLOCK-STEP", text, topic, float(time_s[last]), step_s, "s"))
    return found


def _rms_m(log: Log, timeline: Timeline, flips: Collection[tuple[bool, bool, bool]]) -> float:
    """Return what is left between dead reckoning, turned and shifted, and the fixes; infinite if nothing is."""
    group = segment_numbers(timeline, timeline.fix_time_s)
    if not np.any(group >= 0):
        return np.inf
    return min(fit_rotation(reinterpret(log, timeline, each), group).rms_m for each in flips)
