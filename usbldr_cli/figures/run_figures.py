"""Figures of a run: the track, its errors over time (the paper's Figures 1 and 3) and their distribution."""

import itertools
import textwrap
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.types import Vector
from usbldr.io.reports.run import Run
from usbldr_cli.figures import style
from usbldr_cli.figures.consistency import consistency_figure
from usbldr_cli.figures.distance import distance_figure
from usbldr_cli.figures.drawing import Picture
from usbldr_cli.figures.fixes import fix_figure
from usbldr_cli.figures.health import calibration_figure, innovation_figure, particle_figure
from usbldr_cli.figures.page_data import detail, plot_inside
from usbldr_cli.figures.style import Axes, Figure, Span
from usbldr_cli.figures.track import track_figure

WIDTH_IN, LEAST_LETTERS = 11, 40  # of the errors over time; of a title over a narrow panel
BREAK = 0.2  # of the time that has errors: a longer gap without truth is left out, because the errors would be narrow
MARGIN = 0.005  # of the same time, before and after each stretch
LEAST_SHARE = 0.08  # of the same time: width of the shortest stretch
LEAST_ERRORS = 20  # [epochs] below it a distribution is drawn as single points, not as a curve
DENSE = 1500  # [epochs] from which lines are thinner


def run_pictures(run: Run) -> list[Picture]:
    """Return every figure that may apply to a run."""
    pictures: tuple[tuple[str, str, Callable[[Run], Figure | None]], ...] = (
        ("track", "Track, truth and USBL fixes", track_figure),
        ("errors", "East and north error over time with the 2-sigma band of the filter", error_figure),
        ("consistency", "The track coloured by its error with 2-sigma ellipses; NEES over time", consistency_figure),
        ("error_cdf", "Cumulative distribution of the errors", cdf_figure),
        ("error_distance", "Horizontal error against the distance travelled; box plots of each track", distance_figure),
        ("innovations", "Innovations and NIS of each sensor with their bounds", innovation_figure),
        ("fixes", "Fixes minus track, against bearing, range, heading and time", fix_figure),
        ("calibration", "Estimated sensor errors with their 2-sigma band and the prior", calibration_figure),
        ("ess", "Effective number of particles and acceptance of their moves", particle_figure),
    )
    return [Picture(name, caption, partial(draw, run)) for name, caption, draw in pictures]


def error_figure(run: Run) -> Figure | None:
    """Draw the signed errors of east and north over time; with the raw fixes behind."""
    report = run.scored.report
    if report is None:
        return None
    figure = style.run_figure(run, "Errors", WIDTH_IN, 6.6)
    spans = stretches(report)
    shares = [max(end - start, LEAST_SHARE * (spans[-1][1] - spans[0][0])) for start, end in spans]
    grid: Any = figure.subplots(2, len(spans), sharex="col", sharey=True, squeeze=False, width_ratios=shares)
    raw = next((other.report for other in style.other_tracks(run) if style.raw_fixes(other.trajectory.method)), None)
    dr = next((other.report for other in style.other_tracks(run) if other.trajectory.method == "dr"), None)
    half = half_height(report)
    for k, column in itertools.product(range(2), range(len(spans))):
        axes: Axes = grid[k, column]
        style.shade_outages(axes, run)
        if raw is not None:
            _draw_raw(axes, raw, k, half)
        if dr is not None:
            _draw_dr(axes, dr, k, half)
        _draw_error(axes, report, k, half)
        if run.bound is not None:
            smoothed = run.scored.trajectory.smoothed
            bound_sd_m = run.bound.smoother_sd_m if smoothed else run.bound.filter_sd_m
            two_sd_m = 2 * bound_sd_m[:, [k, k]] * [-1, 1]
            lines = axes.plot(run.bound.time_s, two_sd_m, color=style.TRUTH_COLOUR, lw=0.9, ls="--", zorder=4)
            lines[0].set_label("2-sigma Cramér-Rao bound for the filter's model")
        axes.axhline(0, color=style.TRUTH_COLOUR, lw=0.8, zorder=2)
        axes.set_ylim(-half, half)
        style.time_axis(axes, np.array(spans[column]))
        axes.set_xlabel("time since the log's start [s]" if k else "")
        if not column:
            axes.set_ylabel(f"{style.AXES[k]} error [m]")
        letters = max(LEAST_LETTERS, int(WIDTH_IN * style.LETTERS_AN_INCH * shares[0] / sum(shares)))
        title = textwrap.wrap(_error_title(report, k), letters) if not column else ["\N{NO-BREAK SPACE}"]
        axes.set_title(style.WRAPPED.join(title))
    style.legend_below(figure, (grid[0, 0],))
    return figure


