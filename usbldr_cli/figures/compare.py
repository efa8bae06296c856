"""Figures of a comparison: the error of each method over all runs, and overlays of one run."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from usbldr.filters.evaluation.seed_statistics import average
from usbldr.filters.types import Array
from usbldr_cli.figures.distance import CROWDED, box_plot, name_columns
from usbldr_cli.figures.drawing import Picture
from usbldr_cli.figures.overlay import (
    coincident_text,
    error_figure,
    filtered,
    first_traces,
    line_style,
    overlay_canvas,
    track_figure,
)
from usbldr_cli.figures.page_data import detail
from usbldr_cli.figures.style import Axes, Figure, colour, legend_below, logarithmic, titled_figure
from usbldr_cli.runs.job_store import read_trace
from usbldr_cli.runs.seed_table import BOUND, ComparisonRow, grouped

DOTS_WIDE = 0.08  # of the distance between two filters: half the width of a cloud of dots


def compare_pictures(rows: Sequence[ComparisonRow], each_log: bool) -> list[Picture]:
    """Return the figure of all logs of a comparison, and those of each log if it is asked for or there is but one."""
    groups = grouped(rows)
    pictures: list[Picture] = []
    if len(groups) > 1:
        caption = "Mean horizontal error of each filter; a dot is a log"
        pictures.append(Picture("by_log", caption, partial(log_figure, rows)))
    for log, group in groups.items() if each_log else ():
        end = "" if len(groups) == 1 else "-" + re.sub(r"[^\w.-]+", "_", log).strip("_")
        shown = [row for row in group if row.good and row.method != BOUND]
        for name, caption, describe in FIGURES:
            pictures.append(Picture(f"{name}{end}", f"{caption} ({log})", partial(describe, shown)))
    return pictures


def cdf_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw the cumulative distribution of the errors of all runs."""
    pooled = [(row, errors) for row in rows if len(errors := _pooled_errors(row))]
    if not pooled:
        return None
    detail = f"all runs pooled{coincident_text(first_traces(rows))}"
    figure = overlay_canvas(rows, "Distribution of errors", detail, 11, 5.2)
    panels: Any = figure.subplots(1, 3, sharey=True)
    for k, (axes, name) in enumerate(zip(panels, ("|east|", "|north|", "horizontal"), strict=True)):
        longest = 0.0
        for row, errors in pooled:
            length = np.sort(np.hypot(*errors.T) if k == 2 else np.abs(errors[:, k]))
            share = np.arange(1, len(length) + 1) / len(length)
            thin = np.unique(np.linspace(0, len(length) - 1, 2000).astype(int))  # at most 2000 points
            axes.plot(length[thin], 100 * share[thin], label=row.label, **line_style(rows, row))
            if filtered(row) or not any(map(filtered, rows)):
                longest = max(longest, float(np.percentile(length, 99.5)))
        for share in (50, 95):
            axes.axhline(share, color="#999999", lw=0.8, ls=":", zorder=1)
        axes.set_xlim(0, 1.15 * longest)
        axes.set_ylim(0, 101)
        axes.set_xlabel(f"{name} error [m]")
    panels[0].set_ylabel("cumulative share of epochs [%]")
    panels[0].set_yticks([0, 25, 50, 75, 95, 100])
    legend_below(figure, (panels[0],), 8)
    return figure


def log_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw the mean horizontal error of each filter on each log, and their box plot over logs."""
    errors: dict[str, list[tuple[str, float]]] = {}
    for row in rows:
        value = row.mean("mean_horizontal_m") if row.good and row.method != BOUND else None
        if value is not None:
            errors.setdefault(row.label, []).append((row.log, value))
    if not errors:
        return None
    shown = [next(row for row in rows if row.label == label) for label in errors]
    count = len(grouped(rows))
    figure = titled_figure(
        f"Comparison of {count} logs", "a dot is a log; box: quartiles, 5 and 95 % of the logs", 11, 5.2
    )
    axes: Axes = figure.subplots()
    for place, row in enumerate(shown):
        logs, values = zip(*errors[row.label], strict=True)
        at = place + np.linspace(-DOTS_WIDE, DOTS_WIDE, len(values))
        (dots,) = axes.plot(at, values, ls="", marker="o", ms=4, color=colour(row.method), alpha=0.5, mew=0)
        detail(dots, {"log": np.array(logs)}, key=row.label)
        box_plot(axes, place, np.array(values), colour(row.method))
    every = [value for found in errors.values() for _, value in found if value > 0]
    name_columns(axes, list(errors))
    wide = max(every, default=1.0) > CROWDED * min(every, default=1.0)
    if wide:
        logarithmic(axes, "y", (1, 2, 5))
    else:
        axes.set_ylim(0, 1.12 * max(every, default=1.0))
    axes.set_ylabel(f"mean horizontal error [m]{' (logarithmic)' if wide else ''}")
    return figure


def filter_figure(rows: Sequence[ComparisonRow]) -> Figure | None:
    """Draw the mean error of each method: a dot for each run, the mean over runs with its standard error."""
    if not rows:
        return None
    figure = overlay_canvas(rows, "Mean error of each filter", "dots: runs; bar: mean ± 1 standard error", 11, 5.2)
    panels: Any = figure.subplots(1, 3, sharey=True)
    names = (("mean_abs_east_m", "|east|"), ("mean_abs_north_m", "|north|"), ("mean_horizontal_m", "horizontal"))
    every = [value for row in rows for metric, _ in names for value in row.values(metric).values() if value > 0]
    wide = max(every, default=1.0) > CROWDED * min(every, default=1.0)
    for axes, (metric, name) in zip(panels, names, strict=True):
        for x, row in enumerate(rows):
            values = list(row.values(metric).values())
            if not values:
                continue
            mean, se, _ = average(values)
            beside = np.linspace(-DOTS_WIDE, DOTS_WIDE, len(values)) if len(values) > 1 else np.zeros(1)
            face = colour(row.method)
            axes.plot(x + beside, values, ls="", marker="o", ms=4, color=face, alpha=0.45, mew=0, zorder=2)
            axes.errorbar(x, mean, yerr=se, color=face, marker="_", ms=15, mew=2.2, capsize=4, lw=1.4, zorder=3)
            text = f"{mean:.2f}" if mean < 100 else f"{mean:.0f}"
            axes.annotate(text, (x, max(values)), xytext=(0, 6), textcoords="offset points", ha="center", size=9)
        axes.set_title(f"mean {name} error")
        name_columns(axes, [row.label for row in rows])
        if wide:
            logarithmic(axes, "y", (1, 2, 5))
    panels[0].set_ylabel(f"metres{' (logarithmic)' if wide else ''}")
    if wide:
        panels[0].set_ylim(0.7 * min(every), 1.6 * max(every))
    else:
        panels[0].set_ylim(0, 1.12 * max(every, default=1.0))
    return figure


FIGURES: tuple[tuple[str, str, Callable[[Sequence[ComparisonRow]], Figure | None]], ...] = (
    ("by_filter", "Mean error of each filter; a dot is a run", filter_figure),
    ("errors", "East and north error over time", error_figure),
    ("track", "Tracks and truth", track_figure),
    ("error_cdf", "Cumulative distribution of the errors", cdf_figure),
)


def _pooled_errors(row: ComparisonRow) -> Array:
    found = [read_trace(o.trace).error_m for o in row.good.values() if o.trace is not None]
    return np.vstack(found) if found else np.empty((0, 2))
