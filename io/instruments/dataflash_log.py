"""ArduPilot's onboard logs (DataFlash, .BIN): messages whose layouts are messages (FMT) of the log itself.

pymavlink finds the messages. A topic is a message type, "BARO[1]" if it states an instance. Times count from power-on;
the first GPS message with a fix gives the date. There are no checksums: what is between messages is damaged.
"""

import io
import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import DecoderSet
from usbldr.io.file_access.open_file import mapped
from usbldr.io.file_access.optional_library import library
from usbldr.io.findings import Finding
from usbldr.io.gps_time import LAST_WEEK, utc_ns
from usbldr.io.instruments.packed_rows import dtypes_of, table_of
from usbldr.io.instruments.records_log import RecordsLog, Topic, damaged_bytes
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

MARK = b"\xa3\x95"  # fixed by the format: how each message begins; its type follows
HEAD_BYTES = 3  # fixed by the format
LONGEST = 255  # fixed: bytes of a message
FMT = 128  # fixed: the type that defines the others
LONGEST_US = 10**14  # [us] three years from power-on: a later time is a damaged one
FIX = 3  # fixed: the least Status of a GPS message with a fix in three dimensions


def looks_like_dataflash(head: bytes) -> bool:
    """Return whether a file begins with the layout of a message type, or has two behind other bytes."""
    begin = MARK + bytes([FMT])
    return head.startswith(begin) or head.count(begin) > 1


def dataflash_log(path: Path) -> RecordsLog:
    """Return an onboard log; raise UsageError without pymavlink."""
    dfreader = library("pymavlink.DFReader", "onboard logs", "mavlink", path)
    os.environ.setdefault("PYMAVLINK_FAST_INDEX", "0")  # the fast one writes to the terminal past Python
    return RecordsLog(path, "DataFlash log", lambda file, findings: _Messages(dfreader, file, findings).topics())


