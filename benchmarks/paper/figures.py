"""The pictures of paper.md, in the colours of every other picture of usbldr. Metres and seconds."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter

from paper.runs import COUNTS, GATED, SHARES, SWEPT, Rows, Way, few, shared
from usbldr.filters.bounds.dive_bounds import OF_SIGMA, PositionBound
from usbldr.filters.evaluation.consistency import CONFIDENCE, DOF, nees
from usbldr.filters.evaluation.seed_statistics import average
from usbldr.filters.models.calibration import EstimatedError, estimated_errors
from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Vector
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.figures.overlay import error_figure
from usbldr_cli.figures.style import Axes, Figure, colour, in_style, legend_below, titled_figure
from usbldr_cli.runs.job_store import read_trace
from usbldr_cli.runs.seed_table import ComparisonRow

AXES = (("mean_abs_east_m", "east"), ("mean_abs_north_m", "north"))
DPI = 80  # [dots an inch] readable on a page, some 120 KB a picture
FIRST, OTHERS = {"lw": 1.8, "alpha": 1.0}, {"lw": 0.8, "alpha": 0.6}  # dives of one panel
MARKS = {"cpf": "o", "upf": "D", "pf": "s", "adf": "^", "ekf": "v"}


def write_figures(folder: Path, rows: Rows, sweeps: Path, seeds: int, limits: Mapping[str, PositionBound]) -> None:
    """Draw every picture into a folder; ``limits`` are those of paper-drawn and of paper, with the scale state."""
    folder.mkdir(parents=True, exist_ok=True)
    with in_style():
        pictures = {
            "figure1": _figure1(rows),
            "particles": _particles(rows),
            "outliers": _outliers(rows, sweeps),
            "nees": _nees(rows),
            "scale": _scale(few(seeds)),
            "bound": _bound(rows, limits),
        }
        for name, figure in pictures.items():
            save(figure, folder / f"{name}.png")


def save(figure: Figure, path: Path) -> None:
    """Write a PNG for a page of the documentation, without a version in it."""
    figure.savefig(path, dpi=DPI, metadata={"Software": None}, pil_kwargs={"optimize": True})


def _figure1(rows: Rows) -> Figure:
    """Draw the paper's Figure 1 for our filters: errors over time of one dive."""
    return error_figure([rows["paper", Way(name)] for name in ("pf", "upf", "cpf")])


def _particles(rows: Rows) -> Figure:
    """Draw the error against the number of particles: median over dives, a dot for each dive."""
    subtitle = "paper, 6 states; lines: median over dives, dots: dives; lost ones are drawn at the upper edge"
    figure = titled_figure("Error against the number of particles", subtitle, 11, 5)
    panels: Any = figure.subplots(1, 2, sharey=True)
    top = 3.0
    for axes, (metric, axis) in zip(panels, AXES, strict=True):
        for k, name in enumerate(("pf", "upf", "cpf")):
            values = [list(rows["paper", Way(name, particles=N)].values(metric).values()) for N in COUNTS]
            beside = 1.06 ** (k - 1)  # so that equal values show
            for N, some in zip(COUNTS, values, strict=True):
                dots = {"ls": "", "marker": MARKS[name], "ms": 4, "mew": 0, "alpha": 0.35, "color": colour(name)}
                axes.plot(np.full(len(some), N * beside), np.minimum(some, top), **dots)
            median = [min(average(some).median, top) for some in values]
            axes.plot(np.array(COUNTS) * beside, median, marker=MARKS[name], color=colour(name), label=name)
        adf = average(list(rows["paper", Way("adf")].values(metric).values())).median
        axes.axhline(adf, color=colour("adf"), ls="--", label="adf, one Gaussian")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(COUNTS))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        log_scale(axes)
        axes.set_ylim(0.1, top * 1.05)
        axes.set_xlabel("number of particles N")
        axes.set_title(f"mean |{axis}| error")
    panels[0].set_ylabel("metres (logarithmic)")
    legend_below(figure, panels)
    return figure


