"""Every method on the same dive: errors over time, and tracks with the truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from usbldr.filters.evaluation.alignment import ALIGNMENTS
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Array, Vector
from usbldr_cli.figures.style import (
    TRUTH_COLOUR,
    Axes,
    Figure,
    broken_at_gaps,
    colour,
    legend_below,
    time_axis,
    titled_figure,
    truth_text,
)
from usbldr_cli.runs.job_store import Trace, read_trace
from usbldr_cli.runs.seed_table import ComparisonRow

AXES = ("east", "north")
CLOSE_ERRORS = 8.0  # times the largest error: path length of the close-up to either side
WIDE, THIN = 2.4, 0.8  # of the first and the last line: tracks that coincide show as edges
GAP_STEPS = 3.0  # times the usual step: a longer gap breaks the line

Traces = Mapping[str, Trace]  # by label


def error_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw the errors of all methods over one dive, one panel per axis."""
    traces = _first_traces(rows)
    if not traces:
        return None
    figure = overlay_canvas(rows, "Errors over time", f"{_seed_text(rows)}", 11, 7)
    panels: Any = figure.subplots(2, 1, sharex=True)
    for k, axis in enumerate(AXES):
        axes: Axes = panels[k]
        for label, trace in traces.items():
            _draw_over_time(axes, rows, label, trace.time_s, trace.error_m[:, k : k + 1])
        half = 1.12 * max(float(np.max(np.abs(trace.error_m[:, k]))) for trace in scaling_traces(rows, traces).values())
        axes.set_ylim(-half, half)
        axes.axhline(0, color=TRUTH_COLOUR, lw=0.8, zorder=2)
        beyond = [label for label, trace in traces.items() if float(np.max(np.abs(trace.error_m[:, k]))) > half]
        means = ", ".join(f"{label} {float(np.mean(np.abs(t.error_m[:, k]))):.2f}" for label, t in traces.items())
        leaving = f"   ({', '.join(beyond)} partly outside the axes)" if beyond else ""
        axes.set_title(f"{axis}: mean |error| {means} m{leaving}")
        axes.set_ylabel(f"{axis} error [m]")
    time_axis(panels[1], *(t.time_s for t in traces.values()))
    legend_below(figure, (panels[0],), 8)
    return figure


def track_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw all tracks with the truth, and a close-up of the largest error of the best filter."""
    traces = _first_traces(rows)
    if not traces:
        return None
    figure = overlay_canvas(rows, "Tracks", f"{_seed_text(rows)}; at the scored epochs", 12.5, 7.3)
    panels: Any = figure.subplots(1, 2)
    whole, close = panels
    scaling = scaling_traces(rows, traces)
    leader = min(scaling, key=lambda label: float(np.mean(_lengths(scaling[label]))))
    errors_m = _lengths(traces[leader])
    worst = int(np.argmax(errors_m))
    for axes, span_s in ((whole, None), (close, _close_up_span(traces[leader], worst, CLOSE_ERRORS * errors_m[worst]))):
        for label, trace in traces.items():
            during = _during(trace.time_s, span_s)
            _draw_track(
                axes, rows, label, trace.time_s[during], trace.estimate_m[during], "" if span_s is None else "."
            )
        truth = traces[leader]
        during = _during(truth.time_s, span_s)
        _, truth_m = _broken(truth.time_s[during], truth.truth_m[during])
        mark = "" if span_s is None else "o"
        axes.plot(*truth_m.T, color=TRUTH_COLOUR, lw=1.6, marker=mark, ms=5, mfc="white", label="truth", zorder=2.5)
        points = [trace.estimate_m[_during(trace.time_s, span_s)] for trace in scaling.values()]
        _frame(axes, np.vstack([*points, truth.truth_m[during]]))
        axes.set_xlabel("east [m]")
        axes.set_ylabel("north [m]")
        axes.ticklabel_format(useOffset=False)
    whole.set_title("whole track")
    at_s = traces[leader].time_s[worst]
    close.set_title(f"around the largest error of {leader}: {errors_m[worst]:.2f} m at {at_s:.0f} s")
    legend_below(figure, (whole,), 8)
    return figure


def overlay_canvas(rows: Sequence[ComparisonRow], what: str, detail: str, width_in: float, height_in: float) -> Figure:
    """Return a figure whose title says what is drawn, of which log, with which truth."""
    judged = rows[0].scored_against
    parts = [detail]
    if judged is not None:
        parts.append(truth_text(judged.truth_kind, judged.truth_source))
        parts.append(f"alignment: {ALIGNMENTS[judged.align]}")
    return titled_figure(f"{what}: {rows[0].log}", "; ".join(parts), width_in, height_in)


def _first_traces(rows: Sequence[ComparisonRow]) -> dict[str, Trace]:
    """Return each method's trace of the first seed that all have, else of its own first."""
    seeds = [set(row.good) for row in rows if row.dives]
    common = min(_common(seeds), default=None) if seeds else None
    found: dict[str, Trace] = {}
    for row in rows:
        outcome = row.good.get(common) if common is not None else None
        path = (outcome or next(iter(row.good.values()))).trace
        if path is not None:
            found[row.label] = read_trace(path)
    return found


