"""What a sensor measured as it changes over time, at any other time: interpolated, but never across a gap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usbldr.filters.types import Array, Indices, Vector
from usbldr.io.conventions.converted import ConvertedTable
from usbldr.io.conventions.timestamps import sorted_by_time
from usbldr.io.messages.layouts import blocks
from usbldr.io.reader import Nanoseconds


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """Something measured over time: n records in ascending order, k numbers each."""

    time_ns: Nanoseconds  # (n,)
    values: Array  # (n, k)

    def at(self, time_ns: Nanoseconds, longest_gap_s: float = np.inf, held_s: float = 0.0) -> Array:
        """Return the values at the times, (m, k), NaN outside the records and inside gaps that are longer.

        The first and the last value hold for ``held_s`` before and after the records.
        """
        near = bracketing(self.time_ns, time_ns)
        own_s, wanted_s = (
            np.asarray(t - self.time_ns[0], dtype=np.float64) / 1e9 for t in (self.time_ns[near], time_ns)
        )
        within_s = np.clip(wanted_s, own_s[0], own_s[-1])
        wanted_s = np.where(np.abs(wanted_s - within_s) <= held_s, within_s, wanted_s)
        between = np.full((len(wanted_s), self.values.shape[1]), np.nan)
        for k, column in enumerate(self.values.T):
            between[:, k] = np.interp(wanted_s, own_s, column[near], left=np.nan, right=np.nan)
        first, last = (np.searchsorted(own_s, wanted_s, side=side) for side in ("left", "right"))
        gap_s = own_s[np.minimum(first, len(own_s) - 1)] - own_s[np.maximum(last - 1, 0)]  # 0 on a record
        return np.where(gap_s[:, None] > longest_gap_s, np.nan, between)


def time_series(made: ConvertedTable, sensor: str, columns: Sequence[str]) -> TimeSeries:
    """Return columns of a sensor's table as they change over time; headings run on past 360."""
    table, _ = sorted_by_time(made.table, "", sensor)
    values = np.column_stack([table[name].to_numpy(dtype=float) for name in columns])
    if columns[0] == "heading_deg":
        unwrap(values[:, 0], 360.0)
    return TimeSeries(table["time_ns"].to_numpy(dtype=np.int64), values)


def bracketing(known: Vector | Nanoseconds, wanted: Vector | Nanoseconds) -> Indices:
    """Return which of the known times (n,), ascending, are the last before or the first after a wanted one, or at it.

    Values at the wanted times can be interpolated from these alone; those of a dense sensor would need much memory.
    """
    after, before = np.searchsorted(known, wanted, side="left"), np.searchsorted(known, wanted, side="right") - 1
    return np.union1d(np.minimum(after, len(known) - 1), np.maximum(before, 0))


def unwrap(angle: Vector, turn: float) -> Vector:
    """Take jumps of whole turns out of angles (n,), in place, and return them.

    As numpy.unwrap does, to the bit, but block by block: numpy.unwrap needs seven times the memory of its result.
    """
    before, turns = angle[:1].copy(), 0.0
    for rows in blocks(len(angle)):
        step = np.diff(angle[rows], prepend=before)
        before = angle[rows][-1:].copy()
        short = np.mod(step + turn / 2, turn) - turn / 2
        short[(short == -turn / 2) & (step > 0)] = turn / 2
        added = np.where(np.abs(step) < turn / 2, 0.0, short - step)
        total = np.cumsum(np.concatenate([[turns], added]))[1:]
        angle[rows] += total
        turns = float(total[-1])
    return angle