def _outliers(rows: Rows, sweeps: Path) -> Figure:
    """Draw the error against the share of readings that have ten times the variance."""
    subtitle = (
        "paper, 6 states; share of readings with ten times the variance, known to all filters; bars: ± 1 standard error"
    )
    figure = titled_figure("Error against the share of outliers", subtitle, 11, 5)
    panels: Any = figure.subplots(1, 2, sharey=True)
    dashes = {"ekf": "-", GATED.label: "--"}
    for axes, (metric, axis) in zip(panels, AXES, strict=True):
        for k, way in enumerate(SWEPT):
            found = [average(list(rows[shared(sweeps, share), way].values(metric).values())) for share in SHARES]
            robust, beside = way.method == "pf", 100 * np.array(SHARES) + 0.5 * (k - 2)
            middle = [one.median if robust else one.mean for one in found]
            bars = None if robust else [one.se or 0.0 for one in found]
            style = {"color": colour(way.method), "marker": MARKS[way.method], "ms": 5, "capsize": 2, "elinewidth": 0.9}
            label = f"{way.label} (median)" if robust else way.label
            axes.errorbar(beside, middle, yerr=bars, label=label, ls=dashes.get(way.label, "-"), **style)
        axes.set_xlabel("share of outliers [%]")
        axes.set_title(f"mean |{axis}| error")
    panels[0].set_ylabel("metres")
    panels[0].set_ylim(0, panels[0].get_ylim()[1])  # both panels have drawn into the shared axis
    legend_below(figure, panels)
    return figure


def _nees(rows: Rows) -> Figure:
    """Draw the NEES of each epoch, averaged over dives, with the band that right covariances keep."""
    ways = (Way("ekf", "scale", gate=0.99), Way("cpf", "scale"), Way("adf", "scale"), Way("adf", "scale", smooth=True))
    count = min(len(rows["paper-drawn", way].good) for way in ways)
    subtitle = (
        f"paper-drawn, + scale; {count} dives; shaded: where {CONFIDENCE:.0%} of averages lie if the sigmas are right"
    )
    figure = titled_figure("NEES over time, averaged over dives", subtitle, 11, 5)
    axes: Axes = figure.subplots()
    low, high = (chi_square_quantile(p, DOF * count) / count for p in ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2))
    axes.axhspan(low, high, color="#dddddd", lw=0, zorder=0)
    axes.axhline(DOF, color="#000000", lw=0.9, zorder=1)
    for way in ways:
        time_s, value = nees_over_time(rows["paper-drawn", way], count)
        style = {"ls": "--", "lw": 1.6} if way.smooth else {"lw": 1.2}
        axes.plot(time_s, value, color=colour(way.method), label=f"{way.label}: {value.mean():.2f}", **style)
        axes.set_xlim(time_s[0], time_s[-1])
    axes.set_ylim(0, None)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("NEES (2 is right)")
    legend_below(figure, (axes,))
    return figure


def nees_over_time(row: ComparisonRow, count: int) -> tuple[Vector, Vector]:
    """Return times and the NEES there, averaged over the first ``count`` dives: (M,) each."""
    traces = [read_trace(outcome.trace) for outcome in list(row.good.values())[:count] if outcome.trace is not None]
    values = [nees(trace.error_m, trace.cov_m2) for trace in traces if trace.cov_m2 is not None]
    return traces[0].time_s, np.mean(values, axis=0)


