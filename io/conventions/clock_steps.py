"""Clocks that go back within a log, found in the order of the file, before anything is sorted. Integer nanoseconds.

So is a lasting step forward by more than any log lasts (a clock that counted from its start until it was set), or
of all sensors by more than this log lasts (clock_parts.py). A lasting step back is that of a computer that started
again, or whose clock was set; of a counter that is full and begins again it is put right. Single wrong times are
counted.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Indices, Mask
from usbldr.io.reader import Nanoseconds

SECOND = 1_000_000_000  # fixed: nanoseconds
STEP_NS = SECOND  # a smaller step back is the order in which a recorder writes
LONGEST_LOG_NS = 30 * 86_400 * SECOND  # a longer span means a wrong stamp, and its epochs would fill the memory
LASTING = 10  # [records] before and after a step: fewer are single wrong times
USUAL_OF = 100_000  # [records] whose median interval is the usual one
BINARY_NS = ((2**32 * 1_000, "32-bit counter of microseconds"), (2**32 * 1_000_000, "32-bit counter of milliseconds"))
NARROW_NS = (
    (2**16 * 1_000_000, "16-bit counter of milliseconds"),
    (2**24 * 1_000, "24-bit counter of microseconds"),
    (2**24 * 1_000_000, "24-bit counter of milliseconds"),
)
"""Counters that a clock which was set might seem to be: they are one if they are never fuller, and twice full."""
DAY, WEEK = 86_400 * SECOND, 604_800 * SECOND  # fixed
FIRST_WEEK = 315_964_800 * SECOND  # fixed: 1980-01-06, when GPS weeks began
LEAP_NS = 30 * SECOND  # [ns] more than GPS time was ever ahead of UTC
CALENDAR_NS = (
    (DAY, 0, "count of seconds of the day"),
    (WEEK, 0, "count of seconds of the week"),
    (WEEK, FIRST_WEEK, "count of seconds of the week"),
)


class ClockStep(NamedTuple):
    """A place at which a clock goes back, or far forward."""

    row: int  # the first record after it
    before_ns: int
    after_ns: int
    usual_ns: int  # interval of the records

    @property
    def size_ns(self) -> int:
        """By how much the clock was set back; negative: forward."""
        return self.before_ns + self.usual_ns - self.after_ns


class Wrap(NamedTuple):
    """A place at which a counter was full and began again."""

    name: str  # of the counter
    width_ns: int
    before_ns: int


class Examined(NamedTuple):
    """Times (n,) in the order of the file, wraps put right, and what was found in them."""

    times_ns: Nanoseconds
    steps: list[ClockStep]
    single: int  # records that are before the one in front of them by more than STEP_NS, without a step
    wraps: list[Wrap]


def examined(
    times_ns: Nanoseconds,
    groups: Sequence[Indices] | None = None,
    known: Collection[Wrap] = (),
    longest_ns: int = LONGEST_LOG_NS,
) -> Examined:
    """Examine times in the order of the file; those of ``groups`` of records each by itself.

    ``known`` are wraps of the log's other sensors, which a gap may hide; a step forward is longer than ``longest_ns``.
    """
    if groups is not None and len(groups) > 1:
        whole = times_ns.copy()
        parts = [(rows, examined(times_ns[rows], None, known, longest_ns)) for rows in groups]
        for rows, part in parts:
            whole[rows] = part.times_ns
        most = max(len(part.steps) for _, part in parts)  # of one clock: the groups have the same steps
        each = [(rows, part.steps) for rows, part in parts if len(part.steps) == most]
        in_file = [[step._replace(row=int(rows[step.row])) for step in steps] for rows, steps in each]
        steps = [min(same) for same in zip(*in_file, strict=True)]
        wraps = max((part.wraps for _, part in parts), key=len)
        return Examined(whole, steps, sum(part.single for _, part in parts), wraps)
    rows, ahead = _backward(times_ns), _far_forward(times_ns, longest_ns)
    if not (len(rows) or len(ahead)) or np.all(times_ns[1:] <= times_ns[:-1]):  # a table whose newest row is the first
        return Examined(times_ns, [], 0, [])
    intervals = np.diff(times_ns[:USUAL_OF])
    usual_ns = int(np.median(intervals[intervals > 0])) if np.any(intervals > 0) else 0
    times_ns, wraps = _without_wraps(times_ns, rows, usual_ns, known)
    rows = _backward(times_ns)
    lasting = _lasting(times_ns, rows, usual_ns)
    places = np.sort(np.concatenate([rows[lasting], _far_forward(times_ns, longest_ns)]))
    steps = [ClockStep(row, int(times_ns[row - 1]), int(times_ns[row]), usual_ns) for row in places.tolist()]
    return Examined(times_ns, steps, int(np.sum(~lasting)), wraps)


def _backward(times_ns: Nanoseconds) -> Indices:
    rows = np.flatnonzero(times_ns[1:] < times_ns[:-1]) + 1  # no copy of the times of a dense log
    return rows[times_ns[rows] < times_ns[rows - 1] - STEP_NS]


def _far_forward(times_ns: Nanoseconds, longest_ns: int) -> Indices:
    """Return the first rows behind lasting steps forward that are longer."""
    if not len(times_ns) or times_ns.max() - times_ns.min() <= longest_ns:
        return np.empty(0, dtype=np.intp)
    rows = np.flatnonzero(np.diff(times_ns) > longest_ns) + 1
    rows = rows[(rows >= LASTING) & (rows + LASTING <= len(times_ns))]
    ahead = np.arange(LASTING)
    before, behind = times_ns[rows[:, np.newaxis] - 1 - ahead], times_ns[rows[:, np.newaxis] + ahead]
    return rows[np.min(behind, axis=1) > np.max(before, axis=1) + longest_ns]


def _without_wraps(
    times_ns: Nanoseconds, rows: Indices, usual_ns: int, known: Collection[Wrap]
) -> tuple[Nanoseconds, list[Wrap]]:
    """Add the width of a counter behind each place (its first row) at which it began again."""
    near_ns = max(LASTING * usual_ns, STEP_NS)
    sizes_ns = times_ns[rows - 1] - times_ns[rows]
    narrow = [one for one in NARROW_NS if len(rows) > 1 and times_ns.min(initial=0) >= 0 and times_ns.max() < one[0]]
    narrow = [one for one in narrow if np.all((one[0] - sizes_ns >= 0) & (one[0] - sizes_ns <= near_ns))]
    wraps: list[Wrap] = []
    added = np.zeros(len(times_ns), dtype=np.int64)
    for row in rows.tolist():
        before, after = int(times_ns[row - 1]), int(times_ns[row])
        full = [(width, name) for width, name in (*BINARY_NS, *narrow) if 0 <= after + width - before <= near_ns]
        full += [
            (width, name)
            for width, phase, name in CALENDAR_NS
            if 0 <= after + width - before <= near_ns and (after - phase) % width <= near_ns + LEAP_NS * (phase != 0)
        ]
        full += [
            (wrap.width_ns, wrap.name)
            for wrap in known
            if before <= wrap.before_ns <= after + wrap.width_ns and before - after > wrap.width_ns // 2
        ]
        if full:
            width, name = full[0]
            added[row:] += width
            wraps.append(Wrap(name, width, before))
    return (times_ns + added if wraps else times_ns), wraps


def _lasting(times_ns: Nanoseconds, rows: Indices, usual_ns: int) -> Mask:
    """Return behind which rows all records are earlier than all those in front of them let expect."""
    lasting = (rows >= LASTING) & (rows + LASTING <= len(times_ns))
    ahead = np.arange(LASTING)
    some = rows[lasting, np.newaxis]
    expected = np.min(times_ns[some - 1 - ahead] + (ahead + 1) * usual_ns, axis=1)
    found = np.max(times_ns[some + ahead] - ahead * usual_ns, axis=1)
    lasting[lasting] = found < expected - STEP_NS
    return lasting
