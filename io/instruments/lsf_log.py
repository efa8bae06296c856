"""Logs of LSTS' vehicles (.lsf): IMC messages one after the other, each with a checksum.

A topic is a message of an entity of a vehicle: "imc/30/AHRS/EulerAngles". Source: see imc_definitions.
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.decoders import DecoderSet
from usbldr.io.file_access.open_file import mapped
from usbldr.io.findings import Finding
from usbldr.io.instruments.imc_definitions import Definition, definitions_beside
from usbldr.io.instruments.packed_rows import dtypes_of, table_of
from usbldr.io.instruments.records_log import RecordsLog, Topic
from usbldr.io.limits import UnpackingBudget
from usbldr.io.reader import MAX_TIME_NS, Column, Records, TopicInfo, name_of

SYNC = 0xFE54  # fixed by IMC: the first two bytes of a message, whose order is that of all
HEAD = {
    "sync": "u2",
    "number": "u2",
    "size": "u2",
    "time_s": "f8",
    "source": "u2",
    "entity": "u1",
    "to": "u2",
    "at": "u1",
}
HEAD_BYTES, CHECKSUM_BYTES = 20, 2  # fixed by IMC
ENTITY_INFO = "EntityInfo"
Order: TypeAlias = Literal["<", ">"]
ENDIAN: Mapping[Order, Literal["little", "big"]] = {"<": "little", ">": "big"}
ANY_SYNC = re.compile(b"\x54\xfe|\xfe\x54")
MOST_SYNCS = 20  # [places] that look like the beginning of a message and are examined: a checksum takes milliseconds
FIRST_BYTES = 1 << 17  # [bytes] among which the first message is looked for: two of the longest
MANY = 8  # [messages] of one length, from which on their checksums are computed together
POLYNOMIAL = 0xA001  # fixed by IMC: CRC-16-IBM


def _table() -> NDArray[np.uint16]:
    table = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint16(POLYNOMIAL), table >> 1).astype(np.uint16)
    return table


TABLE = _table()
BYTES = TABLE.tolist()


def looks_like_lsf(head: bytes) -> bool:
    """Return whether a file begins with a message of IMC, or has one behind one that is cut."""
    return len(head) >= HEAD_BYTES and _order_of(head) != ""


def _order_of(head: bytes) -> Order | Literal[""]:
    """Return the order of bytes of the first message with a right checksum, else by how the file begins."""
    for found in islice(ANY_SYNC.finditer(head), MOST_SYNCS):
        order: Order = "<" if found[0] == SYNC.to_bytes(2, "little") else ">"
        size = head[found.start() + 4 : found.start() + 6]
        end = found.start() + HEAD_BYTES + int.from_bytes(size, ENDIAN[order]) + CHECKSUM_BYTES
        if end <= len(head) and _is_whole(head[found.start() : end], order):
            return order
    begins: list[Order] = [order for order in ENDIAN if head.startswith(SYNC.to_bytes(2, ENDIAN[order]))]
    return begins[0] if begins else ""


def lsf_log(path: Path) -> RecordsLog:
    """Return a log of IMC messages; raise UsageError if the definitions of its messages are not beside it."""
    definitions = definitions_beside(path)
    return RecordsLog(path, "LSF", lambda file, findings: _Messages(file, definitions, findings).topics())


class _Messages:
    def __init__(self, file: Path, definitions: Mapping[int, Definition], findings: list[Finding]) -> None:
        self._file, self._definitions, self._findings = file, definitions, findings
        self._data = mapped(file)
        self._order: Order = _order_of(self._data[:FIRST_BYTES]) or ">"
        self._frames, self._heads = self._good()

    def _all_frames(self) -> tuple[NDArray[np.int64], int, bool]:
        """Return where the whole messages begin and end, (n, 2); the bytes that are none; whether the last is cut."""
        data, sync = self._data, SYNC.to_bytes(2, ENDIAN[self._order])
        frames: list[tuple[int, int]] = []
        at, lost, cut, budget = 0, 0, False, UnpackingBudget(self._file, len(data))
        while at < len(data):
            end = self._end(at)
            followed = end == len(data) or data[end : end + 2] == sync
            if data[at : at + 2] == sync and (followed or self._whole_at(at, budget)):
                budget.take_record()
                frames.append((at, end))
                at = end
                continue
            if data[at : at + 2] != sync and frames and not _is_whole(data[slice(*frames[-1])], self._order):
                start, _ = frames.pop()  # its size was wrong
                lost, at = lost + at - start, start
            following = data.find(sync, at + 1)
            while following >= 0 and not self._whole_at(following, budget):
                following = data.find(sync, following + 1)
            cut = following < 0 and data[at : at + 2] == sync and end > len(data)
            after = len(data) if following < 0 else following
            lost, at = lost + (0 if cut else after - at), after
        return np.array(frames, dtype=np.int64).reshape(-1, 2), lost, cut

    def _end(self, at: int) -> int:
        size = int.from_bytes(self._data[at + 4 : at + 6], ENDIAN[self._order])
        return at + HEAD_BYTES + size + CHECKSUM_BYTES if at + HEAD_BYTES <= len(self._data) else len(self._data) + 1

    def _whole_at(self, at: int, budget: UnpackingBudget) -> bool:
        end = self._end(at)
        if end > len(self._data):
            return False
        budget.take_search(end - at)
        return _is_whole(self._data[at:end], self._order)

    def _good(self) -> tuple[NDArray[np.int64], NDArray[np.void]]:
        """Return the messages with right checksums, (n, 2), and their heads; report the others."""
        frames, lost, cut = self._all_frames()
        good = np.zeros(len(frames), dtype=bool)
        lengths = frames[:, 1] - frames[:, 0]
        whole = np.frombuffer(self._data, dtype=np.uint8)
        for length in np.unique(lengths).tolist():
            which = np.flatnonzero(lengths == length)
            good[which] = _checked(whole, frames[which, 0], length, self._order)
        if lost := lost + int(lengths[~good].sum()):
            edges = zip([0, *frames[good, 1].tolist()], [*frames[good, 0].tolist(), len(self._data)], strict=True)
            text = f"{lost} of {len(self._data)} bytes, from byte {next(end for end, at in edges if at > end)} on"
            text += ", are no messages with right checksums; their messages are missing"
            self._findings.append(Finding("DAMAGED", text, lost_data=True))
        if cut:
            text = f"the file ends within a message, at byte {len(self._data)}; that message is missing"
            self._findings.append(Finding("TRUNCATED", text, lost_data=True))
        heads = b"".join(self._data[start : start + HEAD_BYTES] for start in frames[good, 0].tolist())
        kind = np.dtype([(name, self._order + code) for name, code in HEAD.items()])
        return frames[good], np.frombuffer(heads, kind)

    def topics(self) -> Iterator[Topic]:
        """Yield the messages of each entity; those without a possible time are left out."""
        heads, labels, taken = self._heads, self._labels(), set[str]()
        timed = (heads["time_s"] > 0) & (heads["time_s"] < MAX_TIME_NS / 1e9)
        counter = DecoderSet(self._file)
        keys = heads["number"].astype(np.int64) << 32 | heads["source"].astype(np.int64) << 16 | heads["entity"]
        for key in np.unique(keys[timed]).tolist():
            counter.add_topic()
            number, source, entity = key >> 32, key >> 16 & 0xFFFF, key & 0xFF
            definition = self._definitions.get(number)
            label = labels.get((source, entity), str(entity))
            name = f"imc/{source}/{label}/{definition.name if definition else f'UNKNOWN_{number}'}"
            name = name_of(name if name not in taken else f"{name}_{entity}")
            taken.add(name)
            which = np.flatnonzero(timed & (keys == key))
            # microseconds: seconds as a floating-point number have no more
            times = np.rint(heads["time_s"][which] * 1e6).astype(np.int64) * 1000
            if definition is None:
                problem = "its message is not in the definitions beside the log"
                info = TopicInfo(name, "", "imc", *counted(times), problem=problem)
                yield Topic(info)
                continue
            info = TopicInfo(name, f"imc/{definition.name}", "imc", *counted(times), definition.fields)
            yield Topic(info, partial(self._records, name, definition, self._frames[which], times))

    def _labels(self) -> Mapping[tuple[int, int], str]:
        """Return the names of entities by source and number, which the messages EntityInfo state."""
        heads = self._heads
        number = next((n for n, one in self._definitions.items() if one.name == ENTITY_INFO), -1)
        found: dict[tuple[int, int], str] = {}
        for k in np.flatnonzero(heads["number"] == number).tolist():
            try:
                values = dict(self._definitions[number].values(self._payload(self._frames[k]), self._order))
            except struct.error:
                continue
            if label := "_".join(str(values.get("label", "")).split()):
                found[int(heads["source"][k]), int(heads["entity"][k])] = label
        return found

    def _payload(self, frame: NDArray[np.int64]) -> bytes:
        start, end = frame.tolist()
        return self._data[start + HEAD_BYTES : end - CHECKSUM_BYTES]

    def _records(
        self,
        topic: str,
        definition: Definition,
        frames: NDArray[np.int64],
        times: NDArray[np.int64],
        paths: Sequence[str],
    ) -> Records:
        columns, fits = self._columns(definition, [self._payload(frame) for frame in frames])
        if not fits.all():
            text = f"{topic}: {np.sum(~fits)} messages do not match their definition beside the log"
            self._findings.append(Finding("UNDECODED", text, topic, lost_data=True))
        flags = {f"{m.name}.{flag}": (m.name, mask) for m in definition.members for flag, mask in m.flags.items()}
        found: dict[str, Column] = {}
        for path in paths:
            name, mask = flags.get(path, (path, 0))
            found[path] = columns[name] & mask != 0 if mask else columns[name]
        return Records(times[fits], found)

    def _columns(
        self, definition: Definition, payloads: Sequence[bytes]
    ) -> tuple[Mapping[str, Column], NDArray[np.bool_]]:
        """Return the fields of messages that fit their definition, and which these are."""
        names = [member.name for member in definition.members]
        if layout := definition.layout:
            fits = np.array([len(payload) >= struct.calcsize(layout) for payload in payloads], dtype=bool)
            types = [self._order + code[1:] for code in dtypes_of(layout)]
            return table_of([p for p, fit in zip(payloads, fits, strict=True) if fit], names, types), fits
        rows: list[Mapping[str, float | str]] = []
        fits = np.zeros(len(payloads), dtype=bool)
        for k, payload in enumerate(payloads):
            try:
                rows.append(dict(definition.values(payload, self._order)))
                fits[k] = True
            except struct.error:
                continue
        return {name: np.array([row[name] for row in rows]) for name in names}, fits


def _checked(data: NDArray[np.uint8], starts: NDArray[np.int64], length: int, order: Order) -> NDArray[np.bool_]:
    """Return which messages of one length have the checksum that they state."""
    if len(starts) < MANY:
        return np.array([_is_whole(data[at : at + length].tobytes(), order) for at in starts.tolist()], dtype=bool)
    value = np.zeros(len(starts), dtype=np.uint16)
    for k in range(length - CHECKSUM_BYTES):
        value = TABLE[(value ^ data[starts + k]) & 0xFF] ^ (value >> 8)
    first, second = (data[starts + length - place].astype(np.uint16) for place in (2, 1))
    return value == (first | second << 8 if order == "<" else first << 8 | second)


def _is_whole(message: bytes, order: Order) -> bool:
    """Return whether a message has the checksum that it states."""
    value = 0
    for byte in message[:-CHECKSUM_BYTES]:
        value = BYTES[(value ^ byte) & 0xFF] ^ (value >> 8)
    return value == int.from_bytes(message[-CHECKSUM_BYTES:], ENDIAN[order])
