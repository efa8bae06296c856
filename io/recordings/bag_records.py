"""The records of a ROS 1 bag, read front to back; the file may be truncated or damaged.

http://wiki.ros.org/Bags/Format/2.0
"""

import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader
from typing import NamedTuple, TypeAlias

from usbldr.filters.errors import LogError
from usbldr.io.file_access.container_ends import BAG
from usbldr.io.file_access.decompression import DAMAGE, CutError, Decompressor
from usbldr.io.file_access.file_view import FileView
from usbldr.io.limits import TooLargeError, UnpackingBudget

MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7  # op codes
COMPRESSIONS: Mapping[bytes, str] = {b"none": "", b"bz2": "bz2", b"lz4": "lz4"}
WORD = struct.Struct("<I")
TIME = struct.Struct("<II")
MESSAGE_HEAD = re.compile(
    rb"&\0\0\0(?:\x04\0\0\0(op)=\x02|\x09\0\0\0conn=(.{4})|\x0d\0\0\0time=(.{8})){3}(.{4})", re.DOTALL
)
"""The header of a message as all recorders write it, its fields in any order; then the length of the message."""
HEAD_NUMBERS = struct.Struct("<4I")


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


@dataclass(slots=True)
class BagScan:
    """One pass over a bag: an iterator over its connections and messages that records what was damaged."""

    file: BufferedReader
    size: int
    indexed: bool = False  # the bag was closed
    complete: bool = False  # the end of the file is the end of a record, and of the index if the bag was closed
    messages: int = 0
    found: Counter[int] = field(default_factory=Counter[int])  # number of messages by connection
    in_chunks: Counter[int] = field(default_factory=Counter[int])  # the same according to the index after each chunk
    in_index: Counter[int] = field(default_factory=Counter[int])  # the same according to the bag's index
    good_until: int = len(BAG)  # byte after the last complete record
    broken_at: int | None = None  # first byte of the first damaged record
    contradictions: int = 0  # connections that are defined again, as another topic or type
    unknown: set[str] = field(default_factory=set[str])  # compressions of lost chunks
    oversized: bool = False  # lost chunks are beyond the limit of a chunk
    _index_at: int = 0
    _chunk_count: int = 0  # number of chunks according to the bag's header
    _places: set[int] = field(default_factory=set[int])  # of chunks according to the bag's index
    _reached: set[int] = field(default_factory=set[int])  # places of chunks that were found
    _unread: set[int] = field(default_factory=set[int])  # places of chunks that could not be read
    _connections: dict[int, Connection] = field(default_factory=dict[int, Connection])
    _budget: UnpackingBudget = field(init=False)
    _unpacker: Decompressor = field(init=False)

    def __post_init__(self) -> None:
        self._budget = UnpackingBudget(self.file.name, self.size)
        self._unpacker = Decompressor(self._budget)

    @property
    def stated(self) -> Counter[int]:
        """Return the number of messages by connection that the bag states."""
        return self.in_chunks | self.in_index  # the larger of both

    @property
    def lost_chunks(self) -> list[int]:
        """Return the places of chunks that were not found or could not be read."""
        return sorted(self._unread | (self._places - self._reached))

    @property
    def all_chunks_found(self) -> bool:
        """Return whether the bag was closed and all its chunks are there, if not their index."""
        return self.indexed and len(self._reached) >= self._chunk_count

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
                self._broken()
                chunks = self._chunks_by_index() if chunks is None else chunks
                next_chunk = min(
                    (at for at in [*chunks, self._index_at] if self.good_until < at < self.size), default=None
                )
                if next_chunk is None:
                    return
                self.good_until = next_chunk
        self.complete = not self.indexed or len(self._places) >= self._chunk_count

    def _broken(self) -> None:
        self.broken_at = self.good_until if self.broken_at is None else self.broken_at

    def _records(self) -> Iterator[Record]:
        while word := self.file.read(WORD.size):
            if not any(word):  # a crash or a file system left zeros
                self._broken()
                self.good_until = FileView(self.file.fileno()).after_zeros(self.good_until)
                self.file.seek(self.good_until)
                continue
            fields = read_fields(self._exactly(self._length(word)))
            length = self._length(self.file.read(WORD.size))
            op = number_of(fields, b"op", 1)
            if op == CHUNK:
                yield from self._chunk(fields, length)
                self._reached.add(self.good_until)
            else:
                yield from self._outside(op, fields, self._exactly(length))
            self.good_until = self.file.tell()

    def _outside(self, op: int, fields: Fields, data: bytes) -> Iterator[Record]:
        """Take a record that is not a chunk; yield it if it is a connection or a message."""
        if op == BAG_HEADER:
            if fields.get(b"encryptor"):
                raise LogError(f"{self.file.name}: the bag is encrypted; decrypt it first (rosbag decrypt)")
            self._index_at = int.from_bytes(fields.get(b"index_pos", b""), "little")
            self._chunk_count = int.from_bytes(fields.get(b"chunk_count", b""), "little")
            self.indexed = self._index_at != 0
        elif op == INDEX:
            self.in_chunks[number_of(fields, b"conn", 4)] += number_of(fields, b"count", 4)
        elif op == CHUNK_INFO:
            self._places.add(number_of(fields, b"chunk_pos", 8))
            for connection, count in struct.iter_unpack("<2I", data[: len(data) // 8 * 8]):
                self.in_index[connection] += count
        elif op in (CONNECTION, MESSAGE):
            yield from self._record(op, fields, memoryview(data))

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
        try:
            name, size = fields.get(b"compression", b""), number_of(fields, b"size", 4)
            if name not in COMPRESSIONS:
                self.unknown.add(name.decode(errors="replace"))
                raise CutError
            data = self._unpacker.unpack(COMPRESSIONS[name], memoryview(packed), size)
            sound = len(data) == size
            yield from self._inside(data)
        except TooLargeError:
            sound, self.oversized = False, True
        except DAMAGE:
            sound = False
        if not whole:
            raise CutError
        self._unread |= set[int]() if sound else {self.good_until}

    def _inside(self, data: memoryview) -> Iterator[Record]:
        at, end = 0, len(data)
        while at < end:
            self._budget.take_record()
            if message := message_head(data, at):
                number, time_ns, body, at = message
                if at > end:
                    raise CutError
                yield self._message(number, time_ns, data[body:at])
                continue
            head = at + WORD.size
            body = head + self._length(data[at:head]) + WORD.size
            at = body + self._length(data[body - WORD.size : body])
            if at > end:
                raise CutError
            fields = read_fields(bytes(data[head : body - WORD.size]))
            op = number_of(fields, b"op", 1)
            if op in (CONNECTION, MESSAGE):
                yield from self._record(op, fields, data[body:at])

    def _record(self, op: int, fields: Fields, data: memoryview) -> Iterator[Record]:
        number = number_of(fields, b"conn", 4)
        if op == MESSAGE:
            seconds, nanoseconds = TIME.unpack(fields.get(b"time", b"").ljust(TIME.size, b"\0")[: TIME.size])
            yield self._message(number, seconds * 1_000_000_000 + nanoseconds, data)
            return
        connection = read_connection(number, fields, data)
        if self._connections.setdefault(number, connection) == connection:
            yield connection
        else:
            self.contradictions += 1

    def _message(self, connection: int, time_ns: int, data: memoryview) -> BagMessage:
        self.messages += 1
        self.found[connection] += 1
        return BagMessage(connection, time_ns, data)

    def _chunks_by_index(self) -> list[int]:
        """Return the offsets of the chunks in the index, as far as it can be read."""
        places: list[int] = []
        if self._index_at:
            self.file.seek(self._index_at)
            try:
                while word := self.file.read(WORD.size):
                    fields = read_fields(self._exactly(self._length(word)))
                    self._exactly(self._length(self.file.read(WORD.size)))
                    if number_of(fields, b"op", 1) == CHUNK_INFO:
                        places.append(number_of(fields, b"chunk_pos", 8))
            except CutError:
                pass
        return places


def message_head(data: memoryview, at: int) -> tuple[int, int, int, int] | None:
    """Return connection, log time in ns, and first byte and end of the message whose record begins at a byte.

    None if its header holds anything but a message's three fields: it is to be read field by field. Most records of a
    bag are messages, and this takes a third of the time.
    """
    head = MESSAGE_HEAD.match(data, at)
    if head is None:
        return None
    op, connection, time, length = head.groups()
    if op is None or connection is None or time is None:  # a field is there twice
        return None
    number, seconds, nanoseconds, size = HEAD_NUMBERS.unpack(connection + time + length)
    return number, seconds * 1_000_000_000 + nanoseconds, head.end(), head.end() + size


def read_fields(header: bytes) -> Fields:
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


def number_of(fields: Fields, name: bytes, size: int) -> int:
    """Return an unsigned number of a header; raise CutError if it is missing or has another size."""
    value = fields.get(name, b"")
    if len(value) != size:
        raise CutError
    return int.from_bytes(value, "little")


def read_connection(number: int, fields: Fields, data: memoryview) -> Connection:
    """Return the connection of a record; raise CutError if it is not valid."""
    info = read_fields(bytes(data))
    try:
        name = (info.get(b"topic") or fields[b"topic"]).decode()
        return Connection(number, name, info[b"type"].decode(), info[b"message_definition"])
    except (KeyError, UnicodeDecodeError) as err:
        raise CutError from err
