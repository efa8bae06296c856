"""Pauses that all sensors of a log share: two recordings in one log, or a clock that was set forward.

Integer nanoseconds.
"""

from collections.abc import Mapping

import numpy as np

from usbldr.filters.types import Indices
from usbldr.io.conventions.clock_steps import LONGEST_LOG_NS, SECOND
from usbldr.io.findings import Finding
from usbldr.io.messages.layouts import blocks
from usbldr.io.messages.roles import SENSORS
from usbldr.io.reader import Nanoseconds, utc

MIN_PAUSE_NS = 1800 * SECOND  # [ns] a clock that is set to another time zone moves by half an hour or more


def shared_pauses(times_ns: Mapping[str, Nanoseconds]) -> tuple[list[Finding], int]:
    """Report where no sensor has a record for MIN_PAUSE_NS, and return which of it divides the log: what is longer.

    That is the length of the log without the longest pauses, if each is longer than that; else LONGEST_LOG_NS.
    DVL, compass and USBL have records before and behind a pause. ``times_ns``: by role, in the order of the file.
    """
    stretches = {role: _stretches(times) for role, times in times_ns.items() if len(times)}
    if not stretches:
        return [], LONGEST_LOG_NS
    every = np.concatenate(list(stretches.values()))
    first, last = every[np.argsort(every[:, 0])].T
    last = np.maximum.accumulate(last)
    pauses = [(int(last[k]), int(first[k + 1])) for k in np.flatnonzero(first[1:] - last[:-1] > MIN_PAUSE_NS)]
    both = [part for role, part in stretches.items() if role in SENSORS]
    shared = [(before, after) for before, after in pauses if all(s.min() <= before and s.max() >= after for s in both)]
    lengths = np.sort([after - before for before, after in shared])[::-1]
    recorded = last[-1] - first[0] - np.cumsum(lengths)
    longest_ns = int(min(recorded[lengths > recorded], default=LONGEST_LOG_NS))
    return [_finding(before, after - before) for before, after in shared if after - before <= longest_ns], longest_ns


def _finding(before_ns: int, length_ns: int) -> Finding:
    text = f"all sensors pause for {length_ns / SECOND:.0f} s together after {utc(before_ns)}"
    text += ": two recordings, or a clock that was set forward"
    return Finding("PAUSE", f"{text}; score one side with --start or --end, or undo a step with clock_step_s")


def _stretches(times_ns: Nanoseconds) -> Indices:
    """Return the first and last times (k, 2) of the stretches between steps forward by MIN_PAUSE_NS."""
    steps = [
        rows.start + 1 + np.flatnonzero(np.diff(times_ns[rows.start : rows.stop + 1]) > MIN_PAUSE_NS)
        for rows in blocks(len(times_ns))
    ]
    begins = np.concatenate([[0], *steps])
    return np.column_stack([np.minimum.reduceat(times_ns, begins), np.maximum.reduceat(times_ns, begins)])
