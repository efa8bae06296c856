"""Estimated sensor errors over time: value, 2-sigma band, and the prior.

Angles are degrees clockwise, as in all files; positive if the sensor reads too much.
"""

from typing import Any

import numpy as np

from usbldr.filters.models.calibration import EstimatedError, assumed_sd, estimated_errors
from usbldr.io.reports.estimate_text import error_text, in_unit
from usbldr.io.reports.run import Run
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

SETTLING = 0.05  # share of the run, at its start, whose band does not set the scale
PRIOR_COLOUR = "#bbbbbb"


def calibration_figure(run: Run) -> Figure | None:
    """Draw each error with its band; None if none was estimated."""
    errors = estimated_errors(run.scored.trajectory, run.identification.undecided)
    if not errors:
        return None
    figure = run_figure(run, "Sensor errors", 11, 1.3 + 1.75 * len(errors))
    panels: Any = figure.subplots(len(errors), 1, sharex=True, squeeze=False)
    assumed = assumed_sd(run.identification.parameters.errors)
    for axes, error in zip(panels[:, 0], errors, strict=True):
        _draw(axes, run, error, assumed[error.name])
    time_axis(panels[-1, 0], run.timeline.time_s)
    legend_below(figure, panels[:, 0])
    return figure


def _draw(axes: Axes, run: Run, error: EstimatedError, before_sd: float) -> None:
    shade_outages(axes, run)
    factor, unit = in_unit(error.unit)
    t, mine = run.scored.trajectory.time_s, colour(run.method)
    value, two_sd, prior = factor * error.value, 2 * factor * error.sd, 2 * factor * before_sd
    after = slice(int(SETTLING * len(t)), None)
    course = np.concatenate([[0.0], value, (value - two_sd)[after], (value + two_sd)[after]])
    bottom, top = float(course.min()), float(course.max())
    margin = 0.08 * (top - bottom) or 1.0
    axes.set_ylim(bottom - margin, top + margin)
    shown = "2 sigma of the prior" if bottom - margin < -prior or prior < top + margin else None
    axes.axhline(-prior, color=PRIOR_COLOUR, lw=1.2, ls="--", label=shown, zorder=1.5)
    axes.axhline(prior, color=PRIOR_COLOUR, lw=1.2, ls="--", zorder=1.5)
    axes.axhline(0, color=TRUTH_COLOUR, lw=0.8, zorder=1.5)
    axes.fill_between(t, value - two_sd, value + two_sd, color=mine, alpha=0.2, lw=0, label="2 sigma", zorder=1.8)
    axes.plot(t, value, color=mine, lw=1.3, label=run.label, zorder=3)
    axes.set_ylabel(f"[{unit}]")
    axes.set_title(f"{error_text(error)} at the end (prior 0 ± {factor * before_sd:.3g} {unit})")
