"""The records of an MCAP file (https://mcap.dev/spec), read front to back; the file may be truncated or damaged."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from typing import NamedTuple, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from usbldr.io.formats.mcap_chunks import COMPRESSIONS, DAMAGE, HEAD, ChunkReader

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
READ = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)


class McapMessage(NamedTuple):
    """One message; its bytes are valid until the next record is read."""

    channel: int
    time_ns: int  # log time
    data: memoryview


Record: TypeAlias = Schema | Channel | McapMessage


class CutError(EOFError):
    """The bytes end inside a record."""


@dataclass(slots=True)
class McapScan:
    """One pass over a file: an iterator over its records that records what was damaged."""

    file: BufferedReader
    size: int
    chunks: Mapping[int, ChunkIndex] = field(default_factory=dict[int, ChunkIndex])  # by place, as far as known
    complete: bool = False  # the end of the data was reached
    finished: bool = False  # so was the end of the file
    messages: int = 0
    undated: int = 0  # messages with a log time after the year 2262: a flipped bit if there is no checksum
    expected_messages: int | None = None  # number of messages according to the file's statistics
    good_until: int = len(MAGIC)  # byte after the last complete record
    broken_at: int | None = None  # first byte of the first damaged record
    unknown: set[str] = field(default_factory=set[str])  # compressions of lost chunks
    lost_chunks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # log times from, to

    def __iter__(self) -> Iterator[Record]:
        """Yield schemas, channels and messages in the order of the file.

        After damage it continues at the next chunk in the index.
        """
        while not self.finished:
            self.file.seek(self.good_until)
            try:
                yield from self._records()
            except DAMAGE:
                if self.complete:
                    return
                start = self.good_until
                self.broken_at = start if self.broken_at is None else self.broken_at
                next_chunk = min((place for place in self.chunks if place > start), default=None)
                if next_chunk is None:
                    return
                inside = [chunk for place, chunk in self.chunks.items() if place <= start < place + chunk.chunk_length]
                self.lost_chunks += [(chunk.message_start_time, chunk.message_end_time) for chunk in inside]
                self.good_until = next_chunk

    def _records(self) -> Iterator[Record]:
        chunks = ChunkReader(self.file)
        while not self.finished:
            op, length = HEAD.unpack(self._exactly(HEAD.size))
            left = self.size - self.good_until - HEAD.size
            if op == Opcode.CHUNK:
                yield from self._chunk(chunks, length, left)
            elif length > left:
                raise CutError
            elif op in READ and not (self.complete and op == Opcode.MESSAGE):
                record = self._record(op, memoryview(self._exactly(length)))
                if record is not None:
                    yield record
            else:
                self.file.seek(length, 1)
                self.complete |= op == Opcode.DATA_END
                self.finished = op == Opcode.FOOTER and self._exactly(len(MAGIC)) == MAGIC
            self.good_until += HEAD.size + length

    def _exactly(self, count: int) -> bytes:
        data = self.file.read(count)
        if len(data) < count:
            raise CutError
        return data

    def _chunk(self, chunks: ChunkReader, length: int, left: int) -> Iterator[Record]:
        """Yield the records of a chunk if its checksum is right; of a truncated one, the complete records."""
        chunk = chunks.read(length, left)
        sound = chunk.sound
        try:
            yield from self._inside(chunk.data)
        except DAMAGE:
            sound = False
        if not chunk.whole:
            raise CutError
        if not sound:
            self.unknown |= {chunk.compression} - set(COMPRESSIONS)
            self.lost_chunks.append((chunk.first_ns, chunk.last_ns))

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

    def _record(self, op: int, body: memoryview) -> Record | None:
        if op == Opcode.MESSAGE:
            channel, _, time_ns, _ = MESSAGE.unpack_from(body)
            if time_ns < 1 << 63:
                self.messages += 1
                return McapMessage(channel, time_ns, body[MESSAGE.size :])
            self.undated += 1
        elif op == Opcode.SCHEMA:
            return Schema.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.CHANNEL:
            return Channel.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.STATISTICS:
            self.expected_messages = Statistics.read(ReadDataStream(BytesIO(body))).message_count
        return None
