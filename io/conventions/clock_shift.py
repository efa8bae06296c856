"""Sensors that stamp by another clock than the log's: one that counts from power-on, or was never set.

Stamps that all run on one clock, whichever, fit each other and stay. Where clocks disagree by more than half an hour,
stamps are moved to log time: all of one clock by the same amount, so that their spacing stays, and by the least delay
from stamp to log seen, so that no record is stamped much before it was taken. Integer nanoseconds.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from usbldr.io.findings import Finding
from usbldr.io.messages.layouts import RawRecords

SAME_CLOCK_NS = 1800 * 1_000_000_000  # time zones are whole hours apart, or half ones
LEAST = 0.01  # [1] the share of records that may seem to have arrived even sooner


def align_clocks(raws: Mapping[str, RawRecords], by_log: frozenset[str]) -> tuple[dict[str, RawRecords], list[Finding]]:
    """Return the raws on one clock, and what was moved; roles in ``by_log`` are timed without stamps."""
    delay_ns = {role: 0 if role in by_log else least_delay_ns(raw) for role, raw in raws.items()}
    if not delay_ns or max(delay_ns.values()) - min(delay_ns.values()) <= SAME_CLOCK_NS:
        return dict(raws), []
    moved: dict[str, RawRecords] = {}
    findings: list[Finding] = []
    for role, raw in raws.items():
        own = [ns for ns in delay_ns.values() if abs(ns - delay_ns[role]) <= SAME_CLOCK_NS]
        shift = min(own)
        if raw.stamp_ns is None or abs(delay_ns[role]) <= SAME_CLOCK_NS:
            moved[role] = raw
            continue
        moved[role] = replace(raw, stamp_ns=np.where(raw.stamp_ns == 0, 0, raw.stamp_ns + shift))
        text = (
            f"{raw.topic.name}: its stamps are of another clock than the log's and other sensors'; "
            f"moved by {shift / 1e9:.3f} s, the least delay from stamp to log"
        )
        findings.append(Finding("CLOCK-SHIFTED", text, raw.topic.name))
    return moved, findings


def least_delay_ns(raw: RawRecords) -> int:
    """Return log time minus stamp where it is least, but for a few; 0 without stamps."""
    if raw.stamp_ns is None or raw.topic.type.startswith("usbldr/"):  # columns of times are no clock's
        return 0
    delays = (raw.received_ns - raw.stamp_ns)[raw.stamp_ns != 0]
    return int(np.sort(delays)[int(LEAST * len(delays))]) if len(delays) else 0
