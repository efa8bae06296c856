"""The records of an MCAP file (https://mcap.dev/spec), read front to back; the file may be truncated or damaged."""

import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import NamedTuple, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from zlib_ng import zlib_ng

from usbldr.io.file_access import decompression
from usbldr.io.file_access.container_ends import MCAP, MCAP_HEAD
from usbldr.io.file_access.decompression import CutError, Decompressor
from usbldr.io.file_access.file_view import FileView
from usbldr.io.limits import BeyondLimitError, TooLargeError, UnpackingBudget

MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
READ = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
INSIDE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)  # records of a chunk
LATEST = (1 << 63) - 1  # [ns] in the year 2262; a later log time is a flipped bit
STEP = 1 << 20  # [bytes] read at once for a checksum, or in search of a record
LIKE_A_RECORD = re.compile(rb"(?=[\x02-\x0f].{4}\0{4})", re.DOTALL)  # an opcode, and a length below 4 GB
LEAST = {2: 20, 3: 14, 4: 16, 5: 22, 6: 40, 7: 6, 8: 64, 9: 36, 10: 48, 11: 46, 12: 8, 13: 20, 14: 17, 15: 4}
"""[bytes] of a record without its texts, by opcode: fixed by the format."""
FOLLOWING = 3  # [records] by judgement: where many bytes are zero, a single head may be chance
EXAMINED = 1 << 10  # [bytes] of a search that a look at another place of the file costs
CHUNK = struct.Struct("<QQQII")  # first and last log time, decompressed size, checksum, length of compression's name
INNER_LENGTH_BYTES = 8  # fixed by the format: of the records of a chunk, behind its compression's name
COMPRESSIONS = ("", "zstd", "lz4")
DAMAGE = (McapError, struct.error, *decompression.DAMAGE)
"""Errors for damaged bytes, here and in the libraries."""


class McapMessage(NamedTuple):
    """One message; its bytes are valid until the next record is read."""

    channel: int
    time_ns: int  # log time
    data: memoryview


Record: TypeAlias = Schema | Channel | McapMessage


class Chunk(NamedTuple):
    """One chunk."""

    first_ns: int  # log time
    last_ns: int
    data: memoryview  # its records, as far as they can be read; valid until the next chunk is read
    whole: bool  # the file does not end inside
    sound: bool  # it has the stated size and, if one is stated, the stated checksum
    altered: bool  # it has the stated size, but another checksum
    compression: str
    oversized: bool = False  # it is beyond the limit of a chunk


