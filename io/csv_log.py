"""The canonical CSV folder: one text file for each sensor, its stem the topic ("dvl.csv" is "/dvl").

Columns are those of log.COLUMNS with integer ``time_ns`` (and, where known, ``received_ns``) in place of the times in
seconds; the columns that may be absent stand in SHEETS below. A "__" in a stem is a "/" of the topic.
"""

import codecs
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError
from usbldr.filters.types import Vector
from usbldr.io.log import Finding
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

CANONICAL = "usbldr/"  # types of canonical files: "usbldr/dvl"


class Sheet(NamedTuple):
    """How one kind of file is told and read."""

    type: str
    choices: tuple[frozenset[str], ...]  # the columns of at least one of these must be there, beside time_ns
    optional: frozenset[str]


def _sheet(sensor: str, choices: Sequence[str], optional: str = "") -> Sheet:
    return Sheet(CANONICAL + sensor, tuple(frozenset(c.split()) for c in choices), frozenset(optional.split()))


SHEETS: Mapping[str, Sheet] = {
    "dvl": _sheet("dvl", ["starboard_mps forward_mps"], "up_mps sd_mps valid"),
    "compass": _sheet("compass", ["heading_deg"], "sd_deg"),
    "usbl": _sheet(
        "usbl",
        ["east_m north_m", "lat_deg lon_deg", "slant_range_m bearing_deg"],
        "elevation_deg depth_m sd_m cov_ee_m2 cov_en_m2 cov_nn_m2",
    ),
    "gps": _sheet("gps", ["lat_deg lon_deg", "east_m north_m"], "sd_m lat_deg lon_deg"),
    "depth": _sheet("depth", ["depth_m"]),
    "truth": _sheet("truth", ["east_m north_m", "lat_deg lon_deg"], "sd_m lat_deg lon_deg"),
}
"""One line per sensor; a file belongs to the sensor that its stem names, else to the only one that its columns fit."""


