"""Judge a track against the truth: which times, which alignment, which errors. Metres, east and north.

Truth is interpolated linearly to the track's own times, never the other way round: a truth of 0.4 Hz would otherwise
pick 0.4 Hz of the track. Times outside the truth, or inside one of its longer gaps, are left out and counted.
"""

from dataclasses import replace

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import Alignment, fit_alignment
from usbldr.filters.evaluation.consistency import consistency, fix_updates, sensor_updates, truth_covariances
from usbldr.filters.evaluation.constant_shift import ConstantShift, constant_shift, moves_otherwise
from usbldr.filters.evaluation.error_report import WHOLE_LOG, ErrorReport, Matching, Window
from usbldr.filters.evaluation.metrics import (
    Travel,
    axis_errors,
    distance_travelled_m,
    health,
    horizontal_errors,
    surfacing_errors,
    surfacings,
)
from usbldr.filters.evaluation.motion_errors import heading_errors, velocity_errors
from usbldr.filters.evaluation.relative_error import relative_errors
from usbldr.filters.evaluation.time_offset import time_offset
from usbldr.filters.evaluation.whiteness import whiteness
from usbldr.filters.types import Array, Mask, Trajectory, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows, windows_text

FEW_EPOCHS = 5  # with fewer, mean and RMS say next to nothing
APART_EXTENTS = 10.0  # times the larger extent of track and truth: a lever arm or an origin nearby explains less
LEAST_EXTENT_M = 100.0  # [m] of a vehicle at rest: a map's origin may be off by a kilometre and still be of this dive
ALONG_RAD = np.radians(15.0)  # [rad] a shift that near to the course may be a time: a lever arm points anywhere
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
    rows = (truth.time_s >= window.start_s) & (truth.time_s <= window.end_s)
    if not np.any(rows):
        raise LogError(
            f"{truth.source}: no truth row between {window.start_s:g} and {window.end_s:g} s of the log "
            f"({len(truth.time_s)} rows, {_span(truth.time_s)}): choose other --start and --end, or check its clock"
        )
    row_s, row_m = truth.time_s[rows], truth.position_m[rows]

    t, track_m = trajectory.time_s, trajectory.position_m
    defined = np.isfinite(track_m[:, 0]) & np.isfinite(track_m[:, 1])
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
    matching = Matching(
        candidates=candidates,
        matched=_count(scored),
        outside_window=_count(wanted & beyond),
        outside_truth=_count(wanted & ~beyond & ~within),
        in_gap=_count(wanted & within & gap & ~aided),
        aided=_count(wanted & within & aided),
        undefined=_count(wanted & within & ~gap & ~defined & ~aided) + candidates - _count(wanted),
        truth_rows=_rows_used(t[scored], row_s),
    )

    time_s = t[scored]
    truth_m = np.column_stack([np.interp(time_s, row_s, row_m[:, 0]), np.interp(time_s, row_s, row_m[:, 1])])
    first = int(np.flatnonzero(within & defined & ~aided)[0])
    first_row = int(np.argmin(in_windows(row_s, aid)))
    yaw = trajectory.state("psi")
    scored_yaw = None if yaw is None else yaw[scored]
    own = Alignment(lever_m=truth.lever_m[:2])  # from the reference point to that of the truth
    moved_m = own.points(track_m, yaw)
    alignment = fit_alignment(align, moved_m[first], row_m[first_row], moved_m[scored], truth_m, scored_yaw)
    if yaw is not None:
        alignment = alignment.after(own)
    estimate_m = alignment.points(track_m[scored], scored_yaw)
    error_m = estimate_m - truth_m
    truth_sd_m = np.nan_to_num(np.interp(time_s, row_s, truth.sd_m[rows]))
    truth_cov_m2 = truth_covariances(truth, truth_m, truth_sd_m, row_m[first_row])
    if align in ("none", "body") and not truth.place_unknown:
        _refuse_apart(estimate_m, truth_m, f"{trajectory.label} and the truth {truth.source}")
    cov = trajectory.position_cov_m2
    cov_m2 = None if cov is None else alignment.covariances(cov[scored])

    travelled_m = distance_travelled_m(trajectory)
    found = surfacings(t, alignment.points(track_m, yaw), travelled_m, truth, *window)
    found = tuple(one for one in found if not in_windows(np.array([one.time_s]), aid)[0])
    horizontal, travel = horizontal_errors(error_m), None
    if travelled_m is not None:
        # unaligned, the error has grown since the track's start; aligned, since the alignment
        start = first if align != "none" else int(np.flatnonzero(defined)[0])
        distance_m = float(travelled_m[np.flatnonzero(scored)[-1]] - travelled_m[start])
        drifts = trajectory.method == "dr" and distance_m > 0
        travel = Travel(distance_m, 100 * horizontal.final_m / distance_m if drifts else None)
    errors_cov_m2 = None if cov_m2 is None else cov_m2 + truth_cov_m2
    compared = None if errors_cov_m2 is None else consistency(error_m, errors_cov_m2)
    nees, sigma_shares = compared or (None, None)
    shift = constant_shift(error_m, errors_cov_m2)

    warnings = _warnings(matching, truth)
    if align in ("none", "body") and shift.dominates and not truth.place_unknown:
        warnings += (_shift_text(shift, error_m, time_s, truth_m),)
    judged_truth = replace(truth, time_s=row_s, position_m=row_m)
    if (offset := time_offset(time_s, estimate_m, judged_truth)) is not None and offset.notable:
        section = "gps" if truth.kind == "gps" else "truth"
        warnings += (offset.sentence(truth.source, section, by_fixes=bool(trajectory.updates)),)
    elif moves_otherwise(shift, time_s, error_m, truth_m):
        warnings += (
            "track and truth move differently: the track explains less than half of how the truth moves in a minute, "
            f"and without a constant shift they are {shift.rmse_m:.1f} m (RMS) apart, far more than the sigmas allow; "
            "check that the truth is of this vehicle (not of a ship), and the conventions of the sensors with usbldr "
            "doctor",
        )
    if yaw is None and any(truth.lever_m[:2]):
        warnings += ("raw fixes have no heading, so the lever arm of the truth is not taken off their errors",)
    if align == "first" and t[first] - row_s[first_row] > LATE_FIRST_S:
        late_s = t[first] - row_s[first_row]
        warnings += (
            f"--align first put the track's first epoch, {t[first]:.1f} s, on a truth row {late_s:.1f} s "
            "earlier: choose a --start at which both exist",
        )
    return ErrorReport(
        method=trajectory.method,
        label=trajectory.label,
        truth_kind=truth.kind,
        truth_source=truth.source,
        window=window,
        alignment=alignment,
        matching=matching,
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
        travel=travel,
        heading=heading_errors(trajectory, scored, truth, alignment.rotation_rad),
        velocity=velocity_errors(trajectory, scored, truth),
        nees=nees,
        sigma_shares=sigma_shares,
        fixes=fix_updates(trajectory),
        whiteness=whiteness(trajectory),
        health=health(trajectory),
        sensors=sensor_updates(trajectory),
        warnings=warnings,
        relative=relative_errors(time_s, error_m, truth_m, truth.max_gap_s),
        place_unknown=truth.place_unknown,
    )


