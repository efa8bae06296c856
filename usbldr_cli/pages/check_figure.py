"""The figure of a check: the change of every metric over its limit."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from usbldr_cli.figures.drawing import Picture
from usbldr_cli.figures.page_data import detail
from usbldr_cli.figures.style import REJECTED_COLOUR, Axes, Figure, legend_below, titled_figure
from usbldr_cli.tables.check_verdicts import FAILURES, CheckedRow

HEAD_IN, ROW_IN = 1.7, 0.28  # [inches] of axis and legend, and of a row: a line of text
ALLOWED_COLOUR = "#dcebd8"
KINDS = (("within the limit, or better", "o", "#0072b2"), ("failed", "D", REJECTED_COLOUR))


def change_picture(checked: Sequence[CheckedRow]) -> Picture:
    """Return the figure of a check."""
    caption = "Change of every metric over its limit, which is shaded; point at a dot for its name"
    return Picture("metrics", caption, partial(_change_figure, checked))


def _change_figure(checked: Sequence[CheckedRow]) -> Figure | None:
    found = [
        (one.row.name, c.metric, (c.new - c.old) / c.limit, c.verdict in FAILURES)
        for one in checked
        for c in one.changes
        if c.old is not None and c.new is not None and c.limit > 0
    ]
    if not found:
        return None
    names = list(dict.fromkeys(name for name, *_ in found))
    figure = titled_figure("Check", "change of a metric over its limit", 11, HEAD_IN + ROW_IN * len(names))
    axes: Axes = figure.subplots()
    axes.axvspan(-1, 1, facecolor=ALLOWED_COLOUR, lw=0, zorder=0, label="allowed")
    for failed, (label, marker, colour) in enumerate(KINDS):
        mine = [(change, names.index(name), metric) for name, metric, change, bad in found if bad == bool(failed)]
        if mine:
            x, y, metrics = zip(*mine, strict=True)
            (dots,) = axes.plot(x, y, ls="", marker=marker, ms=6, color=colour, alpha=0.6, label=label)
            detail(dots, {"metric": np.array(metrics)})
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlabel("change of a metric over its limit")
    legend_below(figure, (axes,))
    return figure
