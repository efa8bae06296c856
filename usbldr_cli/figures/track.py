"""The whole track with truth and fixes, and a close-up of the largest error."""

from typing import Any

import numpy as np

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.types import Array, Mask, Vector
from usbldr.io.reports.report_json import fixes_table
from usbldr.io.reports.run import Run, ScoredTrack, fix_outcomes
from usbldr_cli.figures import style
from usbldr_cli.figures.page_data import detail
from usbldr_cli.figures.plane import (
    EAST_NORTH,
    Plane,
    frame_plane,
    frame_square,
    plane_axes,
    plane_of,
    sigma_ellipses,
    usual_box,
)
from usbldr_cli.figures.style import Axes, Figure, Span

CLOSE_S = 60.0  # shown at most before and after the largest error, because a survey passes the same place often
CLOSE_ERRORS = 4.0  # times the largest error: from it to the edge of the close-up
CLOSE_M, CLOSE_SHARE = 8.0, 0.15  # [m, share of the track's extent] surroundings that it shows, the smaller one
LEAST_CLOSE_M = 3.0  # [m] from the largest error to the edge, if errors and track are tiny
MAX_GROWTH = 2.0  # times the frame of track and truth: what fixes and dr may add to it
DENSE = 500  # [fixes] from which their marks are smaller, so that they do not hide the tracks
MANY_FIXES = 10_000  # [fixes] from which the page tells the time of each alone, to stay below 2 MB
DENSE_SCALE = 0.6  # times the usual size of a mark


def track_figure(run: Run) -> Figure:
    """Draw the whole track, and beside it a close-up of the largest error."""
    report = run.scored.report
    closer = report is not None and not style.raw_fixes(run.method)  # the largest error of raw fixes is an outlier
    figure = style.run_figure(run, "Track", 12.5 if closer else 8.0, 7.3 if closer else 8.6)
    panels: Any = figure.subplots(1, 2 if closer else 1, squeeze=False)
    whole: Axes = panels[0, 0]
    extent_m = _extent(run)
    plane = EAST_NORTH if style.raw_fixes(run.method) else plane_of(_track(run))
    frame_plane(whole, plane, extent_m, 0.06)
    _draw_context(whole, run, style.EVER, DENSE_SCALE if len(run.timeline.fix_m) > DENSE else 1.0, plane)
    _draw_track(whole, run, style.EVER, plane)
    moved = report is not None and report.alignment.name != "none"
    title = "whole track, aligned; fixes moved with it" if moved else "whole track"
    whole.set_title("\n".join(filter(None, (title, plane.text))))
    if report is not None and closer:
        close: Axes = panels[0, 1]
        worst = _worst(whole, plane, run, report)
        span, corners_m = _frame_worst(close, report, worst, np.ptp(extent_m, axis=0).max() / 2)
        _draw_surroundings(close, run)
        whole.plot(*plane.points(corners_m).T, color=style.REJECTED_COLOUR, lw=1.0, zorder=7)
        _draw_context(close, run, span, 1.8)
        _draw_track(close, run, span)
        _draw_worst(close, report, worst, span)
    long = any("outside" in label for label in whole.get_legend_handles_labels()[1])
    style.legend_below(figure, (whole,), 8 if closer and not long else 5)
    return figure


def aligned(scored: ScoredTrack, time_s: Vector, position_m: Array) -> Array:
    """Return positions of a track, or its fixes, moved as the track was moved before scoring."""
    if scored.report is None:
        return position_m
    psi = scored.trajectory.state("psi")
    yaw = None if psi is None else np.interp(time_s, scored.trajectory.time_s, psi)
    return scored.report.alignment.points(position_m, yaw)


def scored_truth(run: Run) -> tuple[Vector, Array]:
    """Return time and place of the truth inside the run and the window that is scored."""
    if run.truth is None:
        return np.empty(0), np.empty((0, 2))
    t = run.truth.time_s
    rows = style.within(t, (0.0, float(run.timeline.time_s[-1])))
    if run.scored.report is not None:
        rows &= style.within(t, run.scored.report.window)
    return t[rows], run.truth.position_m[rows]


def _track(run: Run) -> Array:
    """Return the track as it was scored, without unknown positions."""
    track_m = aligned(run.scored, run.scored.trajectory.time_s, run.scored.trajectory.position_m)
    return track_m[np.isfinite(track_m).all(axis=1)]


def _draw_surroundings(axes: Axes, run: Run) -> None:
    """Draw the whole track and truth faintly: what passes here at other times."""
    if run.truth is not None:
        _, line_m = style.broken_at_gaps(*scored_truth(run), run.truth.max_gap_s)
        axes.plot(*line_m.T, color=style.TRUTH_COLOUR, lw=0.8, alpha=0.25, zorder=1)
    axes.plot(*_track(run).T, color=style.colour(run.method), lw=0.8, alpha=0.3, zorder=1)


