"""Which of a track's times can be judged by the truth, and the truth at these times."""

from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.error_report import Matching, Window
from usbldr.filters.types import Array, Mask, Trajectory, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows, windows_text


class Matched(NamedTuple):
    """The scored times of a track, with the rows of the truth that the window chooses."""

    scored: Mask  # (T,) of the track's epochs
    first: int  # the first epoch within the truth
    row_s: Vector  # (R,)
    row_m: Array  # (R, 2)
    row_sd_m: Vector  # (R,)
    first_row: int  # that no window of aid holds
    counts: Matching

    def truth_at(self, time_s: Vector) -> tuple[Array, Vector]:
        """Return east and north of the truth at these times, (M, 2), and its sigma, (M,); unknown sigmas are 0."""
        east, north, sd = (np.interp(time_s, self.row_s, column) for column in (*self.row_m.T, self.row_sd_m))
        return np.column_stack([east, north]), np.nan_to_num(sd)


def match(
    trajectory: Trajectory, truth: Truth, window: Window, times_s: Vector | None, aid: tuple[TimeWindow, ...]
) -> Matched:
    """Find the times that can be scored (see `evaluate`); raise LogError, with the causes, if there are none."""
    rows = (truth.time_s >= window.start_s) & (truth.time_s <= window.end_s)
    if not np.any(rows):
        raise LogError(
            f"{truth.source}: no truth row between {window.start_s:g} and {window.end_s:g} s of the log "
            f"({len(truth.time_s)} rows, {_span(truth.time_s)}): choose other --start and --end, or check its clock"
        )
    t, row_s = trajectory.time_s, truth.time_s[rows]
    defined = np.all(np.isfinite(trajectory.position_m[:, :2]), axis=1)
    wanted = np.ones(len(t), np.bool_) if times_s is None else _same_times(t, times_s)
    within = (t >= row_s[0]) & (t <= row_s[-1])
    gap = _inside_gap(t, row_s, truth.max_gap_s)
    aided = in_windows(t, aid)
    scored = wanted & within & ~gap & defined & ~aided
    if np.any(aided) and not np.any(scored):
        raise LogError(
            f"{trajectory.label}: all of its epochs that the truth {truth.source} could judge lie in the windows that "
            f"GPS aids ({windows_text(aid)}): leave some of the log out of them"
        )
    if not np.any(scored):
        raise LogError(
            f"{trajectory.label}: none of its epochs ({_span(t[wanted & defined])}) can be compared with the truth "
            f"{truth.source} ({_span(row_s)}, gaps over {truth.max_gap_s:g} s left out): check the two clocks "
            "(latency_s, clock_offset_s), --start and --end"
        )
    beyond = (t < window.start_s) | (t > window.end_s)
    candidates = len(t) if times_s is None else len(times_s)
    counts = Matching(
        candidates=candidates,
        matched=_count(scored),
        outside_window=_count(wanted & beyond),
        outside_truth=_count(wanted & ~beyond & ~within),
        in_gap=_count(wanted & within & gap & ~aided),
        aided=_count(wanted & within & aided),
        undefined=_count(wanted & within & ~gap & ~defined & ~aided) + candidates - _count(wanted),
        truth_rows=_rows_used(t[scored], row_s),
    )
    first = int(np.flatnonzero(within & defined & ~aided)[0])
    first_row = int(np.argmin(in_windows(row_s, aid)))
    return Matched(scored, first, row_s, truth.position_m[rows], truth.sd_m[rows], first_row, counts)


def _count(mask: Mask) -> int:
    return int(np.count_nonzero(mask))


def _span(time_s: Vector) -> str:
    return f"{time_s[0]:.1f} to {time_s[-1]:.1f} s" if len(time_s) else "none at all"


def _same_times(track_s: Vector, wanted_s: Vector) -> Mask:
    """Return which of the track's times are wanted; grids agree to a microsecond."""
    return np.isin(np.round(track_s * 1e6), np.round(wanted_s * 1e6))


def _inside_gap(time_s: Vector, row_s: Vector, longest_s: float) -> Mask:
    """Return which times lie strictly between two truth rows further apart than ``longest_s``."""
    before = np.clip(np.searchsorted(row_s, time_s, side="right") - 1, 0, len(row_s) - 1)
    after = np.clip(np.searchsorted(row_s, time_s, side="left"), 0, len(row_s) - 1)
    return row_s[after] - row_s[before] > longest_s


def _rows_used(time_s: Vector, row_s: Vector) -> int:
    before = np.searchsorted(row_s, time_s, side="right") - 1
    after = np.searchsorted(row_s, time_s, side="left")
    return len(np.unique(np.concatenate([before, after])))
