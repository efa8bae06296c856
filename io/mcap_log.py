"""MCAP files (https://mcap.dev): chunked or not, indexed or not, zstd or lz4, also cut short or damaged.

The container is read front to back, so that a file without its end still gives what it holds. ROS 2 messages (cdr)
are decoded with the definitions that the file carries.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from usbldr.filters.errors import LogError
from usbldr.io.cdr import Decoder, DefinitionError
from usbldr.io.log import Finding
from usbldr.io.reader import Records, TopicInfo, utc

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
        """Yield schemas, channels and messages in the order of the file."""
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


@dataclass(slots=True)
class Seen:
    """The messages of one topic and type, by their log times."""

    channel: Channel
    schema: Schema | None
    times_ns: list[int] = field(default_factory=list[int])


class McapLog:
    """An MCAP file."""

    format = "MCAP"

    def __init__(self, path: Path) -> None:
        """Open nothing yet; ``path`` has been found to be MCAP by its first bytes."""
        self.path = path
        self._undecoded: Counter[str] = Counter()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics from one pass over the file."""
        return tuple(self._info(seen) for seen in self._scan[0].values())

    @cached_property
    def _scan(self) -> tuple[dict[tuple[str, str], Seen], Pass]:
        """Return what is seen of each (topic, type), and how the walk went."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Seen] = {}
        found: dict[tuple[str, str], Seen] = {}
        with self.path.open("rb") as file:
            walk = Pass(file, self.path.stat().st_size)
            for record in walk:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    schema = schemas.get(record.schema_id)
                    key = (record.topic, schema.name if schema else "")
                    channels[record.id] = found.setdefault(key, Seen(record, schema))
                elif record.channel_id in channels:
                    channels[record.channel_id].times_ns.append(record.log_time)
        return found, walk

    @cached_property
    def _decoders(self) -> dict[tuple[str, str], Decoder | str]:
        """Return for each (topic, type) its decoder, or why there is none."""
        return {key: _decoder(seen) for key, seen in self._scan[0].items()}

    def _info(self, seen: Seen) -> TopicInfo:
        name = seen.schema.name if seen.schema else ""
        decoder = self._decoders[seen.channel.topic, name]
        return TopicInfo(
            name=seen.channel.topic,
            type=name,
            encoding=seen.channel.message_encoding,
            count=len(seen.times_ns),
            first_ns=min(seen.times_ns, default=None),
            last_ns=max(seen.times_ns, default=None),
            fields=() if isinstance(decoder, str) else decoder.fields,
            problem=decoder if isinstance(decoder, str) else "",
        )

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Decode the wanted topics; where one topic has several types, the one with most messages."""
        chosen: dict[str, tuple[str, str]] = {}
        for key in sorted(self._scan[0], key=lambda key: len(self._scan[0][key].times_ns)):
            if key[0] in wanted:
                chosen[key[0]] = key
        getters = {topic: self._getters(chosen[topic], paths) for topic, paths in wanted.items()}
        rows: dict[str, list[tuple[Any, ...]]] = {topic: [] for topic in wanted}
        schemas: dict[int, str] = {}
        channels: dict[int, str] = {}
        with self.path.open("rb") as file:
            for record in Pass(file, self.path.stat().st_size):
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    if chosen.get(record.topic) == (record.topic, schemas.get(record.schema_id, "")):
                        channels[record.id] = record.topic
                elif record.channel_id in channels:
                    topic = channels[record.channel_id]
                    values = getters[topic](record.data)
                    if values is None:
                        self._undecoded[topic] += 1
                    else:
                        rows[topic].append((record.log_time, *values))
        return {topic: _columns(rows[topic], list(paths)) for topic, paths in wanted.items()}

    def _getters(self, key: tuple[str, str], paths: Sequence[str]) -> Callable[[bytes], tuple[Any, ...] | None]:
        decoder = self._decoders[key]
        if isinstance(decoder, str):
            raise LogError(f"{self.path}: {key[0]} cannot be read: {decoder}")
        return decoder.extractor(paths)

    def findings(self) -> tuple[Finding, ...]:
        """Say what is missing of the file."""
        found, walk = self._scan
        said: list[Finding] = []
        times = [t for seen in found.values() for t in (seen.times_ns[:1] + seen.times_ns[-1:])]
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
        for topic, count in self._undecoded.items():
            text = f"{topic}: {count} messages do not fit the definition that the file gives for them"
            said.append(Finding("UNDECODED", text, lost_data=True))
        return tuple(said)


def _decoder(seen: Seen) -> Decoder | str:
    """Return the decoder of a topic, or in a few words why there is none."""
    encoding = seen.channel.message_encoding
    if seen.schema is None or not seen.schema.data:
        return f"its messages ({encoding or 'unknown encoding'}) carry no definition"
    if encoding != "cdr" or seen.schema.encoding != "ros2msg":
        return f"encoding {encoding} with {seen.schema.encoding} definitions is not supported, only cdr with ros2msg"
    try:
        return Decoder(seen.schema.name, seen.schema.data)
    except DefinitionError as err:
        return f"the definition of its type {seen.schema.name} is not valid ({err})"


def _columns(rows: list[tuple[Any, ...]], paths: list[str]) -> Records:
    """Return rows of (log time, values) as columns in the order of log time."""
    received = np.array([row[0] for row in rows], dtype=np.int64)
    order = np.argsort(received, kind="stable")
    columns = {path: np.array([row[i + 1] for row in rows])[order] for i, path in enumerate(paths)}
    return Records(received[order], columns)
