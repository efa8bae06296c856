"""How good the fixes of several dives were, a row for each run, whose name stands for vehicle and ship."""

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.types import Mask, Vector
from usbldr.io.reports.report_text import TextTable
from usbldr.io.reports.run_directory import REPORT

NOTABLE_SIGMAS = 3.0  # of a dive's own sigma and the spread of all: 1 in 1000 by chance
LEAST_DIVES = 3  # of which one can be the odd one
NOISE = ("range_m", "bearing_deg", "east_m", "north_m")  # fields of the statistics: what is noisy, and its unit
PARTS = ("white", "slow")


class DiveFixes(NamedTuple):
    """The statistics of the fixes of a run, as report.json has them."""

    run: str
    log: str
    start_utc: str
    statistics: dict[str, Any]


def read_dives(folders: Sequence[Path]) -> list[DiveFixes]:
    """Return the statistics of run directories in order of time; raise LogError for one that has none."""
    found: list[DiveFixes] = []
    for folder in folders:
        try:
            report: Any = json.loads((folder / REPORT).read_text(encoding="utf-8"))
            statistics, start = report["fix_statistics"], str(report["time_base"]["start_utc"])
            if statistics is None:
                raise LogError(f"{folder}: no statistics of fixes: the run has no filter, or fewer than two good fixes")
            found.append(DiveFixes(folder.resolve().name, str(report["log"]["name"]), start, statistics))
        except (OSError, ValueError, KeyError, TypeError) as err:
            raise LogError(f"{folder / REPORT}: has no statistics of fixes; run replay again") from err
    return sorted(found, key=lambda dive: dive.start_utc)


def fleet_table(dives: Sequence[DiveFixes]) -> TextTable:
    """Return a row for each dive; * marks noise that is larger than that of the dives together."""
    axes = NOISE[:2] if any(one.statistics["range_m"] for one in dives) else NOISE[2:]
    noises = {f"{part} {axis.replace('_', ' ')}": _cells(dives, axis, part) for axis in axes for part in PARTS}
    body = [
        (
            dive.run,
            dive.start_utc[:10],
            str(dive.statistics["fixes"]),
            f"{100 * dive.statistics['good_share']:.0f} %",
            *(cells[k] for cells in noises.values()),
            *_scatter(dive.statistics["scatter"]),
        )
        for k, dive in enumerate(dives)
    ]
    return TextTable("run", ("start", "fixes", "good", *noises, "DRMS m", "CEP95 m", "DRMS %"), tuple(body))


def worse(dives: Sequence[DiveFixes]) -> list[str]:
    """Return a sentence for each noise of a dive that is notably larger than that of all dives."""
    found: list[str] = []
    for axis, part in product(NOISE, PARTS):
        name, unit = axis.split("_")
        sd, _, larger = _noise(dives, axis, part)
        for k in np.flatnonzero(larger).tolist():
            text = f"{sd[k]:.2f} {unit}, median of all {np.nanmedian(sd):.2f} {unit}"
            found.append(f"{dives[k].run}: {part} noise in {name} {text}")
    return found


def _noise(dives: Sequence[DiveFixes], axis: str, part: str) -> tuple[Vector, Vector, Mask]:
    """Return a part of the noise of each dive, its own sigma, and whether it is notably larger than that of all."""
    noises: list[Any] = [one.statistics[axis] for one in dives]
    rows = [(np.nan, np.nan) if one is None else (one[part]["sd"], one[part]["sd_of_sd"]) for one in noises]
    sd, own = np.array(rows, dtype=float).T
    if int(np.isfinite(sd).sum()) < LEAST_DIVES:
        return sd, own, np.zeros(len(sd), dtype=bool)
    more = sd - np.nanmedian(sd)
    spread = TO_SD * np.nanmedian(np.abs(more))
    return sd, own, more > NOTABLE_SIGMAS * np.hypot(own, spread)


def _cells(dives: Sequence[DiveFixes], axis: str, part: str) -> list[str]:
    headless = [axis in NOISE[:2] and not one.statistics["by_range"] for one in dives]
    return [
        f"{sd:.2f} ± {own:.2f}{'*' if larger else ''}" if np.isfinite(sd) else "no head" if unknown else ""
        for sd, own, larger, unknown in zip(*_noise(dives, axis, part), headless, strict=True)
    ]


def _scatter(found: dict[str, Any] | None) -> tuple[str, str, str]:
    if found is None:
        return "", "", ""
    percent = found["drms_percent"]
    return f"{found['drms_m']:.2f}", f"{found['cep95_m']:.2f}", "" if percent is None else f"{percent:.1f}"
