"""PD4 and PD5 files of Doppler logs: ensembles of Teledyne RDI's, which Water Linked writes, too (PD4).

Source: the special output data formats of Teledyne's manuals (Pathfinder DVL Guide, tables 48 and 49; those of Explorer
and Workhorse Navigator are the same). Velocities are those of the instrument over the bottom. An ensemble has a time of
day and no date.
"""

import struct
from collections.abc import Mapping, Sequence
from datetime import time
from pathlib import Path

import numpy as np

from usbldr.io.decoding.nmea_times import NO_TIME, times_from_sentences
from usbldr.io.file_access.open_file import BEGIN_BYTES, begin_of
from usbldr.io.findings import UNDATED, Finding
from usbldr.io.instruments.ensembles import ensembles, first_ensemble
from usbldr.io.instruments.records_log import RecordsLog, log_in_memory
from usbldr.io.reader import Records

BEGIN = (b"\x7d\x00\x2d\x00", b"\x7d\x01\x56\x00")  # fixed: mark, PD4 or PD5, and the size of each
COMMON = struct.Struct("<4xB3h24x4B")  # fixed: coordinates in the highest bits, x, y, z [mm/s], time of the first ping
PD5 = struct.Struct("<46xH4xH")  # fixed: depth [dm], heading [0.01 deg]
PD4_BYTES = 45  # fixed: without checksum
NO_VELOCITY = -32768  # fixed by the format
HUNDREDTH_NS = 10_000_000  # fixed


def name_of_pd45(head: bytes) -> str:
    """Return the format of a file that begins with an ensemble, or within one; empty if it does not."""
    first = head if head.startswith(BEGIN) else first_ensemble(head, BEGIN)
    return f"PD{4 + first[1]}" if first else ""


def pd45_log(file: Path) -> RecordsLog:
    """Return the log of a PD4 or PD5 file: bottom track, and of PD5 heading and depth if they are not constant."""
    head, _ = begin_of(file, BEGIN_BYTES)
    return log_in_memory(file, name_of_pd45(head), "pd45", _read)


def _read(file: Path, findings: list[Finding]) -> Mapping[str, Records]:
    rows: list[tuple[int, ...]] = []  # time of day [ns], coordinates, x, y, z, depth, heading
    unused = 0
    for whole in ensembles(file, BEGIN, findings):
        system, x, y, z, *clock = COMMON.unpack_from(whole)
        depth, heading = PD5.unpack_from(whole) if len(whole) > PD4_BYTES else (0, 0)
        try:
            rows.append((_time_of_day(*clock), system >> 6, x, y, z, depth, heading))
        except ValueError:
            unused += 1
    if unused:
        findings.append(Finding("UNDECODED", f"{unused} ensembles have no valid time; left out"))
    if not rows:
        return {}
    findings.append(Finding("NO-DATE", f"{file.name}: {UNDATED}"))
    return _records(rows)


def _time_of_day(hour: int, minute: int, second: int, hundredths: int) -> int:
    """Return nanoseconds since midnight; raise ValueError if it is no time."""
    whole = time(hour, minute, second, hundredths * 10_000)
    return ((whole.hour * 60 + whole.minute) * 60 + whole.second) * 100 * HUNDREDTH_NS + hundredths * HUNDREDTH_NS


def _records(rows: Sequence[tuple[int, ...]]) -> dict[str, Records]:
    """Return the topics; midnight passes where the time of day jumps back by more than half a day."""
    of_day, coordinates, x, y, z, depth, heading = np.array(rows, dtype=np.int64).T
    times, _ = times_from_sentences(of_day, np.full(len(of_day), NO_TIME))
    velocity = {axis: np.where(v == NO_VELOCITY, np.nan, v / 1000) for axis, v in zip("xyz", (x, y, z), strict=True)}
    return {
        "/bottom_track": Records(times, {**velocity, "coordinates": coordinates}),
        "/heading": Records(times, {"heading_deg": heading / 100}),
        "/depth": Records(times, {"depth_m": depth / 10}),
    }