def stretches(report: ErrorReport) -> list[Span]:
    """Return the stretches of time that have truth: between them, the axis is broken."""
    t = report.time_s
    margin_s = MARGIN * float(t[-1] - t[0])
    cuts = np.flatnonzero(np.diff(t) > max(BREAK * float(t[-1] - t[0]), style.longest_step_s(t)))
    first, last = t[np.append(0, cuts + 1)], t[np.append(cuts, len(t) - 1)]
    return [(float(a) - margin_s, float(b) + margin_s) for a, b in zip(first, last, strict=True)]


def _draw_raw(axes: Axes, raw: ErrorReport, k: int, half: float) -> None:
    """Draw the errors of all raw fixes, those outside the axes at the edge, as in innovations.png."""
    edge = style.EDGE * half
    outside = int(np.count_nonzero((np.abs(raw.error_m) > edge).any(axis=1)))
    more = f" ({outside} of {len(raw.error_m)} drawn at the edge)" if outside else ""
    look: dict[str, Any] = {
        "ls": "",
        "color": style.colour("usbl"),
        "marker": ".",
        "mew": 0,
        "alpha": 0.55,
        "zorder": 1.5,
    }
    size = 4.5 if len(raw.error_m) < DENSE else 3.0
    label = f"raw USBL fix{more}"
    plot_inside(axes, raw.time_s, raw.error_m[:, k], (-edge, edge), ms=size, label=label, **look)


def _draw_dr(axes: Axes, dr: ErrorReport, k: int, half: float) -> None:
    """Draw the error of dead reckoning, along the edge where it is larger than the axes."""
    t, e = style.broken_at_gaps(dr.time_s, dr.error_m[:, k])
    more = " (at the edge: larger)" if np.abs(dr.error_m).max() > style.EDGE * half else ""
    look: dict[str, Any] = {"color": style.colour("dr"), "lw": 1.0, "alpha": 0.8, "zorder": 1.6}
    plot_inside(axes, t, e, (-style.EDGE * half, style.EDGE * half), label=f"dr{more}", **look)


def _draw_error(axes: Axes, report: ErrorReport, k: int, half: float) -> None:
    mine = style.colour(report.method)
    t, e = style.broken_at_gaps(report.time_s, report.error_m[:, k])
    beyond = np.abs(report.error_m[:, k]) > half
    for sign, marker in ((1, "^"), (-1, "v")):
        at = beyond & (sign * report.error_m[:, k] > 0)
        look: dict[str, Any] = {"ls": "", "marker": marker, "ms": 6, "label": f"_{report.label}", "zorder": 5}
        plot_inside(axes, report.time_s[at], report.error_m[at, k], (-0.96 * half, 0.96 * half), color=mine, **look)
    if style.raw_fixes(report.method):
        axes.plot(t, e, ls="", marker=".", ms=4, color=mine, label=report.label, zorder=3)
        return
    _, horizontal_m = style.broken_at_gaps(report.time_s, report.horizontal_m)
    rows = {"horizontal error [m]": horizontal_m}
    if report.sd_m is not None:
        tb, sd = style.broken_at_gaps(report.time_s, report.sd_m[:, k])
        rows["2 sigma [m]"] = 2 * sd
        axes.fill_between(tb, -2 * sd, 2 * sd, color=mine, alpha=0.2, lw=0, label="2 sigma", zorder=1.8)
        edges = np.column_stack([-2 * sd, 2 * sd])
        axes.plot(tb, edges, color=mine, alpha=0.55, lw=0.7, label=["_2 sigma", "_2 sigma"], zorder=1.9)
    (line,) = axes.plot(t, e, color=mine, lw=1.3 if len(t) < DENSE else 0.8, label=report.label, zorder=3)
    detail(line, rows)


