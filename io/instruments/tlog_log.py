"""MAVLink telemetry logs of ground stations (.tlog): packets, each after its time in microseconds since 1970.

pymavlink finds the packets, checks them, and has the definitions of their messages.
"""

import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.io.decoding.decoder_set import DecoderSet
from usbldr.io.file_access.open_file import begin_of
from usbldr.io.findings import Finding
from usbldr.io.instruments.packed_rows import dtypes_of, table_of
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import MAX_TIME_NS, Records, TopicInfo

STAMP_BYTES = 8  # fixed by the format: of the time before each packet, big-endian
V1, V2 = 0xFE, 0xFD  # fixed by MAVLink: the first bytes of its two versions
HEADS = {V1: 6, V2: 10}  # [bytes] fixed: of a packet's head; the length of its payload is the second one
ANY_HEAD = re.compile(b"[\xfd\xfe]")
SIGNED, SIGNATURE_BYTES = 1, 13  # fixed: a flag of version 2, and what follows a packet that has it
CHECKSUM_BYTES = 2  # fixed by MAVLink
EARLIEST_US = 946_684_800_000_000  # [us] the year 2000: an earlier time is no time
HEAD_BYTES = 1 << 12  # [bytes] in which the first packets are looked for
PACKETS = 3  # [packets] one behind the other that are no chance
Key: TypeAlias = tuple[int, int, int]  # system, component, message


@dataclass(slots=True)
class Packets:
    """The packets of one kind: times and payloads, one behind the other, each filled up to the longest."""

    times_us: "array[int]" = field(default_factory=lambda: array("q"))
    rows: bytearray = field(default_factory=bytearray)


def looks_like_tlog(head: bytes) -> bool:
    """Return whether a file begins with packets, or has some behind one that is cut."""
    return _begins_packet(head) or _first_packet(head) >= 0


def _first_packet(head: bytes) -> int:
    """Return the first byte from which packets follow each other, -1 if they do nowhere."""
    begins = (found.start() - STAMP_BYTES for found in ANY_HEAD.finditer(head, STAMP_BYTES))
    return next((at for at in begins if _follow_each_other(head, at)), -1)


def _follow_each_other(head: bytes, at: int) -> bool:
    """Return whether packets begin at a byte."""
    for _ in range(PACKETS):
        if not _begins_packet(head[at : at + STAMP_BYTES + HEADS[V2]]):
            return False
        version, length = head[at + STAMP_BYTES : at + STAMP_BYTES + 2]
        signed = version == V2 and head[at + STAMP_BYTES + 2] & SIGNED
        at += STAMP_BYTES + HEADS[version] + length + CHECKSUM_BYTES + SIGNATURE_BYTES * signed
    return True


def _begins_packet(head: bytes) -> bool:
    """Return whether bytes begin with a time since 2000 and a packet."""
    if len(head) < STAMP_BYTES + HEADS[V1] or head[STAMP_BYTES] not in HEADS:
        return False
    return EARLIEST_US <= int.from_bytes(head[:STAMP_BYTES]) < MAX_TIME_NS // 1000


def _key(packet: bytes) -> Key:
    """Return system, component and number of the message."""
    if packet[0] == V1:
        return packet[3], packet[4], packet[5]
    return packet[5], packet[6], int.from_bytes(packet[7 : HEADS[V2]], "little")