def _refuse_apart(estimate_m: Array, truth_m: Array, names: str) -> None:
    """Raise LogError if a track and the truth are so far apart that one of them must be of another place."""
    apart_m = float(np.hypot(*(estimate_m.mean(axis=0) - truth_m.mean(axis=0))))
    extent_m = max(float(np.hypot(*np.ptp(points_m, axis=0))) for points_m in (estimate_m, truth_m))
    if apart_m > APART_EXTENTS * max(extent_m, LEAST_EXTENT_M):
        raise LogError(
            f"{names} are {apart_m:,.0f} m apart, and neither extends over more than {extent_m:,.0f} m, so that errors "
            "would say nothing: check whether latitude and longitude are exchanged in the truth, in the fixes or under "
            "[map], and that both are of this dive; --align shift takes a constant shift off"
        )


def _warnings(matching: Matching, truth: Truth) -> tuple[str, ...]:
    """Say a low coverage, unless the user chose it by the window, and a track that broke off."""
    found: list[str] = []
    if matching.low:
        outside = f"{matching.outside_truth} lie before or after it" if matching.outside_truth else ""
        gaps = f"{matching.in_gap} in its gaps over {truth.max_gap_s:g} s" if matching.in_gap else ""
        why = ", ".join(filter(None, (outside, gaps)))
        found.append(
            f"only {matching.matched} of {matching.asked} epochs could be compared with the truth{why and ': '}{why}"
        )
    if matching.matched < FEW_EPOCHS:
        found.append(f"these numbers rest on {matching.matched} of the track's epochs alone: they say next to nothing")
    if matching.undefined:
        found.append(f"the track has no position at {matching.undefined} epochs; they are left out of the errors")
    return tuple(found)


def _shift_text(shift: ConstantShift, error_m: Array, time_s: Vector, truth_m: Array) -> str:
    """Say that a constant shift makes up most of the error, and what may cause it."""
    east_m, north_m = error_m.mean(axis=0)
    east, north = "east" if east_m > 0 else "west", "north" if north_m > 0 else "south"
    where = f"{abs(east_m):.2f} m {east}, {abs(north_m):.2f} m {north}"
    return (
        f"a constant shift ({where} of the truth) makes up {100 * shift.share:.0f} % of the mean square error: check "
        "the origin under [map] and the lever arm of the truth, and that the truth is of this vehicle"
        f"{_clock_instead(error_m, time_s, truth_m)}; --align shift takes the shift off"
    )


def _clock_instead(error_m: Array, time_s: Vector, truth_m: Array) -> str:
    """Return which clock would explain a shift along a straight course; empty if none does.

    An offset of the truth's clock moves errors along the velocity, which is the same all the time: no shift and no
    offset can then be told apart.
    """
    way_m, shift_m = truth_m[-1] - truth_m[0], error_m.mean(axis=0)
    path_m = float(np.hypot(*np.diff(truth_m, axis=0).T).sum())
    along_m = float(shift_m @ way_m) / max(float(np.hypot(*way_m)), 1e-9)
    straight = float(np.hypot(*way_m)) > np.cos(ALONG_RAD) * path_m > 0
    if not straight or abs(along_m) < np.cos(ALONG_RAD) * float(np.hypot(*shift_m)):
        return ""
    late_s = along_m * float(time_s[-1] - time_s[0]) / float(np.hypot(*way_m))
    return (
        f"; the shift lies along the straight course, so that it may be a clock as well: stamps of the truth that are "
        f"{abs(late_s):.1f} s {'late' if late_s > 0 else 'early'}, or stamps of the fixes that are as much "
        f"{'early' if late_s > 0 else 'late'}"
    )


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
