"""MCAP files (https://mcap.dev): chunked or not, indexed or not, zstd or lz4, also cut short or damaged.

The container is read front to back, so that a file without its end still gives what it holds. ROS 2 messages (cdr) and
ROS 1 messages are decoded with the definitions that the file carries.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import IO

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from usbldr.io.log import Finding
from usbldr.io.reader import Records, TopicInfo, utc
from usbldr.io.streams import Decoder, Key, Stream, collect, decoder_of, undecoded_findings
from usbldr.io.streams import Message as Payload

MAGIC = b"\x89MCAP0\r\n"
DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError, EOFError, zstandard.ZstdError)
"""What the libraries raise on broken bytes; a checksum error is a ValueError, lz4's are RuntimeErrors."""


@dataclass(slots=True)
class Pass:
    """One walk through the file: an iterator over its records that remembers what was broken."""

    file: IO[bytes]
    size: int
    complete: bool = False  # the end of the data was reached
    finished: bool = False  # so was the end of the file
    messages: int = 0
    undated: int = 0  # messages whose log time is beyond the year 2262: a bent bit where there is no checksum
    promised: int | None = None  # number of messages by the file's own statistics
    good_until: int = 0  # byte behind the last whole record
    lost_chunks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])  # log times from, to

    def __iter__(self) -> Iterator[Schema | Channel | Message]:
        """Yield schemas, channels and messages in the order of the file, first those that its summary repeats.

        They stand in the first chunk, too; where that is damaged the later ones can still be read.
        """
        yield from _summed_up(self.file)
        reader = StreamReader(self.file, emit_chunks=True, record_size_limit=self.size)
        try:
            for record in reader.records:
                self.good_until = self.file.tell()
                if isinstance(record, Chunk):
                    yield from self._unpacked(record)
                elif isinstance(record, DataEnd):
                    self.complete = True
                elif isinstance(record, Statistics):
                    self.promised = record.message_count
                else:
                    yield from self._counted([record])
            self.finished = True
        except DAMAGE:
            if not self.complete:
                yield from self._counted(_inside_cut_chunk(self.file, self.good_until or len(MAGIC)))

    def _unpacked(self, chunk: Chunk) -> Iterator[Schema | Channel | Message]:
        try:
            records = breakup_chunk(chunk, validate_crc=True)
        except DAMAGE:
            self.lost_chunks.append((chunk.message_start_time, chunk.message_end_time))
        else:
            yield from self._counted(records)

    def _counted(self, records: Sequence[McapRecord] | Iterator[McapRecord]) -> Iterator[Schema | Channel | Message]:
        for record in records:
            if isinstance(record, Message):
                if record.log_time >= 1 << 63:
                    self.undated += 1
                    continue
                self.messages += 1
            if isinstance(record, (Message, Schema, Channel)):
                yield record


def _summed_up(file: IO[bytes]) -> Iterator[Schema | Channel]:
    """Yield the schemas and channels of the summary, none where the file has lost it; leave the file at its start."""
    try:
        summary = make_reader(file).get_summary()
    except (*DAMAGE, OSError):  # an OSError: the file is shorter than a footer
        summary = None
    file.seek(0)
    if summary is not None:
        yield from summary.schemas.values()
        yield from summary.channels.values()


def _unpack_lz4(packed: bytes) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))  # pyright: ignore


UNPACK: Mapping[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": lambda packed: zstandard.ZstdDecompressor().decompressobj().decompress(packed),
    "lz4": _unpack_lz4,
}
"""Decompression that gives what it can of data without an end."""


def _inside_cut_chunk(file: IO[bytes], start: int) -> Iterator[McapRecord]:
    """Yield the whole records in a chunk whose end is missing."""
    file.seek(start)
    head = file.read(9 + 28 + 4)
    if len(head) < 41 or head[0] != Opcode.CHUNK:
        return
    try:
        compression = file.read(struct.unpack("<I", head[37:])[0]).decode()
        file.read(8)
        data = UNPACK[compression](file.read())
        yield from StreamReader(BytesIO(data), skip_magic=True, record_size_limit=len(data)).records
    except (*DAMAGE, KeyError):
        return


class McapLog:
    """An MCAP file."""

    format = "MCAP"

    def __init__(self, path: Path) -> None:
        """Open nothing yet; ``path`` has been found to be MCAP by its first bytes."""
        self.path = path
        self._undecoded: Counter[str] = Counter()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics from one pass over the file."""
        return tuple(stream.info() for stream in self._scan[0].values())

    @cached_property
    def _scan(self) -> tuple[dict[Key, Stream], Pass]:
        """Return what is seen of each (topic, type), and how the walk went."""
        found: dict[Key, Stream] = {}
        channels: dict[int, Stream] = {}
        schemas: dict[int, Schema] = {}
        with self.path.open("rb") as file:
            walk = Pass(file, self.path.stat().st_size)
            for record in walk:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    schema = schemas.get(record.schema_id)
                    key = (record.topic, schema.name if schema else "")
                    if key not in found:
                        found[key] = Stream(*key, record.message_encoding, _decoder(record, schema))
                    channels[record.id] = found[key]
                elif record.channel_id in channels:
                    channels[record.channel_id].saw(record.log_time)
        return found, walk

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Decode the wanted topics; where one topic has several types, the one with most messages."""
        records, self._undecoded = collect(self.path, self._scan[0], wanted, self._messages())
        return records

    def _messages(self) -> Iterator[Payload]:
        schemas: dict[int, str] = {}
        channels: dict[int, Key] = {}
        with self.path.open("rb") as file:
            for record in Pass(file, self.path.stat().st_size):
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    channels[record.id] = (record.topic, schemas.get(record.schema_id, ""))
                elif record.channel_id in channels:
                    yield channels[record.channel_id], record.log_time, record.data

    def findings(self) -> tuple[Finding, ...]:
        """Say what is missing of the file."""
        found, walk = self._scan
        said: list[Finding] = []
        times = [t for stream in found.values() for t in (stream.first_ns, stream.last_ns) if t is not None]
        span = f", the last {(max(times) - min(times)) / 1e9:.1f} s after the first" if times else ""
        if not walk.complete:
            text = (
                f"the file is cut or broken at byte {walk.good_until} of {walk.size}: "
                f"{walk.messages} messages could be read{span}"
            )
            said.append(Finding("TRUNCATED", text, lost_data=True))
        elif not walk.finished:
            said.append(
                Finding("TRUNCATED", f"the file's index is missing; all {walk.messages} messages could be read")
            )
        if walk.lost_chunks:
            total = f" of {walk.promised}" if walk.promised is not None else ""
            first, last = min(start for start, _ in walk.lost_chunks), max(end for _, end in walk.lost_chunks)
            text = (
                f"{len(walk.lost_chunks)} chunks are damaged (logged between {utc(first)} and {utc(last)}): "
                f"{walk.messages}{total} messages could be read"
            )
            said.append(Finding("DAMAGED", text, lost_data=True))
        if walk.undated:
            text = f"{walk.undated} messages have an impossible log time and are left out"
            said.append(Finding("DAMAGED", text, lost_data=True))
        return (*said, *undecoded_findings(self._undecoded))


def _decoder(channel: Channel, schema: Schema | None) -> Decoder | str:
    """Return the decoder of a topic, or in a few words why there is none."""
    if schema is None or not schema.data:
        return decoder_of(schema.name if schema else "", b"", channel.message_encoding, "")
    return decoder_of(schema.name, schema.data, channel.message_encoding, schema.encoding)
