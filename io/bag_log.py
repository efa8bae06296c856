"""ROS 1 bags, version 2.0 (http://wiki.ros.org/Bags/Format/2.0): uncompressed, bz2 or lz4.

A bag is read front to back, record by record, and its index is not needed: one that was never closed, or was cut
short, gives what it holds. Messages are decoded by rosbags' type system with the definitions that the bag carries.
"""

import bz2
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]

from usbldr.filters.errors import LogError
from usbldr.io.log import Finding
from usbldr.io.reader import Records, TopicInfo, utc
from usbldr.io.streams import Key, Message, Stream, collect, decoder_of, undecoded_findings

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 5, 6, 7  # op codes


class CutError(Exception):
    """The bytes end inside a record."""


class Connection(NamedTuple):
    """Who sent messages of which topic and type."""

    number: int
    topic: str
    type: str
    definition: bytes


class Payload(NamedTuple):
    """One message."""

    connection: int
    time_ns: int
    data: bytes


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a record's header; raise CutError where it makes no sense."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(header):
        if at + 4 > len(header):
            raise CutError
        (length,) = struct.unpack_from("<I", header, at)
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(header):
            raise CutError
        fields[name] = value
        at += 4 + length
    return fields


def _exactly(file: IO[bytes], count: int, size: int) -> bytes:
    data = file.read(count) if count <= size else b""
    if len(data) < count:
        raise CutError
    return data


def _unpack_lz4(packed: bytes) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))  # pyright: ignore


UNPACK: Mapping[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": lambda packed: bz2.BZ2Decompressor().decompress(packed),
    b"lz4": _unpack_lz4,
}
"""Decompression that gives what it can of data without an end."""


