"""Every method on the same dive: errors over time, and tracks with the truth."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from usbldr.filters.evaluation.alignment import ALIGNMENTS
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Array, Vector
from usbldr_cli.figures import style
from usbldr_cli.figures.plane import EAST_NORTH, frame_plane, plane_of
from usbldr_cli.figures.style import Axes, Figure
from usbldr_cli.runs.job_store import Trace, read_trace
from usbldr_cli.runs.seed_table import ComparisonRow

CLOSE_ERRORS = 8.0  # times the largest error: path length of the close-up to either side
WIDTH = 1.4  # [points] of every filter's line: none looks more certain than another
COINCIDE = 0.02  # of the largest error of the two: a line is about as wide in the picture
COINCIDE_PERCENT = 95.0  # [%] of the epochs that have to

Drawn: TypeAlias = tuple[ComparisonRow, Trace]


def error_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw the errors of all methods over one dive, one panel per axis."""
    drawn = first_traces(rows)
    if not drawn:
        return None
    figure = overlay_canvas(rows, "Errors over time", f"{seed_text(rows)}{coincident_text(drawn)}", 11, 7)
    panels: Any = figure.subplots(2, 1, sharex=True)
    for k, axis in enumerate(style.AXES):
        axes: Axes = panels[k]
        sizes = [(row, np.abs(trace.error_m[:, k])) for row, trace in drawn]
        for row, trace in drawn:
            _draw_over_time(axes, rows, row, trace.time_s, trace.error_m[:, k : k + 1])
        half = 1.12 * max(float(np.max(np.abs(trace.error_m[:, k]))) for _, trace in scaling(drawn))
        axes.set_ylim(-half, half)
        axes.axhline(0, color=style.TRUTH_COLOUR, lw=0.8, zorder=2)
        beyond = [row.label for row, size in sizes if float(np.max(size)) > half]
        means = ", ".join(f"{row.label} {float(np.mean(size)):.2f}" for row, size in sizes)
        leaving = f"   ({', '.join(beyond)} partly outside the axes)" if beyond else ""
        axes.set_title(f"{axis}: mean |error| {means} m{leaving}")
        axes.set_ylabel(f"{axis} error [m]")
    style.time_axis(panels[1], *(trace.time_s for _, trace in drawn))
    style.legend_below(figure, (panels[0],), 8)
    return figure


def track_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw all tracks with the truth, and a close-up of the largest error of the best filter."""
    drawn = first_traces(rows)
    if not drawn:
        return None
    detail = f"{seed_text(rows)}; at the scored epochs{coincident_text(drawn)}"
    figure = overlay_canvas(rows, "Tracks", detail, 12.5, 7.3)
    whole, close = figure.subplots(1, 2)
    leader, best = min(scaling(drawn), key=lambda one: float(np.mean(one[1].horizontal_m)))
    worst = int(np.argmax(best.horizontal_m))
    worst_m = best.horizontal_m[worst]
    for axes, span_s in ((whole, style.EVER), (close, _close_up_span(best, worst, CLOSE_ERRORS * worst_m))):
        mark, truth_mark = ("", "") if span_s == style.EVER else (".", "o")
        plane = plane_of(best.truth_m) if span_s == style.EVER else EAST_NORTH
        for row, trace in drawn:
            now = style.within(trace.time_s, span_s)
            _draw_track(axes, rows, row, trace.time_s[now], plane.points(trace.estimate_m[now]), mark)
        now = style.within(best.time_s, span_s)
        _, truth_m = style.broken_at_gaps(best.time_s[now], best.truth_m[now])
        look = {"color": style.TRUTH_COLOUR, "lw": 1.6, "marker": truth_mark, "ms": 5, "mfc": "white", "zorder": 2.5}
        axes.plot(*plane.points(truth_m).T, label="truth", **look)
        points = [trace.estimate_m[style.within(trace.time_s, span_s)] for _, trace in scaling(drawn)]
        frame_plane(axes, plane, np.vstack([*points, best.truth_m[now]]), 0.08)
        if span_s == style.EVER:
            axes.set_title("; ".join(filter(None, ("whole track", plane.text))))
    at_s = best.time_s[worst]
    close.set_title(f"around the largest error of {leader.label}: {worst_m:.2f} m at {at_s:.0f} s")
    style.legend_below(figure, (whole,), 8)
    return figure


def overlay_canvas(rows: Sequence[ComparisonRow], what: str, detail: str, width_in: float, height_in: float) -> Figure:
    """Return a figure whose title says what is drawn, of which log, with which truth."""
    judged = rows[0].scored_against
    parts = [detail]
    if judged is not None:
        parts.append(style.truth_text(judged.truth_kind, judged.truth_source))
        parts.append(f"alignment: {ALIGNMENTS[judged.align]}")
    return style.titled_figure(f"{what}: {rows[0].log}", "; ".join(parts), width_in, height_in)


def first_traces(rows: Sequence[ComparisonRow]) -> list[Drawn]:
    """Return each method's trace of the first seed that all have, else of its own first."""
    seeds = [set(row.good) for row in rows if row.dives]
    common = min(_common(seeds), default=None) if seeds else None
    outcomes = [row.good.get(common) if common is not None else None for row in rows]
    paths = [(row, (found or next(iter(row.good.values()))).trace) for row, found in zip(rows, outcomes, strict=True)]
    return [(row, read_trace(path)) for row, path in paths if path is not None]


