"""The interactive figures of comparisons, drills and checks. Metres and seconds."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from usbldr.io.reports.page import Plot
from usbldr_cli.figures.drill import FAULT_SHADE, first_errors
from usbldr_cli.figures.overlay import filtered, first_traces, line_style, scaling, seed_text
from usbldr_cli.figures.style import AXES, colour, raw_fixes
from usbldr_cli.pages.plots import (
    INK,
    Canvas,
    broken,
    categories,
    frame,
    framed_by,
    hover,
    inert,
    legend_below,
    over_time,
    plane,
    shade,
    source,
    stacked,
)
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow, worst_first
from usbldr_cli.runs.job_store import Trace
from usbldr_cli.runs.seed_table import BOUND, ComparisonRow, grouped
from usbldr_cli.tables.check_verdicts import FAILURES, CheckedRow

DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
POINTS = 1000  # [points] of a line in each of many figures: as many as a screen shows
Plots = tuple[tuple[Plot, ...], dict[str, Any]]


def compare_plots(rows: Sequence[ComparisonRow]) -> Plots:
    """Return the figures of a comparison: tracks and errors of each log, as blocks and Bokeh models by name."""
    blocks: list[Plot] = []
    models: dict[str, Any] = {}
    groups = grouped(rows)
    for k, (log, group) in enumerate(groups.items()):
        shown = [row for row in group if row.good and row.method != BOUND]
        drawn = first_traces(shown)
        if not drawn:
            continue
        of = f" on {log}" if len(groups) > 1 else ""
        for name, caption, model in (
            (f"track-{k}", f"Tracks{of}, {seed_text(shown)}. Click an entry of the legend to hide it.", _tracks(drawn)),
            (f"errors-{k}", f"Errors over time{of}, {seed_text(shown)}. Drag to zoom into a span.", _errors(drawn)),
        ):
            blocks.append(Plot(name, caption))
            models[name] = model
    return tuple(blocks), models


def _style(rows: Sequence[ComparisonRow], row: ComparisonRow) -> dict[str, Any]:
    style = line_style(rows, row)
    return {"line_color": style["color"], "line_dash": DASHES[style["ls"]], "line_width": max(style["lw"], 1.2)}


def _tracks(drawn: Sequence[tuple[ComparisonRow, Trace]]) -> Canvas:
    canvas = plane()
    rows = [row for row, _ in drawn]
    best = min(scaling(drawn), key=lambda one: float(np.mean(one[1].horizontal_m)))[1]
    entries: list[tuple[str, Sequence[Any]]] = []
    framing: list[Any] = []
    for row, trace in drawn:
        t, place_m, size_m = broken(trace.time_s, trace.estimate_m, trace.horizontal_m)
        data = source(time=t, east=place_m[:, 0], north=place_m[:, 1], error=size_m)
        if raw_fixes(row.method):
            mark = canvas.scatter("east", "north", source=data, size=4, color=colour(row.method), alpha=0.5)
        else:
            mark = canvas.line("east", "north", source=data, **_style(rows, row))
        hover(canvas, [mark], [(inert(row.label), "@error{0.00} m at @time{0.0} s")])
        entries.append((row.label, [mark]))
        framing += [mark] if filtered(row) else []
    t, truth_m = broken(best.time_s, best.truth_m)
    data = source(time=t, east=truth_m[:, 0], north=truth_m[:, 1])
    line = canvas.line("east", "north", source=data, line_width=1.6, alpha=0.8)
    line.glyph.tags = INK
    framed_by(canvas, [*framing, line])
    legend_below(canvas, [*entries, ("truth", [line])])
    return canvas


def _errors(drawn: Sequence[tuple[ComparisonRow, Trace]]) -> Any:
    rows = [row for row, _ in drawn]
    panels: list[Canvas] = []
    for k, axis in enumerate(AXES):
        canvas = over_time(f"{axis} error [m]", panels[0] if panels else None)
        entries: list[tuple[str, Sequence[Any]]] = []
        for row, trace in drawn:
            t, error_m = broken(trace.time_s, trace.error_m[:, k])
            data = source(time=t, error=error_m)
            if raw_fixes(row.method):
                mark = canvas.scatter("time", "error", source=data, size=3, color=colour(row.method), alpha=0.35)
            else:
                mark = canvas.line("time", "error", source=data, **_style(rows, row))
            hover(canvas, [mark], [(inert(row.label), "@error{0.00} m at @time{0.0} s")])
            entries.append((row.label, [mark]))
        frame(canvas, 1.12 * max(float(np.max(np.abs(trace.error_m[:, k]))) for _, trace in scaling(drawn)) or 1.0)
        if k == len(AXES) - 1:
            legend_below(canvas, entries, 4)
        panels.append(canvas)
    return stacked(panels)


def drill_plots(report: DrillReport) -> Plots:
    """Return the figures of drills: every drill at a glance, and the errors under each, worst first."""
    rows = worst_first(report.rows)
    names = list(dict.fromkeys(row.drill.name for row in rows))
    blocks: list[Plot] = []
    models: dict[str, Any] = {}
    if len(names) > 1 and any(row.ratio for row in rows):
        blocks.append(Plot("drills", "Mean error with the faults over that without them, the worst drill on top."))
        models["drills"] = _ratios(rows, names)
    for k, name in enumerate(names):
        mine = [row for row in rows if row.drill.name == name]
        canvas = _drill(mine)
        if canvas is not None:
            text = "thin: the same filters without the faults; shaded: the faults"
            blocks.append(Plot(f"drill-{k}", f"Horizontal error under {name}; {text}."))
            models[f"drill-{k}"] = canvas
    return tuple(blocks), models


def _ratios(rows: Sequence[DrillRow], names: Sequence[str]) -> Canvas:
    canvas = categories(names, "times the error without the faults", logarithmic=True)
    entries: list[tuple[str, Sequence[Any]]] = []
    for label in dict.fromkeys(row.runs.label for row in rows):
        mine = [row for row in rows if row.runs.label == label and row.ratio]
        if not mine:
            continue
        data = source(ratio=np.array([row.ratio for row in mine]), drill=[inert(row.drill.name) for row in mine])
        dots = canvas.scatter("ratio", "drill", source=data, size=9, color=colour(mine[0].runs.method), alpha=0.85)
        hover(canvas, [dots], [(inert(label), "@ratio{0.00} times under @drill")])
        entries.append((label, [dots]))
    legend_below(canvas, entries, 4)
    return canvas


def _drill(rows: Sequence[DrillRow]) -> Canvas | None:
    drawn = [(row, found) for row in rows if (found := first_errors(row)) is not None]
    if not drawn:
        return None
    canvas = over_time("horizontal error [m]", height=300)
    canvas.xaxis.axis_label = "time since the log's start [s]"
    shade(canvas, drawn[0][0].spans_s, FAULT_SHADE)
    entries: list[tuple[str, Sequence[Any]]] = []
    for row, ((time_s, error_m), (usual_s, usual_m)) in drawn:
        style = _style([one.runs for one in rows], row.runs)
        marks: list[Any] = []
        for t, size_m, look in ((usual_s, usual_m, {"line_width": 0.8, "line_alpha": 0.5}), (time_s, error_m, {})):
            kept = np.unique(np.linspace(0, len(t) - 1, POINTS).astype(int))
            data = source(time=t[kept], error=size_m[kept])
            marks.append(canvas.line("time", "error", source=data, **(style | look)))
        hover(canvas, marks[1:], [(inert(row.runs.label), "@error{0.00} m at @time{0.0} s")])
        entries.append((row.runs.label, marks))
    legend_below(canvas, entries, 4)
    return canvas


def check_plots(checked: Sequence[CheckedRow]) -> Plots:
    """Return the figure of a check: the change of every metric over its limit."""
    reported = [(one.row.name, c) for one in checked for c in one.changes if c.old is not None and c.new is not None]
    reported = [(name, c) for name, c in reported if c.limit > 0]
    if not reported:
        return (), {}
    canvas = categories(list(dict.fromkeys(name for name, _ in reported)), "change of a metric over its limit")
    entries: list[tuple[str, Sequence[Any]]] = []
    for failed, text, mark in ((False, "within the limit, or better", "circle"), (True, "failed", "diamond")):
        mine = [(name, c) for name, c in reported if (c.verdict in FAILURES) == failed]
        if not mine:
            continue
        data = source(
            change=np.array([((c.new or 0.0) - (c.old or 0.0)) / c.limit for _, c in mine]),
            row=[inert(name) for name, _ in mine],
            metric=[c.metric for _, c in mine],
        )
        dots = canvas.scatter("change", "row", source=data, marker=mark, size=9, line_color="#0072b2", fill_alpha=0.2)
        dots.glyph.tags = ["alarm"] if failed else []
        hover(canvas, [dots], [("metric", "@metric"), ("change over limit", "@change{0.00}")])
        entries.append((text, [dots]))
    shade(canvas, [(-1.0, 1.0)], "#7fb873")
    legend_below(canvas, entries)
    return (Plot("metrics", "Change of every metric over its limit, which is shaded; point at a dot for its name."),), {
        "metrics": canvas
    }
