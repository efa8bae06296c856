"""A log in canonical form: one table per sensor, where each came from, and what was noticed on the way."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from usbldr.filters.models.parameters import Assumptions
from usbldr.filters.types import Truth

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "dvl": ("time_s", "received_s", "starboard_mps", "forward_mps", "up_mps", "sd_mps", "valid"),
    "compass": ("time_s", "received_s", "heading_deg", "sd_deg"),
    "usbl": ("time_s", "received_s", "east_m", "north_m", "cov_ee_m2", "cov_en_m2", "cov_nn_m2"),
    "gps": ("time_s", "received_s", "east_m", "north_m", "sd_m", "lat_deg", "lon_deg"),
    "depth": ("time_s", "received_s", "depth_m"),
}
"""Columns of each sensor's table; float64 but for ``valid`` (bool); sorted by time_s; NaN = unknown."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The point that the local plane touches."""

    lat_deg: float
    lon_deg: float
    source: str  # "[map]", "usbl head", "first gps fix"


@dataclass(frozen=True, slots=True)
class Provenance:
    """Which records a sensor's table was made of, and by which conventions."""

    topic: str
    type: str
    chosen_by: str  # "configuration", "option", "type and name"
    conventions: tuple[str, ...]  # short sentences, one each: "axes FRD (by type)", "mount 135 deg (configuration)"
    messages: int  # in the file
    used: int


@dataclass(frozen=True, slots=True)
class Finding:
    """Something a user ought to know of this log."""

    code: str  # stable, for machines: "DVL-INVALID", "OUT-OF-ORDER", "TRUNCATED"
    text: str  # one sentence
    lost_data: bool = False  # part of the input could not be read: exit code 3


@dataclass(frozen=True, slots=True)
class Log:
    """One dive. Tables have the COLUMNS of their sensor; a sensor that is absent has no table."""

    path: Path
    sha256: str
    format: str  # "MCAP", "CSV folder", "simulated"
    start_ns: int  # absolute time of time_s = 0: the earliest stamp among the DVL, compass and USBL records used
    tables: Mapping[str, pd.DataFrame]
    provenance: Mapping[str, Provenance]
    assumptions: Assumptions
    origin: Origin | None = None
    truth: Truth | None = None
    configuration: Path | None = None  # which usbldr.toml was read
    findings: tuple[Finding, ...] = field(default=())


def missing_sensor_text(log: Log, role: str) -> str:
    """Say that a log holds no records of a sensor, which ones it holds, and how to give them."""
    have = ", ".join(log.tables) or "none"
    return (
        f"no {role} data (sensors in this log: {have}); name its topic by --{role} TOPIC, "
        "or add the file that holds it by --with FILE"
    )
