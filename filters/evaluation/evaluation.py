"""Judge a track against the truth: which times, which alignment, which errors. Metres, east and north.

Truth is interpolated linearly to the track's own times, never the other way round: a truth of 0.4 Hz would otherwise
pick 0.4 Hz of the track. Times outside the truth, or inside one of its longer gaps, are left out and counted.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import Alignment, constant_shift, fit_alignment
from usbldr.filters.evaluation.consistency import consistency, fix_updates, sensor_updates, truth_covariances, whiteness
from usbldr.filters.evaluation.error_report import WHOLE_LOG, ErrorReport, Matching, Window
from usbldr.filters.evaluation.metrics import (
    Travel,
    axis_errors,
    distance_travelled_m,
    heading_errors,
    health,
    horizontal_errors,
    relative_errors,
    surfacing_errors,
    surfacings,
    velocity_errors,
)
from usbldr.filters.evaluation.score_warnings import coverage_warnings, motion_text, refuse_apart, shift_text
from usbldr.filters.evaluation.time_offset import time_offset
from usbldr.filters.types import Array, Mask, Trajectory, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows, windows_text

LATE_FIRST_S = 5.0  # --align first joins two instants this far apart only with a warning


def evaluate(
    trajectory: Trajectory,
    truth: Truth,
    window: Window = WHOLE_LOG,
    align: str = "auto",
    times_s: Vector | None = None,
    aid: tuple[TimeWindow, ...] = (),
) -> ErrorReport:
    """Score a track at those of its epochs that ``times_s`` names (None: all of them).

    A filter or dr is scored on the slow grid, ``timeline.time_s[timeline.slow]``; raw fixes each at its own stamp. The
    window chooses truth rows; what is scored lies between the first and the last row left, and outside the windows
    ``aid`` in which GPS aided the filter. The alignment ``auto`` is a shift if the place of the truth is unknown, else
    none. Raise LogError where nothing is left to score.
    """
    if align == "auto":
        align = "shift" if truth.place_unknown else "none"
    t, track_m, yaw = trajectory.time_s, trajectory.position_m, trajectory.state("psi")
    matched = match(trajectory, truth, window, times_s, aid)
    scored, time_s = matched.scored, t[matched.scored]
    truth_m, truth_sd_m = matched.truth_at(time_s)
    truth_cov_m2 = truth_covariances(truth, truth_m, truth_sd_m, matched.row_m[matched.first_row])
    alignment = _aligned(align, trajectory, truth, matched, truth_m)
    estimate_m = alignment.points(track_m[scored], None if yaw is None else yaw[scored])
    error_m = estimate_m - truth_m
    unaligned = align in ("none", "body") and not truth.place_unknown
    if unaligned:
        refuse_apart(estimate_m, truth_m, f"{trajectory.label} and the truth {truth.source}")
    cov = trajectory.position_cov_m2
    cov_m2 = None if cov is None else alignment.covariances(cov[scored])

    travelled_m = distance_travelled_m(trajectory)
    found = surfacings(t, alignment.points(track_m, yaw), travelled_m, truth, *window)
    found = tuple(one for one in found if not in_windows(np.array([one.time_s]), aid)[0])
    horizontal = horizontal_errors(error_m)
    errors_cov_m2 = None if cov_m2 is None else cov_m2 + truth_cov_m2
    compared = None if errors_cov_m2 is None else consistency(error_m, errors_cov_m2)
    nees, sigma_shares = compared or (None, None)
    shift = constant_shift(error_m, errors_cov_m2)
    warnings = coverage_warnings(matched.counts, truth)
    if unaligned and shift.dominates:
        warnings += (shift_text(shift, error_m, time_s, truth_m),)
    judged_truth = replace(truth, time_s=matched.row_s, position_m=matched.row_m)
    offset = time_offset(time_s, estimate_m, judged_truth)
    clock_share = 1.0
    if offset is not None and offset.notable:
        clock_share = (offset.corrected_m / offset.rms_m) ** 2
        warnings += (offset.sentence(judged_truth, by_fixes=bool(trajectory.updates)),)
    elif text := motion_text(shift, time_s, estimate_m, truth_m):
        warnings += (text,)
    return ErrorReport(
        method=trajectory.method,
        label=trajectory.label,
        truth_kind=truth.kind,
        truth_source=truth.source,
        window=window,
        alignment=alignment,
        matching=matched.counts,
        time_s=time_s,
        estimate_m=estimate_m,
        truth_m=truth_m,
        truth_cov_m2=truth_cov_m2,
        cov_m2=cov_m2,
        surfacings=found,
        aid=aid,
        east=axis_errors(error_m[:, 0]),
        north=axis_errors(error_m[:, 1]),
        horizontal=horizontal,
        shift=shift,
        surfacing=surfacing_errors(found),
        travel=_travel(trajectory, travelled_m, matched, align, horizontal.final_m),
        heading=heading_errors(trajectory, scored, truth, alignment.rotation_rad),
        velocity=velocity_errors(trajectory, scored, truth),
        nees=nees,
        sigma_shares=sigma_shares,
        fixes=fix_updates(trajectory),
        whiteness=whiteness(trajectory),
        health=health(trajectory),
        sensors=sensor_updates(trajectory),
        warnings=warnings + _point_warnings(trajectory, truth, matched, align),
        relative=relative_errors(time_s, error_m, truth_m, truth.max_gap_s),
        place_unknown=truth.place_unknown,
        clock_share=clock_share,
    )


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


def _aligned(name: str, trajectory: Trajectory, truth: Truth, matched: Matched, truth_m: Array) -> Alignment:
    """Return the alignment of that name, after the track was moved to the point of the truth on the vehicle."""
    yaw = trajectory.state("psi")
    own = Alignment(lever_m=truth.lever_m[:2])  # from the reference point to that of the truth
    moved_m, scored = own.points(trajectory.position_m, yaw), matched.scored
    scored_yaw = None if yaw is None else yaw[scored]
    alignment = fit_alignment(
        name, moved_m[matched.first], matched.row_m[matched.first_row], moved_m[scored], truth_m, scored_yaw
    )
    return alignment if yaw is None else alignment.after(own)


def _travel(
    trajectory: Trajectory, travelled_m: Vector | None, matched: Matched, align: str, final_m: float
) -> Travel | None:
    """Return the distance over which the error has grown: since the track's start, or since the alignment."""
    if travelled_m is None:
        return None
    defined = np.isfinite(trajectory.position_m).all(axis=1)
    start = matched.first if align != "none" else int(np.flatnonzero(defined)[0])
    distance_m = float(travelled_m[np.flatnonzero(matched.scored)[-1]] - travelled_m[start])
    drifts = trajectory.method == "dr" and distance_m > 0
    return Travel(distance_m, 100 * final_m / distance_m if drifts else None)


def _point_warnings(trajectory: Trajectory, truth: Truth, matched: Matched, align: str) -> tuple[str, ...]:
    """Say what keeps a track from the point of the vehicle that the truth is of, or from a common instant."""
    found: tuple[str, ...] = ()
    if trajectory.state("psi") is None and any(truth.lever_m[:2]):
        found += ("raw fixes have no heading, so the lever arm of the truth is not taken off their errors",)
    first_s = trajectory.time_s[matched.first]
    late_s = first_s - matched.row_s[matched.first_row]
    if align == "first" and late_s > LATE_FIRST_S:
        found += (
            f"--align first put the track's first epoch, {first_s:.1f} s, on a truth row {late_s:.1f} s "
            "earlier: choose a --start at which both exist",
        )
    return found


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
