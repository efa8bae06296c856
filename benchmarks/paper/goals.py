"""The goals of the study: what was to be reached, what was measured, and whether it was."""

import math
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from paper.bounds import Limits
from paper.runs import Rows, Way
from paper.tables import AXES, command, errors, over, times
from usbldr.filters.evaluation.seed_statistics import average
from usbldr.filters.replay.run import run
from usbldr.io.reports.report_text import Table
from usbldr.io.scenarios.library import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.timeline import timeline
from usbldr_cli.runs.seed_table import ComparisonRow
from usbldr_cli.tables.compare_table import piped

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
        """Whether the measured mean lies within the goal."""
        return self.excess <= 0

    @property
    def verdict(self) -> str:
        """Say so in words."""
        close = f", by less than {CLOSE:g} standard errors" if abs(self.excess) < CLOSE else ""
        return f"{'met' if self.met else '**not met**'}{close}"


def goals(rows: Rows, limit: Limits, times_s: Mapping[Way, float]) -> list[Goal]:
    """Return every goal; ``limit`` is the bound on `paper-drawn` with the scale state, ``times_s`` are of `timed`."""
    return [
        *_errors("cpf, 6 states", rows, "paper", Way("cpf"), (0.24, 0.27)),
        *_errors("cpf + scale", rows, "paper", Way("cpf", "scale"), (0.12, 0.13)),
        _worst_seed("cpf + scale, worst seed", rows["paper", Way("cpf", "scale")], 0.20),
        *_errors("cpf + scale, stretch", rows, "paper", Way("cpf", "scale"), (0.095, 0.095)),
        *_errors("cpf + scale and misalignment", rows, "paper", Way("cpf", "scale,misalignment"), (0.14, 0.14)),
        *_efficiency(rows, limit),
        *_smoother(rows),
        *_errors("cpf on `paper-range`, + scale", rows, "paper-range", Way("cpf", "scale"), (0.45, 0.55)),
        *_errors(
            "smoother on `paper-range`, + scale", rows, "paper-range", Way("adf", "scale", smooth=True), (0.36, 0.46)
        ),
        _ratio("one second of delay, at its time of validity", rows, ("delay", Way("cpf", "scale")), 1.1),
        _few_particles("cpf, N = 20 against 100, 6 states", rows, "none"),
        _few_particles("cpf, N = 20 against 100, + scale", rows, "scale"),
        *(_speed(way, cpu_s) for way, cpu_s in times_s.items()),
    ]


def table(found: list[Goal]) -> str:
    """Return the goals as Markdown."""
    body = tuple((g.what, g.goal, g.measured, g.verdict, str(g.seeds), f"`{g.made_by}`") for g in found)
    text = piped(Table("what", ("goal", "measured", "", "seeds", "command"), body))
    return text.replace(r"\*\*", "**")


def _errors(what: str, rows: Rows, log: str, way: Way, most: tuple[float, float]) -> Iterator[Goal]:
    row = rows[log, way]
    excess = max(_excess(row, axis, limit) for axis, limit in zip(AXES, most, strict=True))
    stated = "/".join(f"{limit:.3g}".removeprefix("0") for limit in most)
    yield Goal(what, stated, errors(row), excess, len(row.seeds), command(log, way, len(row.seeds)))


def _worst_seed(what: str, row: ComparisonRow, most: float) -> Goal:
    worst = max(value for axis in AXES for value in row.values(axis).values())
    made_by = command("paper", Way("cpf", "scale"), len(row.seeds))
    return Goal(
        what,
        f"no axis above {most:.2f}",
        f"{worst:.3f}",
        math.copysign(math.inf, worst - most),
        len(row.seeds),
        made_by,
    )


def _efficiency(rows: Rows, limit: Limits) -> Iterator[Goal]:
    way = Way("adf", "scale")
    row = rows["paper-drawn", way]
    seeds, made_by = len(row.seeds), command("paper-drawn", way, len(row.seeds))
    found = [over(row, axis, bound) for axis, bound in zip(AXES, limit.filter_m, strict=True)]
    excess = max((abs(ratio - 1) - 0.05) / (se or math.nan) for ratio, se in found)
    told = " / ".join(f"{ratio:.3f} ± {se or math.nan:.3f}" for ratio, se in found)
    yield Goal("`paper-drawn`, + scale: error over PCRLB (adf)", ".95 to 1.05", told, excess, seeds, made_by)
    nees = average(list(row.values("nees_mean").values()))
    excess = (abs(nees.mean - 2) - 0.2) / (nees.se or math.nan)
    told = f"{nees.mean:.2f} ± {nees.se or math.nan:.2f}"
    yield Goal("`paper-drawn`, + scale: NEES (adf)", "1.8 to 2.2", told, excess, seeds, made_by)


def _smoother(rows: Rows) -> Iterator[Goal]:
    way = Way("adf", "scale", smooth=True)
    yield from _errors("smoother + scale", rows, "paper", way, (0.085, 0.085))
    row = rows["paper", way]
    nees = average(list(row.values("nees_mean").values()))
    excess = (nees.mean - 2.3) / (nees.se or math.nan)
    told = f"{nees.mean:.2f} ± {nees.se or math.nan:.2f}"
    yield Goal(
        "smoother + scale: NEES", "at most 2.3", told, excess, len(row.seeds), command("paper", way, len(row.seeds))
    )


def _ratio(what: str, rows: Rows, cell: tuple[str, Way], most: float) -> Goal:
    row = rows[cell]
    ratio = times(row, rows["paper", cell[1]])
    made_by = command(*cell, len(row.seeds))
    return Goal(
        what,
        f"at most {most:g} times",
        f"{ratio:.3f} times",
        math.copysign(math.inf, ratio - most),
        len(row.seeds),
        made_by,
    )


def _few_particles(what: str, rows: Rows, calibrate: str) -> Goal:
    way = Way("cpf", calibrate, particles=20)
    row = rows["paper", way]
    ratio = times(row, rows["paper", Way("cpf", calibrate)])
    return Goal(
        what,
        "within 10 %",
        f"{100 * (ratio - 1):+.1f} %",
        math.copysign(math.inf, abs(ratio - 1) - 0.1),
        len(row.seeds),
        command("paper", way, len(row.seeds)),
    )


def timed() -> dict[Way, float]:
    """Return the CPU seconds that each filter of FASTEST_S takes over the log of `paper`, 1000 s long."""
    log = simulated_log(find_scenario("paper"), 0)
    line = timeline(log)
    found: dict[Way, float] = {}
    for way in FASTEST_S:
        began_s = time.process_time()
        run(way.method, line, log.assumptions, way.choices(0).settings)
        found[way] = time.process_time() - began_s
    return found


def _speed(way: Way, cpu_s: float) -> Goal:
    most_s = FASTEST_S[way]
    what = f"filter time over 1000 s, {way.label}"
    return Goal(what, f"{most_s:g} s", f"{cpu_s:.1f} s of CPU", math.copysign(math.inf, cpu_s - most_s), 1, "timed")


def _excess(row: ComparisonRow, metric: str, most: float) -> float:
    """Return by how many standard errors a mean lies above what it may be at most."""
    found = average(list(row.values(metric).values()))
    return (found.mean - most) / found.se if found.se else math.copysign(math.inf, found.mean - most)
