"""The goals of the study: the goal, the measured value, and whether it is met."""

import math
import time
from collections.abc import Mapping
from typing import NamedTuple

from paper.runs import Cell, Rows, Way
from paper.tables import AXES, command, errors, over, times
from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.evaluation.seed_statistics import average
from usbldr.filters.replay.run import run
from usbldr.io.reading.epochs import timeline
from usbldr.io.reports.markdown_report import markdown_table
from usbldr.io.reports.report_text import Table
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.runs.seed_table import ComparisonRow

FASTEST_S = {Way("cpf", particles=1000): 15.0, Way("cpf"): 6.0, Way("adf"): 3.0}
CLOSE = 2.0  # standard errors: nearer to the goal than that, more seeds might say otherwise


class Goal(NamedTuple):
    """A line of the table; ``excess`` says by how many standard errors the worst number misses: negative is met."""

    what: str
    goal: str
    measured: str
    excess: float
    seeds: int
    made_by: str

    @property
    def met(self) -> bool:
        """Whether the measured mean is within the goal."""
        return self.excess <= 0

    @property
    def verdict(self) -> str:
        """Say so in words."""
        close = f", by less than {CLOSE:g} standard errors" if abs(self.excess) < CLOSE else ""
        return f"{'met' if self.met else '**not met**'}{close}"


def goals(rows: Rows, limit: PositionBound, times_s: Mapping[Way, float]) -> list[Goal]:
    """Return every goal; ``limit`` is the bound on `paper-drawn` with the scale state, ``times_s`` are of `timed`."""
    cpf, drawn = ("paper", Way("cpf", "scale")), ("paper-drawn", Way("adf", "scale"))
    both, smoother = ("paper", Way("cpf", "scale,misalignment")), Way("adf", "scale", smooth=True)
    worst = max(value for axis in AXES for value in rows[cpf].values(axis).values())
    late = times(rows["delay", cpf[1]], rows[cpf])
    return [
        _error("cpf, 6 states", rows, ("paper", Way("cpf")), (0.24, 0.27)),
        _error("cpf + scale", rows, cpf, (0.12, 0.13)),
        _goal("cpf + scale, worst seed", "no axis above 0.20", f"{worst:.3f}", _exact(worst - 0.2), rows, cpf),
        _error("cpf + scale, stretch", rows, cpf, (0.095, 0.095)),
        _error("cpf + scale and misalignment", rows, both, (0.14, 0.14)),
        _efficiency("`paper-drawn`, + scale: error over PCRLB (adf)", rows, drawn, limit),
        _nees("`paper-drawn`, + scale: NEES (adf)", rows, drawn, (1.8, 2.2)),
        _error("smoother + scale", rows, ("paper", smoother), (0.085, 0.085)),
        _nees("smoother + scale: NEES", rows, ("paper", smoother), (0.0, 2.3)),
        _error("cpf on `paper-range`, + scale", rows, ("paper-range", cpf[1]), (0.45, 0.55)),
        _error("smoother on `paper-range`, + scale", rows, ("paper-range", smoother), (0.36, 0.46)),
        _goal(
            "one second of delay, at its time of validity",
            "at most 1.1 times",
            f"{late:.3f} times",
            _exact(late - 1.1),
            rows,
            ("delay", cpf[1]),
        ),
        _few_particles("cpf, N = 20 against 100, 6 states", rows, "none"),
        _few_particles("cpf, N = 20 against 100, + scale", rows, "scale"),
        *(_speed(way, cpu_s) for way, cpu_s in times_s.items()),
    ]


def table(found: list[Goal]) -> str:
    """Return the goals as Markdown."""
    body = tuple((g.what, g.goal, g.measured, g.verdict, str(g.seeds), f"`{g.made_by}`") for g in found)
    text = markdown_table(Table("what", ("goal", "measured", "", "seeds", "command"), body))
    return text.replace(r"\*\*", "**")


def _goal(what: str, goal: str, measured: str, excess: float, rows: Rows, cell: Cell) -> Goal:
    seeds = len(rows[cell].seeds)
    return Goal(what, goal, measured, excess, seeds, command(*cell, seeds))


def _exact(excess: float) -> float:
    """Return an excess in standard errors of a number that has none."""
    return math.copysign(math.inf, excess)


def _error(what: str, rows: Rows, cell: Cell, most: tuple[float, float]) -> Goal:
    excess = max(_excess(rows[cell], axis, limit) for axis, limit in zip(AXES, most, strict=True))
    stated = "/".join(f"{limit:.3g}".removeprefix("0") for limit in most)
    return _goal(what, stated, errors(rows[cell]), excess, rows, cell)


def _efficiency(what: str, rows: Rows, cell: Cell, limit: PositionBound) -> Goal:
    found = [over(rows[cell], axis, bound) for axis, bound in zip(AXES, limit.filter_m, strict=True)]
    excess = max((abs(ratio - 1) - 0.05) / (se or math.nan) for ratio, se in found)
    measured = " / ".join(f"{ratio:.3f} ± {se or math.nan:.3f}" for ratio, se in found)
    return _goal(what, ".95 to 1.05", measured, excess, rows, cell)


def _nees(what: str, rows: Rows, cell: Cell, within: tuple[float, float]) -> Goal:
    nees = average(list(rows[cell].values("nees_mean").values()))
    least, most = within
    excess = max(nees.mean - most, least - nees.mean) / (nees.se or math.nan)
    stated = f"{least} to {most}" if least else f"at most {most}"
    return _goal(what, stated, f"{nees.mean:.2f} ± {nees.se or math.nan:.2f}", excess, rows, cell)


def _few_particles(what: str, rows: Rows, calibrate: str) -> Goal:
    cell = ("paper", Way("cpf", calibrate, particles=20))
    more = times(rows[cell], rows["paper", Way("cpf", calibrate)]) - 1
    return _goal(what, "within 10 %", f"{100 * more:+.1f} %", _exact(abs(more) - 0.1), rows, cell)


def timed() -> dict[Way, float]:
    """Return the CPU seconds that each filter of FASTEST_S takes over the log of `paper`, 1000 s long."""
    log = simulated_log(find_scenario("paper"), 0)
    line = timeline(log)
    found: dict[Way, float] = {}
    for way in FASTEST_S:
        began_s = time.process_time()
        run(way.method, line, log.parameters, way.choices(0).settings())
        found[way] = time.process_time() - began_s
    return found


def _speed(way: Way, cpu_s: float) -> Goal:
    most_s = FASTEST_S[way]
    what = f"filter time over 1000 s, {way.label}"
    return Goal(what, f"{most_s:g} s", f"{cpu_s:.1f} s of CPU", _exact(cpu_s - most_s), 1, "timed")


def _excess(row: ComparisonRow, metric: str, most: float) -> float:
    """Return by how many standard errors a mean is above its limit."""
    found = average(list(row.values(metric).values()))
    return (found.mean - most) / found.se if found.se else _exact(found.mean - most)