def _seed_text(rows: Sequence[ComparisonRow]) -> str:
    seeds = [set(row.good) for row in rows if len(row.seeds) > 1]
    if not seeds:
        return "one run of each"
    first = min(_common(seeds), default=None)
    return "the first run of each" if first is None else f"seed {first}"


def scaling_traces(rows: Sequence[ComparisonRow], traces: Traces) -> Traces:
    """Return the traces that set the scale: those of filters, if there are any."""
    filters = {label: trace for label, trace in traces.items() if filtered(method_of(rows, label))}
    return filters or traces


def method_of(rows: Sequence[ComparisonRow], label: str) -> str:
    """Return the method of a row."""
    return next(row.method for row in rows if row.label == label)


def filtered(method: str) -> bool:
    """Return whether a method is a filter; the errors of the others do not set the scale."""
    return method not in METHODS or METHODS[method].is_filter


def colour_of(rows: Sequence[ComparisonRow], label: str) -> str:
    """Return the colour of a row's method."""
    return colour(method_of(rows, label))


def line_style(rows: Sequence[ComparisonRow], label: str) -> dict[str, Any]:
    """Return colour, dashes that distinguish rows of one method, and a width that shows coinciding lines.

    Tracks without a filter are thin and behind the filters.
    """
    method = method_of(rows, label)
    same = [row.label for row in rows if row.method == method]
    style = {"color": colour(method), "ls": ("-", "--", ":", "-.")[same.index(label) % 4]}
    if not filtered(method):
        return {**style, "lw": 1.0, "zorder": 2}
    filters = [row.label for row in rows if filtered(row.method)]
    width = np.linspace(WIDE, THIN, len(filters))[filters.index(label)] if len(filters) > 1 else 1.4
    return {**style, "lw": float(width), "zorder": 3}


def _draw_over_time(axes: Axes, rows: Sequence[ComparisonRow], label: str, time_s: Vector, values: Array) -> None:
    if method_of(rows, label) == "usbl":
        style = {"ls": "", "marker": ".", "ms": 3.5, "alpha": 0.3, "zorder": 1.5}
        axes.plot(time_s, values[:, 0], color=colour_of(rows, label), label=label, **style)
        return
    t, e = _broken(time_s, values)
    axes.plot(t, e[:, 0], label=label, **line_style(rows, label))


def _draw_track(
    axes: Axes, rows: Sequence[ComparisonRow], label: str, time_s: Vector, position_m: Array, marker: str = ""
) -> None:
    """Draw one track; with a marker at each epoch, errors along the track are visible, too."""
    if method_of(rows, label) == "usbl":
        style = {"ls": "", "marker": ".", "ms": 4, "alpha": 0.5, "zorder": 1.5}
        axes.plot(*position_m.T, color=colour_of(rows, label), label=label, **style)
        return
    _, line_m = _broken(time_s, position_m)
    axes.plot(*line_m.T, label=label, marker=marker, ms=5, **line_style(rows, label))


def _close_up_span(trace: Trace, middle: int, reach_m: float) -> tuple[float, float]:
    """Return the times between which the truth is within ``reach_m`` of an epoch along its path."""
    travelled_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trace.truth_m, axis=0).T))])
    near = np.flatnonzero(np.abs(travelled_m - travelled_m[middle]) <= reach_m)
    first, last = max(min(near[0], middle - 1), 0), min(max(near[-1], middle + 1), len(travelled_m) - 1)
    return float(trace.time_s[first]), float(trace.time_s[last])


def _during(time_s: Vector, span_s: tuple[float, float] | None) -> Any:
    if span_s is None:
        return np.ones(len(time_s), np.bool_)
    return (time_s >= span_s[0]) & (time_s <= span_s[1])


def _frame(axes: Axes, points_m: Array) -> None:
    """Frame the points in a square: metres are as long east as north."""
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    half = 1.08 * max(float(np.max(np.ptp(points_m, axis=0))) / 2, 0.5)
    axes.set_aspect("equal")
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _broken(time_s: Vector, values: Array) -> tuple[Vector, Array]:
    longest_s = GAP_STEPS * float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    return broken_at_gaps(time_s, values, longest_s)


def _common(seeds: Sequence[set[int]]) -> set[int]:
    return seeds[0].intersection(*seeds[1:])


def _lengths(trace: Trace) -> Vector:
    return np.hypot(*trace.error_m.T)
