"""How far fixes lie from a track that leaves each of them out, against bearing, range and heading."""

import numpy as np

from usbldr.filters.evaluation.fix_statistics import sight
from usbldr.filters.types import Array, Vector
from usbldr.io.reports.run import Run, fix_outcomes
from usbldr_cli.figures import style
from usbldr_cli.figures.page_data import plot_kinds
from usbldr_cli.figures.style import Axes, Figure

SECTORS = 12  # of a turn, and of the ranges: the mean of each is a mark
LEAST_MARKED = 5  # [fixes] of a mean
MEAN_COLOUR = "#000000"
NOT_USED = "not fully used (at the edge: farther away)"
HEADING, BEARING = ANGLES = "heading of the vehicle [deg]", "bearing from the head [deg]"


def fix_figure(run: Run) -> Figure | None:
    """Draw what fixes differ from the track by, in range and bearing if their head is known, else east and north."""
    residual_m, statistics = run.fix_residuals_m, run.fix_statistics
    if residual_m is None or statistics is None:
        return None
    line, track = run.timeline, run.scored.trajectory
    good = fix_outcomes(line, track) == "used"
    shown, against = _axes(run, residual_m)
    detail = "a fix less the smoothed track without it" if track.smoothed else "a fix less the track from earlier ones"
    detail += "; marks are means: a slope or a wave is an error of the head's heading, of the scale or of a lever arm"
    figure = style.titled_figure(f"Fixes: {run.label} on {run.log.path.name}", detail, 12, 5.6)
    panels = figure.subplots(len(shown), len(against), sharex="col", sharey="row", squeeze=False)
    for row, (label, values) in enumerate(shown.items()):
        usual = np.abs(values[good & np.isfinite(values)])
        half = 1.12 * style.usual_most(usual) if len(usual) and usual.max() > 0 else 1.0
        for column, (name, where) in enumerate(against.items()):
            axes: Axes = panels[row, column]
            once = "" if row == column == 0 else "_"  # in the legend
            kinds = (good, style.colour("usbl"), f"{once}used"), (~good, style.REJECTED_COLOUR, f"{once}{NOT_USED}")
            plot_kinds(axes, where, values, kinds, style.EDGE * half, ms=5, mew=0, alpha=0.6)
            _draw_means(axes, where, values, good, f"{once}mean")
            axes.axhline(0, color="#444444", lw=0.8, zorder=1)
            axes.set_ylim(-half, half)
            if column == 0:
                axes.set_ylabel(label)
            if row == len(shown) - 1:
                axes.set_xlabel(name)
            if name in ANGLES:
                axes.set_xlim(0, 360)
                axes.set_xticks(range(0, 361, 90))
    style.legend_below(figure, (panels[0, 0],))
    return figure


def _axes(run: Run, residual_m: Array) -> tuple[dict[str, Vector], dict[str, Vector]]:
    """Return the residuals by their label, and what they are drawn against."""
    line, track = run.as_used, run.scored.trajectory
    yaw = track.state("psi")
    against: dict[str, Vector] = {}
    if yaw is not None:
        against[HEADING] = np.degrees(-np.interp(line.fix_time_s, track.time_s, yaw)) % 360
    if line.fix_away_m is None:
        east_m, north_m = residual_m.T
        return {"residual east [m]": east_m, "residual north [m]": north_m}, against | {"time [s]": line.fix_time_s}
    to_track = line.fix_away_m - residual_m
    reach, *axes = sight(to_track)
    along, across = (np.sum(residual_m * axis, axis=1) for axis in axes)
    places = {BEARING: np.degrees(np.arctan2(to_track[:, 0], to_track[:, 1])) % 360, "horizontal range [m]": reach}
    return {"residual in range [m]": along, "residual in bearing [deg]": across}, places | against


def _draw_means(axes: Axes, where: Vector, values: Vector, good: Array, label: str) -> None:
    kept = good & np.isfinite(values) & np.isfinite(where)
    if not kept.any():
        return
    low, high = float(where[kept].min()), float(where[kept].max())
    sector = np.minimum(((where[kept] - low) / max(high - low, 1e-9) * SECTORS).astype(int), SECTORS - 1)
    count = np.bincount(sector, minlength=SECTORS)
    mean = [np.bincount(sector, one[kept], SECTORS) / np.maximum(count, 1) for one in (where, values)]
    there = count >= LEAST_MARKED
    axes.plot(mean[0][there], mean[1][there], "o", color=MEAN_COLOUR, ms=4.5, label=label)
