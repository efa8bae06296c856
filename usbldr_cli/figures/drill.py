"""Figures of drills: the error of each filter over time with the faults shaded, and every drill at a glance."""

import re
from collections.abc import Sequence
from functools import partial

import numpy as np

from usbldr.filters.types import Vector
from usbldr_cli.figures.distance import CROWDED
from usbldr_cli.figures.drawing import Picture
from usbldr_cli.figures.overlay import line_style
from usbldr_cli.figures.style import Axes, Figure, colour, legend_below, logarithmic, time_axis, titled_figure
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow, worst_first
from usbldr_cli.runs.job_store import JobResult, read_trace

FAULT_SHADE = "#fde3cf"
MARKS = ("o", "^", "s", "D")  # of rows of one method
BAR_IN = 0.22  # [inches] height of a filter's line in the overview: one line of text
DETAIL_LETTERS = 200  # of the faults under the title: two lines
NAME_LETTERS = 40  # of a drill in the name of a file


def drill_pictures(report: DrillReport) -> list[Picture]:
    """Return the overview of drills, and the errors under each, the worst first."""
    pictures = [Picture("drills", "Error with the faults over error without them", partial(ratio_figure, report.rows))]
    for k, name in enumerate(dict.fromkeys(row.drill.name for row in worst_first(report.rows))):
        rows = [row for row in report.rows if row.drill.name == name]
        end = re.sub(r"[^\w.-]+", "_", name).strip("_")[:NAME_LETTERS]
        pictures.append(Picture(f"drill-{k + 1:02d}-{end}", f"Horizontal error: {name}", partial(error_figure, rows)))
    return pictures


def error_figure(rows: Sequence[DrillRow]) -> Figure | None:
    """Draw the horizontal error over time of every filter under one drill, thin without the faults, first seed."""
    drawn = [(row, found) for row in rows if (found := first_errors(row)) is not None]
    if not drawn:
        return None
    first = drawn[0][0]
    name, faults = first.drill.name, first.drill.text
    text = faults if name == faults else f"{name}: {faults}"
    detail = f"{text[:DETAIL_LETTERS]}; seed {first.runs.seeds[0]}; thin: the same filters without the faults"
    figure = titled_figure(f"Errors under a drill: {first.runs.log}", detail, 11, 5)
    axes: Axes = figure.subplots()
    for k, (start_s, end_s) in enumerate(first.spans_s):
        axes.axvspan(start_s, end_s, facecolor=FAULT_SHADE, lw=0, zorder=0, label=None if k else "fault")
    times: list[Vector] = []
    sizes: list[Vector] = []
    for row, ((time_s, error_m), (usual_s, usual_m)) in drawn:
        style = line_style([one.runs for one in rows], row.runs)
        axes.plot(time_s, error_m, label=row.runs.label, **style)
        axes.plot(usual_s, usual_m, label=f"_{row.runs.label}", **style | {"lw": 0.8, "alpha": 0.4, "zorder": 2})
        times += [time_s]
        sizes += [error_m, usual_m]
    whole = np.concatenate(sizes)
    if float(whole.max()) > CROWDED * float(np.median(whole)):
        logarithmic(axes, "y", (1, 2, 5))
        axes.set_ylim(bottom=float(np.percentile(whole, 1)))
    else:
        axes.set_ylim(0, 1.08 * float(whole.max()))
    axes.set_ylabel("horizontal error [m]")
    time_axis(axes, *times)
    legend_below(figure, (axes,), 6)
    return figure


def first_errors(row: DrillRow) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]] | None:
    """Return times and horizontal errors of the first seed, with and without the faults."""
    if not row.runs.good or not row.usual.good:
        return None
    seed = next(iter(row.runs.good))
    usual = row.usual.good
    return _lengths(row.runs.good[seed]), _lengths(usual.get(seed) or next(iter(usual.values())))


def _lengths(outcome: JobResult) -> tuple[Vector, Vector]:
    assert outcome.trace is not None  # drills always have a store
    trace = read_trace(outcome.trace)
    return trace.time_s, trace.horizontal_m


def ratio_figure(rows: Sequence[DrillRow]) -> Figure | None:
    """Draw error over undamaged error of every filter under every drill, the worst on top; None for one drill."""
    ordered = worst_first(rows)
    names = list(dict.fromkeys(row.drill.name for row in ordered))
    labels = list(dict.fromkeys(row.runs.label for row in ordered))
    if len(names) < 2 or not any(row.ratio for row in ordered):
        return None
    height_in = 1.6 + BAR_IN * len(names) * max(1.0, 0.5 * len(labels))
    figure = titled_figure(
        f"Drills: {rows[0].runs.log}", "mean error with the faults over that without them", 11, height_in
    )
    axes: Axes = figure.subplots()
    offsets = np.linspace(-0.25, 0.25, len(labels)) if len(labels) > 1 else np.zeros(1)
    for offset, label in zip(offsets, labels, strict=True):
        mine = [(names.index(r.drill.name), r.ratio) for r in ordered if r.runs.label == label and r.ratio is not None]
        if mine:
            y, x = np.array(mine).T
            method = next(row.runs.method for row in rows if row.runs.label == label)
            alike = list(dict.fromkeys(row.runs.label for row in ordered if row.runs.method == method))
            mark = MARKS[alike.index(label) % len(MARKS)]
            axes.plot(x, y + offset, ls="", marker=mark, ms=5, color=colour(method), label=label)
    axes.axvline(1, color="#000000", lw=0.8)
    logarithmic(axes, "x", (1, 2, 5))
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlabel("times the error without the faults (logarithmic)")
    legend_below(figure, (axes,), 8)
    return figure
