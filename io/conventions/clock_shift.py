"""Sensors whose stamps come from another clock than the log's: one that counts from power-on, or was never set.

Stamps of one clock are not changed. If clocks disagree by more than half an hour, stamps are shifted to log time: all
of one clock by the same amount, which keeps their spacing, and by the smallest delay from stamp to log, so that no
record is stamped much before it was measured. Integer nanoseconds.
"""

from collections.abc import Mapping

import numpy as np

from usbldr.io.findings import Finding
from usbldr.io.messages.layouts import RawRecords, blocks

SAME_CLOCK_NS = 1800 * 1_000_000_000  # time zones are whole hours apart, or half ones
LEAST = 0.01  # [1] share of records that may have smaller delays


def align_clocks(raws: Mapping[str, RawRecords], by_log: frozenset[str]) -> tuple[dict[str, RawRecords], list[Finding]]:
    """Return the raws on one clock, and what was shifted; roles in ``by_log`` are timed without stamps."""
    delay_ns = {role: 0 if role in by_log else least_delay_ns(raw) for role, raw in raws.items()}
    if not delay_ns or max(delay_ns.values()) - min(delay_ns.values()) <= SAME_CLOCK_NS:
        return dict(raws), []
    shifted, findings = dict(raws), list[Finding]()
    for role, raw in raws.items():
        if raw.stamp_ns is None or abs(delay_ns[role]) <= SAME_CLOCK_NS:
            continue
        shift_ns = min(ns for ns in delay_ns.values() if abs(ns - delay_ns[role]) <= SAME_CLOCK_NS)
        shifted[role] = raw.later_by(shift_ns)
        text = "stamps come from another clock than the log's and other sensors'; shifted by "
        text += f"{shift_ns / 1e9:.3f} s, the smallest delay from stamp to log"
        findings.append(raw.finding("CLOCK-SHIFTED", text))
    return shifted, findings


def least_delay_ns(raw: RawRecords) -> int:
    """Return the smallest delay from stamp to log, a few records apart; 0 without stamps."""
    if raw.stamp_ns is None or raw.topic.type.startswith("usbldr/"):  # a column of times, not a clock
        return 0
    known = raw.stamped
    rank = int(LEAST * np.count_nonzero(known))
    least = np.empty(0, dtype=np.int64)  # the smallest of the blocks so far, as many as decide
    for rows in blocks(len(known)):
        delays = (raw.received_ns[rows] - raw.stamp_ns[rows])[known[rows]]
        least = np.sort(np.concatenate([least, delays]))[: rank + 1]
    return int(least[rank]) if len(least) else 0
