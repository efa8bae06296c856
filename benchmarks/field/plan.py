"""Which runs field.md rests on: which filter, on which log, with which change.

A cell is one way of running a filter on one log, with at most one change. Of a scenario each seed is a dive of its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

from field.changes import ABLATIONS, PF, SENSITIVITY, THINNED_S
from field.logs import Case
from paper.runs import Way
from usbldr_cli.runs.seed_table import ComparisonRow

AUTO = "auto"
GATED = Way("ekf", gate=0.99)
FILTERS = (Way("ekf"), GATED, Way("adf"), Way("cpf"))
BEST = Way("adf", AUTO)  # what the ablation takes features from, and the sensitivity defaults
ONLINE = replace(BEST, order="arrival")
PAPER_LOGS = ("uib_field", "stpere_marina")  # dives of real vehicles: the filters of the paper's lake trial run on them
FEW_DIVES = 3  # of a scenario, for differences


class Cell(NamedTuple):
    """One row of a table."""

    case: str
    way: Way
    change: str = ""


Rows: TypeAlias = Mapping[tuple[str, Way, str], ComparisonRow]  # by what tables call the case, the way and the change
Plan: TypeAlias = Mapping[Cell, int]  # how many seeds


def plan(cases: Sequence[Case], sensitivity: bool = True) -> Plan:
    """Return every run of the study on these logs, or all but those of halved and doubled defaults."""
    wanted: dict[Cell, int] = {}
    for case in cases:
        few = min(case.dives, FEW_DIVES)
        for way in main_ways(case):
            wanted[Cell(case.name, way)] = case.dives
        if case.held_back:
            continue
        wanted |= {Cell(case.name, way, name): case.dives for name in thinned_names() for way in thinned_ways(case)}
        wanted |= {Cell(case.name, way, name): few for name, way in ablated(case)}
        wanted |= {Cell(case.name, BEST, name): 1 for name in SENSITIVITY if sensitivity}
        if case.name in PAPER_LOGS:
            wanted |= {Cell(case.name, way, change): 1 for way, change in paper_ways(case)}
        if case.name == "stpere_marina":
            wanted |= {Cell(case.name, way, "cut"): 1 for way in cut_ways()}
    return wanted


def online(case: Case) -> str:
    """Return the order in which a vehicle receives its fixes: in `paper` none is late, so both are the same."""
    return "arrival" if case.folder else "validity"


def titled(way: Way) -> str:
    """Return what tables call a way whose order of fixes they state above."""
    return way.label.removesuffix(" --order arrival")


def main_ways(case: Case) -> list[Way]:
    orders = list(dict.fromkeys((online(case), "validity")))
    ways = [replace(way, calibrate=c, order=o) for c in ("none", AUTO) for way in FILTERS for o in orders]
    return [Way("usbl"), Way("dr"), *ways, *(Way("adf", c, smooth=True) for c in ("none", AUTO))]


def thinned_names() -> list[str]:
    return [f"one fix in {every_s:g} s" for every_s in THINNED_S]


def thinned_ways(case: Case) -> list[Way]:
    return [replace(way, calibrate=AUTO, order=online(case)) for way in (GATED, Way("adf"), Way("cpf"))]


def paper_ways(case: Case) -> list[tuple[Way, str]]:
    """Return the filters of the paper's lake trial with their changes, as a vehicle could run them."""
    return [(Way(name, AUTO, order=online(case)), PF if name == "pf" else "") for name in ("pf", "upf", "cpf")]


def cut_ways() -> list[Way]:
    ways = [
        replace(way, calibrate=c, order="arrival") for c in ("none", AUTO) for way in (GATED, Way("adf"), Way("cpf"))
    ]
    return [Way("dr"), *ways, *(Way("adf", c, smooth=True) for c in ("none", AUTO))]


def ablated(case: Case) -> Iterator[tuple[str, Way]]:
    """Yield each feature that is taken away, and what is left."""
    way = replace(BEST, order=online(case))
    yield "", replace(way, method="ckf")
    yield "", replace(way, method="ckf", gate=0.99)
    for name in ABLATIONS:
        yield name, way
