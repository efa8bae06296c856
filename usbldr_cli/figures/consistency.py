"""Errors beside what the filter says of them: the track coloured by its error with ellipses, and NEES over time."""

import math
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from usbldr.filters.evaluation.consistency import DOF, nees
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.io.reports.run import Run
from usbldr_cli.figures import style
from usbldr_cli.figures.health import BINS, bin_means, draw_bounds, mean_bounds
from usbldr_cli.figures.page_data import plot_inside
from usbldr_cli.figures.plane import Plane, frame_plane, plane_of, sigma_ellipses, usual_box
from usbldr_cli.figures.style import Axes, Figure

ELLIPSES = 25  # along the track: more would cover each other
VISIBLE = 0.02  # of the track's extent: smaller ellipses are drawn larger, and the title says how much
SCALES = (1, 2, 5, 10, 20, 50, 100, 200, 500)  # fixed: round numbers
SEGMENTS = 600  # of the coloured track: each is drawn by itself, which takes time
SHOWN_ERRORS = 99.0  # [%] of the errors that the scale of colours covers


def consistency_figure(run: Run) -> Figure | None:
    """Draw where the errors are and whether their covariance is right; None without a covariance."""
    report = run.scored.report
    if report is None or report.cov_m2 is None or report.nees is None:
        return None
    figure = style.run_figure(run, "Errors and their covariance", 13, 5.6)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    _draw_coloured(figure, left, report)
    _draw_nees(right, run, report)
    style.legend_below(figure, (right,), 8)
    return figure


def _draw_coloured(figure: Figure, axes: Axes, report: ErrorReport) -> None:
    """Draw the scored track, its colour the horizontal error, with 2-sigma ellipses of the filter along it."""
    plane = plane_of(report.estimate_m)
    error_m = report.horizontal_m
    place_m = np.column_stack([plane.points(report.estimate_m), error_m])
    every = math.ceil(len(error_m) / SEGMENTS)
    _, line = style.broken_at_gaps(
        report.time_s[::every], place_m[::every], every * style.longest_step_s(report.time_s)
    )
    segments = np.stack([line[:-1, :2], line[1:, :2]], axis=1)
    whole = np.isfinite(segments).all(axis=(1, 2))
    drawn: Any = LineCollection(list(segments[whole]), linewidths=2.5, zorder=3, cmap="viridis_r")
    drawn.set_array(line[1:, 2][whole])
    drawn.set_clim(0, float(np.percentile(error_m, SHOWN_ERRORS)))
    axes.add_collection(drawn)
    bar: Any = figure.colorbar(drawn, ax=axes, shrink=0.8, pad=0.01, extend="max")
    bar.set_label("horizontal error [m]")
    scale = _draw_ellipses(axes, report, plane)
    frame_plane(axes, plane, np.vstack([report.estimate_m, usual_box(report.truth_m)]), 0.06)
    ellipses = "2-sigma ellipses" if scale == 1 else f"2-sigma ellipses {scale} times as large"
    ellipses = "bars: 2 sigma across" if plane.turn is not None else ellipses
    axes.set_title("\n".join(filter(None, (f"track by its error, {ellipses}", plane.text))))


def _draw_ellipses(axes: Axes, report: ErrorReport, plane: Plane) -> int:
    """Draw the filter's ellipses in the middle of equal times; return how many times as large.

    That of a start which the first fixes make certain would cover the track.
    """
    assert report.cov_m2 is not None
    rows = np.unique(((np.arange(ELLIPSES) + 0.5) / ELLIPSES * len(report.time_s)).astype(int))
    rows = rows[np.isfinite(report.cov_m2[rows]).all(axis=(1, 2))]
    cov_m2 = (report.cov_m2 + report.truth_cov_m2)[rows]
    usual_m = 2 * float(np.median(np.sqrt(np.trace(cov_m2, axis1=1, axis2=2) / 2)))
    least_m = VISIBLE * float(np.max(np.ptp(report.estimate_m, axis=0))) if plane.turn is None else 0.0
    scale = next((one for one in SCALES if one * usual_m >= least_m), SCALES[-1])
    outlines = sigma_ellipses(report.estimate_m[rows], cov_m2, 2.0 * scale)
    lines = [plane.points(outline) for outline in outlines]
    axes.add_collection(LineCollection(lines, colors=style.colour(report.method), linewidths=0.8, alpha=0.8, zorder=2))
    return scale


def _draw_nees(axes: Axes, run: Run, report: ErrorReport) -> None:
    """Draw NEES faintly, its mean over a sixtieth of the run, and the bounds of that mean."""
    assert report.cov_m2 is not None
    assert report.nees is not None
    style.shade_outages(axes, run)
    t, mine = report.time_s, style.colour(report.method)
    values = nees(report.error_m, report.cov_m2 + report.truth_cov_m2)
    edges = np.linspace(float(t[0]), float(t[-1]), min(BINS, max(1, len(t) // 10)) + 1)
    bins = bin_means(t, values, edges)
    independent = np.where(bins[:, 2] > 0, np.maximum(bins[:, 2] * report.nees.independent_errors / len(t), 1.0), 0.0)
    low, high = mean_bounds(independent, DOF)
    mean_s = edges[1] - edges[0]
    bottom, top = 0.01 * DOF, max(20.0 * DOF, 1.5 * float(np.nanmax(bins[:, 1])))
    look: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2, "alpha": 0.3, "label": "NEES of an epoch"}
    plot_inside(axes, t, values, (bottom, top), color=mine, **look)
    draw_bounds(axes, edges, (low, high), f"95 % bounds of {mean_s:.0f} s means if the covariance is right")
    axes.plot(bins[:, 0], bins[:, 1], color=mine, marker="o", ms=3, label=f"mean of {mean_s:.0f} s")
    axes.axhline(DOF, color=style.TRUTH_COLOUR, lw=0.8)
    style.logarithmic(axes)
    axes.set_ylim(bottom, top)
    axes.set_ylabel("NEES, position")
    style.time_axis(axes, t)
    found = report.nees
    bounds = f"95 % bounds of the whole run {found.low:.2f} to {found.high:.2f}"
    axes.set_title(f"NEES: mean {found.mean:.2f} (expected {DOF}; {bounds})")
