"""A log in canonical form: one table per sensor, where each came from, and findings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Array, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows, windows_text
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import NO_CONVENTION, Convention, Provenance
from usbldr.io.settings.sensor_sections import Configuration

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "dvl": ("time_s", "received_s", "starboard_mps", "forward_mps", "up_mps", "sd_mps", "valid"),
    "compass": ("time_s", "received_s", "heading_deg", "sd_deg"),
    "usbl": ("time_s", "received_s", "east_m", "north_m", "cov_ee_m2", "cov_en_m2", "cov_nn_m2"),
    "gps": ("time_s", "received_s", "east_m", "north_m", "sd_m", "lat_deg", "lon_deg"),
    "depth": ("time_s", "received_s", "depth_m"),
}
"""Columns of each sensor's table; float64 but for ``valid`` (bool); sorted by time_s; NaN = unknown."""


MAX_UNREAD = 3  # [topics] that a sentence names
MAX_GAP_S = 3.0  # [s] across which depth, roll and pitch are interpolated


@dataclass(frozen=True, slots=True)
class Log:
    """One dive. Tables have the COLUMNS of their sensor; a sensor that is absent has no table."""

    path: Path
    sha256: str
    format: str  # "MCAP", "CSV folder", "simulated"
    start_ns: int  # absolute time of time_s = 0: the earliest stamp among the DVL, compass and USBL records used
    tables: Mapping[str, pd.DataFrame]
    provenance: Mapping[str, Provenance]
    parameters: Parameters
    origin: Origin | None = None
    truth: Truth | None = None
    truth_fault: str = ""  # why the GPS, which would be the truth, has exchanged coordinates and is left out
    configuration: Path | None = None  # which usbldr.toml was read
    settings: Configuration = Configuration()  # its content
    findings: tuple[Finding, ...] = ()
    raws: Mapping[str, RawRecords] = field(default_factory=dict[str, RawRecords])  # by role, if requested
    attitude: pd.DataFrame | None = None  # time_s, roll_deg, pitch_deg of the compass, evenly spread over the log
    altitude: pd.DataFrame | None = None  # time_s, altitude_m of the DVL above the bottom, where its records have it
    unread: Mapping[str, str] = field(default_factory=dict[str, str])  # topic -> why it gives no records

    @property
    def map_unknown(self) -> bool:
        """Whether fixes are positions on a map whose origin is not stated, so that latitudes have no place on it."""
        return any(finding.code == "MAP-UNKNOWN" for finding in self.findings)

    def without_records(self, role: str) -> "Log":
        """Return the log without the records of a sensor, which it still has; those of a dense one fill the memory."""
        tables = {name: table.iloc[:0].copy() if name == role else table for name, table in self.tables.items()}
        return replace(self, tables=tables)

    def without_windows(self, role: str, windows: Sequence[TimeWindow]) -> "Log":
        """Return the log without the records of a sensor in these windows, and with a finding that says so."""
        if role not in self.tables:
            return self
        table = self.tables[role]
        inside = in_windows(table["time_s"].to_numpy(dtype=float), windows)
        text = f"{inside.sum()} of {len(table)} records from {windows_text(windows)} are left out by --exclude"
        kept, excluded = table[~inside].reset_index(drop=True), self.finding("EXCLUDED", role, text)
        return replace(self, tables={**self.tables, role: kept}, findings=(*self.findings, excluded))

    def topic_of(self, role: str) -> str:
        """Return the topic of a sensor, or its role if there is none."""
        return self.provenance[role].topic if role in self.provenance else role

    def depth_below_head_m(self, time_s: Vector) -> Vector:
        """Return how deep the vehicle is below the USBL's head, (n,), by the log's depth; NaN where it has none."""
        head = self.settings.usbl.head
        return column_at(time_s, self.tables.get("depth"), "depth_m") - (head.depth_m if head else 0.0)

    def finding(
        self, code: str, role: str, text: str, time_s: float | None = None, worst: float | None = None, unit: str = ""
    ) -> Finding:
        """Return a finding on a sensor, with whose topic its sentence begins."""
        topic = self.topic_of(role)
        return Finding(code, f"{topic}: {text}", topic, time_s, worst, unit)

    def convention(self, role: str, key: str) -> Convention:
        """Return by which convention a sensor was read, NO_CONVENTION if unknown."""
        return self.provenance[role].convention(key) if role in self.provenance else NO_CONVENTION


def missing_sensor_text(log: Log, role: str) -> str:
    """Return a sentence that a log has no records of a sensor, which sensors it has, and how to add one."""
    have = ", ".join(log.tables) or "none"
    unread = "".join(f"; {topic} {why}" for topic, why in islice(log.unread.items(), MAX_UNREAD))
    fixes = "; without it, --filter usbl judges the raw fixes" if role != "usbl" and "usbl" in log.tables else ""
    return (
        f"no {role} data (sensors in this log: {have}); name its topic by --{role} TOPIC, "
        f"or add the file that holds it by --with FILE{fixes}{unread}"
    )


def column_at(time_s: Vector, table: pd.DataFrame | None, column: str) -> Vector:
    """Return a column of a table at the times, (n,); NaN outside of its records and inside long gaps."""
    if table is None or not len(table):
        return np.full(len(time_s), np.nan)
    known_s = table["time_s"].to_numpy(dtype=float)
    values: Array = table[column].to_numpy(dtype=float)
    found = np.interp(time_s, known_s, values, left=np.nan, right=np.nan)
    after = np.minimum(np.searchsorted(known_s, time_s), len(known_s) - 1)
    before = np.maximum(np.searchsorted(known_s, time_s, side="right") - 1, 0)
    return np.where(known_s[after] - known_s[before] > MAX_GAP_S, np.nan, found)