def _scale(seeds: int) -> Figure:
    """Draw the DVL's scale error as adf and its smoother see it over time."""
    subtitle = f"paper; adf --calibrate scale; {seeds} dives, the band is the filter's own 2 sigma in the first"
    figure = titled_figure("The DVL's scale error, found on the way", subtitle, 11, 5)
    axes: Axes = figure.subplots()
    tracks = [scale_over_time(seed) for seed in range(seeds)]
    time_s, first = tracks[0]
    band = (100 * (first.value - 2 * first.sd), 100 * (first.value + 2 * first.sd))
    axes.fill_between(time_s, *band, color=colour("adf"), alpha=0.2, lw=0, label="2 sigma")
    for k, (_, one) in enumerate(tracks):
        label = ("first dive", "the other dives")[k] if k < 2 else None
        axes.plot(time_s, 100 * one.value, color=colour("adf"), **FIRST if k == 0 else OTHERS, label=label)
    axes.axhline(1.0, color="#000000", lw=1.0, ls="--", label="truth: the DVL reads 1 % too much")
    axes.set_ylim(-1.2, 3.2)
    axes.set_xlim(time_s[0], time_s[-1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("scale error [%]")
    legend_below(figure, (axes,))
    return figure


def scale_over_time(seed: int) -> tuple[Vector, EstimatedError]:
    """Return times and the DVL's scale error as adf sees it on `paper`."""
    log = simulated_log(find_scenario("paper"), seed)
    line = timeline(log)
    track = run("adf", line, replace(log.parameters, calibrate=("scale",)), FilterSettings())
    return track.time_s, next(one for one in estimated_errors(track) if one.name == "dvl_scale")


def _bound(rows: Rows, limits: Mapping[str, PositionBound]) -> Figure:
    """Draw the error over time beside the least one: where it is a bound, and where it may be beaten."""
    subtitle = "adf + scale; |error| averaged over dives and 20 s; bound: mean |error| of the least sigma, .798 of it"
    figure = titled_figure("Error over time and the Cramér-Rao bound", subtitle, 11, 7)
    panels: Any = figure.subplots(2, 2, sharex=True, sharey=True)
    for down, (log, limit) in enumerate(limits.items()):
        for across, axis in enumerate(("east", "north")):
            axes = panels[down][across]
            assumed = log == "paper"
            for smooth in (False, True):
                row = rows[log, Way("adf", "scale", smooth=smooth)]
                time_s, mean = mean_error_over_time(row, across)
                label = f"adf{' --smooth' if smooth else ''}"
                axes.plot(time_s, mean, color=colour("adf"), ls=":" if smooth else "-", lw=1.8, label=label)
                least = (limit.smoother_sd_m if smooth else limit.filter_sd_m)[:, across]
                what = "for the assumed Q, may be beaten" if assumed else "PCRLB"
                label = f"{'smoother' if smooth else 'filter'}: {what}"
                style = {"color": "#000000" if not smooth else "#777777", "ls": "--" if assumed else "-", "lw": 1.3}
                axes.plot(limit.time_s, OF_SIGMA * least, label=label, **style)
            dives = len(rows[log, Way("adf", "scale")].good)
            axes.set_title(f"{log}, {axis} ({dives} dives, smoother {len(row.good)})")
            axes.set_ylim(0, 0.3)
            axes.set_xlim(0, limit.time_s[-1])
    for axes in panels[1]:
        axes.set_xlabel("time [s]")
    for axes in panels[:, 0]:
        axes.set_ylabel("mean |error| [m]")
    legend_below(figure, panels.ravel(), 3)
    return figure


def mean_error_over_time(row: ComparisonRow, axis: int, window: int = 20) -> tuple[Vector, Vector]:
    """Return times and |error| of one axis averaged over dives and over windows of so many epochs."""
    traces = [read_trace(outcome.trace) for outcome in row.good.values() if outcome.trace is not None]
    size: Array = np.mean([np.abs(trace.error_m[:, axis]) for trace in traces], axis=0)
    whole = len(size) // window * window
    return traces[0].time_s[:whole].reshape(-1, window).mean(axis=1), size[:whole].reshape(-1, window).mean(axis=1)


def log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with 1, 2 and 5 of each decade."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