class ChunkReader:
    """Reads the chunks of a file one after the other."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file
        self._raw = bytearray()
        self.budget = UnpackingBudget(file.name, Path(file.name).stat().st_size)
        self._unpacker = Decompressor(self.budget)

    def read(self, length: int, left: int) -> Chunk:
        """Read the record of a chunk, of which at most ``left`` bytes exist; raise one of DAMAGE for its head."""
        most = min(length, left)
        if most > len(self._raw):
            self._raw = bytearray(most)
        raw = memoryview(self._raw)[:most]
        raw = raw[: self._file.readinto(raw)]
        whole = len(raw) == length
        first_ns, last_ns, size, checksum, named = CHUNK.unpack_from(raw)
        packed_at = CHUNK.size + named + INNER_LENGTH_BYTES
        compression = bytes(raw[CHUNK.size : CHUNK.size + named]).decode(errors="replace")
        nothing = Chunk(first_ns, last_ns, memoryview(b""), whole, sound=False, altered=False, compression=compression)
        if compression not in COMPRESSIONS:
            return nothing
        try:
            data = self._unpacker.unpack(compression, raw[packed_at:], size)
        except TooLargeError:
            return nothing._replace(oversized=True)
        except DAMAGE:
            return nothing
        complete = whole and len(data) == size
        altered = complete and checksum != 0 and crc32(data) != checksum
        return nothing._replace(data=data, sound=complete and not altered, altered=altered)


@dataclass(slots=True)
class McapScan:
    """One pass over a file: an iterator over its records that records what was damaged."""

    file: BufferedReader
    size: int
    chunks: Mapping[int, ChunkIndex] = field(default_factory=dict[int, ChunkIndex])  # by place, as far as known
    complete: bool = False  # the end of the data was reached
    finished: bool = False  # so was the end of the file
    messages: int = 0
    undated: int = 0  # messages with a log time after the year 2262, or outside their altered chunk's
    found: Counter[int] = field(default_factory=Counter[int])  # number of messages by channel
    stated: Mapping[int, int] = field(default_factory=dict[int, int])  # the same according to the file's statistics
    expected_messages: int | None = None  # number of messages according to the file's statistics
    good_until: int = len(MCAP)  # byte after the last complete record
    doubtful: int = len(MCAP)  # the last record, whose length may be wrong; good_until behind one that may hold records
    broken_at: int | None = None  # first byte of the first damaged record
    unknown: set[str] = field(default_factory=set[str])  # compressions of lost chunks
    oversized: bool = False  # lost chunks are beyond the limit of a chunk
    lost_chunks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # log times from, to
    altered_chunks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # read despite their checksum
    altered_data: bool = False  # the data as a whole have another checksum than the file states

    def __iter__(self) -> Iterator[Record]:
        """Yield schemas, channels and messages in the order of the file.

        After damage it continues at the next chunk in the index, else where records follow each other again.
        """
        chunks = ChunkReader(self.file)
        while not self.finished:
            self.file.seek(self.good_until)
            try:
                yield from self._records(chunks)
            except DAMAGE:
                if self.complete:
                    return
                start = self.good_until
                self.broken_at = start if self.broken_at is None else self.broken_at
                behind = min((place for place in self.chunks if place > start), default=None)
                behind = behind or self._next_record(self.doubtful + 1, chunks.budget)
                if behind is None:
                    return
                inside = [chunk for place, chunk in self.chunks.items() if place <= start < place + chunk.chunk_length]
                self.lost_chunks += [(chunk.message_start_time, chunk.message_end_time) for chunk in inside]
                self.good_until = behind

    def _next_record(self, start: int, budget: UnpackingBudget) -> int | None:
        """Return where records follow each other again, None if they do nowhere."""
        data = FileView(self.file.fileno())
        with suppress(BeyondLimitError):  # too many places look like a record: what precedes is read
            while (start := data.after_zeros(start)) < self.size:
                for found in LIKE_A_RECORD.finditer(data[start : start + STEP + MCAP_HEAD.size - 1]):
                    if _follow(data, place := start + found.start(), budget):
                        return place
                start += STEP
        return None

    def _records(self, chunks: ChunkReader) -> Iterator[Record]:
        while not self.finished:
            op, length = MCAP_HEAD.unpack(self._exactly(MCAP_HEAD.size))
            left = self.size - self.good_until - MCAP_HEAD.size
            if op == Opcode.CHUNK:
                chunk = chunks.read(length, left)
                if chunk.whole or chunk.compression:
                    yield from self._chunk(chunk, chunks.budget)
                else:  # its records follow as if they were in none
                    self.broken_at = self.good_until if self.broken_at is None else self.broken_at
                    length = CHUNK.size + INNER_LENGTH_BYTES
                    self.file.seek(self.good_until + MCAP_HEAD.size + length)
            elif length > left or op == 0:
                raise CutError
            elif op in READ and not (self.complete and op == Opcode.MESSAGE):
                record = self._record(op, memoryview(self._exactly(length)))
                if record is not None:
                    yield record
            elif op == Opcode.DATA_END:
                (checksum,) = struct.unpack_from("<I", self._exactly(length))
                self.complete = True
                self._compare(checksum)
            else:
                self.file.seek(length, 1)
                self.finished = op == Opcode.FOOTER and self._exactly(len(MCAP)) == MCAP
            begin, self.good_until = self.good_until, self.good_until + MCAP_HEAD.size + length
            self.doubtful = self.good_until if op in (Opcode.CHUNK, Opcode.ATTACHMENT) else begin

    def _compare(self, checksum: int) -> None:
        """Compare the checksum of all bytes before this record with the stated one; 0 states none."""
        if not checksum or self.broken_at is not None or self.lost_chunks or self.altered_chunks:
            return
        here, left, computed = self.file.tell(), self.good_until, 0
        self.file.seek(0)
        while left:
            block = self._exactly(min(left, STEP))
            computed, left = crc32(block, computed), left - len(block)
        self.altered_data = computed != checksum
        self.file.seek(here)

    def _exactly(self, count: int) -> bytes:
        data = self.file.read(count)
        if len(data) < count:
            raise CutError
        return data

    def _chunk(self, chunk: Chunk, budget: UnpackingBudget) -> Iterator[Record]:
        """Yield the records of a chunk; of a truncated one, the complete records.

        If its checksum is wrong, its records are read only if they fill it exactly, at times within its own.
        """
        sound = chunk.sound
        times = chunk.first_ns, min(chunk.last_ns, LATEST)
        try:
            if not chunk.altered:
                yield from self._inside(chunk.data, budget)
            elif sound := _filled(chunk.data):
                self.altered_chunks.append(times)
                yield from self._inside(chunk.data, budget, times)
        except DAMAGE:
            sound = False
        if not chunk.whole:
            raise CutError
        if not sound:
            self.unknown |= {chunk.compression} - set(COMPRESSIONS)
            self.oversized |= chunk.oversized
            self.lost_chunks.append(times)

    def _inside(
        self, data: memoryview, budget: UnpackingBudget, times: tuple[int, int] = (0, LATEST)
    ) -> Iterator[Record]:
        at, end = 0, len(data)
        while at < end:
            op, length = MCAP_HEAD.unpack_from(data, at)
            budget.take_record()
            body, at = at + MCAP_HEAD.size, at + MCAP_HEAD.size + length
            if at > end or not op:
                raise CutError
            record = self._record(op, data[body:at], times)
            if record is not None:
                yield record

    def _record(self, op: int, body: memoryview, times: tuple[int, int] = (0, LATEST)) -> Record | None:
        if op == Opcode.MESSAGE:
            channel, _, time_ns, _ = MESSAGE.unpack_from(body)
            self.found[channel] += 1
            if times[0] <= time_ns <= times[1]:
                self.messages += 1
                return McapMessage(channel, time_ns, body[MESSAGE.size :])
            self.undated += 1
        elif op == Opcode.SCHEMA:
            return Schema.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.CHANNEL:
            return Channel.read(ReadDataStream(BytesIO(body)))
        elif op == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(body)))
            self.stated, self.expected_messages = statistics.channel_message_counts, statistics.message_count
        return None


def _follow(data: FileView, at: int, budget: UnpackingBudget) -> bool:
    """Return whether so many records follow each other from a byte on as are no chance, or all up to the end."""
    for _ in range(FOLLOWING):
        op, length = MCAP_HEAD.unpack(data[at : at + MCAP_HEAD.size])
        at += MCAP_HEAD.size + length
        if length < LEAST.get(op, len(data)) or at > len(data):
            return False
        budget.take_search(EXAMINED)
        if op == Opcode.FOOTER or at > len(data) - MCAP_HEAD.size:
            return data[at : at + len(MCAP) + 1] in (MCAP, b"")
    return True


def _filled(data: memoryview) -> bool:
    """Return whether records of a chunk fill the bytes exactly."""
    at = 0
    while at + MCAP_HEAD.size <= len(data):
        op, length = MCAP_HEAD.unpack_from(data, at)
        if op not in INSIDE:
            return False
        at += MCAP_HEAD.size + length
    return at == len(data)


def crc32(data: bytes | memoryview, before: int = 0) -> int:
    """Return the checksum of bytes; ``before``: that of those before them."""
    return zlib_ng.crc32(data, before)  # pyright: ignore[reportUnknownMemberType]