class TelemetryLog:
    """A telemetry log."""

    format = "MAVLink telemetry log"

    def __init__(self, path: Path) -> None:
        """Take the file; raise UsageError without pymavlink."""
        self.path = path
        try:
            self._types: Mapping[int, Any] = import_module("pymavlink.dialects.v20.ardupilotmega").mavlink_map
            self._library = import_module("pymavlink.mavutil")
        except ImportError as err:
            raise UsageError("telemetry logs need pymavlink: pip install 'usbldr[mavlink]'", path=path) from err
        self._findings: list[Finding] = []
        self._first_unknown = path.stat().st_size  # [byte]

    @cached_property
    def _packets(self) -> Mapping[Key, Packets]:
        """Return the packets by kind; record what was lost."""
        head, place = begin_of(self.path, HEAD_BYTES)
        begin, size = place + max(0, _first_packet(head)), self.path.stat().st_size
        found, good, first_lost = dict[Key, Packets](), 0, 0 if begin else size
        counter, budget = DecoderSet(self.path), UnpackingBudget(self.path, size)
        self._library.set_dialect("ardupilotmega")
        log = self._library.mavlogfile(str(self.path))
        log.f.seek(begin)
        try:
            while (message := log.recv_msg()) is not None:
                time_us = round(message._timestamp * 1e6)
                if message.get_type() == "BAD_DATA" or not EARLIEST_US <= time_us < MAX_TIME_NS // 1000:
                    first_lost = min(first_lost, good)
                    continue
                budget.take_record()
                packet = bytes(message.get_msgbuf())
                start = HEADS[packet[0]]
                key = _key(packet)
                if key not in found:
                    counter.add_topic()
                if key[2] not in self._types:
                    self._first_unknown = min(self._first_unknown, good)
                packets, longest = found.setdefault(key, Packets()), self._row_bytes(key)
                packets.times_us.append(time_us)
                packets.rows += packet[start : start + packet[1]].ljust(longest, b"\0")[:longest]
                good += STAMP_BYTES + len(packet)
        finally:
            log.close()
        if good < size:
            text = f"{size - good} of {size} bytes, from byte {min(first_lost, good)} on, are damaged or cut"
            self._findings.append(Finding("DAMAGED", f"{text}; their messages are missing", lost_data=True))
        return found

    def _row_bytes(self, key: Key) -> int:
        return self._types[key[2]].unpacker.size if key[2] in self._types else 0

    def _name(self, key: Key) -> str:
        system, component, number = key
        kind = self._types.get(number)
        return f"mavlink/{system}/{component}/{kind.msgname if kind else f'UNKNOWN_{number}'}"

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the messages of each sender."""
        return tuple(self._info(key, packets) for key, packets in self._packets.items())

    def _info(self, key: Key, packets: Packets) -> TopicInfo:
        kind, times = self._types.get(key[2]), packets.times_us
        counted = len(times), min(times) * 1000, max(times) * 1000
        name = self._name(key)
        if kind is None:
            problem = f"its message {key[2]} is not in the dialect ardupilotmega"
            return TopicInfo(name, "", "mavlink", *counted, problem=problem)
        lengths = dict(zip(kind.ordered_fieldnames, kind.lengths, strict=True))
        fields = tuple(f"message.{field}" for field in kind.fieldnames)
        arrays = frozenset(f"message.{field}" for field, length in lengths.items() if length > 1)
        return TopicInfo(name, f"mavlink/{kind.msgname}", "mavlink", *counted, fields, arrays=arrays)

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Decode the wanted messages."""
        keys = {self._name(key): key for key in self._packets}
        for topic, paths in wanted.items():
            yield topic, self._records(keys[topic], paths)

    def _records(self, key: Key, paths: Sequence[str]) -> Records:
        kind, packets = self._types[key[2]], self._packets[key]
        names: list[str] = []
        for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
            names += [f"message.{name}.{k}" for k in range(length)] if length > 1 else [f"message.{name}"]
        size = self._row_bytes(key)
        payloads = [bytes(packets.rows[at : at + size]) for at in range(0, len(packets.rows), size)]
        columns = table_of(payloads, names, dtypes_of(kind.unpacker.format))
        received = np.array(packets.times_us, dtype=np.int64) * 1000
        return Records(received, {path: columns[path] for path in paths})

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        unknown = sum(len(packets.times_us) for key, packets in self._packets.items() if key[2] not in self._types)
        counted = f"{unknown} messages, from byte {self._first_unknown} on,"
        text = f"{counted} are not in the dialect ardupilotmega, or damaged; not read"
        return (*self._findings, *([Finding("UNDECODED", text)] if unknown else []))
