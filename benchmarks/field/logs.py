"""The logs of docs/studies/field.md: their folders, and how each is read. The files are third-party and not shipped."""

import os
from functools import cache
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.types import Timeline, Truth
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.opening import Request
from usbldr.io.session import UNCONFIGURED, open_log

HERE = Path(__file__).resolve().parent
FOLDERS = {
    "uib_field": "uib_field",
    "uib_simulation": "uib_simulation",
    "stpere_marina": "stpere_marina",
    "mhkit_riverpro": "mhkit_riverpro",
    "tanana_002": "mhkit_tanana",
    "tanana_003": "mhkit_tanana",
}
SCENARIO = "paper"  # beside the logs, with the generic defaults
SCORED_S = Window(20.0, 1084.0)  # of uib_field


class Dive(NamedTuple):
    """What the runs on a log are given."""

    log: Log
    line: Timeline
    truth: Truth


def field_folder() -> Path:
    """Return the folder of the third-party logs; raise LogError where there is none."""
    folder = Path(os.environ.get("USBLDR_FIELD_LOGS", HERE.parents[2] / "shared" / "logs"))
    if not folder.is_dir():
        raise LogError(f"{folder}: no folder of field logs; name the one that holds uib_field with USBLDR_FIELD_LOGS")
    return folder


@cache
def dive(name: str, seed: int = 0) -> Dive:
    """Read a log with its configuration, or simulate the scenario without one."""
    if name == SCENARIO:
        log = open_log(name, UNCONFIGURED, seed)
    else:
        file = field_folder() / FOLDERS[name] / f"{name}.mcap"
        log = open_log(file, Request(configuration=str(HERE / f"{name}.toml")))
    if log.truth is None:
        raise LogError(f"{log.path}: no truth to measure errors against")
    return Dive(log, timeline(log), log.truth)
