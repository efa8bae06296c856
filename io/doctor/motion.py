"""Whether fixes move as dead reckoning does, and the truth as the fixes: a ship's sensor moves otherwise.

Movements are those within a minute, freed of the white noise of the fixes, which second differences show.
"""

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import Points, as_points, dead_reckoned, fix_points, segment_numbers
from usbldr.filters.types import Indices, Timeline, Vector
from usbldr.io.doctor.interpretations import InterpretationResult, reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log


def motion_findings(log: Log, timeline: Timeline, result: InterpretationResult) -> list[Finding]:
    """Report fixes that move unlike dead reckoning by its best interpretation, else a truth that moves unlike them."""
    latency_s = result.best.fit.latency_s
    line = reinterpret(log, timeline, result.best.flips)
    track = np.exp(1j * result.best.fit.rotation_rad) * dead_reckoned(line, line.fix_time_s - latency_s)
    group = segment_numbers(line, line.fix_time_s)
    unlike, median = (
        unexplained_share(line.fix_time_s, track, fix_points(line), group, share)
        for share in (THRESHOLDS.sound_share, 0.5)
    )
    if unlike > THRESHOLDS.unlike_share:
        text = (
            "the fixes move unlike dead reckoning, so that they decide nothing about conventions and sensor "
            "errors: name the topic of this vehicle's transponder (--usbl TOPIC), not the ship's end or another "
            "vehicle's; else check DVL and heading"
        )
        return [log.finding("USBL-MOTION", "usbl", text)]
    truth = log.truth
    if truth is None or len(truth.time_s) < 2 or median > THRESHOLDS.unlike_share:
        return []  # fixes and dead reckoning agree too little to judge a truth
    time_s = line.fix_time_s - latency_s
    after = np.searchsorted(truth.time_s, time_s).clip(1, len(truth.time_s) - 1)
    known = np.diff(truth.time_s)[after - 1] <= truth.max_gap_s
    known &= (time_s >= truth.time_s[0]) & (time_s <= truth.time_s[-1])
    there = np.interp(time_s, truth.time_s, as_points(truth.position_m))
    unlike = unexplained_share(time_s, there, track, np.where(known, group, -1), 0.5)
    if unlike <= THRESHOLDS.unlike_share:
        return []
    text = (
        f"{truth.source}: the truth moves unlike the fixes of {log.topic_of('usbl')} and dead reckoning, which agree: "
        "it is of another vehicle, such as the ship (then perhaps topic of head under [usbl]); name another by --truth "
        "or --gps"
    )
    return [Finding("TRUTH-MOTION", text, truth.source)]


def unexplained_share(time_s: Vector, one: Points, other: Points, group: Indices, quantile: float) -> float:
    """Return the share of the squared movement of two tracks in which they differ; 0 if there is too little to see.

    It is the quantile of all movements.
    """
    apart = one - other
    later = np.searchsorted(time_s, time_s + THRESHOLDS.displacement_s)
    first = np.flatnonzero(later < len(time_s))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < THRESHOLDS.min_displacements:
        return 0.0
    bends: Vector = np.abs(apart[1:-1] - (apart[:-2] + apart[2:]) / 2)[group[1:-1] >= 0]
    noise_m2 = 4 / 3 * float(np.median(bends)) ** 2  # of the difference of two fixes
    moved_m2 = np.maximum(*(np.abs(p[later[first]] - p[first]) ** 2 for p in (one, other)))
    changed_m2: Vector = np.abs(apart[later[first]] - apart[first]) ** 2
    if float(np.median(moved_m2)) <= THRESHOLDS.gross_sigmas**2 * noise_m2:
        return 0.0
    return float(np.quantile((changed_m2 - noise_m2) / np.maximum(moved_m2, 1e-9), quantile))
