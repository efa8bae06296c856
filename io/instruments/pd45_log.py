"""PD4 and PD5 files of Doppler logs: ensembles of Teledyne RDI's, which Water Linked writes, too (PD4).

Source: the special output data formats of Teledyne's manuals (Pathfinder DVL Guide, tables 48 and 49; those of Explorer
and Workhorse Navigator are the same). Velocities are those of the instrument over the bottom. An ensemble has a time of
day and no date.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from usbldr.io.decoding.nmea_times import NO_TIME, times_from_sentences
from usbldr.io.file_access.open_file import BEGIN_BYTES, begin_of
from usbldr.io.findings import UNDATED, Finding
from usbldr.io.instruments.ensembles import ensembles, first_ensemble
from usbldr.io.instruments.records_log import RecordsLog, log_in_memory
from usbldr.io.reader import Records

BEGIN = (b"\x7d\x00\x2d\x00", b"\x7d\x01\x56\x00")  # fixed: mark, PD4 or PD5, and the size of each
ROW = np.dtype(
    {
        "names": ["coordinates", "velocity_mmps", "clock", "depth_dm", "heading_cdeg"],
        "formats": ["u1", ("<i2", 3), ("u1", 4), "<u2", "<u2"],
        "offsets": [4, 5, 35, 46, 52],
    }
)
"""What is used of an ensemble, fixed by the formats; PD4 ends before the depth."""
CLOCK = (24, 60, 60, 100)  # fixed: what hours, minutes, seconds and hundredths of the first ping are below
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
    """Return the topics; midnight passes where the time of day jumps back by more than half a day."""
    size = ROW.itemsize
    rows = np.frombuffer(b"".join(one[:size].ljust(size, b"\0") for one in ensembles(file, BEGIN, findings)), ROW)
    timed = np.all(rows["clock"] < CLOCK, axis=1)
    if unused := int(np.sum(~timed)):
        findings.append(Finding("UNDECODED", f"{unused} ensembles have no valid time; left out"))
    if not timed.any():
        return {}
    findings.append(Finding("NO-DATE", f"{file.name}: {UNDATED}"))
    rows = rows[timed]
    hour, minute, second, hundredths = rows["clock"].astype(np.int64).T
    of_day = (((hour * 60 + minute) * 60 + second) * 100 + hundredths) * HUNDREDTH_NS
    times, _ = times_from_sentences(of_day, np.full(len(of_day), NO_TIME))
    mps = np.where(rows["velocity_mmps"] == NO_VELOCITY, np.nan, rows["velocity_mmps"] / 1000)
    track = dict(zip("xyz", mps.T, strict=True)) | {"coordinates": rows["coordinates"].astype(np.int64) >> 6}
    return {
        "/bottom_track": Records(times, track),  # coordinates are in the highest bits
        "/heading": Records(times, {"heading_deg": rows["heading_cdeg"] / 100}),
        "/depth": Records(times, {"depth_m": rows["depth_dm"] / 10}),
    }
