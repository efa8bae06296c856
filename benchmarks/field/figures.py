"""The pictures of field.md, one set for each log, in the style of every other picture of usbldr."""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from PIL import Image

from field.changes import CHANGES
from field.goals import SMOOTHED
from field.logs import CASES, Case, dive, truth_for
from field.plan import AUTO, BEST, GATED, Cell, Rows, online
from field.runs import told_to_the_filter
from paper.runs import Way
from usbldr.filters.evaluation.consistency import DOF, nees
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.replay.methods import find_anchor, track
from usbldr.filters.types import Vector
from usbldr.io.reports.report_json import Run, ScoredTrack
from usbldr_cli.figures.calibration import calibration_figure
from usbldr_cli.figures.health import innovation_figure
from usbldr_cli.figures.run_figures import error_figure
from usbldr_cli.figures.style import Axes, Figure, colour, in_style, legend_below, titled_figure
from usbldr_cli.figures.track import track_figure
from usbldr_cli.runs.job_store import read_trace

RUN_PICTURES: Mapping[str, Callable[[Run], Figure | None]] = {
    "track": track_figure,
    "errors": error_figure,
    "calibration": calibration_figure,
    "innovations": innovation_figure,
}
WINDOW_S = 60  # over which NEES is averaged
LARGEST_BYTES, COLOURS = 150_000, 120
RESOLUTIONS = (95, 85, 75, 65, 55)  # dots an inch


def draw_run(name: str, change: str, folder: Path, output: Path) -> list[str]:
    """Draw a run of adf on a log as its vehicle could have had it; return the names of the files."""
    case = CASES[name]
    run = online_run(case, change, folder)
    written = []
    with in_style():
        for what, draw in RUN_PICTURES.items():
            figure = draw(run)
            if figure is not None:
                written.append(f"{_stem(name, change)}_{what}.png")
                save_small(figure, output / written[-1])
    return written


def save_small(figure: Figure, path: Path) -> None:
    """Write a PNG of few colours at the finest resolution that keeps it small."""
    small = b""
    for dpi in RESOLUTIONS:
        drawn, packed = io.BytesIO(), io.BytesIO()
        figure.savefig(drawn, dpi=dpi, metadata={"Software": None})
        few = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(packed, "PNG", optimize=True)
        small = packed.getvalue()
        if len(small) < LARGEST_BYTES:
            break
    path.write_bytes(small)


def online_run(case: Case, change: str, folder: Path) -> Run:
    """Return adf on a log with what people do without a filter beside it, by the log's last definition."""
    given, definition, way = dive(case.name, 0, folder), case.definitions[-1], replace(BEST, order=online(case))
    line, assumptions = told_to_the_filter(Cell(case.name, way, change), 0, given)
    truth = truth_for(definition, given)
    scored: list[ScoredTrack] = []
    for method in (way.method, "usbl", "dr"):
        anchor = find_anchor("start", line, assumptions, None)
        made = track(method, line, assumptions, way.choices(0).settings, anchor)
        times_s = None if method == "usbl" else line.time_s[line.slow]
        scored.append(ScoredTrack(made, evaluate(made, truth, definition.window, definition.align, times_s)))
    titled_by = given.log.path.with_name(", USBL ".join(filter(None, (given.log.path.name, change))))
    log = replace(given.log, path=titled_by, assumptions=assumptions, truth=truth)
    return Run(log, line, scored[0], tuple(scored[1:]), order=way.order)


def draw_consistency(case: Case, rows: Rows, output: Path) -> list[str]:
    """Draw NEES over time, and which share of it lies where; return the name of the file."""
    name = case.scored[-1]
    drawn = [replace(way, calibrate=AUTO, order=online(case)) for way in (GATED, Way("adf"), Way("cpf"))]
    with in_style():
        figure = titled_figure(
            f"Consistency on {name}",
            f"{case.truth}; left: mean over {WINDOW_S} s, 2 is right; right: share of the epochs",
            11,
            4.4,
        )
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        for way in (*drawn, SMOOTHED):
            found = nees_over_time(rows, name, way)
            if found is not None:
                label = way.label.removesuffix(" --order arrival")
                _draw_nees(left, right, way, label, *found)
        _dress(left, right)
        legend_below(figure, (left, right), 5)
        file = f"{_stem(case.name, '')}_consistency.png"
        save_small(figure, output / file)
    return [file]


def nees_over_time(rows: Rows, name: str, way: Way) -> tuple[Vector, Vector] | None:
    """Return times and NEES of the first dive, (M,) each."""
    first = next(iter(rows[name, way, ""].good.values()), None)
    if first is None or first.trace is None:
        return None
    trace = read_trace(first.trace)
    return None if trace.cov_m2 is None else (trace.time_s, nees(trace.error_m, trace.cov_m2))


def _draw_nees(left: Axes, right: Axes, way: Way, label: str, time_s: Vector, value: Vector) -> None:
    style = {"color": colour(way.method), "lw": 1.4, "ls": "--" if way.smooth else "-"}
    bins = np.floor((time_s - time_s[0]) / WINDOW_S).astype(int)
    count = np.maximum(np.bincount(bins), 1)
    middle_s, mean = (np.bincount(bins, part) / count for part in (time_s, value))
    known = np.bincount(bins) > 0
    left.plot(middle_s[known], mean[known], label=f"{label}: {value.mean():.2f}", **style)
    right.plot(np.sort(value), 100 * (np.arange(len(value)) + 0.5) / len(value), **style)


def _dress(left: Axes, right: Axes) -> None:
    left.axhline(DOF, color="#000000", lw=0.9)
    left.set_yscale("log")
    left.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    left.yaxis.set_major_formatter("{x:g}")
    left.yaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel("time since the log's start [s]")
    left.set_ylabel("NEES")
    shares = np.linspace(0.005, 0.995, 200)
    chi = [-2 * math.log(1 - share) for share in shares]  # chi-square with two degrees of freedom
    right.plot(chi, 100 * shares, color="#000000", lw=0.9, label="right sigmas")
    right.axvline(chi_square_quantile(0.95, DOF), color="#999999", lw=0.8, ls=":")
    right.set_xscale("log")
    right.xaxis.set_major_formatter("{x:g}")
    right.set_xlim(0.05, 50)
    right.set_xlabel("NEES of an epoch (dotted: 95 % belong below)")
    right.set_ylabel("share of the epochs [%]")


def pictures(cases: Sequence[Case]) -> list[tuple[str, str]]:
    """Return what is drawn of runs: the logs, and the one with its outages."""
    drawn = [(case.name, "") for case in cases]
    return drawn + [(case.name, "cut") for case in cases if case.name == "stpere_marina" and "cut" in CHANGES]


def _stem(name: str, change: str) -> str:
    return "_".join(filter(None, (name, change)))