def text_files(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that look like CSV, by name."""
    for file in sorted(folder.iterdir()):
        if file.is_file() and not file.name.startswith(".") and file.suffix not in (".toml", ".md", ".json"):
            with file.open("rb") as opened:
                if looks_like_csv(opened.read(4096)):
                    yield file


def looks_like_csv(head: bytes) -> bool:
    """Tell whether a file's first bytes are text whose first line names columns."""
    if b"\0" in head or not head.strip():
        return False
    first = head.removeprefix(codecs.BOM_UTF8).splitlines()[0]
    return b"," in first and any(chr(c).isalpha() for c in first)


class CsvLog:
    """A folder of CSV files, or one such file."""

    format = "CSV folder"

    def __init__(self, path: Path) -> None:
        """Open nothing yet."""
        self.path = path
        self._read: dict[str, Mapping[str, Sequence[str]]] = {}

    @cached_property
    def _files(self) -> Mapping[str, Path]:
        """Return the files by topic."""
        files = text_files(self.path) if self.path.is_dir() else [self.path]
        return {"/" + file.stem.replace("__", "/"): file for file in files}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the files; one whose columns fit no sensor has no type."""
        return tuple(self._info(topic, file) for topic, file in self._files.items())

    def _texts(self, topic: str) -> Mapping[str, Sequence[str]]:
        if topic not in self._read:
            self._read[topic] = read_texts(self._files[topic])
        return self._read[topic]

    def _info(self, topic: str, file: Path) -> TopicInfo:
        header = read_header(file)
        sheet = _recognised(file.stem, set(header))
        if sheet is None:
            return TopicInfo(topic, "", "csv", 0, None, None, problem="its columns fit no sensor")
        fields = [c for c in header if c in sheet.optional or any(c in choice for choice in sheet.choices)]
        missing = min((sorted((choice | {"time_ns"}) - set(header)) for choice in sheet.choices), key=len)
        if missing:
            problem = f"{file.name} has no column {', '.join(missing)} (its columns: {', '.join(header)})"
            return TopicInfo(topic, sheet.type, "csv", 0, None, None, tuple(fields), problem)
        try:
            times = self._received(topic)
        except LogError as err:
            return TopicInfo(topic, sheet.type, "csv", 0, None, None, tuple(fields), str(err))
        first, last = (int(times.min()), int(times.max())) if len(times) else (None, None)
        return TopicInfo(topic, sheet.type, "csv", len(times), first, last, ("header.stamp", *fields))

    def _received(self, topic: str) -> Nanoseconds:
        texts = self._texts(topic)
        name = "received_ns" if "received_ns" in texts else "time_ns"
        return nanoseconds(texts[name], name, self._files[topic])

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Read the wanted columns; "header.stamp" is time_ns."""
        return {topic: self._records(topic, paths) for topic, paths in wanted.items()}

    def _records(self, topic: str, paths: Sequence[str]) -> Records:
        texts, file, received = self._texts(topic), self._files[topic], self._received(topic)
        columns: dict[str, Column] = {
            path: nanoseconds(texts["time_ns"], "time_ns", file)
            if path == "header.stamp"
            else numbers(texts[path], path, file)
            for path in paths
        }
        order = np.argsort(received, kind="stable")
        return Records(received[order], {path: column[order] for path, column in columns.items()})

    def findings(self) -> tuple[Finding, ...]:
        """Report nothing: what cannot be read here is an error."""
        return ()


def _recognised(stem: str, header: set[str]) -> Sheet | None:
    """Return the sheet that a file's stem is, else the one that its columns fit and, of several, its stem names."""
    name = stem.lower().split("__")[-1]
    if name in SHEETS:
        return SHEETS[name]
    fitting = {k: s for k, s in SHEETS.items() if any(choice | {"time_ns"} <= header for choice in s.choices)}
    named = {sensor: sheet for sensor, sheet in fitting.items() if sensor in name}
    wished = list((named or fitting).values())
    return wished[0] if len(wished) == 1 else None


def read_header(file: Path) -> list[str]:
    """Return a file's column names without blanks, a leading "%" and rostopic's "field."."""
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            return [name.strip().lstrip("% ").removeprefix("field.").strip() for name in lines.readline().split(",")]
    except OSError as err:
        raise LogError(f"{file}: cannot be read ({err.strerror})") from err


def read_texts(file: Path) -> Mapping[str, Sequence[str]]:
    """Return all columns of a CSV file as text without blanks; raise LogError where it is none."""
    header = read_header(file)
    try:
        table = pd.read_csv(file, header=0, names=header, dtype=str, keep_default_na=False, index_col=False)
    except (ValueError, UnicodeDecodeError) as err:
        raise LogError(f"{file}: is not a CSV file ({' '.join(str(err).split())})") from err
    return {name: [str(text).strip() for text in table[name]] for name in header}


def column(texts: Mapping[str, Sequence[str]], name: str, file: Path) -> Sequence[str]:
    """Return one column; raise LogError with the header where it is missing."""
    if name not in texts:
        raise LogError(f"{file}: has no column {name} (its columns: {', '.join(texts)})")
    return texts[name]


def nanoseconds(texts: Sequence[str], name: str, file: Path) -> Nanoseconds:
    """Return a column of integer nanoseconds, through no float."""
    try:
        return np.array([int(text) for text in texts], dtype=np.int64)
    except (ValueError, OverflowError) as err:
        line, text = next((i + 2, text) for i, text in enumerate(texts) if not _is_nanoseconds(text))
        raise LogError(f'{file}: line {line}: {name} is "{text}", not a whole number of nanoseconds') from err


def numbers(texts: Sequence[str], name: str, file: Path) -> Vector:
    """Return a column of numbers; an empty cell is NaN, True and False are 1 and 0."""
    words = {"": "nan", "true": "1", "false": "0"}
    values = [words.get(text.lower(), text) for text in texts]
    try:
        return np.array([float(value) for value in values], dtype=np.float64)
    except ValueError as err:
        line, text = next((i + 2, value) for i, value in enumerate(values) if not _is_number(value))
        raise LogError(f'{file}: line {line}: {name} is "{text}", not a number') from err


def _is_nanoseconds(text: str) -> bool:
    digits = text.removeprefix("-").removeprefix("+")
    return digits.isdecimal() and abs(int(text)) < 2**63


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
