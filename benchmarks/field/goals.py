"""The goals of the field study: the goal, the measured value, and whether it is met. Metres."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from field.logs import Case
from field.plan import BEST, ONLINE, Rows, online, thinned_names, thinned_ways
from paper.runs import Way
from usbldr.io.reports.markdown_report import markdown_table
from usbldr.io.reports.report_text import Table
from usbldr_cli.runs.seed_table import ComparisonRow

HORIZONTAL, NEES = "mean_horizontal_m", "nees_mean"
SMOOTHED = replace(BEST, smooth=True)
WORSE_THAN_GATED, APART = 0.05, 0.03  # what cpf may lose to the gated ekf, and how far cpf and adf may lie apart
MOST_NEES_THINNED = 4.0
LOCKED_OUT = 5  # fixes in a row that the filter refuses to the end of the log


class Goal(NamedTuple):
    """A line of the table."""

    what: str
    goal: str
    measured: str
    met: bool


def goals(rows: Rows, cases: Sequence[Case]) -> list[Goal]:
    """Return every goal of the logs that were run."""
    return [goal for case in cases for goal in _of(case, rows)]


def _of(case: Case, rows: Rows) -> Iterator[Goal]:
    if case.name == "uib_field":
        for definition, most, stretch in (("A", 0.70, 0.61), ("B", 0.62, 0.55)):
            name = f"uib_field {definition}"
            yield _error(name, rows[name, ONLINE, ""], most)
            yield _error(f"{name}, stretch", rows[name, ONLINE, ""], stretch)
        yield _consistent("uib_field B", rows["uib_field B", ONLINE, ""], 3.5)
        tuned, plain = rows["uib_field B", ONLINE, "tuned"], rows["uib_field B", ONLINE, ""]
        yield _error("uib_field B, `--tune`: not worse", tuned, _value(plain))
        yield _consistent("uib_field B, `--tune`", tuned, 3.0)
    elif case.name == "uib_simulation":
        yield _error(case.name, rows[case.name, ONLINE, ""], 0.34)
    elif case.name == "stpere_marina":
        yield _error(case.name, rows[case.name, ONLINE, ""], 0.95)
        yield _error(f"{case.name}, smoothed", rows[case.name, SMOOTHED, ""], 0.64)
        yield _error(f"{case.name}, two USBL outages", rows[case.name, ONLINE, "cut"], 2.5)
        yield _error(f"{case.name}, two USBL outages, smoothed", rows[case.name, SMOOTHED, "cut"], 1.1)
    elif case.name == "paper":
        row = rows[case.name, BEST, ""]
        pair = [_value(row, f"mean_abs_{axis}_m") for axis in ("east", "north")]
        measured = "/".join(f"{value:.3f}" for value in pair)
        yield Goal("paper, generic defaults", "0.26/0.27 per axis", measured, pair[0] <= 0.26 and pair[1] <= 0.27)
    if not case.held_back:
        yield from thinned_goals(case, rows)
    yield from particle_goals(case, rows)


def thinned_goals(case: Case, rows: Rows) -> Iterator[Goal]:
    """Yield for each thinning whether adf is better than dr, honest, and not locked out."""
    name, way = case.scored[-1], replace(BEST, order=online(case))
    dr = _value(rows[name, Way("dr"), ""])
    for change in thinned_names():
        row = rows[name, way, change]
        error, size, refused = _value(row), _value(row, NEES), worst(row, "refused_at_the_end")
        measured = f"{error:.2f} m (dr {dr:.2f} m), NEES {size:.2f}, {refused:.0f} rejected at the end"
        met = error < dr and size <= MOST_NEES_THINNED and refused < LOCKED_OUT
        goal = f"better than dr, NEES at most {MOST_NEES_THINNED:g}, no lock-out"
        yield Goal(f"{name}, {change}", goal, measured, met)


def particle_goals(case: Case, rows: Rows) -> Iterator[Goal]:
    """Yield how `cpf` compares with the gated `ekf` and with `adf`, with fixes by arrival."""
    name = case.scored[-1]
    gated, adf, cpf = (_value(rows[name, way, ""]) for way in thinned_ways(case))
    worse, apart = cpf / gated - 1, cpf / adf - 1
    at_most, within = f"at most {100 * WORSE_THAN_GATED:.0f} % worse", f"within {100 * APART:.0f} %"
    yield Goal(f"{name}: cpf against the gated ekf", at_most, f"{100 * worse:+.1f} %", worse <= WORSE_THAN_GATED)
    yield Goal(f"{name}: cpf against adf", within, f"{100 * apart:+.1f} %", abs(apart) <= APART)


def table(found: Sequence[Goal]) -> str:
    """Return the goals as Markdown."""
    body = tuple((g.what, g.goal, g.measured, "met" if g.met else "not met") for g in found)
    return markdown_table(Table("what", ("goal", "measured", ""), body)).replace("not met |", "**not met** |")


def _error(what: str, row: ComparisonRow, most: float) -> Goal:
    return Goal(what, f"{most:.3g} m", f"{_value(row):.3f} m", _value(row) <= most)


def _consistent(what: str, row: ComparisonRow, most: float) -> Goal:
    return Goal(f"{what}: NEES", f"at most {most:g}", f"{_value(row, NEES):.2f}", _value(row, NEES) <= most)


def worst(row: ComparisonRow, metric: str) -> float:
    """Return the largest value over dives, 0 where there is none."""
    return max(row.values(metric).values(), default=0.0)


def _value(row: ComparisonRow, metric: str = HORIZONTAL) -> float:
    """Return the mean over dives; a run that failed is as bad as can be."""
    value = row.mean(metric)
    return float("inf") if value is None or row.fault else value
