"""MAVLink telemetry logs of ground stations (.tlog): packets, each after its time in microseconds since 1970.

pymavlink finds the packets, checks them, and has the definitions of their messages.
"""

import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import DecoderSet
from usbldr.io.file_access.open_file import begin_of
from usbldr.io.file_access.optional_library import library
from usbldr.io.findings import Finding
from usbldr.io.instruments.packed_rows import dtypes_of, table_of
from usbldr.io.instruments.records_log import RecordsLog, Topic, damaged_bytes
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
    if packet[0] == V1:
        return packet[3], packet[4], packet[5]
    return packet[5], packet[6], int.from_bytes(packet[7 : HEADS[V2]], "little")


def telemetry_log(path: Path) -> RecordsLog:
    """Return a telemetry log; raise UsageError without pymavlink."""
    dialect, mavutil = (
        library(f"pymavlink.{name}", "telemetry logs", "mavlink", path)
        for name in ("dialects.v20.ardupilotmega", "mavutil")
    )
    types: Mapping[int, Any] = dialect.mavlink_map

    def topics(file: Path, findings: list[Finding]) -> Iterator[Topic]:
        for key, packets in _packets(file, mavutil, types, findings).items():
            yield _topic(key, packets, types.get(key[2]))

    return RecordsLog(path, "MAVLink telemetry log", topics)


def _packets(file: Path, mavutil: Any, types: Mapping[int, Any], findings: list[Finding]) -> Mapping[Key, Packets]:
    """Return the packets by kind; append what is lost to the findings."""
    head, place = begin_of(file, HEAD_BYTES)
    begin, size = place + max(0, _first_packet(head)), file.stat().st_size
    found, good, first_lost, first_unknown = dict[Key, Packets](), 0, 0 if begin else size, size
    counter, budget = DecoderSet(file), UnpackingBudget(file, size)
    mavutil.set_dialect("ardupilotmega")
    log = mavutil.mavlogfile(str(file))
    log.f.seek(begin)
    try:
        while (message := log.recv_msg()) is not None:
            time_us = round(message._timestamp * 1e6)
            if message.get_type() == "BAD_DATA" or not EARLIEST_US <= time_us < MAX_TIME_NS // 1000:
                first_lost = min(first_lost, good)
                continue
            budget.take_record()
            packet = bytes(message.get_msgbuf())
            start, key = HEADS[packet[0]], _key(packet)
            if key not in found:
                counter.add_topic()
            first_unknown = first_unknown if key[2] in types else min(first_unknown, good)
            packets, longest = found.setdefault(key, Packets()), _row_bytes(types.get(key[2]))
            packets.times_us.append(time_us)
            packets.rows += packet[start : start + packet[1]].ljust(longest, b"\0")[:longest]
            good += STAMP_BYTES + len(packet)
    finally:
        log.close()
    findings += damaged_bytes(size - good, size, min(first_lost, good), "messages")
    if unknown := sum(len(packets.times_us) for key, packets in found.items() if key[2] not in types):
        text = f"{unknown} messages, from byte {first_unknown} on, are not in the dialect ardupilotmega, or damaged"
        findings.append(Finding("UNDECODED", f"{text}; not read"))
    return found


def _row_bytes(kind: Any) -> int:
    return kind.unpacker.size if kind else 0


def _topic(key: Key, packets: Packets, kind: Any) -> Topic:
    """Return the messages of a sender; ``kind``: what the dialect says of them, None if it does not know them."""
    system, component, number = key
    received = np.array(packets.times_us, dtype=np.int64) * 1000
    name = f"mavlink/{system}/{component}/{kind.msgname if kind else f'UNKNOWN_{number}'}"
    if kind is None:
        problem = f"its message {number} is not in the dialect ardupilotmega"
        return Topic(TopicInfo(name, "", "mavlink", *counted(received), problem=problem))
    columns: list[str] = []
    for part, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        columns += [f"message.{part}.{k}" for k in range(length)] if length > 1 else [f"message.{part}"]

    def records(paths: Sequence[str]) -> Records:
        size = _row_bytes(kind)
        payloads = [bytes(packets.rows[at : at + size]) for at in range(0, len(packets.rows), size)]
        return Records(received, table_of(payloads, columns, dtypes_of(kind.unpacker.format))).only(paths)

    fields = tuple(f"message.{part}" for part in kind.fieldnames)
    arrays = frozenset(path.rpartition(".")[0] for path in columns if path not in fields)
    return Topic(
        TopicInfo(name, f"mavlink/{kind.msgname}", "mavlink", *counted(received), fields, arrays=arrays), records
    )