def seed_text(rows: Sequence[ComparisonRow]) -> str:
    """Return which run of several is drawn."""
    seeds = [set(row.good) for row in rows if len(row.seeds) > 1]
    if not seeds:
        return "one run of each"
    first = min(_common(seeds), default=None)
    return "the first run of each" if first is None else f"seed {first}"


def scaling(drawn: Sequence[Drawn]) -> Sequence[Drawn]:
    """Return the traces that set the scale: those of filters, if there are any."""
    return [one for one in drawn if filtered(one[0])] or drawn


def filtered(row: ComparisonRow) -> bool:
    """Return whether a row's method is a filter; the errors of the others do not set the scale."""
    return row.method not in METHODS or METHODS[row.method].is_filter


def line_style(rows: Sequence[ComparisonRow], row: ComparisonRow) -> dict[str, Any]:
    """Return colour, and dashes that distinguish rows of one method.

    Tracks without a filter are thin and behind the filters, which are equally wide: `coincident_text` names those that
    hide each other.
    """
    same = [other.label for other in rows if other.method == row.method]
    look = {"color": style.colour(row.method), "ls": ("-", "--", ":", "-.")[same.index(row.label) % 4]}
    if not filtered(row):
        return {**look, "lw": 1.0, "zorder": 2}
    return {**look, "lw": WIDTH, "zorder": 3}


def coincident_text(drawn: Sequence[Drawn]) -> str:
    """Return which filters' tracks coincide, for the line under the title; empty if none do."""
    groups: list[list[Drawn]] = []
    for one in [one for one in drawn if filtered(one[0])]:
        group = next((group for group in groups if _coincide(group[0][1], one[1])), None)
        groups.append([one]) if group is None else group.append(one)
    texts = [", ".join(row.label for row, _ in group) for group in groups if len(group) > 1]
    return "".join(f"; {text} coincide (95 % of the time)" for text in texts)


def _coincide(one: Trace, other: Trace) -> bool:
    if one.estimate_m.shape != other.estimate_m.shape:
        return False
    apart_m = float(np.percentile(np.hypot(*(one.estimate_m - other.estimate_m).T), COINCIDE_PERCENT))
    return apart_m <= COINCIDE * max(float(one.horizontal_m.max()), float(other.horizontal_m.max()))


def _draw_over_time(
    axes: Axes, rows: Sequence[ComparisonRow], row: ComparisonRow, time_s: Vector, values: Array
) -> None:
    if style.raw_fixes(row.method):
        look = {"ls": "", "marker": ".", "ms": 3.5, "alpha": 0.3, "zorder": 1.5}
        axes.plot(time_s, values[:, 0], color=style.colour(row.method), label=row.label, **look)
        return
    t, e = style.broken_at_gaps(time_s, values)
    axes.plot(t, e[:, 0], label=row.label, **line_style(rows, row))


def _draw_track(
    axes: Axes, rows: Sequence[ComparisonRow], row: ComparisonRow, time_s: Vector, position_m: Array, marker: str
) -> None:
    """Draw one track; with a marker at each epoch, errors along the track are visible, too."""
    if style.raw_fixes(row.method):
        look = {"ls": "", "marker": ".", "ms": 4, "alpha": 0.5, "zorder": 1.5}
        axes.plot(*position_m.T, color=style.colour(row.method), label=row.label, **look)
        return
    _, line_m = style.broken_at_gaps(time_s, position_m)
    axes.plot(*line_m.T, label=row.label, marker=marker, ms=5, **line_style(rows, row))


def _close_up_span(trace: Trace, middle: int, reach_m: float) -> tuple[float, float]:
    """Return the times between which the truth is within ``reach_m`` of an epoch along its path."""
    travelled_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trace.truth_m, axis=0).T))])
    near = np.flatnonzero(np.abs(travelled_m - travelled_m[middle]) <= reach_m)
    first, last = max(min(near[0], middle - 1), 0), min(max(near[-1], middle + 1), len(travelled_m) - 1)
    return float(trace.time_s[first]), float(trace.time_s[last])


def _common(seeds: Sequence[set[int]]) -> set[int]:
    return seeds[0].intersection(*seeds[1:])