class _Messages:
    """The messages of a log by the number of their type."""

    def __init__(self, dfreader: Any, file: Path, findings: list[Finding]) -> None:
        """Find them; append what is lost to the findings."""
        self._file, self._findings, self._data = file, findings, mapped(file)
        formats, places = _index(dfreader, file)
        self._formats = {number: form for number, form in formats.items() if _is_whole(form)}
        self._places = self._whole(places)
        self._start_ns = self._power_on_ns()

    def _whole(self, places: Mapping[int, Sequence[int]]) -> Mapping[int, Sequence[int]]:
        """Return where the messages begin that are not cut; report the bytes between them."""
        data, found = self._data, dict[int, Sequence[int]]()
        budget = UnpackingBudget(self._file, len(data))
        for number, form in self._formats.items():
            if begins := [at for at in places.get(number, ()) if at + form.len <= len(data)]:
                budget.take_record(len(begins))
                found[number] = begins
        spans = sorted((at, at + self._formats[number].len) for number, begins in found.items() for at in begins)
        edges = zip([0, *(end for _, end in spans)], [*(at for at, _ in spans), len(data)], strict=True)
        gaps = [(end, at) for end, at in edges if data[end:at].strip(_unused(at - end, at == len(data)))]
        lost = sum(at - end for end, at in gaps)
        self._findings += damaged_bytes(lost, len(data), gaps[0][0] if gaps else 0, "messages")
        return found

    def _table(self, number: int) -> Mapping[str, Column]:
        form = self._formats[number]
        payloads = [self._data[at + HEAD_BYTES : at + form.len] for at in self._places[number]]
        return table_of(payloads, form.columns, dtypes_of(form.msg_struct))

    def _power_on_ns(self) -> int:
        """Return the time since 1970 of power-on by the first GPS fix; 0 without one."""
        for number in self._places:
            form = self._formats[number]
            if form.name != "GPS" or not {"TimeUS", "Status", "GMS", "GWk"} <= set(form.columns):
                continue
            table = self._table(number)
            dated = (table["GWk"] > 0) & (table["GWk"] < LAST_WEEK) & (table["TimeUS"] < LONGEST_US)
            first = np.flatnonzero((table["Status"] >= FIX) & dated)[:1]
            if len(first):
                gps_ms, week, time_us = (table[name][first].astype(np.int64) for name in ("GMS", "GWk", "TimeUS"))
                return int((utc_ns(week, gps_ms / 1000) - time_us * 1000)[0])
        return 0

    def topics(self) -> Iterator[Topic]:
        """Yield the message types, by instance if they state one; report impossible times."""
        counter, undated = DecoderSet(self._file), 0
        for number, places in self._places.items():
            form = self._formats[number]
            kind = f"dataflash/{form.name}"
            if number == FMT:
                continue
            if form.columns[0] != "TimeUS" or form.format[0] != "Q":
                problem = "its messages have no time TimeUS"
                yield Topic(TopicInfo(form.name, kind, "dataflash", len(places), None, None, problem=problem))
                continue
            table = self._table(number)
            undated += int(np.sum(table["TimeUS"] >= LONGEST_US))
            for instance in [None] if form.instance_field is None else np.unique(table[form.instance_field]).tolist():
                counter.add_topic()
                name = form.name if instance is None else f"{form.name}[{instance}]"
                _, times = self._rows(number, instance)
                info = TopicInfo(name, kind, "dataflash", *counted(times), tuple(form.columns))
                yield Topic(info, partial(self._records, number, instance))
        if undated:
            text = f"{undated} messages have an impossible time; left out"
            self._findings.append(Finding("DAMAGED", text, lost_data=True))

    def _rows(self, number: int, instance: int | None) -> tuple[Mapping[str, Column], Nanoseconds]:
        """Return the columns of a topic, and its times in nanoseconds since 1970; impossible times are left out."""
        table = self._table(number)
        good = table["TimeUS"] < LONGEST_US
        if instance is not None:
            good &= table[self._formats[number].instance_field] == instance
        times = table["TimeUS"][good].astype(np.int64) * 1000 + self._start_ns
        return {name: values[good] for name, values in table.items()}, times

    def _records(self, number: int, instance: int | None, paths: Sequence[str]) -> Records:
        table, times = self._rows(number, instance)
        scales = dict(zip(self._formats[number].columns, self._formats[number].msg_mults, strict=True))
        columns = {path: table[path] if scales[path] is None else table[path] * scales[path] for path in paths}
        return Records(times, columns)


def _index(dfreader: Any, file: Path) -> tuple[Mapping[int, Any], Mapping[int, list[int]]]:
    """Return the formats, and the places of messages by type: by pymavlink's index, behind damage one by one."""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):  # a line for each damaged byte
            reader = dfreader.DFReader_binary
            with reader.__new__(reader) as log:  # closed if the first pass over the file fails, too
                log.__init__(str(file))
                places = {number: list(map(int, log.offsets[number])) for number in log.formats}
                log.offset = max((at + log.formats[number].len for number, found in places.items() for at in found))
                while (message := log.recv_msg()) is not None:
                    places.setdefault(message.fmt.type, []).append(log.offset - message.fmt.len)
                return log.formats, places
    except Exception as err:  # it raises whatever damaged layouts lead to
        why = " ".join(str(err).split())[:80]
        raise LogError(f"cannot be read as an onboard log: damaged ({why})", path=file) from err


def _unused(size: int, at_end: bool) -> bytes:
    """Return which bytes between messages are no loss: those of an erased page that no message fits in, or any last."""
    return b"\0\xff" if at_end else b"\xff" * (size < LONGEST)


def _is_whole(form: Any) -> bool:
    """Return whether the parts of a layout agree with each other."""
    columns: list[str] = form.columns
    fits = struct.calcsize(form.msg_struct) + HEAD_BYTES == form.len and len(columns) == len(form.msg_mults)
    return fits and bool(columns) and len(set(columns)) == len(columns) and all(columns)
