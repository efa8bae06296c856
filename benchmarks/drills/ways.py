"""Which filters are drilled on which logs.

The first way is the default of the command line. A scenario is taken with ``--config none``: as a log that is not
configured.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from field.logs import CASES, field_folder
from paper.runs import GATED, Way
from usbldr.filters.errors import LogError
from usbldr_cli.options.run_options import RunChoices

AUTO, NONE = "auto", "none"
DEFAULT = Way("cpf", AUTO)
WAYS = (DEFAULT, Way("adf", AUTO), Way("adf", AUTO, smooth=True), Way("adf", NONE), replace(GATED, calibrate=NONE))
OF_PAPERS = tuple(Way(name, c) for c in (NONE, AUTO) for name in ("afukf", "aekf", "pf-wekf", "ukf", "ekf", "adf"))
"""The filters under the faults that their papers made them for, beside those that they change."""


@dataclass(frozen=True, slots=True)
class DrilledLog:
    """A log, how it is read and scored, and over how many seeds."""

    name: str
    path: str  # or the name of a scenario
    seeds: int
    selection: Mapping[str, Any] = field(default_factory=dict[str, Any])
    scored: Mapping[str, Any] = field(default_factory=dict[str, Any])  # options of RunChoices

    def choices(self, way: Way) -> RunChoices:
        """Return the options of a run on this log."""
        return replace(way.choices(0), calibrate=way.calibrate, **{"align": "none", **self.scored})


def label(way: Way) -> str:
    """Return what tables call a way."""
    return way.label if way.calibrate == AUTO else f"{way.label}, none"


def logs(seeds: int) -> list[DrilledLog]:
    """Return the scenarios, and the field logs if they are there; those that are held back are not drilled."""
    unconfigured = {"config": "none"}
    few = max(1, seeds // 4)
    found = [DrilledLog("turns", "turns", seeds, unconfigured)]
    found += [DrilledLog(name, name, few, unconfigured) for name in ("square", "lawnmower", "lake", "paper")]
    try:
        folder = field_folder()
    except LogError:
        return found
    for name in ("uib_field", "stpere_marina"):
        case, (definition, *_) = CASES[name], CASES[name].definitions
        window = definition.window
        ends = {"start": f"{window.start_s:g}", "end": f"{window.end_s:g}"} if definition.name else {}
        configuration = str(Path(__file__).parents[1] / "field" / f"{name}.toml")
        path = str(folder / case.folder / f"{name}.mcap")
        found.append(DrilledLog(name, path, few, {"config": configuration}, {"align": definition.align, **ends}))
    return found
