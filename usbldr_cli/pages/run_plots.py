"""The interactive figures of a run: the track with truth and fixes, and its errors over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.influence import most_influential
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.types import Array
from usbldr.io.reports.estimate_text import in_unit
from usbldr.io.reports.page import Plot
from usbldr.io.reports.report_json import Run, fix_outcomes, fixes_table
from usbldr.io.reports.tracks import a_point_a_second
from usbldr_cli.figures.plane import usual_box
from usbldr_cli.figures.run_figures import half_height
from usbldr_cli.figures.style import AXES, colour, other_tracks, raw_fixes
from usbldr_cli.figures.track import aligned, scored_truth
from usbldr_cli.pages.plots import (
    ALARM,
    INK,
    SHADES,
    Canvas,
    broken,
    frame,
    framed_by,
    hover,
    legend_below,
    over_time,
    plane,
    shade,
    source,
    stacked,
)

TRACK = Plot(
    "track",
    "Track. Drag to move, choose a tool above to zoom, point at a line or a fix for its numbers, click an entry of the "
    "legend to hide it.",
)
ERRORS = Plot("errors", "Error over time with the band of 2 sigma. Drag to zoom into a span of time.")
CALIBRATION = Plot("calibration", "Estimated sensor errors over time with their bands of 2 sigma.")
MARKS = {"used": "circle", "down-weighted": "circle", "rejected": "x"}  # by outcome of a fix
MARK_SIZE, MANY, SMALL_MARK = 5, 2000, 3  # [pixels], [fixes] from which marks are smaller, [pixels]


def run_plots(run: Run) -> tuple[tuple[Plot, ...], dict[str, Any]]:
    """Return the figures of a run as blocks of its page, and as Bokeh models by their names."""
    drawn: list[tuple[Plot, Any]] = [(TRACK, _track(run))]
    if run.scored.report is not None:
        drawn.append((ERRORS, _errors(run, run.scored.report)))
    if estimated_errors(run.scored.trajectory):
        drawn.append((CALIBRATION, _calibration(run)))
    return tuple(plot for plot, _ in drawn), {plot.name: model for plot, model in drawn}


def _track(run: Run) -> Canvas:
    canvas = plane()
    entries: list[tuple[str, Sequence[Any]]] = []
    framing: list[Any] = []
    for other in other_tracks(run):
        if other.trajectory.method == "dr":
            place = _path(other, other.trajectory)
            line = canvas.line("east", "north", source=place, line_color=colour("dr"), line_width=1, alpha=0.7)
            entries.append(("dr", [line]))
    entries += _fixes(canvas, run)
    if run.truth is not None:
        time_s, truth_m = scored_truth(run)
        shown = a_point_a_second(time_s)
        t, place_m = broken(time_s[shown], truth_m[shown], longest_s=max(run.truth.max_gap_s, 3.0))
        truth = source(time=t, east=place_m[:, 0], north=place_m[:, 1])
        line = canvas.line("east", "north", source=truth, line_width=2.4, alpha=0.85)
        line.glyph.tags = INK
        entries.append((f"truth ({run.truth.kind})", [line]))
        framing.append(canvas.scatter(*usual_box(truth_m).T, alpha=0))
    if not raw_fixes(run.method):
        entries += _own(canvas, run)
        framing += entries[-1][1]
    if framing:
        framed_by(canvas, framing)
    legend_below(canvas, entries)
    return canvas


def _path(scored: Any, track: Any) -> Any:
    shown = a_point_a_second(track.time_s)
    position_m = aligned(scored, track.time_s[shown], track.position_m[shown])
    return source(time=track.time_s[shown], east=position_m[:, 0], north=position_m[:, 1])


def _own(canvas: Canvas, run: Run) -> list[tuple[str, Sequence[Any]]]:
    """Draw the track, which shows its error where it was scored, and the largest error."""
    place = _path(run.scored, run.scored.trajectory)
    line = canvas.line("east", "north", source=place, line_color=colour(run.method), line_width=1.8)
    report = run.scored.report
    if report is None:
        hover(canvas, [line], [("time", "@time{0.0} s"), ("east, north", "@east{0.00}, @north{0.00} m")])
        return [(run.label, [line])]
    rows = {
        "time": report.time_s,
        "east": report.estimate_m[:, 0],
        "north": report.estimate_m[:, 1],
        "error": report.horizontal_m,
    }
    points = canvas.scatter("east", "north", source=source(**rows), size=9, alpha=0)
    reported = [("time", "@time{0.0} s"), ("error", "@error{0.00} m"), ("east, north", "@east{0.00}, @north{0.00} m")]
    hover(canvas, [points], reported)
    worst = int(np.argmax(report.horizontal_m))
    ends = np.stack([report.truth_m[worst], report.estimate_m[worst]])
    largest = canvas.line(ends[:, 0], ends[:, 1], line_width=3)
    spot = canvas.scatter(ends[1:, 0], ends[1:, 1], size=13, marker="diamond", fill_color=None, line_width=2)
    largest.glyph.tags = spot.glyph.tags = ALARM
    text = f"largest error: {report.horizontal_m[worst]:.2f} m at {report.time_s[worst]:.0f} s"
    return [(text, [largest, spot]), (run.label, [line, points])]


def _fixes(canvas: Canvas, run: Run) -> list[tuple[str, Sequence[Any]]]:
    """Draw the fixes by outcome, and rings around those that moved the track most."""
    table = fixes_table(run.timeline, run.scored.trajectory)
    place_m = aligned(run.scored, run.timeline.fix_time_s, run.timeline.fix_m)
    outcomes = fix_outcomes(run.timeline, run.scored.trajectory)
    shift_m = np.hypot(table["shift_east_m"].to_numpy(float), table["shift_north_m"].to_numpy(float))
    innovation_m = np.hypot(table["innovation_east_m"].to_numpy(float), table["innovation_north_m"].to_numpy(float))
    size = MARK_SIZE if len(table) < MANY else SMALL_MARK
    entries: list[tuple[str, Sequence[Any]]] = []
    drawn: list[Any] = []
    for outcome, mark in MARKS.items():
        at = outcomes == outcome
        at = at | ~np.isin(outcomes, list(MARKS)) if outcome == "used" else at
        if not at.any():
            continue
        shown = source(
            fix=np.flatnonzero(at),
            time=table["time_s"].to_numpy(float)[at],
            east=place_m[at, 0],
            north=place_m[at, 1],
            innovation=innovation_m[at],
            shift=shift_m[at],
            outcome=table["outcome"].to_numpy(object)[at].astype(str).tolist(),
        )
        fill = colour("usbl") if outcome == "used" else None
        style = {"marker": mark, "size": size, "line_color": colour("usbl"), "fill_color": fill, "fill_alpha": 0.6}
        drawn.append(canvas.scatter("east", "north", source=shown, line_alpha=0.8, **style))
        drawn[-1].glyph.tags = ALARM if outcome == "rejected" else []
        entries.append((f"fix {outcome} ({int(at.sum())})", drawn[-1:]))
    reported = [
        ("fix @fix", "@outcome at @time{0.0} s"),
        ("innovation", "@innovation{0.00} m"),
        ("shift", "@shift{0.00} m"),
    ]
    hover(canvas, drawn, reported)
    rows = [one.row for one in most_influential(run.scored.trajectory)]
    if rows:
        ring = canvas.scatter(place_m[rows, 0], place_m[rows, 1], size=15, fill_color=None, line_width=1.8)
        ring.glyph.tags = INK
        entries.append((f"the {len(rows)} most influential fixes", [ring]))
    return entries


def _errors(run: Run, report: ErrorReport) -> Any:
    half = half_height(report)
    sd_m = np.full(report.error_m.shape, np.nan) if report.sd_m is None else report.sd_m
    t, error_m, sd_m = broken(report.time_s, report.error_m, sd_m)
    rows = {"time": t, "horizontal": np.hypot(*error_m.T)}
    for k, axis in enumerate(AXES):
        rows |= {axis: error_m[:, k], f"low_{axis}": -2 * sd_m[:, k], f"high_{axis}": 2 * sd_m[:, k]}
    data = source(**rows)
    raw = next((other.report for other in other_tracks(run) if raw_fixes(other.trajectory.method)), None)
    panels: list[Canvas] = []
    for k, axis in enumerate(AXES):
        canvas = over_time(f"{axis} error [m]", panels[0] if panels else None)
        frame(canvas, half)
        entries: list[tuple[str, Sequence[Any]]] = []
        if raw is not None:
            inside = np.abs(raw.error_m[:, k]) <= half
            fixes = source(time=raw.time_s[inside], error=raw.error_m[inside, k])
            points = canvas.scatter("time", "error", source=fixes, size=3, color=colour("usbl"), alpha=0.4)
            entries.append(("raw USBL fix", [points]))
        if report.sd_m is not None:
            band = canvas.varea("time", f"low_{axis}", f"high_{axis}", source=data, color=colour(run.method), alpha=0.2)
            entries.append(("2 sigma", [band]))
        line = canvas.line("time", axis, source=data, line_color=colour(run.method), line_width=1.5)
        if raw_fixes(run.method):
            line.visible = False
            line = canvas.scatter("time", axis, source=data, size=3, color=colour(run.method))
        reported = [
            ("time", "@time{0.0} s"),
            (f"{axis} error", f"@{axis}{{0.00}} m"),
            ("2 sigma", f"@high_{axis}{{0.00}} m"),
        ]
        hover(canvas, [line], [*reported, ("horizontal error", "@horizontal{0.00} m")])
        entries.append((run.label, [line]))
        shade_outages(canvas, run)
        if k == len(AXES) - 1:
            legend_below(canvas, entries, 3)
        panels.append(canvas)
    return stacked(panels)


def shade_outages(canvas: Canvas, run: Run) -> None:
    """Shade the outages of each sensor."""
    for sensor, tone in SHADES.items():
        spans_s = [(one.start_s, one.end_s) for one in run.timeline.outages if one.sensor == sensor]
        shade(canvas, spans_s, tone)


def _calibration(run: Run) -> Any:
    track = run.scored.trajectory
    shown = a_point_a_second(track.time_s)
    panels: list[Canvas] = []
    for error in estimated_errors(track):
        factor, unit = in_unit(error.unit)
        value: Array = factor * error.value[shown]
        two_sd = 2 * factor * error.sd[shown]
        canvas = over_time(f"{error.title} [{unit}]", panels[0] if panels else None, height=200)
        data = source(time=track.time_s[shown], value=value, low=value - two_sd, high=value + two_sd, two_sd=two_sd)
        canvas.varea("time", "low", "high", source=data, color=colour(run.method), alpha=0.2)
        line = canvas.line("time", "value", source=data, line_color=colour(run.method), line_width=1.5)
        hover(canvas, [line], [("time", "@time{0} s"), (error.title, f"@value{{0.0000}} ± @two_sd{{0.0000}} {unit}")])
        panels.append(canvas)
    return stacked(panels)
