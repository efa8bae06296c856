"""Figures of a survey: the transponder as each fix places it, and what fixes differ from the fitted installation by."""

from functools import partial
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Vector
from usbldr.filters.usbl_survey.calibration import Installation, assumed
from usbldr.filters.usbl_survey.geometry import PLACE, UsblSurvey, placed, residuals, seen_from_head
from usbldr.io.reports.usbl_calibration import Calibration, summary
from usbldr_cli.figures.drawing import Picture
from usbldr_cli.figures.page_data import plot_kinds
from usbldr_cli.figures.plane import frame_square, plane_axes, usual_box
from usbldr_cli.figures.style import REJECTED_COLOUR, Axes, Figure, legend_below, titled_figure

BEFORE_COLOUR, AFTER_COLOUR = "#999999", "#0072b2"
TRACK_COLOUR = "#444444"
RESIDUALS = ("range [m]", "bearing [deg]", "elevation [deg]")
SHOWN_SIGMAS = 8.0  # of the axes of residuals: a false fix lies at the edge


class FittedSurvey(NamedTuple):
    """A survey with its fit, and the report of both."""

    survey: UsblSurvey
    stated: Vector  # (11,) the installation of the configuration
    fit: Installation
    report: Calibration


def survey_pictures(found: FittedSurvey) -> list[Picture]:
    """Return the figures of a survey."""
    pictures = (
        ("transponder", "The transponder as each fix places it", transponder_figure),
        ("survey", "The ship's track and the transponder, and the fixes around the head", survey_figure),
        ("residuals", "Residuals of the fixes after the fit", residual_figure),
        ("polar", "The same around the head, by their bearing", polar_figure),
    )
    return [Picture(name, caption, partial(draw, found)) for name, caption, draw in pictures]


def transponder_figure(found: FittedSurvey) -> Figure:
    """Draw where each fix places the transponder, before and after."""
    survey, fit = found.survey, found.fit
    figure = titled_figure(f"Transponder: {found.report.log.path.name}", summary(found.report), 11, 5.6)
    panels = figure.subplots(1, 2)
    before = placed(survey, assumed(survey, found.stated))[fit.good, :2]
    after = placed(survey, fit.values)[fit.good, :2]
    panels[0].plot(*before.T, ".", color=BEFORE_COLOUR, ms=3, label="as configured")
    shown = {"before and after": np.vstack([before, after]), "after": after}
    for axes, (text, points) in zip(panels, shown.items(), strict=True):
        axes.plot(*after.T, ".", color=AFTER_COLOUR, ms=3, label="calibrated")
        axes.plot(*fit.values[PLACE][:2], "k+", ms=12, mew=1.5, label="fitted place")
        axes.set_title(text)
        plane_axes(axes)
        frame_square(axes, usual_box(points), 0.15)
    legend_below(figure, panels[:1])
    return figure


def survey_figure(found: FittedSurvey) -> Figure:
    """Draw the ship's track around the transponder, and where the fixes lie around the head."""
    survey, fit = found.survey, found.fit
    figure = titled_figure(f"Survey: {found.report.log.path.name}", found.report.measured, 11, 5.6)
    left, right = figure.subplots(1, 2)
    track = survey.ship.positions(survey.time_s, 0.0)
    left.plot(*track.T, color=TRACK_COLOUR, lw=1.0, label="ship's antenna")
    left.plot(*fit.values[PLACE][:2], "k+", ms=12, mew=1.5, label="transponder")
    left.set_title("map")
    plane_axes(left)
    frame_square(left, np.vstack([track, fit.values[PLACE][:2]]), 0.08)
    seen = seen_from_head(survey, fit.values)[:, :2]
    _draw_fixes(right, found, *seen.T)
    right.plot(0, 0, "k^", ms=8, label="head")
    right.set(aspect="equal", title="from the head: all directions are needed")
    right.set(xlabel="starboard [m]", ylabel="forward [m]")
    frame_square(right, np.vstack([seen, [[0.0, 0.0]]]), 0.08)
    legend_below(figure, [left, right])
    return figure


def residual_figure(found: FittedSurvey) -> Figure:
    """Draw the residuals of range, bearing and elevation against bearing, heading, range and time."""
    survey, fit = found.survey, found.fit
    in_degrees = np.array([1.0, np.degrees(1.0), np.degrees(1.0)])
    differences, sds = residuals(survey, fit.values) * in_degrees, fit.noise_sd * in_degrees
    against = {
        "bearing from the head [deg]": np.degrees(survey.bearing_rad) % 360,
        "heading of the ship [deg]": survey.ship.attitudes(survey.time_s)[:, 0] % 360,
        "slant range [m]": survey.range_m,
        "time [min]": survey.time_s / 60,
    }
    detail = (
        "Fixes less what the fitted installation gives; shaded: one sigma. A slope or a wave is an error that stays."
    )
    figure = titled_figure(f"Residuals: {found.report.log.path.name}", detail, 12, 7.5)
    panels = figure.subplots(3, 4, sharex="col", sharey="row")
    for row, (name, sd) in enumerate(zip(RESIDUALS, sds, strict=True)):
        edge = SHOWN_SIGMAS * sd
        for axes, values in zip(panels[row], against.values(), strict=True):
            axes.axhspan(-sd, sd, color="#dddddd", lw=0, zorder=0)
            _draw_fixes(axes, found, values, differences[:, row], edge)
            axes.set_ylim(-edge * 1.05, edge * 1.05)
        panels[row, 0].set_ylabel(name)
    for axes, label in zip(panels[-1], against, strict=True):
        axes.set_xlabel(label)
    legend_below(figure, panels[0, :1])
    return figure


def polar_figure(found: FittedSurvey) -> Figure:
    """Draw the residuals as the distance from a circle, at the bearing of each fix from the head."""
    survey, fit = found.survey, found.fit
    sigmas = residuals(survey, fit.values) / fit.noise_sd
    detail = "Outside the full circle: more than fitted; dashed: one sigma. Around another circle: a constant error."
    figure = titled_figure(f"Residuals by bearing: {found.report.log.path.name}", detail, 12, 4.9)
    panels = figure.subplots(1, 3, sharey=True)
    around, widest = np.radians(np.linspace(0, 360, 181)), 2.1 * SHOWN_SIGMAS
    for axes, name, off in zip(panels, RESIDUALS, sigmas.T, strict=True):
        for radius, style in ((SHOWN_SIGMAS, "-"), (SHOWN_SIGMAS - 1, "--"), (SHOWN_SIGMAS + 1, "--")):
            axes.plot(radius * np.sin(around), radius * np.cos(around), style, color=TRACK_COLOUR, lw=0.8)
        away = SHOWN_SIGMAS + np.clip(off, -SHOWN_SIGMAS, SHOWN_SIGMAS)
        _draw_fixes(axes, found, away * np.sin(survey.bearing_rad), away * np.cos(survey.bearing_rad))
        axes.set(xlim=(-widest, widest), ylim=(-widest, widest), aspect="equal", title=name.split(" [")[0])
        axes.set(xticks=[], yticks=[], xlabel="starboard")
    panels[0].set_ylabel("forward")
    legend_below(figure, list(panels))
    return figure


def _draw_fixes(axes: Axes, found: FittedSurvey, x: Vector, y: Vector, edge: float = np.inf) -> None:
    """Draw the good and the false fixes, those whose y is beyond the edge at the edge."""
    good = found.fit.good
    kinds = (good, AFTER_COLOUR, "good fix"), (~good, REJECTED_COLOUR, "false fix")
    plot_kinds(axes, x, y, kinds, edge, ms=2.5)
