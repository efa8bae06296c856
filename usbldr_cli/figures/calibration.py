"""Estimated sensor errors over time: value, 2-sigma band, and the prior.

Angles are degrees clockwise, as in all files; positive if the sensor reads too much.
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

SETTLING = 0.05  # share of the run, at its start, that does not set the scale
PRIOR_COLOUR = "#bbbbbb"


def calibration_figure(run: Run) -> Figure | None:
    """Draw each error with its band; None if none was estimated."""
    errors = estimated_errors(run.scored.trajectory)
    if not errors:
        return None
    figure = run_figure(run, "Sensor errors", 11, 1.3 + 1.75 * len(errors))
    panels: Any = figure.subplots(len(errors), 1, sharex=True, squeeze=False)
    assumed = assumed_sd(run.identification.parameters.errors)
    for axes, error in zip(panels[:, 0], errors, strict=True):
        _draw(axes, run, error, assumed[error.name])
    time_axis(panels[-1, 0], run.timeline.time_s)
    legend_below(figure, (panels[0, 0],))
    return figure


def _draw(axes: Axes, run: Run, error: EstimatedError, before_sd: float) -> None:
    shade_outages(axes, run)
    t, mine = run.scored.trajectory.time_s, colour(run.method)
    low, high = error.value - 2 * error.sd, error.value + 2 * error.sd
    for side, label in ((-2, "2 sigma of the prior"), (2, None)):
        axes.axhline(side * before_sd, color=PRIOR_COLOUR, lw=1.2, ls="--", label=label, zorder=1.5)
    axes.axhline(0, color=TRUTH_COLOUR, lw=0.8, zorder=1.5)
    axes.fill_between(t, low, high, color=mine, alpha=0.2, lw=0, label="2 sigma", zorder=1.8)
    axes.plot(t, error.value, color=mine, lw=1.3, label=run.label, zorder=3)
    after = slice(int(SETTLING * len(t)), None)
    bottom, top = min(0.0, float(np.min(low[after]))), max(0.0, float(np.max(high[after])))
    margin = 0.08 * (top - bottom) or 1.0
    axes.set_ylim(bottom - margin, top + margin)
    axes.set_ylabel(f"[{error.unit}]" if error.unit else "")
    unit = f" {error.unit}" if error.unit else ""
    axes.set_title(
        f"{error.title}: {error.value[-1]:.4f} ± {error.sd[-1]:.4f}{unit} at the end (prior 0 ± {before_sd:.4g}{unit})"
    )
