"""PD6: the text that Doppler logs of Teledyne RDI and Water Linked write, groups of lines that begin with a colon.

Source: Water Linked's page of PD formats (docs/dvl/dvl-pd-formats.md of waterlinked/docs), which states the fields and
units. A group is timed by its line TS; one without it is lost. Lines have no checksum.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from usbldr.io.file_access.open_file import head_lines, is_damaged, text_lines
from usbldr.io.findings import Finding
from usbldr.io.instruments.records_log import RecordsLog, log_in_memory
from usbldr.io.reader import Records

LOGGED = r"\d[-\d/.:T]*Z?[\s,;]+"  # a part of the time at which a line was logged
LINE = re.compile(rf"^\s*(?:{LOGGED}){{0,2}}:(SA|TS|WI|WS|WE|WD|BI|BS|BE|BD|RA)((?:,[^,:]*)+?)\s*$")
TIME = re.compile(r"\d{14}", re.ASCII)
LINES: Mapping[str, Mapping[str, int]] = {
    "BI": {"x": 0, "y": 1, "z": 2, "status": 4},
    "BS": {"x": 0, "y": 1, "z": 2, "status": 3},
    "BE": {"x": 0, "y": 1, "z": 2, "status": 3},
    "SA": {"pitch_deg": 0, "roll_deg": 1, "heading_deg": 2},
    "TS": {"depth_m": 3, "sound_speed_mps": 4},
}
"""By the name of a line: its columns, and which fields they are."""
FIELD_COUNTS: Mapping[str, int] = {
    "SA": 3,
    "TS": 6,
    **dict.fromkeys(("WI", "WD", "BI", "BD"), 5),
    **dict.fromkeys(("WS", "WE", "BS", "BE"), 4),
}  # fixed by the format


def looks_like_pd6(head: bytes) -> bool:
    """Return whether most lines of a file's first bytes are lines of PD6."""
    lines = [line for line in head_lines(head)[:20] if line.strip()]
    return sum(LINE.match(line) is not None for line in lines) > len(lines) / 2


def pd6_log(file: Path) -> RecordsLog:
    """Return the log of a text file of PD6; its topics are the lines that hold something."""
    return log_in_memory(file, "PD6 text", "pd6", _read)


def _read(file: Path, findings: list[Finding]) -> Mapping[str, Records]:
    rows: dict[str, list[tuple[int, tuple[float | str, ...]]]] = {name: [] for name in LINES}
    bad: list[int] = []
    for group in _groups(text_lines(file)):
        time_ns = next((_time(fields) for _, name, fields in group if name == "TS"), None)
        for number, name, fields in group:
            try:
                known = len(fields) == FIELD_COUNTS.get(name, len(fields))
                if not name or time_ns is None or not known or any(map(is_damaged, fields)):
                    raise ValueError
                if name in LINES:
                    values = (_value(column, fields[place]) for column, place in LINES[name].items())
                    rows[name].append((time_ns, tuple(values)))
            except ValueError:
                bad.append(number)
    if bad:
        text = f"{file.name}: {len(bad)} lines are cut, altered or without a time, the first is line {bad[0]}"
        findings.append(Finding("UNDECODED", f"{text}; left out", lost_data=True))
    return {f"/{name}": _records(name, found) for name, found in rows.items() if found}


def _groups(lines: Iterator[str]) -> Iterator[list[tuple[int, str, Sequence[str]]]]:
    """Yield the lines of each group as number, name and fields; a group ends before the next SA or TS.

    The name of a line that is none of PD6 is empty.
    """
    group: list[tuple[int, str, Sequence[str]]] = []
    names: set[str] = set()
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        match = LINE.match(line) if line.endswith("\n") else None  # a last line without a line end may be cut
        name, fields = (match[1], [field.strip() for field in match[2][1:].split(",")]) if match else ("", [])
        if (name in names and name in ("SA", "TS")) or (name == "SA" and "TS" in names):
            yield group
            group, names = [], set()
        group.append((number, name, fields))
        names.add(name)
    yield group


def _time(fields: Sequence[str]) -> int | None:
    """Return the time of a line TS, YYMMDDhhmmss and hundredths; None if it is not valid."""
    if len(fields) != FIELD_COUNTS["TS"] or not TIME.fullmatch(fields[0]):
        return None
    digits = fields[0]
    year, month, day, hour, minute, second, hundredths = (int(digits[k : k + 2]) for k in range(0, 14, 2))
    try:
        moment = datetime(2000 + year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return (int(moment.timestamp()) * 100 + hundredths) * 10_000_000


def _value(column: str, text: str) -> float | str:
    if column == "status":
        if text not in ("A", "V"):
            raise ValueError
        return text
    if "_" in text:  # which Python takes for part of a number
        raise ValueError
    return float(text)


def _records(name: str, rows: Sequence[tuple[int, tuple[float | str, ...]]]) -> Records:
    times = np.array([time_ns for time_ns, _ in rows], dtype=np.int64)
    values = zip(*(values for _, values in rows), strict=True)
    return Records(times, dict(zip(LINES[name], map(np.array, values), strict=True)))
