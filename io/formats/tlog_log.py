"""MAVLink telemetry logs of ground stations (.tlog): packets, each after its time in microseconds since 1970.

Each packet has a checksum, into which the definition of its message enters; pymavlink has these definitions.
"""

import binascii
import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from mmap import mmap
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.io.decoding.decoder_set import DecoderSet
from usbldr.io.findings import Finding
from usbldr.io.formats.files import mapped
from usbldr.io.formats.packed_rows import dtypes_of, table_of
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import MAX_TIME_NS, Records, TopicInfo

STAMP_BYTES = 8  # fixed by the format: of the time before each packet, big-endian
V1, V2 = 0xFE, 0xFD  # fixed by MAVLink: the first bytes of its two versions
HEADS = {V1: 6, V2: 10}  # [bytes] fixed: of a packet's head; the length of its payload is the second one
ANY_HEAD = re.compile(b"[\xfd\xfe]")
SIGNED, SIGNATURE_BYTES = 1, 13  # fixed: a flag of version 2, and what follows a packet that has it
CHECKSUM_BYTES = 2  # fixed by MAVLink
PACKETS = 3  # [packets] one behind the other that are no chance
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
LAST_STEP = {binascii.crc_hqx(bytes([byte]), 0): byte for byte in range(256)}
EARLIEST_US = 946_684_800_000_000  # [us] the year 2000: an earlier time is no time
Key: TypeAlias = tuple[int, int, int]  # system, component, message


class Packet(NamedTuple):
    """One packet of the file."""

    key: Key
    time_us: int
    payload: slice


@dataclass(slots=True)
class Packets:
    """The packets of one kind: times and places of the payloads, of which a log may have millions."""

    times_us: "array[int]" = field(default_factory=lambda: array("q"))
    starts: "array[int]" = field(default_factory=lambda: array("q"))
    ends: "array[int]" = field(default_factory=lambda: array("q"))


def looks_like_tlog(head: bytes) -> bool:
    """Return whether a file begins with packets, or has some behind one that is cut."""
    begins = (0, *(found.start() - STAMP_BYTES for found in ANY_HEAD.finditer(head, STAMP_BYTES)))
    return _begins_packet(head) or any(_follow_each_other(head, at) for at in begins)


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


class TelemetryLog:
    """A telemetry log."""

    format = "MAVLink telemetry log"

    def __init__(self, path: Path) -> None:
        """Take the file; raise UsageError without pymavlink."""
        self.path = path
        try:
            dialect = import_module("pymavlink.dialects.v20.ardupilotmega")
        except ImportError as err:
            raise UsageError("telemetry logs need pymavlink: pip install 'usbldr[mavlink]'", path=path) from err
        self._types: Mapping[int, Any] = dialect.mavlink_map
        self._extras: dict[int, int] = {}  # bytes of the definitions of messages that are not in the dialect
        self._findings: list[Finding] = []

    @cached_property
    def _data(self) -> mmap:
        return mapped(self.path)

    @cached_property
    def _packets(self) -> Mapping[Key, Packets]:
        """Return the packets by kind; record what was lost."""
        data, found, lost, at = self._data, dict[Key, Packets](), 0, 0
        counter, first_lost, cut = DecoderSet(self.path), -1, False
        budget = UnpackingBudget(self.path, len(data))
        while at < len(data):
            packet, after = self._packet(at)
            if packet is not None:
                budget.take_record()
                if packet.key not in found:
                    counter.add_topic()
                    found[packet.key] = Packets()
                packets = found[packet.key]
                packets.times_us.append(packet.time_us)
                packets.starts.append(packet.payload.start)
                packets.ends.append(packet.payload.stop)
                at = after
                continue
            following = self._next(at + 1, budget)
            if following == len(data) and after > len(data):
                cut = True
            else:
                first_lost, lost = (at if first_lost < 0 else first_lost), lost + following - at
            at = following
        if lost:
            text = f"{lost} of {len(data)} bytes, from byte {first_lost} on, are damaged; their messages are missing"
            self._findings.append(Finding("DAMAGED", text, lost_data=True))
        if cut:
            text = f"the file ends within a message, at byte {len(data)}; that message is missing"
            self._findings.append(Finding("TRUNCATED", text, lost_data=True))
        return found

    def _packet(self, at: int) -> tuple[Packet | None, int]:
        """Return the packet whose time begins at a byte, None if there is no whole one, and the byte after it."""
        data, head = self._data, at + STAMP_BYTES
        if head + HEADS[V1] > len(data) or data[head] not in HEADS:
            return None, head + HEADS[V1]
        version, length = data[head], data[head + 1]
        start = head + HEADS[version]
        end = start + length
        after = end + CHECKSUM_BYTES + SIGNATURE_BYTES * (version == V2 and data[head + 2] & SIGNED)
        time_us = int.from_bytes(data[at:head])
        if after > len(data) or not EARLIEST_US <= time_us < MAX_TIME_NS // 1000:
            return None, after
        if version == V2:
            system, component, number = data[head + 5], data[head + 6], int.from_bytes(data[head + 7 : start], "little")
        else:
            system, component, number = data[head + 3 : start]
        kind = self._types.get(number)
        extra = definition_byte(data[head + 1 : end], data[end : end + CHECKSUM_BYTES])
        if kind is None and after < len(data) and not _begins_packet(data[after : after + 32]):
            return None, after
        if extra is None or extra != (self._extras.setdefault(number, extra) if kind is None else kind.crc_extra):
            return None, after
        return Packet((system, component, number), time_us, slice(start, end)), after

    def _next(self, at: int, budget: UnpackingBudget) -> int:
        """Return the first byte from which a packet follows, else the end of the file."""
        for head in ANY_HEAD.finditer(self._data, at + STAMP_BYTES):
            budget.take_search(STAMP_BYTES + HEADS[V1])
            if self._packet(head.start() - STAMP_BYTES)[0] is not None:
                return head.start() - STAMP_BYTES
        return len(self._data)

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

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Decode the wanted messages."""
        keys = {self._name(key): key for key in self._packets}
        return {topic: self._records(keys[topic], paths) for topic, paths in wanted.items()}

    def _records(self, key: Key, paths: Sequence[str]) -> Records:
        kind, packets = self._types[key[2]], self._packets[key]
        names: list[str] = []
        for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
            names += [f"message.{name}.{k}" for k in range(length)] if length > 1 else [f"message.{name}"]
        payloads = [self._data[start:end] for start, end in zip(packets.starts, packets.ends, strict=True)]
        columns = table_of(payloads, names, dtypes_of(kind.unpacker.format))
        received = np.array(packets.times_us, dtype=np.int64) * 1000
        return Records(received, {path: columns[path] for path in paths})

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        unknown = sum(len(packets.starts) for key, packets in self._packets.items() if key[2] not in self._types)
        text = f"{unknown} messages are not in the dialect ardupilotmega, or damaged; not read"
        return (*self._findings, *([Finding("UNDECODED", text)] if unknown else []))


def definition_byte(data: bytes, checksum: bytes) -> int | None:
    """Return the byte of its definition with which a packet after its first byte has a checksum, None if with none.

    The checksum (CRC-16/MCRF4XX) goes over the packet and that byte, which all messages of a kind share.
    """
    before = binascii.crc_hqx(data.translate(MIRRORED), 0xFFFF)
    last = LAST_STEP.get(int.from_bytes(checksum.translate(MIRRORED)) ^ (before << 8 & 0xFF00))
    return None if last is None else MIRRORED[last ^ before >> 8]