@dataclass(slots=True)
class Pass:
    """One walk through a bag: an iterator over its connections and messages that remembers what was broken."""

    file: IO[bytes]
    size: int
    indexed: bool = False  # the bag was closed
    complete: bool = False  # the end of the file is the end of a record
    messages: int = 0
    promised: int = 0  # number of messages by the bag's own index
    good_until: int = 0  # byte behind the last whole record
    lost_chunks: int = 0

    def __iter__(self) -> Iterator[Connection | Payload]:
        """Yield connections and messages in the order of the bag."""
        self.file.seek(len(MAGIC))
        self.good_until = len(MAGIC)
        try:
            while length := self.file.read(4):
                yield from self._record(length)
                self.good_until = self.file.tell()
            self.complete = True
        except CutError:
            pass

    def _record(self, length: bytes) -> Iterator[Connection | Payload]:
        if len(length) < 4:
            raise CutError
        fields = _fields(_exactly(self.file, struct.unpack("<I", length)[0], self.size))
        (size,) = struct.unpack("<I", _exactly(self.file, 4, self.size))
        op = (fields.get(b"op") or b"\0")[0]
        if op == CHUNK:
            packed = self.file.read(min(size, self.size))
            yield from self._chunk(fields.get(b"compression", b""), packed, whole=len(packed) == size)
        else:
            data = _exactly(self.file, size, self.size)
            if op == BAG_HEADER:
                self.indexed = fields.get(b"index_pos", b"").strip(b"\0") != b""
                if fields.get(b"encryptor"):
                    raise LogError(f"{self.file.name}: the bag is encrypted; decrypt it first (rosbag decrypt)")
            elif op == CHUNK_INFO:
                self.promised += sum(struct.unpack(f"<{size // 4}I", data[: size // 4 * 4])[1::2])
            elif op in (CONNECTION, MESSAGE):
                yield self._counted(op, fields, data)

    def _chunk(self, compression: bytes, packed: bytes, whole: bool) -> Iterator[Connection | Payload]:
        """Yield what is in a chunk, of one without its end the whole records."""
        try:
            data = UNPACK[compression](packed)
        except KeyError as err:
            text = compression.decode(errors="replace")
            raise LogError(f"{self.file.name}: unknown compression {text!r} (known: none, bz2, lz4)") from err
        except (OSError, ValueError, RuntimeError, EOFError):
            data, self.lost_chunks = b"", self.lost_chunks + whole
        inside = BytesIO(data)
        try:
            while length := inside.read(4):
                fields = _fields(_exactly(inside, struct.unpack("<I", length)[0], len(data)))
                (size,) = struct.unpack("<I", _exactly(inside, 4, len(data)))
                body = _exactly(inside, size, len(data))
                op = (fields.get(b"op") or b"\0")[0]
                if op in (CONNECTION, MESSAGE):
                    yield self._counted(op, fields, body)
        except (CutError, struct.error):
            self.lost_chunks += whole
        if not whole:
            raise CutError

    def _counted(self, op: int, fields: Mapping[bytes, bytes], data: bytes) -> Connection | Payload:
        try:
            (number,) = struct.unpack("<I", fields[b"conn"])
            if op == MESSAGE:
                seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
                self.messages += 1
                return Payload(number, seconds * 1_000_000_000 + nanoseconds, data)
            about = _fields(data)
            name = about.get(b"topic") or fields[b"topic"]
            type_name, definition = about[b"type"].decode(), about[b"message_definition"]
            return Connection(number, name.decode(), type_name, definition)
        except (KeyError, struct.error, UnicodeDecodeError) as err:
            raise CutError from err


class BagLog:
    """A ROS 1 bag."""

    format = "ROS 1 bag"

    def __init__(self, path: Path) -> None:
        """Open nothing yet; ``path`` has been found to be a bag by its first bytes."""
        self.path = path
        self._undecoded: Counter[str] = Counter()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics from one pass over the bag."""
        return tuple(stream.info() for stream in self._scan[0].values())

    @cached_property
    def _scan(self) -> tuple[dict[Key, Stream], Pass]:
        """Return what is seen of each (topic, type), and how the walk went."""
        found: dict[Key, Stream] = {}
        connections: dict[int, Stream] = {}
        with self.path.open("rb") as file:
            walk = Pass(file, self.path.stat().st_size)
            for record in walk:
                if isinstance(record, Connection):
                    key = (record.topic, record.type)
                    if key not in found:
                        found[key] = Stream(*key, "ros1", decoder_of(record.type, record.definition, "ros1", "ros1msg"))
                    connections[record.number] = found[key]
                elif record.connection in connections:
                    connections[record.connection].saw(1, record.time_ns, record.time_ns)
        return found, walk

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Decode the wanted topics; where one topic has several types, the one with most messages."""
        records, self._undecoded = collect(self.path, self._scan[0], wanted, self._messages())
        return records

    def _messages(self) -> Iterator[Message]:
        connections: dict[int, Key] = {}
        with self.path.open("rb") as file:
            for record in Pass(file, self.path.stat().st_size):
                if isinstance(record, Connection):
                    connections[record.number] = (record.topic, record.type)
                elif record.connection in connections:
                    yield connections[record.connection], record.time_ns, record.data

    def findings(self) -> tuple[Finding, ...]:
        """Say what is missing of the bag."""
        found, walk = self._scan
        said: list[Finding] = []
        last = max((stream.last_ns for stream in found.values() if stream.last_ns is not None), default=None)
        until = f", the last of {utc(last)}" if last is not None else ""
        could = f"{walk.messages} messages could be read{until}"
        if not walk.complete:
            text = f"the bag is cut or broken at byte {walk.good_until} of {walk.size}: {could}"
            said.append(Finding("TRUNCATED", text, lost_data=walk.promised == 0 or walk.messages < walk.promised))
        elif not walk.indexed:
            text = f"the bag was never closed, its index is missing; {could} (rosbag reindex makes it whole)"
            said.append(Finding("UNINDEXED", text))
        if walk.lost_chunks:
            total = f" of {walk.promised}" if walk.promised else ""
            text = f"{walk.lost_chunks} chunks are damaged: {walk.messages}{total} messages could be read"
            said.append(Finding("DAMAGED", text, lost_data=True))
        return (*said, *undecoded_findings(self._undecoded))