def _draw_context(axes: Axes, run: Run, span: Span, marker_scale: float, plane: Plane = EAST_NORTH) -> None:
    for other in style.other_tracks(run):
        if other.trajectory.method == "dr":
            path = aligned(other, other.trajectory.time_s, other.trajectory.position_m)[
                style.within(other.trajectory.time_s, span)
            ]
            path = plane.points(path)
            label = "dr (partly outside the axes)" if _outside(axes, path) else "dr"
            (line,) = axes.plot(*path.T, color=style.colour("dr"), lw=1, alpha=0.7, label=label, zorder=1)
            time_s = other.trajectory.time_s
            detail(line, {"time [s]": time_s[style.within(time_s, span)]}, key="dr")
    _draw_fixes(axes, run, span, marker_scale, plane)


def _outside(axes: Axes, points_m: Array) -> int:
    """Return how many points lie outside the axes."""
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    x, y = points_m.T
    return int(np.count_nonzero((x < west) | (x > east) | (y < south) | (y > north)))


def _draw_track(axes: Axes, run: Run, span: Span, plane: Plane = EAST_NORTH) -> None:
    trajectory = run.scored.trajectory
    position_m = plane.points(aligned(run.scored, trajectory.time_s, trajectory.position_m))
    if run.truth is not None:
        time_s, truth_m = scored_truth(run)
        during = style.within(time_s, span)
        line_s, line_m = style.broken_at_gaps(time_s[during], plane.points(truth_m[during]), run.truth.max_gap_s)
        look: dict[str, Any] = {"lw": 2.2, "marker": ".", "ms": 2.2, "mew": 0, "zorder": 3}
        outside = f", {far} outside the axes" if (far := _outside(axes, line_m)) else ""
        (line,) = axes.plot(*line_m.T, color=style.TRUTH_COLOUR, label=f"truth ({run.truth.kind}{outside})", **look)
        detail(line, {"time [s]": line_s}, key="truth")
    if not style.raw_fixes(run.method):
        during = style.within(trajectory.time_s, span)
        (line,) = axes.plot(*position_m[during].T, color=style.colour(run.method), lw=1.3, label=run.label, zorder=4)
        rows = {"time [s]": trajectory.time_s, "horizontal error [m]": _errors_m(run)}
        detail(line, {name: values[during] for name, values in rows.items()})
    defined = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    for label, marker, row in (("start", "o", defined[:1]), ("end", "s", defined[-1:])):
        if len(row) and span[0] <= trajectory.time_s[row[0]] <= span[1]:
            look = {"ls": "", "ms": 7, "mfc": "white", "mew": 1.6, "zorder": 6}
            axes.plot(*position_m[row[0]], marker=marker, label=label, color=style.colour(run.method), **look)


def _errors_m(run: Run) -> Vector:
    """Return the horizontal error at each epoch of the track, (K,), NaN where it was not scored."""
    time_s, report = run.scored.trajectory.time_s, run.scored.report
    errors_m = np.full(len(time_s), np.nan)
    if report is not None:
        at = np.minimum(np.searchsorted(time_s, report.time_s), len(time_s) - 1)
        same = time_s[at] == report.time_s
        errors_m[at[same]] = report.horizontal_m[same]
    return errors_m


def _draw_fixes(axes: Axes, run: Run, span: Span, marker_scale: float, plane: Plane) -> None:
    styles: dict[str, dict[str, Any]] = {
        "used": {"marker": ".", "ms": 5, "color": style.colour("usbl"), "alpha": 0.75, "zorder": 2},
        "down-weighted": {
            "marker": "o",
            "ms": 4.5,
            "mfc": "none",
            "mec": style.colour("usbl"),
            "alpha": 0.9,
            "zorder": 2,
        },
        "rejected": {"marker": "x", "ms": 4, "mew": 0.9, "color": style.REJECTED_COLOUR, "alpha": 0.8, "zorder": 2.5},
    }
    during = style.within(run.timeline.fix_time_s, span)
    fix_m = plane.points(aligned(run.scored, run.timeline.fix_time_s, run.timeline.fix_m)[during])
    outcomes = fix_outcomes(run.timeline, run.scored.trajectory)[during]
    shown_m = fix_m if span != style.EVER else _inside(axes, fix_m)
    rows = {name: values[during] for name, values in _fix_rows(run).items()}
    for outcome, look in styles.items():
        at = outcomes == outcome
        if outcome == "used":
            at |= ~np.isin(outcomes, list(styles))
        if at.any():
            look["ms"] *= marker_scale
            edge = f", {far} outside the axes, at the edge" if (far := _outside(axes, fix_m[at])) else ""
            label = f"USBL fix {outcome} ({np.count_nonzero(at)}{edge if span == style.EVER else ''})"
            (marks,) = axes.plot(*shown_m[at].T, ls="", label=label, clip_on=span != style.EVER, **look)
            true = {"x": fix_m[at, 0], "y": fix_m[at, 1]} if span == style.EVER else {}
            detail(marks, {name: values[at] for name, values in rows.items()}, key=f"USBL fix {outcome}", **true)


