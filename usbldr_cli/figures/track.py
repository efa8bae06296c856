"""The whole track with truth and fixes, and a close-up of the largest error."""

from typing import Any

import numpy as np
from matplotlib.patches import Ellipse

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.types import Array, Trajectory
from usbldr.io.reports.report_json import Run, fixes_table
from usbldr_cli.figures.style import (
    EVER,
    REJECTED_COLOUR,
    TRUTH_COLOUR,
    Axes,
    Figure,
    Span,
    broken_at_gaps,
    colour,
    frame_square,
    legend_below,
    other_tracks,
    plane_axes,
    raw_fixes,
    run_figure,
    within,
)

CLOSE_S = 60.0  # shown before and after the largest error, because a survey passes the same place often


def track_figure(run: Run) -> Figure:
    """Draw the whole track, and beside it a close-up of the largest error."""
    report = run.scored.report
    closer = report is not None and not raw_fixes(run.method)  # the largest error of raw fixes is an outlier
    figure = run_figure(run, "Track", 12.5 if closer else 8.0, 7.3 if closer else 8.6)
    panels: Any = figure.subplots(1, 2 if closer else 1, squeeze=False)
    whole: Axes = panels[0, 0]
    aligned = report is not None and report.alignment.name != "none"
    _draw_context(whole, run, EVER)
    _draw_track(whole, run, run.scored.trajectory.position_m, EVER)
    frame_square(whole, _extent(run), 0.06)
    whole.set_title("whole track, before alignment" if aligned else "whole track")
    if report is not None and closer:
        close: Axes = panels[0, 1]
        worst_s = float(report.time_s[np.argmax(report.horizontal_m)])
        span = worst_s - CLOSE_S, worst_s + CLOSE_S
        if not aligned:  # fixes and dr are not aligned, so they would mislead
            _draw_context(close, run, span, marker_scale=1.8)
        _draw_track(close, run, _aligned_m(run.scored.trajectory, report), span)
        _draw_worst(close, report)
    legend_below(figure, (whole,), 8 if closer else 5)
    return figure


def _aligned_m(trajectory: Trajectory, report: ErrorReport) -> Array:
    return report.alignment.points(trajectory.position_m, trajectory.state("psi"))


def _draw_context(axes: Axes, run: Run, span: Span, marker_scale: float = 1.0) -> None:
    for other in other_tracks(run):
        if other.trajectory.method == "dr":
            path = other.trajectory.position_m[within(other.trajectory.time_s, span)]
            axes.plot(*path.T, color=colour("dr"), lw=1, alpha=0.7, label="dr", zorder=1)
    _draw_fixes(axes, run, span, marker_scale)


def _draw_track(axes: Axes, run: Run, position_m: Array, span: Span) -> None:
    trajectory = run.scored.trajectory
    if run.truth is not None:
        during = within(run.truth.time_s, span)
        _, truth_m = broken_at_gaps(run.truth.time_s[during], run.truth.position_m[during], run.truth.max_gap_s)
        axes.plot(*truth_m.T, color=TRUTH_COLOUR, lw=2.2, label=f"truth ({run.truth.kind})", zorder=3)
    if not raw_fixes(run.method):
        path = position_m[within(trajectory.time_s, span)]
        axes.plot(*path.T, color=colour(run.method), lw=1.3, label=run.label, zorder=4)
    defined = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    for label, marker, row in (("start", "o", defined[:1]), ("end", "s", defined[-1:])):
        if len(row) and span[0] <= trajectory.time_s[row[0]] <= span[1]:
            style: dict[str, Any] = {"ls": "", "ms": 9, "mec": "white", "mew": 1, "zorder": 6}
            axes.plot(*position_m[row[0]], marker=marker, label=label, color=colour(run.method), **style)
    plane_axes(axes)


def _draw_fixes(axes: Axes, run: Run, span: Span, marker_scale: float) -> None:
    styles: dict[str, dict[str, Any]] = {
        "used": {"marker": ".", "ms": 5, "color": colour("usbl"), "alpha": 0.75, "zorder": 2},
        "down-weighted": {"marker": "o", "ms": 4.5, "mfc": "none", "mec": colour("usbl"), "alpha": 0.9, "zorder": 2},
        "rejected": {"marker": "x", "ms": 4, "mew": 0.9, "color": REJECTED_COLOUR, "alpha": 0.8, "zorder": 2.5},
    }
    during = within(run.timeline.fix_time_s, span)
    outcomes = fixes_table(run.timeline, run.scored.trajectory)["outcome"].to_numpy()[during]
    for outcome, style in styles.items():
        at = outcomes == outcome
        if outcome == "used":
            at |= ~np.isin(outcomes, list(styles))
        count = int(np.count_nonzero(at))
        if count:
            style["ms"] *= marker_scale
            axes.plot(*run.timeline.fix_m[during][at].T, ls="", label=f"USBL fix {outcome} ({count})", **style)


def _draw_worst(axes: Axes, report: ErrorReport) -> None:
    """Join truth and estimate at the largest error, and draw the filter's 2-sigma ellipse there."""
    worst = int(np.argmax(report.horizontal_m))
    ends = np.stack([report.truth_m[worst], report.estimate_m[worst]])
    axes.plot(*ends.T, color=REJECTED_COLOUR, lw=1.5, marker="o", ms=4, zorder=7)
    ellipse = ""
    if report.cov_m2 is not None and np.isfinite(report.cov_m2[worst]).all():
        variance, vectors = np.linalg.eigh(report.cov_m2[worst])
        length = 2 * 2 * np.sqrt(np.maximum(variance, 0))
        turn = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        face = colour(report.method)
        axes.add_patch(Ellipse(tuple(ends[1]), length[1], length[0], angle=turn, fc=face, alpha=0.2, zorder=3.5))
        ellipse = ", with the 2-sigma ellipse"
    half = max(4.0 * float(report.horizontal_m[worst]), 3.0)
    frame_square(axes, np.stack([ends.mean(axis=0) - half, ends.mean(axis=0) + half]), 0.0)
    axes.set_title(f"largest error: {report.horizontal_m[worst]:.2f} m at {report.time_s[worst]:.0f} s{ellipse}")


def _extent(run: Run) -> Array:
    """Return the points that the figure must show, without outliers of fixes or drift of dr."""
    points = [run.scored.trajectory.position_m] if not raw_fixes(run.method) else []
    if run.truth is not None:
        near = (run.truth.time_s >= 0) & (run.truth.time_s <= run.timeline.time_s[-1])
        points.append(run.truth.position_m[near])
    if len(run.timeline.fix_m):
        points.append(np.percentile(run.timeline.fix_m, [1, 99], axis=0))
    whole = np.vstack(points)
    return whole[np.isfinite(whole).all(axis=1)]
