"""The records of a ROS 1 bag, read front to back; the file may be truncated or damaged.

http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader
from typing import NamedTuple, TypeAlias

from usbldr.filters.errors import LogError
from usbldr.io.formats.decompression import DAMAGE, Decompressor

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 5, 6, 7  # op codes
COMPRESSIONS: Mapping[bytes, str] = {b"none": "", b"bz2": "bz2", b"lz4": "lz4"}
WORD = struct.Struct("<I")
TIME = struct.Struct("<II")


class CutError(Exception):
    """The bytes end inside a record, or are not a record."""


class Connection(NamedTuple):
    """A publisher of messages of one topic and type."""

    number: int
    topic: str
    type: str
    definition: bytes


class BagMessage(NamedTuple):
    """One message; its bytes are valid until the next record is read."""

    connection: int
    time_ns: int  # log time
    data: memoryview


Record: TypeAlias = Connection | BagMessage
Fields: TypeAlias = Mapping[bytes, bytes]


def _fields(header: bytes) -> Fields:
    """Return the fields of a record's header; raise CutError if it is not valid."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(header):
        if at + 4 > len(header):
            raise CutError
        (length,) = WORD.unpack_from(header, at)
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(header):
            raise CutError
        fields[name] = value
        at += 4 + length
    return fields


def _op(fields: Fields) -> int:
    return (fields.get(b"op") or b"\0")[0]


def _number(fields: Fields, name: bytes, size: int) -> int:
    """Return an unsigned number of a header; raise CutError if it is missing or has another size."""
    value = fields.get(name, b"")
    if len(value) != size:
        raise CutError
    return int.from_bytes(value, "little")


@dataclass(slots=True)
class BagScan:
    """One pass over a bag: an iterator over its connections and messages that records what was damaged."""

    file: BufferedReader
    size: int
    indexed: bool = False  # the bag was closed
    complete: bool = False  # the end of the file is the end of a record
    messages: int = 0
    expected_messages: int = 0  # number of messages according to the bag's index
    good_until: int = len(MAGIC)  # byte after the last complete record
    broken_at: int | None = None  # first byte of the first damaged record
    lost_chunks: int = 0
    unknown: set[str] = field(default_factory=set[str])  # compressions of lost chunks
    _index_at: int = 0
    _unpacker: Decompressor = field(default_factory=Decompressor)

    def __iter__(self) -> Iterator[Record]:
        """Yield connections and messages in the order of the bag.

        After damage it continues at the next chunk in the index.
        """
        chunks: list[int] | None = None
        while not self.complete:
            self.file.seek(self.good_until)
            try:
                yield from self._records()
                self.complete = True
            except CutError:
                self.broken_at = self.good_until if self.broken_at is None else self.broken_at
                chunks = self._chunks_by_index() if chunks is None else chunks
                next_chunk = min(
                    (at for at in [*chunks, self._index_at] if self.good_until < at < self.size), default=None
                )
                if next_chunk is None:
                    return
                self.lost_chunks += 1
                self.good_until = next_chunk

    def _records(self) -> Iterator[Record]:
        while word := self.file.read(WORD.size):
            fields = _fields(self._exactly(self._length(word)))
            length = self._length(self.file.read(WORD.size))
            op = _op(fields)
            if op == CHUNK:
                yield from self._chunk(fields, length)
            else:
                data = self._exactly(length)
                if op == BAG_HEADER:
                    self._look_at_header(fields)
                elif op == CHUNK_INFO:
                    self.expected_messages += sum(struct.unpack(f"<{length // 4}I", data[: length // 4 * 4])[1::2])
                elif op in (CONNECTION, MESSAGE):
                    yield self._record(op, fields, memoryview(data))
            self.good_until = self.file.tell()

    def _look_at_header(self, fields: Fields) -> None:
        self._index_at = int.from_bytes(fields.get(b"index_pos", b""), "little")
        self.indexed = self._index_at != 0
        if fields.get(b"encryptor"):
            raise LogError(f"{self.file.name}: the bag is encrypted; decrypt it first (rosbag decrypt)")

    def _length(self, word: bytes | memoryview) -> int:
        if len(word) < WORD.size:
            raise CutError
        return WORD.unpack(word)[0]

    def _exactly(self, count: int) -> bytes:
        data = self.file.read(count) if count <= self.size else b""
        if len(data) < count:
            raise CutError
        return data

    def _chunk(self, fields: Fields, length: int) -> Iterator[Record]:
        """Yield the records of a chunk; of a truncated one, the complete records."""
        packed = self.file.read(min(length, self.size))
        whole = len(packed) == length
        sound = True
        try:
            yield from self._inside(self._unpacked(fields, packed))
        except (CutError, *DAMAGE):
            sound = False
        if not whole:
            raise CutError
        self.lost_chunks += not sound

    def _unpacked(self, fields: Fields, packed: bytes) -> memoryview:
        name = fields.get(b"compression", b"")
        if name not in COMPRESSIONS:
            self.unknown.add(name.decode(errors="replace"))
            raise CutError
        return self._unpacker.unpack(COMPRESSIONS[name], memoryview(packed), _number(fields, b"size", 4))

    def _inside(self, data: memoryview) -> Iterator[Record]:
        at, end = 0, len(data)
        while at < end:
            head = at + WORD.size
            body = head + self._length(data[at:head]) + WORD.size
            at = body + self._length(data[body - WORD.size : body])
            if at > end:
                raise CutError
            fields = _fields(bytes(data[head : body - WORD.size]))
            if _op(fields) in (CONNECTION, MESSAGE):
                yield self._record(_op(fields), fields, data[body:at])

    def _record(self, op: int, fields: Fields, data: memoryview) -> Record:
        number = _number(fields, b"conn", 4)
        if op == MESSAGE:
            seconds, nanoseconds = TIME.unpack(fields.get(b"time", b"").ljust(TIME.size, b"\0")[: TIME.size])
            self.messages += 1
            return BagMessage(number, seconds * 1_000_000_000 + nanoseconds, data)
        info = _fields(bytes(data))
        try:
            name = (info.get(b"topic") or fields[b"topic"]).decode()
            return Connection(number, name, info[b"type"].decode(), info[b"message_definition"])
        except (KeyError, UnicodeDecodeError) as err:
            raise CutError from err

    def _chunks_by_index(self) -> list[int]:
        """Return the offsets of the chunks in the index, as far as it can be read."""
        places: list[int] = []
        if self._index_at:
            self.file.seek(self._index_at)
            try:
                while word := self.file.read(WORD.size):
                    fields = _fields(self._exactly(self._length(word)))
                    self._exactly(self._length(self.file.read(WORD.size)))
                    if _op(fields) == CHUNK_INFO:
                        places.append(_number(fields, b"chunk_pos", 8))
            except CutError:
                pass
        return places