def _fix_rows(run: Run) -> dict[str, Vector]:
    """Return what the page tells of each fix: number, time, innovation, and how far it moved the track."""
    table = fixes_table(run.timeline, run.scored.trajectory)
    sizes = {
        f"{name} [m]": np.hypot(*(table[f"{name}_{axis}_m"].to_numpy(float) for axis in style.AXES))
        for name in ("innovation", "shift")
    }
    number = {"fix": np.arange(len(table), dtype=float), **sizes} if len(table) <= MANY_FIXES else {}
    return {"time [s]": table["time_s"].to_numpy(float), **number}


def _inside(axes: Axes, points_m: Array) -> Array:
    """Return points (n, 2), those outside the axes moved to the edge."""
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    return np.clip(points_m, limits[:, 0], limits[:, 1])


def _worst(axes: Axes, plane: Plane, run: Run, report: ErrorReport) -> int:
    """Return the epoch of the largest error, if possible of those whose truth is inside the axes and does not jump."""
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    x, y = plane.points(report.truth_m).T
    inside = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    for kept in (inside & ~_jumps(run, report), inside):
        if kept.any():
            return int(np.argmax(np.where(kept, report.horizontal_m, -1.0)))
    return int(np.argmax(report.horizontal_m))


def _jumps(run: Run, report: ErrorReport) -> Mask:
    """Return the epochs (M,) beside the truth that the finding TRUTH-JUMP names."""
    found = np.zeros(len(report.time_s), dtype=np.bool_)
    for finding in run.log.findings:
        if finding.code == "TRUTH-JUMP" and finding.time_s is not None and run.truth is not None:
            t = run.truth.time_s
            row = int(np.searchsorted(t, finding.time_s))
            found |= (report.time_s > t[max(row - 2, 0)]) & (report.time_s < t[min(row + 2, len(t) - 1)])
    return found


def _frame_worst(axes: Axes, report: ErrorReport, worst: int, most_m: float) -> tuple[Span, Array]:
    """Frame the surroundings of the largest error, at most ``most_m`` to each side.

    Return the time around it that track or truth spend there, and the outline of the frame, closed, (5, 2).
    """
    middle = (report.truth_m[worst] + report.estimate_m[worst]) / 2
    surroundings_m = min(CLOSE_M, CLOSE_SHARE * float(np.max(np.ptp(usual_box(report.truth_m), axis=0))))
    half = max(CLOSE_ERRORS * float(report.horizontal_m[worst]), surroundings_m)
    half = max(min(half, most_m), LEAST_CLOSE_M)
    plane_axes(axes)
    frame_square(axes, np.stack([middle - half, middle + half]), 0.0)
    off_m = np.max(np.abs(np.stack([report.estimate_m, report.truth_m]) - middle), axis=2)
    away = np.flatnonzero(off_m.min(axis=0) > half)
    first, last = away[away < worst].max(initial=0), away[away > worst].min(initial=len(report.time_s) - 1)
    worst_s = report.time_s[worst]
    span = max(float(report.time_s[first]), worst_s - CLOSE_S), min(float(report.time_s[last]), worst_s + CLOSE_S)
    return span, middle + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])


def _draw_worst(axes: Axes, report: ErrorReport, worst: int, span: Span) -> None:
    """Join truth and estimate at the largest error, and draw the filter's 2-sigma ellipse there."""
    ends = np.stack([report.truth_m[worst], report.estimate_m[worst]])
    axes.plot(*ends.T, color=style.REJECTED_COLOUR, lw=1.5, marker="o", ms=4, zorder=7)
    ellipse = ""
    if report.cov_m2 is not None and np.isfinite(report.cov_m2[worst]).all():
        outline = sigma_ellipses(ends[1:], report.cov_m2[worst][None], 2.0)[0]
        axes.fill(*outline.T, fc=style.colour(report.method), alpha=0.2, lw=0, zorder=3.5)
        ellipse = ", 2-sigma ellipse"
    larger = int(np.count_nonzero(report.horizontal_m > report.horizontal_m[worst]))
    outside = f"\n{larger} larger, up to {report.horizontal_m.max():.2f} m: their truth jumps or is outside the axes"
    axes.set_title(
        f"largest error (red frame): {report.horizontal_m[worst]:.2f} m at {report.time_s[worst]:.0f} s{ellipse}; "
        f"{span[0]:.0f} to {span[1]:.0f} s{outside if larger else ''}"
    )


def _extent(run: Run) -> Array:
    """Return the points that the figure must show: track and truth, and fixes and dr that are not far from them."""
    track_m = aligned(run.scored, run.scored.trajectory.time_s, run.scored.trajectory.position_m)
    fix_m = aligned(run.scored, run.timeline.fix_time_s, run.timeline.fix_m)
    drifting = [
        aligned(other, other.trajectory.time_s, other.trajectory.position_m) for other in style.other_tracks(run)
    ]
    core = np.vstack([usual_box(fix_m) if style.raw_fixes(run.method) else track_m, usual_box(scored_truth(run)[1])])
    core = core[np.isfinite(core).all(axis=1)]
    middle, half = (core.min(axis=0) + core.max(axis=0)) / 2, float(np.max(np.ptp(core, axis=0))) / 2
    others = np.vstack([fix_m, *drifting])
    return np.vstack([core, others[np.max(np.abs(others - middle), axis=1) <= MAX_GROWTH * half]])
