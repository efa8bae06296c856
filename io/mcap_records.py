"""The records of an MCAP file (https://mcap.dev/spec), front to back, cut short or damaged as it may be.

Bytes are read into the same memory again and again, and no message is taken apart: 300 MB of pictures beside the
navigation cost a copy and a checksum.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from typing import Any, NamedTuple, TypeAlias

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of a record: opcode, length
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK = struct.Struct("<QQQII")  # first and last log time, size unpacked, its checksum, length of compression's name
STEP = 1 << 18  # bytes unpacked at once, so that they stay near the processor
READ = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError, EOFError, zstandard.ZstdError)
"""What broken bytes raise here and in the libraries; lz4's errors are RuntimeErrors."""


class Message(NamedTuple):
    """One message; its bytes are good until the next record is asked for."""

    channel: int
    time_ns: int  # log time
    data: memoryview


Record: TypeAlias = Schema | Channel | Message


class CutError(EOFError):
    """The bytes end inside a record."""


@dataclass(slots=True)
class Walk:
    """One walk through a file: an iterator over its records that remembers what was broken."""

    file: BufferedReader
    size: int
    chunks: Mapping[int, ChunkIndex] = field(default_factory=dict[int, ChunkIndex])  # by place, as far as known
    passed: Mapping[int, int] = field(default_factory=dict[int, int])  # chunks not to be opened, and their messages
    complete: bool = False  # the end of the data was reached
    finished: bool = False  # so was the end of the file
    messages: int = 0
    undated: int = 0  # messages whose log time is beyond the year 2262: a bent bit where there is no checksum
    promised: int | None = None  # number of messages by the file's own statistics
    good_until: int = 0  # byte behind the last whole record
    broken_at: int | None = None  # byte where the first record begins that is none
    lost_chunks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # log times from, to
    _raw: bytearray = field(default_factory=bytearray)
    _unpacked: bytearray = field(default_factory=bytearray)

    def __iter__(self) -> Iterator[Record]:
        """Yield schemas, channels and messages in the order of the file.

        Where the file is broken the walk goes on at the next chunk that its index knows.
        """
        self.file.seek(len(MAGIC))
        self.good_until = len(MAGIC)
        while True:
            try:
                yield from self._records()
            except DAMAGE:
                if self.complete:
                    return
                self.broken_at = self.good_until if self.broken_at is None else self.broken_at
                lost = self.chunks.get(self.good_until)
                self.good_until = min((at for at in self.chunks if at > self.good_until), default=self.size)
                if self.good_until == self.size:
                    return
                if lost:
                    self.lost_chunks.append((lost.message_start_time, lost.message_end_time))
                self.file.seek(self.good_until)
            else:
                return

    def _records(self) -> Iterator[Record]:
        while not self.finished:
            op, length = HEAD.unpack(self._exactly(HEAD.size))
            if op == Opcode.CHUNK and self.good_until not in self.passed:
                yield from self._chunk(length)
            elif length > self.size - self.good_until - HEAD.size:
                raise CutError
            elif op in READ and not (self.complete and op == Opcode.MESSAGE):
                record = self._record(op, memoryview(self._exactly(length)))
                if record is not None:
                    yield record
            else:
                self.messages += self.passed.get(self.good_until, 0)
                self.file.seek(length, 1)
                self.complete |= op == Opcode.DATA_END
                self.finished = op == Opcode.FOOTER and self._exactly(len(MAGIC)) == MAGIC
            self.good_until += HEAD.size + length

    def _exactly(self, count: int) -> bytes:
        data = self.file.read(count)
        if len(data) < count:
            raise CutError
        return data

    def _record(self, op: int, body: memoryview) -> Record | None:
        """Return a record that is to be yielded."""
        if op == Opcode.MESSAGE:
            channel, _, time_ns, _ = MESSAGE.unpack_from(body)
            if time_ns < 1 << 63:
                self.messages += 1
                return Message(channel, time_ns, body[MESSAGE.size :])
            self.undated += 1
        elif op == Opcode.SCHEMA:
            return Schema.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.CHANNEL:
            return Channel.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.STATISTICS:
            self.promised = Statistics.read(ReadDataStream(BytesIO(body))).message_count
        return None

    def _chunk(self, length: int) -> Iterator[Record]:
        """Yield what is in a chunk, if its checksum is right; of one without its end, the whole records."""
        raw = self._read(length)
        whole = len(raw) == length
        first, last, size, checksum, named = CHUNK.unpack_from(raw)
        packed_at = CHUNK.size + named + 8
        try:
            data = self._unpack(bytes(raw[CHUNK.size : packed_at - 8]), raw[packed_at:], size)
            if whole and checksum and zlib.crc32(data) != checksum:
                raise ValueError("checksum")
            yield from self._inside(data)
            if whole and len(data) != size:
                raise CutError
        except DAMAGE:
            if whole:
                self.lost_chunks.append((first, last))
        if not whole:
            raise CutError

    def _read(self, length: int) -> memoryview:
        """Return the next bytes, fewer at the end of the file."""
        length = min(length, self.size - self.good_until - HEAD.size)
        if length > len(self._raw):
            self._raw = bytearray(length)
        into = memoryview(self._raw)[:length]
        return into[: self.file.readinto(into)]  # pyright: ignore[reportUnknownMemberType]

    def _unpack(self, compression: bytes, packed: memoryview, size: int) -> memoryview:
        """Return what can be unpacked."""
        if not compression:
            return packed
        if size > len(self._unpacked):
            self._unpacked = bytearray(size)
        into, got = memoryview(self._unpacked)[:size], 0
        if compression == b"zstd":
            reader: Any = zstandard.ZstdDecompressor().stream_reader(packed)
            while got < size and (more := reader.readinto(into[got:])):
                got += more
        elif compression == b"lz4":
            unpacker: Any = lz4.frame.LZ4FrameDecompressor()
            for at in range(0, len(packed), STEP):
                piece = unpacker.decompress(packed[at : at + STEP])
                into[got : got + len(piece)] = piece  # a ValueError where it is too much
                got += len(piece)
        else:
            raise ValueError(f"unknown compression {compression}")
        return into[:got]

    def _inside(self, data: memoryview) -> Iterator[Record]:
        at, end = 0, len(data)
        while at < end:
            op, length = HEAD.unpack_from(data, at)
            body, at = at + HEAD.size, at + HEAD.size + length
            if at > end:
                raise CutError
            record = self._record(op, data[body:at])
            if record is not None:
                yield record
