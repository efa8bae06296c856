"""ArduPilot's onboard logs (DataFlash, .BIN): messages whose layouts are messages (FMT) of the log itself.

A topic is a message type, "BARO[1]" if it states an instance. Times count from power-on; the first GPS message with a
fix gives the date. There are no checksums: what does not begin with the two marks is damaged.
"""

from array import array
from collections.abc import Mapping, Sequence
from functools import cached_property
from mmap import mmap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usbldr.io.decoding.decoder_set import DecoderSet
from usbldr.io.findings import Finding
from usbldr.io.formats.files import mapped
from usbldr.io.formats.packed_rows import dtypes_of, table_of
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

MARK = b"\xa3\x95"  # fixed by the format: how each message begins; its type follows
HEAD_BYTES = 3  # fixed by the format
FMT, FMT_BYTES = 128, 89  # fixed: the type that defines the others
STRUCT_CODES: Mapping[str, str] = (
    {code: code for code in "bBhHiIfdqQ"}
    | {"g": "e", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B"}
    | {"a": "64s", "n": "4s", "N": "16s", "Z": "64s"}
)
"""ArduPilot's codes of a value's type as those of the module struct."""
SCALES: Mapping[str, float] = dict.fromkeys("cCeE", 0.01) | {"L": 1e-7}
"""Factors of the values by code: hundredths, degrees."""
INSTANCE = "#"  # fixed: the unit of a field that tells sensors of one kind apart
GPS_EPOCH_S, WEEK_S = 315_964_800, 604_800  # fixed: 1980-01-06 in seconds since 1970
LAST_WEEK = 6000  # [weeks] since then, in the year 2095: a later one is a damaged number
LEAP_S = 18  # [s] GPS time minus UTC since 2017
LONGEST_US = 10**14  # [us] three years from power-on: a later time is a damaged one
FIX = 3  # fixed: the least Status of a GPS message with a fix in three dimensions


class Format(NamedTuple):
    """The layout of a message type."""

    name: str
    length: int  # [bytes] with its head
    codes: str
    columns: tuple[str, ...]

    @property
    def types(self) -> list[str]:
        """NumPy's types of the columns."""
        return [dtypes_of(f"<{STRUCT_CODES[code]}")[0] for code in self.codes]


class Source(NamedTuple):
    """The messages of a topic."""

    number: int  # of the message type
    instance: int | None


def looks_like_dataflash(head: bytes) -> bool:
    """Return whether a file begins with the layout of a message type, or has two behind bytes of another."""
    begin = MARK + bytes([FMT])
    at = head.find(begin)
    return at == 0 or (at > 0 and head[at + FMT_BYTES :].startswith(begin))


class DataflashLog:
    """An onboard log."""

    format = "DataFlash log"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._formats: dict[int, Format] = {}
        self._findings: list[Finding] = []
        self._undated: dict[int, int] = {}  # messages with impossible times by type

    @cached_property
    def _data(self) -> mmap:
        return mapped(self.path)

    @cached_property
    def _places(self) -> Mapping[int, "array[int]"]:
        """Return where the messages of each type begin; record what was lost."""
        data, places, at, lost, first_lost = self._data, dict[int, "array[int]"](), 0, 0, -1
        budget = UnpackingBudget(self.path, len(data))
        while at < len(data):
            length = self._length(at)
            if length and at + length <= len(data) and self._is_apart(at, length, budget):
                budget.take_record()
                places.setdefault(data[at + 2], array("q")).append(at)
                at += length
                continue
            following = self._next(at + 1, budget)
            rest = data[at:following] if following - at < 1 << 16 else b"long"
            if rest.strip(b"\0\xff"):  # the unused end of a page is no loss
                first_lost, lost = (at if first_lost < 0 else first_lost), lost + following - at
            at = following
        if lost:
            text = f"{lost} of {len(data)} bytes, from byte {first_lost} on, are damaged or cut"
            self._findings.append(Finding("DAMAGED", f"{text}; their messages are missing", lost_data=True))
        return places

    def _length(self, at: int) -> int:
        """Return the length of the message at a byte, 0 if there is none; keep its layout if it is one."""
        data = self._data
        if data[at : at + 2] != MARK or at + HEAD_BYTES > len(data):
            return 0
        number = data[at + 2]
        if number != FMT:
            return self._formats[number].length if number in self._formats else 0
        body = data[at + HEAD_BYTES : at + FMT_BYTES]
        if len(body) == FMT_BYTES - HEAD_BYTES:
            name, codes, columns = (
                part.rstrip(b"\0").decode("ascii", "replace") for part in (body[2:6], body[6:22], body[22:86])
            )
            made = Format(name, body[1], codes, tuple(columns.split(",")))
            if _is_whole(made):
                self._formats.setdefault(body[0], made)
        return FMT_BYTES

    def _is_apart(self, at: int, length: int, budget: UnpackingBudget) -> bool:
        """Return whether the next message begins behind this one, not within it, as behind a cut."""
        after = self._data[at + length : at + length + 2]
        return after in (MARK, b"") or self._next(at + 1, budget) >= at + length

    def _next(self, at: int, budget: UnpackingBudget) -> int:
        """Return where the next message begins that another one or the end of the file follows."""
        data = self._data
        while (at := data.find(MARK, at)) >= 0:
            budget.take_search(FMT_BYTES)
            length = self._length(at)
            after = at + length
            if length and (after == len(data) or data[after : after + 2] == MARK):
                return at
            at += 1
        return len(data)

    def _table(self, number: int) -> Mapping[str, Column]:
        form = self._formats[number]
        payloads = [self._data[at + HEAD_BYTES : at + form.length] for at in self._places[number]]
        return table_of(payloads, form.columns, form.types)

    @cached_property
    def _sources(self) -> Mapping[str, Source]:
        """Return the topics: message types with times, by instance if they state one."""
        found: dict[str, Source] = {}
        counter = DecoderSet(self.path)
        for number in self._places:
            form = self._formats.get(number)
            if form is None or number == FMT:
                continue
            if not _is_timed(form):
                found[form.name] = Source(number, None)
                continue
            instances = self._instances(number)
            values = [None] if instances is None else sorted(set(instances.tolist()))
            for value in values:
                counter.add_topic()
                found[form.name if value is None else f"{form.name}[{value}]"] = Source(number, value)
        return found

    def _instances(self, number: int) -> Column | None:
        """Return the instance of each message of a type, None if it has none."""
        column = self._instance_columns.get(number)
        return None if column is None else self._table(number)[column]

    @cached_property
    def _instance_columns(self) -> Mapping[int, str]:
        """Return by message type the column of the instance, which the messages FMTU name."""
        units = next((number for number, form in self._formats.items() if form.name == "FMTU"), None)
        if (
            units is None
            or units not in self._places
            or not {"FmtType", "UnitIds"} <= set(self._formats[units].columns)
        ):
            return {}
        table, found = self._table(units), dict[int, str]()
        for number, ids in zip(table["FmtType"].tolist(), table["UnitIds"].tolist(), strict=True):
            form = self._formats.get(number)
            place = str(ids).find(INSTANCE)
            if form is not None and 0 <= place < len(form.columns) and form.codes[place] == "B":
                found[number] = form.columns[place]
        return found

    @cached_property
    def _start_ns(self) -> int:
        """Return the time since 1970 of power-on by the first GPS fix; 0 without one."""
        for number, form in self._formats.items():
            if (
                form.name == "GPS"
                and number in self._places
                and {"TimeUS", "Status", "GMS", "GWk"} <= set(form.columns)
            ):
                table = self._table(number)
                dated = (table["GWk"] > 0) & (table["GWk"] < LAST_WEEK) & (table["TimeUS"] < LONGEST_US)
                fixed = np.flatnonzero((table["Status"] >= FIX) & dated)
                if len(fixed):
                    gps_ms, week, time_us = (int(table[name][fixed[0]]) for name in ("GMS", "GWk", "TimeUS"))
                    return ((GPS_EPOCH_S + week * WEEK_S - LEAP_S) * 1000 + gps_ms) * 1_000_000 - time_us * 1000
        return 0

    def _rows(self, source: Source) -> tuple[Mapping[str, Column], Nanoseconds]:
        """Return the columns of a topic, and its times in nanoseconds since 1970; impossible times are left out."""
        table = self._table(source.number)
        good = table["TimeUS"] < LONGEST_US
        if not good.all():
            self._undated[source.number] = int(np.sum(~good))
        column = self._instance_columns.get(source.number)
        if source.instance is not None and column is not None:
            good &= table[column] == source.instance
        times = table["TimeUS"][good].astype(np.int64) * 1000 + self._start_ns
        return {name: values[good] for name, values in table.items()}, times

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the message types."""
        found: list[TopicInfo] = []
        for name, source in self._sources.items():
            form, kind = self._formats[source.number], f"dataflash/{self._formats[source.number].name}"
            if not _is_timed(form):
                count, problem = len(self._places[source.number]), "its messages have no time TimeUS"
                found.append(TopicInfo(name, kind, "dataflash", count, None, None, problem=problem))
                continue
            _, times = self._rows(source)
            span = (int(times.min()), int(times.max())) if len(times) else (None, None)
            found.append(TopicInfo(name, kind, "dataflash", len(times), *span, form.columns))
        return tuple(found)

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Decode the wanted messages."""
        return {topic: self._records(self._sources[topic], paths) for topic, paths in wanted.items()}

    def _records(self, source: Source, paths: Sequence[str]) -> Records:
        table, times = self._rows(source)
        form = self._formats[source.number]
        scales = dict(zip(form.columns, (SCALES.get(code) for code in form.codes), strict=True))
        columns = {path: table[path] if scales[path] is None else table[path] * scales[path] for path in paths}
        return Records(times, columns)

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        undated = sum(self._undated.values()) if self._places else 0
        text = f"{undated} messages have an impossible time; left out"
        return (*self._findings, *([Finding("DAMAGED", text, lost_data=True)] if undated else []))


def _is_timed(form: Format) -> bool:
    return form.columns[0] == "TimeUS" and form.codes[0] == "Q"


def _is_whole(form: Format) -> bool:
    """Return whether the parts of a layout agree with each other."""
    if not form.codes or len(form.codes) != len(form.columns) or not set(form.codes) <= STRUCT_CODES.keys():
        return False
    length = sum(np.dtype(kind).itemsize for kind in form.types)
    return length + HEAD_BYTES == form.length and len(set(form.columns)) == len(form.columns) and all(form.columns)
