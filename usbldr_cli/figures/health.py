"""Figures of a filter's health: innovations and NIS of each sensor, sensor errors, particles."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.models.calibration import EstimatedError, assumed_sd, estimated_errors
from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.types import OUTCOMES, Array, Vector
from usbldr.filters.updates import UpdateTable
from usbldr.io.reports.estimate_text import error_text, in_unit
from usbldr.io.reports.run import Run
from usbldr_cli.figures import style
from usbldr_cli.figures.page_data import plot_inside
from usbldr_cli.figures.style import Axes, Figure

DENSE = 3000  # [points] from which they are drawn smaller
MOST_BANDS = 3000  # [points] of a band: three for each dot of its panel
DOWN_WEIGHTED_COLOUR = "#333333"
BINS = 60  # of the running mean of NIS over the whole run
RESAMPLED_BELOW = 0.5  # fixed: ESS / N at which the particle filters resample
SETTLING = 0.05  # share of the run, at its start, whose band does not set the scale
PRIOR_COLOUR = "#bbbbbb"


class Channel(NamedTuple):
    """One axis of a sensor as it is drawn: in degrees clockwise if the filter has radians counter-clockwise."""

    sensor: str
    axis: str
    label: str
    factor: float
    scalar: int = 0  # of the update


CHANNELS = (
    Channel("usbl", "position", "USBL east [m]", 1.0),
    Channel("usbl", "position", "USBL north [m]", 1.0, 1),
    Channel("compass", "yaw", "heading [deg]", -math.degrees(1.0)),
    Channel("dvl", "starboard", "DVL starboard [m/s]", 1.0),
    Channel("dvl", "forward", "DVL forward [m/s]", 1.0),
)


class Series(NamedTuple):
    """The innovations of one channel over time, (n,) each."""

    time_s: Vector
    innovation: Vector
    sd: Vector
    nominal_sd: Vector
    outcome: NDArray[np.uint8]  # index into OUTCOMES: words would need 50 times the memory


def innovation_figure(run: Run) -> Figure | None:
    """Draw measured minus predicted of every axis to the left, NIS of its sensor to the right."""
    updates = UpdateTable.of(run.scored.trajectory.updates)
    drawn = [(channel, series) for channel in CHANNELS if len((series := _series(updates, channel)).time_s)]
    if not drawn:
        return None
    sensors = list(dict.fromkeys(channel.sensor for channel, _ in drawn))
    what = "Innovations and NIS of the forward pass" if run.scored.trajectory.smoothed else "Innovations and NIS"
    figure = style.run_figure(run, what, 13, 1.0 + 1.75 * len(drawn))
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2))
    rows: Any = left.subplots(len(drawn), 1, sharex=True, squeeze=False)
    for axes, (channel, series) in zip(rows[:, 0], drawn, strict=True):
        _draw_innovations(axes, run, channel, series)
    rows[0, 0].set_title("innovations (measured minus predicted) and 2 sigma; larger ones are drawn at the edge")
    heights = [sum(channel.sensor == sensor for channel, _ in drawn) for sensor in sensors]
    tall: Any = right.subplots(len(sensors), 1, sharex=True, squeeze=False, height_ratios=heights)
    for axes, sensor in zip(tall[:, 0], sensors, strict=True):
        _draw_nis(axes, run, updates, sensor)
    for axes in (rows[-1, 0], tall[-1, 0]):
        style.time_axis(axes, run.timeline.time_s)
    style.legend_below(figure, (rows[0, 0], tall[0, 0]), 8)
    return figure


def _series(updates: UpdateTable, channel: Channel) -> Series:
    mine, scalar = updates.of_sensor(channel.sensor), channel.scalar
    here = mine.axis == channel.axis
    part = (mine.last if scalar else mine.first)[here]  # that of north if it was taken by itself
    e, sd, nominal_sd = (mine.vectors(name)[here, scalar] for name in ("innovation", "innovation_sd", "nominal_sd"))
    k = abs(channel.factor)
    return Series(mine.time_s[here], channel.factor * e, k * sd, k * nominal_sd, mine.parts.outcome[part])


def _draw_innovations(axes: Axes, run: Run, channel: Channel, series: Series) -> None:
    style.shade_outages(axes, run)
    mine = style.colour(run.method)
    outcomes = series.outcome
    half = _half_height(series)
    point = 3.0 if len(outcomes) < DENSE else 1.6
    longest_s = 20 * float(np.median(np.diff(series.time_s))) if len(outcomes) > 1 else np.inf
    t, bands = style.broken_at_gaps(series.time_s, 2 * np.column_stack([series.sd, series.nominal_sd]), longest_s)
    t, bands = thinned(t, bands)
    axes.fill_between(t, -bands[:, 0], bands[:, 0], color=mine, alpha=0.18, lw=0, label="2 sigma, outliers included")
    if not np.allclose(series.sd, series.nominal_sd):
        look = {"color": mine, "alpha": 0.4, "lw": 0, "label": "2 sigma without outliers"}
        axes.fill_between(t, -bands[:, 1], bands[:, 1], **look)
    styles: dict[str, dict[str, Any]] = {
        "used": {"marker": "o", "ms": point, "mew": 0, "color": mine, "alpha": 0.6},
        "down-weighted": {
            "marker": "o",
            "ms": point,
            "mfc": "none",
            "mec": DOWN_WEIGHTED_COLOUR,
            "mew": 0.6,
            "alpha": 0.8,
        },
        "rejected": {"marker": "x", "ms": point + 1, "color": style.REJECTED_COLOUR, "mew": 0.7, "alpha": 0.7},
    }
    for outcome, look in styles.items():
        at = outcomes == OUTCOMES.index(outcome)
        if at.any():
            limits = -style.EDGE * half, style.EDGE * half
            plot_inside(axes, series.time_s[at], series.innovation[at], limits, ls="", label=outcome, **look)
    axes.axhline(0, color=style.TRUTH_COLOUR, lw=0.8)
    axes.set_ylim(-half, half)
    axes.set_ylabel(channel.label)


def thinned(t: Vector, bands: Array) -> tuple[Vector, Array]:
    """Return the largest of neighbouring bands, (n, 2), so that few are drawn; gaps, which are NaN, stay."""
    last = len(t) - 1
    if last < MOST_BANDS:
        return t, bands
    gaps = np.flatnonzero(np.isnan(bands[:, 0]))
    kept = np.arange(0, last, -(-last // MOST_BANDS)), gaps, np.minimum(gaps + 1, last), [last]
    first = np.unique(np.concatenate(kept))
    return t[first], np.maximum.reduceat(bands, first, axis=0)


def _half_height(series: Series) -> float:
    """Return the height of the axes, which innovations of the updates used set, and their sigma without outliers."""
    used = series.outcome == OUTCOMES.index("used")
    size = np.abs(series.innovation[used] if used.any() else series.innovation)
    sd = float(np.median(series.nominal_sd))
    half = min(float(size.max()), max(float(np.percentile(size, 97)), 4 * sd))
    return 1.1 * max(half, 2.2 * sd) or 1.0


def _draw_nis(axes: Axes, run: Run, updates: UpdateTable, sensor: str) -> None:
    """Draw each NIS faintly and its mean over a sixtieth of the run with its chi-square bounds."""
    style.shade_outages(axes, run)
    parts = updates.parts
    taken = (parts.sensor == updates.names.index(sensor)) & np.isfinite(parts.nis)
    t, nis = parts.time_s[taken], parts.nis[taken]
    if not len(t):
        return
    dof = float(parts.dof[taken].mean())
    mine = style.colour(run.method)
    ends = float(run.timeline.time_s[0]), float(run.timeline.time_s[-1])
    edges = np.linspace(*ends, min(BINS, max(1, len(t) // 10)) + 1)
    bins = bin_means(t, nis, edges)
    low, high = 0.01 * dof, max(20 * dof, 1.5 * float(np.nanmax(bins[:, 1])))
    plot_inside(axes, t, nis, (low, high), ls="", marker=".", ms=1.5, color=mine, alpha=0.25)
    axes.axhline(dof, color=style.TRUTH_COLOUR, lw=0.8)
    draw_bounds(axes, edges, mean_bounds(bins[:, 2], dof), "95 % bounds of the mean NIS")
    axes.plot(bins[:, 0], bins[:, 1], color=mine, marker="o", ms=3)
    style.logarithmic(axes)  # shows outliers of hundreds, values near 0, and the means
    axes.set_ylim(low, high)
    axes.set_ylabel(f"NIS, {sensor}")
    axes.set_title(
        f"NIS of {sensor}: mean {nis.mean():.2f} (expected {dof:.0f}); line: {edges[1] - edges[0]:.0f} s means"
    )


def draw_bounds(axes: Axes, edges: Vector, bounds: tuple[Vector, Vector], label: str) -> None:
    """Draw two bounds between edges as lines: a shade is an outage."""
    for bound, name in zip(bounds, (label, f"_{label}"), strict=True):
        axes.plot(edges, bound, drawstyle="steps-post", color="#444444", ls=":", lw=0.9, label=name)


def bin_means(t: Vector, nis: Vector, edges: Vector) -> Array:
    """Return middle, mean and count of each bin, (B, 3); an empty bin has no mean."""
    bins = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bins, minlength=len(edges) - 1)
    total = np.bincount(bins, nis, minlength=len(edges) - 1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.column_stack([(edges[1:] + edges[:-1]) / 2, mean, count.astype(np.float64)])


def mean_bounds(count: Vector, dof: float) -> tuple[Vector, Vector]:
    """Return the 95 % bounds of the mean of ``count`` independent chi-square values, one more so that steps end."""
    low, high = np.full(len(count) + 1, np.nan), np.full(len(count) + 1, np.nan)
    for k, n in enumerate(count):
        if n > 0:
            low[k], high[k] = (chi_square_quantile(p, n * dof) / n for p in (0.025, 0.975))
    low[-1], high[-1] = low[-2], high[-2]
    return low, high


def particle_figure(run: Run) -> Figure | None:
    """Draw the effective share of the particles and the acceptance of their moves; None for a single Gaussian."""
    trajectory = run.scored.trajectory
    if trajectory.ess is None or trajectory.particles < 2:
        return None
    moved = trajectory.acceptance is not None and bool(np.isfinite(trajectory.acceptance).any())
    figure = style.run_figure(run, "Particles", 11, 5.6 if moved else 3.8)
    panels: Any = figure.subplots(2 if moved else 1, 1, sharex=True, squeeze=False)
    mine, t = style.colour(run.method), trajectory.time_s
    top: Axes = panels[0, 0]
    style.shade_outages(top, run)
    share = trajectory.ess / trajectory.particles
    top.plot(t, share, color=mine, lw=0.7, label="ESS / N")
    top.axhline(RESAMPLED_BELOW, color=style.TRUTH_COLOUR, lw=0.8, ls="--", label="resampling below")
    top.set_ylim(0, 1.02)
    top.set_ylabel("ESS / N")
    lowest = float(np.nanmin(share))
    top.set_title(
        f"effective share of N = {trajectory.particles} particles: mean {np.nanmean(share):.2f}, lowest {lowest:.2f}"
    )
    if moved and trajectory.acceptance is not None:
        low: Axes = panels[1, 0]
        style.shade_outages(low, run)
        low.plot(t, trajectory.acceptance, ls="", marker=".", ms=3, color=mine, alpha=0.6)
        low.set_ylim(0, 1.02)
        low.set_ylabel("accepted share")
        low.set_title(f"accepted moves of resampled particles: mean {np.nanmean(trajectory.acceptance):.2f}")
    style.time_axis(panels[-1, 0], t)
    style.legend_below(figure, (top,))
    return figure


def calibration_figure(run: Run) -> Figure | None:
    """Draw each error with its band; None if none was estimated."""
    errors = estimated_errors(run.scored.trajectory, run.identification.undecided)
    if not errors:
        return None
    figure = style.run_figure(run, "Sensor errors", 11, 1.3 + 1.75 * len(errors))
    panels: Any = figure.subplots(len(errors), 1, sharex=True, squeeze=False)
    assumed = assumed_sd(run.identification.parameters.errors)
    for axes, error in zip(panels[:, 0], errors, strict=True):
        _draw(axes, run, error, assumed[error.name])
    style.time_axis(panels[-1, 0], run.timeline.time_s)
    style.legend_below(figure, panels[:, 0])
    return figure


def _draw(axes: Axes, run: Run, error: EstimatedError, before_sd: float) -> None:
    style.shade_outages(axes, run)
    factor, unit = in_unit(error.unit)
    t, mine = run.scored.trajectory.time_s, style.colour(run.method)
    value, two_sd, prior = factor * error.value, 2 * factor * error.sd, 2 * factor * before_sd
    after = slice(int(SETTLING * len(t)), None)
    course = np.concatenate([[0.0], value, (value - two_sd)[after], (value + two_sd)[after]])
    bottom, top = float(course.min()), float(course.max())
    margin = 0.08 * (top - bottom) or 1.0
    axes.set_ylim(bottom - margin, top + margin)
    shown = "2 sigma of the prior" if bottom - margin < -prior or prior < top + margin else None
    axes.axhline(-prior, color=PRIOR_COLOUR, lw=1.2, ls="--", label=shown, zorder=1.5)
    axes.axhline(prior, color=PRIOR_COLOUR, lw=1.2, ls="--", zorder=1.5)
    axes.axhline(0, color=style.TRUTH_COLOUR, lw=0.8, zorder=1.5)
    axes.fill_between(t, value - two_sd, value + two_sd, color=mine, alpha=0.2, lw=0, label="2 sigma", zorder=1.8)
    axes.plot(t, value, color=mine, lw=1.3, label=run.label, zorder=3)
    axes.set_ylabel(f"[{unit}]")
    axes.set_title(f"{error_text(error)} at the end (prior 0 ± {factor * before_sd:.3g} {unit})")
