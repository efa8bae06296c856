"""The pictures of field.md, one set for each log, in the style of every other picture of usbldr."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from field.goals import SMOOTHED
from field.logs import CASES, Case, dive, truth_for
from field.plan import BEST, Cell, Rows, online, paper_ways, thinned_ways, titled
from field.runs import resolved_input
from paper.figures import log_scale, nees_over_time, save
from usbldr.filters.evaluation.consistency import DOF
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.types import Vector
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.session import replay
from usbldr_cli.figures import overlay
from usbldr_cli.figures.calibration import calibration_figure
from usbldr_cli.figures.health import innovation_figure
from usbldr_cli.figures.run_figures import error_figure
from usbldr_cli.figures.style import Axes, Figure, colour, in_style, legend_below, titled_figure
from usbldr_cli.figures.track import track_figure

RUN_PICTURES: Mapping[str, Callable[[Run], Figure | None]] = {
    "track": track_figure,
    "errors": error_figure,
    "calibration": calibration_figure,
    "innovations": innovation_figure,
}
WINDOW_S = 60  # over which NEES is averaged


def draw_run(name: str, change: str, folder: Path, output: Path) -> list[str]:
    """Draw a run of adf on a log as its vehicle could have had it; return the names of the files."""
    case = CASES[name]
    run = online_run(case, change, folder)
    written = []
    with in_style():
        for what, draw in RUN_PICTURES.items():
            figure = draw(run)
            if figure is not None:
                written.append(f"{'_'.join(filter(None, (name, change, what)))}.png")
                save(figure, output / written[-1])
    return written


def online_run(case: Case, change: str, folder: Path) -> Run:
    """Return adf on a log with what people do without a filter beside it, by the log's last definition."""
    given, definition, way = dive(case.name, 0, folder), case.definitions[-1], replace(BEST, order=online(case))
    line, found = resolved_input(Cell(case.name, way, change), 0, given, folder)
    truth = truth_for(definition, given)
    scored: list[ScoredTrack] = []
    for method in (way.method, "usbl", "dr"):
        made = replay(given.log, line, method, way.choices(0).settings(), found)
        times_s = None if method == "usbl" else line.time_s[line.slow]
        scored.append(ScoredTrack(made, evaluate(made, truth, definition.window, definition.align, times_s)))
    titled_by = given.log.path.with_name(", USBL ".join(filter(None, (given.log.path.name, change))))
    log = replace(given.log, path=titled_by, truth=truth)
    return Run(log, line, found, scored[0], tuple(scored[1:]), order=way.order)


def draw_consistency(case: Case, rows: Rows, output: Path) -> str:
    """Draw NEES over time, and its distribution, of the first dive; return the name of the file."""
    name, file = case.scored[-1], f"{case.name}_consistency.png"
    subtitle = f"{case.truth}; left: mean over {WINDOW_S} s, 2 is right; right: share of the epochs"
    with in_style():
        figure = titled_figure(f"Consistency on {name}", subtitle, 11, 4.4)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        for way in (*thinned_ways(case), SMOOTHED):
            row = rows[name, way, ""]
            if row.good:
                style = {"color": colour(way.method), "lw": 1.4, "ls": "--" if way.smooth else "-"}
                _draw_nees(left, right, titled(way), style, *nees_over_time(row, 1))
        left.axhline(DOF, color="#000000", lw=0.9)
        log_scale(left)
        left.set_xlabel("time since the log's start [s]")
        left.set_ylabel("NEES")
        shares = np.linspace(0.005, 0.995, 200)
        right.plot(-2 * np.log(1 - shares), 100 * shares, color="#000000", lw=0.9)  # chi-square, 2 degrees of freedom
        right.axvline(chi_square_quantile(0.95, DOF), color="#999999", lw=0.8, ls=":")
        right.set_xscale("log")
        right.xaxis.set_major_formatter("{x:g}")
        right.set_xlim(0.05, 50)
        right.set_xlabel("NEES of an epoch (dotted: 95 % belong below)")
        right.set_ylabel("share of the epochs [%]")
        legend_below(figure, (left, right), 5)
        save(figure, output / file)
    return file


def draw_paper_filters(case: Case, rows: Rows, output: Path) -> str:
    """Draw the errors of the paper's filters, as its Figure 3 does for a lake trial; return the name of the file."""
    file = f"{case.name}_filters.png"
    compared = [replace(rows[case.scored[-1], way, change], label=way.method) for way, change in paper_ways(case)]
    with in_style():
        figure = overlay.error_figure(compared)
        if figure is not None:
            save(figure, output / file)
    return file


def _draw_nees(left: Axes, right: Axes, label: str, style: Mapping[str, Any], time_s: Vector, value: Vector) -> None:
    bins = np.floor((time_s - time_s[0]) / WINDOW_S).astype(int)
    count = np.bincount(bins)
    middle_s, mean = (np.bincount(bins, part)[count > 0] / count[count > 0] for part in (time_s, value))
    left.plot(middle_s, mean, label=f"{label}: {value.mean():.2f}", **style)
    right.plot(np.sort(value), 100 * (np.arange(len(value)) + 0.5) / len(value), **style)


def pictures(cases: Sequence[Case]) -> list[tuple[str, str]]:
    """Return what is drawn of runs: the logs, and the one with its outages."""
    return [(case.name, "") for case in cases] + [(c.name, "cut") for c in cases if c.name == "stpere_marina"]
