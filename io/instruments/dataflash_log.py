"""ArduPilot's onboard logs (DataFlash, .BIN): messages whose layouts are messages (FMT) of the log itself.

pymavlink finds the messages. A topic is a message type, "BARO[1]" if it states an instance. Times count from power-on;
the first GPS message with a fix gives the date. There are no checksums: what is between messages is damaged.
"""

import io
import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import cached_property
from importlib import import_module
from mmap import mmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.decoder_set import DecoderSet
from usbldr.io.file_access.open_file import mapped
from usbldr.io.findings import Finding
from usbldr.io.gps_time import LAST_WEEK, utc_ns
from usbldr.io.instruments.packed_rows import dtypes_of, table_of
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

MARK = b"\xa3\x95"  # fixed by the format: how each message begins; its type follows
HEAD_BYTES = 3  # fixed by the format
LONGEST = 255  # fixed: bytes of a message
FMT = 128  # fixed: the type that defines the others
LONGEST_US = 10**14  # [us] three years from power-on: a later time is a damaged one
FIX = 3  # fixed: the least Status of a GPS message with a fix in three dimensions


class Source(NamedTuple):
    """The messages of a topic."""

    number: int  # of the message type
    instance: int | None


def looks_like_dataflash(head: bytes) -> bool:
    """Return whether a file begins with the layout of a message type, or has two behind other bytes."""
    begin = MARK + bytes([FMT])
    return head.startswith(begin) or head.count(begin) > 1


class DataflashLog:
    """An onboard log."""

    format = "DataFlash log"

    def __init__(self, path: Path) -> None:
        """Take the file; raise UsageError without pymavlink."""
        self.path = path
        try:
            self._library = import_module("pymavlink.DFReader")
        except ImportError as err:
            raise UsageError("onboard logs need pymavlink: pip install 'usbldr[mavlink]'", path=path) from err
        os.environ.setdefault("PYMAVLINK_FAST_INDEX", "0")  # the fast one writes to the terminal past Python
        self._findings: list[Finding] = []
        self._undated: dict[int, int] = {}  # messages with impossible times by type

    @cached_property
    def _data(self) -> mmap:
        return mapped(self.path)

    @cached_property
    def _index(self) -> tuple[Mapping[int, Any], Mapping[int, list[int]]]:
        """Return the formats, and the places of messages by type: by pymavlink's index, behind damage one by one."""
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):  # a line for each damaged byte
                reader = self._library.DFReader_binary
                with reader.__new__(reader) as log:  # closed if the first pass over the file fails, too
                    log.__init__(str(self.path))
                    places = {number: list(map(int, log.offsets[number])) for number in log.formats}
                    log.offset = max((at + log.formats[number].len for number, found in places.items() for at in found))
                    while (message := log.recv_msg()) is not None:
                        places.setdefault(message.fmt.type, []).append(log.offset - message.fmt.len)
                    return log.formats, places
        except Exception as err:  # it raises whatever damaged layouts lead to
            why = " ".join(str(err).split())[:80]
            raise LogError(f"cannot be read as an onboard log: damaged ({why})", path=self.path) from err

    @cached_property
    def _formats(self) -> Mapping[int, Any]:
        return {number: form for number, form in self._index[0].items() if _is_whole(form)}

    @cached_property
    def _places(self) -> Mapping[int, Sequence[int]]:
        """Return where the messages of each type begin; record what was lost."""
        data, found = self._data, dict[int, Sequence[int]]()
        budget = UnpackingBudget(self.path, len(data))
        for number, form in self._formats.items():
            if places := [at for at in self._index[1].get(number, ()) if at + form.len <= len(data)]:
                budget.take_record(len(places))
                found[number] = places
        spans = sorted((at, at + self._formats[number].len) for number, places in found.items() for at in places)
        edges = zip([0, *(end for _, end in spans)], [*(at for at, _ in spans), len(data)], strict=True)
        gaps = [(end, at) for end, at in edges if data[end:at].strip(_unused(at - end, at == len(data)))]
        if gaps:
            lost = sum(at - end for end, at in gaps)
            text = f"{lost} of {len(data)} bytes, from byte {gaps[0][0]} on, are damaged or cut"
            self._findings.append(Finding("DAMAGED", f"{text}; their messages are missing", lost_data=True))
        return found

    def _table(self, number: int) -> Mapping[str, Column]:
        form = self._formats[number]
        payloads = [self._data[at + HEAD_BYTES : at + form.len] for at in self._places[number]]
        return table_of(payloads, form.columns, dtypes_of(form.msg_struct))

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
        column = self._formats[number].instance_field
        return None if column is None else self._table(number)[column]

    @cached_property
    def _start_ns(self) -> int:
        """Return the time since 1970 of power-on by the first GPS fix; 0 without one."""
        needed = {"TimeUS", "Status", "GMS", "GWk"}
        for number, form in self._formats.items():
            if form.name != "GPS" or number not in self._places or not needed <= set(form.columns):
                continue
            table = self._table(number)
            dated = (table["GWk"] > 0) & (table["GWk"] < LAST_WEEK) & (table["TimeUS"] < LONGEST_US)
            first = np.flatnonzero((table["Status"] >= FIX) & dated)[:1]
            if len(first):
                gps_ms, week, time_us = (table[name][first].astype(np.int64) for name in ("GMS", "GWk", "TimeUS"))
                return int((utc_ns(week, gps_ms / 1000) - time_us * 1000)[0])
        return 0

    def _rows(self, source: Source) -> tuple[Mapping[str, Column], Nanoseconds]:
        """Return the columns of a topic, and its times in nanoseconds since 1970; impossible times are left out."""
        table = self._table(source.number)
        good = table["TimeUS"] < LONGEST_US
        if not good.all():
            self._undated[source.number] = int(np.sum(~good))
        column = self._formats[source.number].instance_field
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
            found.append(TopicInfo(name, kind, "dataflash", len(times), *span, tuple(form.columns)))
        return tuple(found)

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Decode the wanted messages."""
        for topic, paths in wanted.items():
            yield topic, self._records(self._sources[topic], paths)

    def _records(self, source: Source, paths: Sequence[str]) -> Records:
        table, times = self._rows(source)
        form = self._formats[source.number]
        scales = dict(zip(form.columns, form.msg_mults, strict=True))
        columns = {path: table[path] if scales[path] is None else table[path] * scales[path] for path in paths}
        return Records(times, columns)

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        undated = sum(self._undated.values()) if self._places else 0
        text = f"{undated} messages have an impossible time; left out"
        return (*self._findings, *([Finding("DAMAGED", text, lost_data=True)] if undated else []))


def _unused(size: int, at_end: bool) -> bytes:
    """Return which bytes between messages are no loss: those of an erased page that no message fits in, or any last."""
    return b"\0\xff" if at_end else b"\xff" * (size < LONGEST)


def _is_timed(form: Any) -> bool:
    return form.columns[0] == "TimeUS" and form.format[0] == "Q"


def _is_whole(form: Any) -> bool:
    """Return whether the parts of a layout agree with each other."""
    columns: list[str] = form.columns
    fits = struct.calcsize(form.msg_struct) + HEAD_BYTES == form.len and len(columns) == len(form.msg_mults)
    return fits and bool(columns) and len(set(columns)) == len(columns) and all(columns)
