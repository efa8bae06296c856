"""The errors of sensors that a filter estimated, over time: value, 2-sigma band, and what was assumed before.

Angles are degrees clockwise, as everywhere at the border; positive means that the sensor reads too much.
"""

from typing import Any

import numpy as np

from usbldr.filters.models.calibration import EstimatedError, assumed_sd, estimated_errors
from usbldr.io.reports.report_json import Run
from usbldr_cli.figures.style import (
    TRUTH_COLOUR,
    Axes,
    Figure,
    colour,
    legend_below,
    run_figure,
    shade_outages,
    time_axis,
)

SETTLING = 0.05  # share of the run in which a sigma may still be as wide as before, and sets no scale
PRIOR_COLOUR = "#bbbbbb"


def calibration_figure(run: Run) -> Figure | None:
    """Draw each error with its band; None where none was estimated."""
    errors = estimated_errors(run.scored.trajectory)
    if not errors:
        return None
    figure = run_figure(run, "Errors of sensors", 11, 1.3 + 1.75 * len(errors))
    panels: Any = figure.subplots(len(errors), 1, sharex=True, squeeze=False)
    assumed = assumed_sd(run.log.assumptions.errors)
    for axes, error in zip(panels[:, 0], errors, strict=True):
        _draw(axes, run, error, assumed[error.name])
    time_axis(panels[-1, 0], run.timeline.time_s)
    legend_below(figure, (panels[0, 0],))
    return figure


def _draw(axes: Axes, run: Run, error: EstimatedError, before_sd: float) -> None:
    shade_outages(axes, run)
    t, mine = run.scored.trajectory.time_s, colour(run.method)
    low, high = error.value - 2 * error.sd, error.value + 2 * error.sd
    for side, label in ((-2, "2 sigma before anything was measured"), (2, None)):
        axes.axhline(side * before_sd, color=PRIOR_COLOUR, lw=1.2, ls="--", label=label, zorder=1.5)
    axes.axhline(0, color=TRUTH_COLOUR, lw=0.8, zorder=1.5)
    axes.fill_between(t, low, high, color=mine, alpha=0.2, lw=0, label="2 sigma", zorder=1.8)
    axes.plot(t, error.value, color=mine, lw=1.3, label=run.label, zorder=3)
    settled = slice(int(SETTLING * len(t)), None)
    bottom, top = min(0.0, float(np.min(low[settled]))), max(0.0, float(np.max(high[settled])))
    margin = 0.08 * (top - bottom) or 1.0
    axes.set_ylim(bottom - margin, top + margin)
    axes.set_ylabel(f"[{error.unit}]" if error.unit else "")
    unit = f" {error.unit}" if error.unit else ""
    axes.set_title(
        f"{error.title}: {error.value[-1]:.4f} ± {error.sd[-1]:.4f}{unit} at the end, 0 ± {before_sd:.4g}{unit} before"
    )
