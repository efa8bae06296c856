"""The horizontal error against the distance travelled, and its spread in box plots."""

from typing import Any

import numpy as np

from usbldr.filters.evaluation.metrics import distance_m
from usbldr.filters.types import Vector
from usbldr.io.reports.run import Run
from usbldr_cli.figures import style
from usbldr_cli.figures.page_data import plot_inside
from usbldr_cli.figures.style import Axes, Figure

WHISKERS = (5.0, 95.0)  # [%] of the errors between the ends of a box plot
CROWDED = 20.0  # largest over smallest error from which its axis is logarithmic
LEAST_M = 1e-3  # [m] of an error on a logarithmic axis


def distance_figure(run: Run) -> Figure | None:
    """Draw each track's horizontal error over the way of the truth, and box plots; None without truth."""
    report = run.scored.report
    if report is None:
        return None
    figure = style.run_figure(run, "Errors against distance", 12, 4.9)
    left, right = figure.subplots(1, 2, width_ratios=(2.6, 1))
    reports = [*(other.report for other in style.other_tracks(run) if other.report is not None), report]
    way_m = distance_m(report.truth_m)
    top = 1.12 * style.usual_most(report.horizontal_m) or 1.0
    for other in reports:
        at_m = np.interp(other.time_s, report.time_s, way_m)
        more = " (at the edge: larger)" if np.any(other.horizontal_m > style.EDGE * top) else ""
        look: dict[str, Any] = {"color": style.colour(other.method), "label": f"{other.label}{more}"}
        if style.raw_fixes(other.method):
            error_m = other.horizontal_m
            look |= {"ls": "", "marker": ".", "ms": 3.5, "mew": 0, "alpha": 0.55}
        else:
            columns = np.column_stack([at_m, other.horizontal_m])
            at_m, error_m = style.broken_at_gaps(other.time_s, columns)[1].T
            look["lw"] = 1.5 if other is report else 1.0
        plot_inside(left, at_m, error_m, (0.0, style.EDGE * top), **look)
    left.set_xlim(0, way_m[-1] or 1.0)
    left.set_ylim(0, top)
    left.set_xlabel("distance travelled by the truth [m]")
    left.set_ylabel("horizontal error [m]")
    _draw_boxes(right, {other.label: (style.colour(other.method), other.horizontal_m) for other in reversed(reports)})
    style.legend_below(figure, (left,))
    return figure


def _draw_boxes(axes: Axes, errors: dict[str, tuple[str, Vector]]) -> None:
    medians = [float(np.median(error_m)) for _, error_m in errors.values()]
    for place, (face, error_m) in enumerate(errors.values()):
        box_plot(axes, place, np.maximum(error_m, LEAST_M), face)
    if max(medians) > CROWDED * max(min(medians), LEAST_M):
        style.logarithmic(axes, "y", (1, 2, 5))
    else:
        axes.set_ylim(bottom=0)
    name_columns(axes, list(errors))
    axes.set_ylabel("horizontal error [m]")
    axes.set_title("median, quartiles, 5 and 95 %")


def name_columns(axes: Axes, names: list[str]) -> None:
    """Name columns at 0, 1, ... of the horizontal axis; many letters are turned."""
    axes.set_xticks(range(len(names)), names, rotation=30 if sum(map(len, names)) > 30 else 0)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.grid(visible=False, axis="x")


def box_plot(axes: Axes, place: int, values: Vector, face: str) -> None:
    """Draw median, quartiles and the ends of WHISKERS of values at a place of the horizontal axis."""
    parts = {name: {"color": face, "lw": 1.5} for name in ("boxprops", "whiskerprops", "capprops")}
    median = {"color": style.TRUTH_COLOUR, "lw": 1.5}
    given = {"whis": WHISKERS, "showfliers": False, "manage_ticks": False}
    axes.boxplot([values], positions=[place], widths=0.5, medianprops=median, **given, **parts)
