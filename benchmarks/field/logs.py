"""The logs of the field study: folder, kind of truth, and the definitions by which each is scored.

The files are third-party and not ours to ship. Metres and seconds, east before north.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import fit_rigid
from usbldr.filters.evaluation.error_report import WHOLE_LOG, Window
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Outage, Timeline, Truth
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

HERE = Path(__file__).resolve().parent
TRIMMED = 3.0  # times the median residual: a fix further off has no part in definition B's alignment
FIXES_FROM = Window(4.0, 1084.0)  # of uib_field, as its authors scored it


class Definition(NamedTuple):
    """How the errors of a track are taken."""

    name: str = ""
    window: Window = WHOLE_LOG
    align: str = "none"
    truth_onto_fixes: bool = False  # the truth is moved once, the same for every filter


AUTHORS = Definition("A", FIXES_FROM, "first")
MOVED_ONCE = Definition("B", Window(20.0, 1084.0), truth_onto_fixes=True)


@dataclass(frozen=True, slots=True)
class Case:
    """One log, or one scenario whose seeds are dives of their own."""

    name: str
    folder: str  # "" for a scenario
    truth: str  # what kind it is, in the words that stand beside every number
    definitions: tuple[Definition, ...] = (Definition(),)
    dives: int = 1
    held_back: bool = False

    @property
    def scored(self) -> tuple[str, ...]:
        """What tables call it: once for each definition."""
        return tuple(f"{self.name} {definition.name}".strip() for definition in self.definitions)


CASES: Mapping[str, Case] = {
    case.name: case
    for case in (
        Case(
            "uib_field",
            "uib_field",
            "real AUV, real USBL; truth: visual SLAM, not surveyed",
            (AUTHORS, MOVED_ONCE),
        ),
        Case("uib_simulation", "uib_simulation", "simulated by its authors, exact truth"),
        Case("stpere_marina", "stpere_marina", "real AUV; truth: real DGPS; USBL synthetic, with white errors"),
        Case("paper", "", "simulated by us, exact truth; filters with generic defaults", dives=8),
        Case("mhkit_riverpro", "mhkit_riverpro", "real boat; truth: real GPS; USBL synthetic", held_back=True),
        Case("tanana_002", "mhkit_tanana", "real boat; truth: real GPS; USBL synthetic", held_back=True),
        Case("tanana_003", "mhkit_tanana", "real boat; truth: real GPS; USBL synthetic", held_back=True),
    )
}


class Dive(NamedTuple):
    """What the runs of a case are given."""

    log: Log
    line: Timeline
    truth: Truth


def field_folder() -> Path:
    """Return the folder of the third-party logs; raise LogError where there is none."""
    folder = Path(os.environ.get("USBLDR_FIELD_LOGS", HERE.parents[2] / "shared" / "logs"))
    if not folder.is_dir():
        raise LogError(f"{folder}: no folder of field logs; name the one that holds uib_field with USBLDR_FIELD_LOGS")
    return folder


@lru_cache(maxsize=2)
def dive(name: str, seed: int, folder: Path) -> Dive:
    """Read a case. For a scenario, filters use the defaults and the sigmas stated in the records."""
    case = CASES[name]
    if case.folder:
        request = Request(configuration=str(HERE / f"{name}.toml"))
        log = read_log(folder / case.folder / f"{name}.mcap", request)
    else:
        log = replace(simulated_log(find_scenario(name), seed), parameters=Parameters())
    if log.truth is None:
        raise LogError(f"{log.path}: no truth to measure errors against")
    return Dive(log, timeline(log), log.truth)


def truth_for(definition: Definition, found: Dive) -> Truth:
    """Return the truth that a definition scores against."""
    return moved_onto_fixes(found.truth, found.line) if definition.truth_onto_fixes else found.truth


def moved_onto_fixes(truth: Truth, line: Timeline, window: Window = FIXES_FROM) -> Truth:
    """Turn and shift a truth, once, to where the raw fixes lie, without the gross ones among them.

    It hangs on no filter and on no single point, so it serves to compare filters where a truth has a frame of its own.
    """
    stamps = line.fix_time_s
    among = (stamps > max(window.start_s, truth.time_s[0])) & (stamps < min(window.end_s, truth.time_s[-1]))
    fix_m = line.fix_m[among]
    there_m = np.column_stack([np.interp(stamps[among], truth.time_s, column) for column in truth.position_m.T])
    near, alignment = np.ones(len(fix_m), np.bool_), fit_rigid(there_m, fix_m)
    while True:
        off_m = np.hypot(*(alignment.points(there_m) - fix_m).T)
        still = off_m < TRIMMED * np.median(off_m)
        if np.array_equal(still, near):
            source = f"{truth.source}, moved once onto the fixes"
            return replace(truth, position_m=alignment.points(truth.position_m), source=source)
        near, alignment = still, fit_rigid(there_m[still], fix_m[still])


def cut(line: Timeline, spans_s: tuple[tuple[float, float], ...]) -> Timeline:
    """Return the log without its fixes in spans that count from the first GPS fix."""
    cuts = [(line.gps_time_s[0] + start, line.gps_time_s[0] + end) for start, end in spans_s]
    left = ~np.any([(line.fix_time_s >= start) & (line.fix_time_s <= end) for start, end in cuts], axis=0)
    outages = tuple(Outage("usbl", float(start), float(min(end, line.time_s[-1]))) for start, end in cuts)
    return replace(line.with_fixes(left), outages=(*line.outages, *outages))


def thinned(line: Timeline, every_s: float) -> Timeline:
    """Return the log with the first fix of each so many seconds."""
    _, first = np.unique(np.floor(line.fix_time_s / every_s), return_index=True)
    return line.with_fixes(np.isin(np.arange(len(line.fix_time_s)), first))


def stamped_at_arrival(line: Timeline) -> Timeline:
    """Return the log with its fixes stamped at arrival."""
    order = np.argsort(line.fix_received_s, kind="stable")
    late = line.with_fixes(order)
    return replace(late, fix_time_s=late.fix_received_s)