def half_height(report: ErrorReport) -> float:
    """Return the height, the same for both axes, which gross errors do not set: they are marked at the edge."""
    half = style.usual_most(np.abs(report.error_m))
    if report.sd_m is not None:
        half = max(half, min(2 * float(np.nanpercentile(report.sd_m, 99)), 2 * half))
    return 1.12 * half if half > 0 else 1.0


def _error_title(report: ErrorReport, k: int) -> str:
    errors = (report.east, report.north)[k]
    text = (
        f"{style.AXES[k]}: mean |error| {errors.mean_abs_m:.2f} m, rmse {errors.rmse_m:.2f} m, "
        f"bias {errors.bias_m:+z.2f} m, 95 % below {errors.p95_abs_m:.2f} m, all below {errors.max_abs_m:.2f} m"
    )
    if report.sd_m is not None:
        inside = np.mean(np.abs(report.error_m[:, k]) <= 2 * report.sd_m[:, k])
        text += f"; {100 * inside:.0f} % inside 2 sigma (expected 95 %)"
    return text


def cdf_figure(run: Run) -> Figure | None:
    """Draw the cumulative distribution of east, north and horizontal error, with raw USBL and dr for comparison."""
    report = run.scored.report
    if report is None:
        return None
    figure = style.run_figure(run, "Distribution of errors", 11, 4.9)
    panels: Any = figure.subplots(1, 3, sharey=True)
    references = [other.report for other in style.other_tracks(run) if other.report is not None]
    widest_m = max(_widest(report, references, k) for k in range(3))
    for k, (axes, name) in enumerate(zip(panels, ("|east|", "|north|", "horizontal"), strict=True)):
        for other in (*references, report):
            width = 2.2 if other is report else 1.3
            length, share = _cdf(_lengths(other, k))
            look = {"color": style.colour(other.method), "lw": width, "label": other.label}
            if len(length) <= LEAST_ERRORS:
                look |= {"ls": "", "marker": "o", "ms": 4, "label": f"{other.label} ({len(length) - 1} errors only)"}
                axes.plot(length[1:], 100 * share[1:], **look)
            else:
                axes.step(length, 100 * share, where="post", **look)
        axes.set_title(_mark_quantiles(axes, _lengths(report, k), report))
        axes.set_xlim(0, widest_m)
        axes.set_ylim(0, 101)
        largest_m = float(_lengths(report, k).max())
        axes.set_xlabel(f"{name} error [m]" + (f" (largest: {largest_m:.2f})" if largest_m > widest_m else ""))
    panels[0].set_ylabel("cumulative share of errors [%]")
    style.legend_below(figure, (panels[0],))
    return figure


def _lengths(report: ErrorReport, k: int) -> Vector:
    return report.horizontal_m if k == 2 else np.abs(report.error_m[:, k])


def _cdf(lengths: Vector) -> tuple[Vector, Vector]:
    return np.concatenate([[0.0], np.sort(lengths)]), np.linspace(0, 1, len(lengths) + 1)


def _mark_quantiles(axes: Axes, lengths: Vector, report: ErrorReport) -> str:
    """Mark the quantiles of the method and return them in words."""
    texts: list[str] = []
    for percent in (50, 95):
        x = float(np.percentile(lengths, percent))
        axes.plot([0, x, x], [percent, percent, 0], color=style.colour(report.method), lw=0.8, ls=":", zorder=1)
        texts.append(f"{percent} % below {x:.2f} m")
    return f"{report.label}: {', '.join(texts)}"


def _widest(report: ErrorReport, references: list[ErrorReport], k: int) -> float:
    """Return the width that shows the method up to a few far larger errors, and of the others what fits."""
    own = style.usual_most(_lengths(report, k))
    theirs = [float(np.percentile(_lengths(other, k), 90)) for other in references]
    return max(1.15 * own, min(max(theirs, default=0.0), 4 * own)) or 1.0
