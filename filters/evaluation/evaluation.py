"""Judge a track against the truth: which times, which alignment, which errors. Metres, east and north.

Truth is interpolated linearly to the track's own times, never the other way round: a truth of 0.4 Hz would otherwise
pick 0.4 Hz of the track. Times outside the truth, or inside one of its longer gaps, are left out and counted.
"""

from dataclasses import replace

import numpy as np

from usbldr.filters.evaluation.alignment import Alignment, fit_alignment
from usbldr.filters.evaluation.consistency import consistency, fix_updates, sensor_updates, truth_covariances
from usbldr.filters.evaluation.constant_shift import constant_shift
from usbldr.filters.evaluation.error_report import WHOLE_LOG, ErrorReport, Window
from usbldr.filters.evaluation.matching import Matched, match
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
from usbldr.filters.evaluation.score_warnings import coverage_warnings, motion_warnings, refuse_apart, shift_text
from usbldr.filters.evaluation.whiteness import whiteness
from usbldr.filters.types import Array, Trajectory, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows

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
    horizontal, travel = horizontal_errors(error_m), None
    if travelled_m is not None:
        # unaligned, the error has grown since the track's start; aligned, since the alignment
        start = matched.first if align != "none" else int(np.flatnonzero(np.isfinite(track_m).all(axis=1))[0])
        distance_m = float(travelled_m[np.flatnonzero(scored)[-1]] - travelled_m[start])
        drifts = trajectory.method == "dr" and distance_m > 0
        travel = Travel(distance_m, 100 * horizontal.final_m / distance_m if drifts else None)
    errors_cov_m2 = None if cov_m2 is None else cov_m2 + truth_cov_m2
    compared = None if errors_cov_m2 is None else consistency(error_m, errors_cov_m2)
    nees, sigma_shares = compared or (None, None)
    shift = constant_shift(error_m, errors_cov_m2)
    warnings = coverage_warnings(matched.counts, truth)
    if unaligned and shift.dominates:
        warnings += (shift_text(shift, error_m, time_s, truth_m),)
    judged_truth = replace(truth, time_s=matched.row_s, position_m=matched.row_m)
    warnings += motion_warnings(shift, time_s, estimate_m, truth_m, judged_truth, by_fixes=bool(trajectory.updates))
    if yaw is None and any(truth.lever_m[:2]):
        warnings += ("raw fixes have no heading, so the lever arm of the truth is not taken off their errors",)
    late_s = t[matched.first] - matched.row_s[matched.first_row]
    if align == "first" and late_s > LATE_FIRST_S:
        warnings += (
            f"--align first put the track's first epoch, {t[matched.first]:.1f} s, on a truth row {late_s:.1f} s "
            "earlier: choose a --start at which both exist",
        )
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
