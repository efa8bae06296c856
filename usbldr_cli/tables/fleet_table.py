"""How good the fixes of several dives were, a row for each: which vehicle, ship or week got worse."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.types import Mask, Vector
from usbldr.io.reports.report_text import Table
from usbldr.io.reports.run_directory import REPORT

NOTABLE_SIGMAS = 3.0  # of a dive's own sigma and the spread of all: 1 in 1000 by chance
LEAST_DIVES = 3  # of which one can be the odd one
NOISE = {
    "range_m": ("range", "m"),
    "bearing_deg": ("bearing", "deg"),
    "east_m": ("east", "m"),
    "north_m": ("north", "m"),
}


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


def fleet_table(dives: Sequence[DiveFixes]) -> Table:
    """Return a row for each dive; * marks noise that is larger than that of the dives together."""
    axes = ["range_m", "bearing_deg"] if any(one.statistics["range_m"] for one in dives) else ["east_m", "north_m"]
    parts = [(axis, part) for axis in axes for part in ("white", "slow")]
    columns = [_noise(dives, *one) for one in parts]
    heads = ("start", "fixes", "good", *(f"{part} {NOISE[axis][0]} {NOISE[axis][1]}" for axis, part in parts))
    body = [
        (
            dive.run,
            dive.start_utc[:10],
            str(dive.statistics["fixes"]),
            f"{100 * dive.statistics['good_share']:.0f} %",
            *cells,
            *_scatter(dive.statistics["scatter"]),
        )
        for dive, cells in zip(dives, zip(*columns, strict=True), strict=True)
    ]
    return Table("run", (*heads, "DRMS m", "CEP95 m", "DRMS %"), tuple(body))


def worse(dives: Sequence[DiveFixes]) -> list[str]:
    """Return a sentence for each noise of a dive that is notably larger than that of all dives."""
    found: list[str] = []
    for axis, (name, unit) in NOISE.items():
        for part in ("white", "slow"):
            sd, own = _values(dives, axis, part)
            for k in np.flatnonzero(_notable(sd, own)).tolist():
                text = f"{sd[k]:.2f} {unit}, median of all {np.nanmedian(sd):.2f} {unit}"
                found.append(f"{dives[k].run}: {part} noise in {name} {text}")
    return found


def _values(dives: Sequence[DiveFixes], axis: str, part: str) -> tuple[Vector, Vector]:
    noises: list[Any] = [one.statistics[axis] for one in dives]
    rows = [(np.nan, np.nan) if one is None else (one[part]["sd"], one[part]["sd_of_sd"]) for one in noises]
    sd, own = np.array(rows, dtype=float).T
    return sd, own


def _notable(sd: Vector, own: Vector) -> Mask:
    if int(np.isfinite(sd).sum()) < LEAST_DIVES:
        return np.zeros(len(sd), dtype=bool)
    middle = np.nanmedian(sd)
    spread = TO_SD * np.nanmedian(np.abs(sd - middle))
    larger: Mask = sd - middle > NOTABLE_SIGMAS * np.hypot(own, spread)
    return larger


def _noise(dives: Sequence[DiveFixes], axis: str, part: str) -> list[str]:
    sd, own = _values(dives, axis, part)
    marks = np.where(_notable(sd, own), "*", "")
    return [
        f"{a:.2f} ± {b:.2f}{mark}" if np.isfinite(a) else "" for a, b, mark in zip(sd, own, marks.tolist(), strict=True)
    ]


def _scatter(found: dict[str, Any] | None) -> tuple[str, str, str]:
    if found is None:
        return "", "", ""
    percent = found["drms_percent"]
    return f"{found['drms_m']:.2f}", f"{found['cep95_m']:.2f}", "" if percent is None else f"{percent:.1f}"
