"""MCAP files (https://mcap.dev): chunked or not, indexed or not, zstd or lz4, also cut short or damaged.

A file that agrees with its index is read by it. Any other is scanned front to back: what it still holds is read, and
what is lost is reported.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain, islice
from pathlib import Path

from mcap.records import Channel, Schema

from usbldr.io.decoding.decoders import (
    Decoder,
    DecoderSet,
    Stream,
    TopicType,
    decode_blocks,
    decoder_without_definition,
    definition_hash,
    json_decoder,
    stream_infos,
    wanted_streams,
)
from usbldr.io.decoding.decoders import StreamMessage as Payload
from usbldr.io.decoding.definitions import SHIPPED, Definitions
from usbldr.io.file_access.decompression import ZSTD, MessageUnpacker, unread_text
from usbldr.io.file_access.open_file import opened
from usbldr.io.findings import Finding
from usbldr.io.reader import BeginAgainError, Records, TopicInfo, name_of, utc
from usbldr.io.recordings.counts import count_findings
from usbldr.io.recordings.mcap_index import Index, IndexMismatchError, indexed_messages, read_index, with_schemas
from usbldr.io.recordings.mcap_records import McapMessage, McapScan


class McapLog:
    """An MCAP file."""

    format = "MCAP"

    def __init__(self, path: Path, known: Definitions = SHIPPED) -> None:
        self.path = path
        self._definitions = known
        self._decoders = DecoderSet(path)
        self._unfit: dict[str, Finding] = {}
        self._last_scan: McapScan | None = None  # None: the file was read by its index
        self._unpacker: MessageUnpacker | None = None  # None: messages are not compressed each on its own
        self._index_is_wrong = False
        self._schemas: dict[int, Schema] = {}
        self._known: dict[TopicType, Stream] = {}
        self._keys: dict[int, TopicType] = {}  # by the file's channel numbers

    @cached_property
    def _index(self) -> Index:
        with opened(self.path) as file:
            index = read_index(file)
            if index.channel_summaries is None or not index.absent_schemas:
                return index
            return with_schemas(index, McapScan(file, self.path.stat().st_size, index.chunks))

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        return stream_infos(self._streams)

    @cached_property
    def _streams(self) -> dict[TopicType, Stream]:
        """Return the stream of each (topic, type) from the index, else from one scan of the file."""
        if self._index.channel_summaries is None:
            for key, time_ns, _ in self._by_walk():
                self._known[key].add_messages(1, time_ns, time_ns)
            return self._known
        for record in (*self._index.schemas.values(), *self._index.channels.values()):
            self._register(record)
        for channel, summary in self._index.channel_summaries.items():
            self._known[self._keys[channel]].add_messages(*summary)
        return self._known

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Decode the wanted topics block by block; raise BeginAgainError if the file disagrees with its index."""
        self._unfit = {}
        by_index = self._index.channel_summaries is not None and not self._index_is_wrong
        messages = self._by_index(wanted_streams(self._streams, wanted).keys()) if by_index else self._by_walk()
        try:
            yield from decode_blocks(self.path, self._streams, wanted, self._decompressed(messages), self._unfit)
        except IndexMismatchError as err:
            self._index_is_wrong = True
            raise BeginAgainError from err

    def _decompressed(self, messages: Iterator[Payload]) -> Iterator[Payload]:
        """Decompress each message if rosbag2 compressed each on its own, as the first one shows."""
        first = next(messages, None)
        if first is None or bytes(first[2][: len(ZSTD)]) != ZSTD:
            return messages if first is None else chain([first], messages)
        self._unpacker = unpacker = MessageUnpacker(self.path)
        return ((key, time_ns, unpacker.unpacked(bytes(data))) for key, time_ns, data in chain([first], messages))

    def _by_index(self, wanted: Collection[TopicType]) -> Iterator[Payload]:
        """Yield the wanted messages of a file that agrees with its index."""
        keys = {number: key for number, key in self._keys.items() if key in wanted}
        with opened(self.path) as file:
            for channel, time_ns, data in indexed_messages(file, self._index, keys.keys()):
                yield keys[channel], time_ns, data

    def _by_walk(self) -> Iterator[Payload]:
        """Yield all messages of any file, front to back.

        Schemas and channels from the index come first: if the first chunk is damaged, the others can
        still be read. A channel whose schema the index lacks waits for its first message.
        """
        with opened(self.path) as file:
            self._last_scan = McapScan(file, self.path.stat().st_size, self._index.chunks)
            absent, channels = self._index.absent_schemas, self._index.channels
            waiting = {number: channel for number, channel in channels.items() if channel.schema_id in absent}
            known = [channel for number, channel in channels.items() if number not in waiting]
            for record in chain(self._index.schemas.values(), known, self._last_scan):
                if not isinstance(record, McapMessage):
                    self._register(record)
                    continue
                if record.channel not in self._keys and record.channel in waiting:
                    self._register(waiting[record.channel])
                if key := self._keys.get(record.channel):
                    yield key, record.time_ns, record.data

    def _register(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
            return
        if record.id in self._keys:  # repeated, in a damaged summary perhaps otherwise
            return
        schema = self._schemas.get(record.schema_id)
        kind = schema.name if schema else ""
        if kind == "mavlink":  # BlueOS: one name for the schemas of all messages, which the topics name
            kind = record.topic.replace("/", ".")
        definition = definition_hash(schema.data, schema.encoding) if schema else 0
        key = (name_of(record.topic), name_of(kind), definition)
        if key not in self._known:
            self._decoders.add_topic()
            self._known[key] = Stream(*key[:2], record.message_encoding, self._decoder(record, schema))
        self._keys[record.id] = key

    def _decoder(self, channel: Channel, schema: Schema | None) -> Decoder | str:
        encoding = channel.message_encoding
        if schema is None or not schema.data:
            if schema is not None and encoding == "cdr" and schema.name:
                return decoder_without_definition(schema.name, self._definitions, self._samples(channel.id))
            if schema is not None and encoding == "json" and schema.name:
                return json_decoder(schema.name, self._samples(channel.id))
            return self._decoders.of(schema.name if schema else "", b"", encoding, "")
        decoder = self._decoders.of(schema.name, schema.data, encoding, schema.encoding)
        if encoding == "json" and not isinstance(decoder, str) and not decoder.fields:  # any object is allowed
            return json_decoder(schema.name, self._samples(channel.id))
        return decoder

    def _samples(self, channel: int) -> list[bytes]:
        """Return some messages of a channel, none if the index is not usable."""
        if self._index.channel_summaries is None:
            return []
        try:
            with opened(self.path) as file:
                return [bytes(data) for _, _, data in islice(indexed_messages(file, self._index, {channel}), 5)]
        except IndexMismatchError:
            return []

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        times = [t for stream in self._streams.values() for t in (stream.first_ns, stream.last_ns) if t is not None]
        span = f", the last {(max(times) - min(times)) / 1e9:.1f} s after the first" if times else ""
        findings = [] if self._last_scan is None else _losses(self._last_scan, span, set(self._keys))
        oversized = self._unpacker.findings() if self._unpacker else ()
        return (*findings, *oversized, *self._unfit.values())


def _losses(scan: McapScan, span: str, channels: set[int]) -> list[Finding]:
    """Return what is missing; ``channels``: those that the file defines."""
    findings: list[Finding] = []
    if not scan.complete:
        where = scan.size if scan.broken_at is None else scan.broken_at
        text = (
            f"the file is truncated or damaged at byte {where} of {scan.size}: "
            f"{scan.messages} messages could be read{span}"
        )
        findings.append(Finding("TRUNCATED", text, lost_data=True))
    elif not scan.finished:
        text = f"the file's index is missing; all {scan.messages} messages could be read"
        findings.append(Finding("TRUNCATED", text))
    if scan.lost_chunks:
        total = f" of {scan.expected_messages}" if scan.expected_messages is not None else ""
        text = (
            f"{len(scan.lost_chunks)} chunks are damaged{unread_text(scan.unknown, scan.oversized)} "
            f"({_logged(scan.lost_chunks)}): {scan.messages}{total} messages could be read"
        )
        findings.append(Finding("DAMAGED", text, lost_data=True))
    elif scan.complete and scan.broken_at is not None:
        text = f"the file is damaged at byte {scan.broken_at} of {scan.size}: {scan.messages} messages could be read"
        findings.append(
            Finding("DAMAGED", text, lost_data=scan.expected_messages is None or scan.messages < scan.expected_messages)
        )
    elif scan.complete and scan.expected_messages is not None:
        by_channel = scan.stated or not scan.expected_messages  # the statistics may state the total alone
        stated = scan.stated if by_channel else {0: scan.expected_messages}
        found = scan.found if by_channel else {0: scan.found.total()}
        findings += count_findings("the file's statistics", stated, found)
    if scan.altered_chunks or scan.altered_data:
        chunks = f"{len(scan.altered_chunks)} chunks"
        what = f"{chunks} ({_logged(scan.altered_chunks)})" if scan.altered_chunks else "the data"
        text = f"the checksum of {what} is wrong, but all messages could be read: values may be altered"
        findings.append(Finding("CHECKSUM", text, lost_data=True))
    if scan.undated:
        text = f"{scan.undated} messages have an impossible log time; left out"
        findings.append(Finding("DAMAGED", text, lost_data=True))
    if nowhere := sum(count for channel, count in scan.found.items() if channel not in channels):
        text = f"{nowhere} messages belong to a channel that the file does not define; left out"
        findings.append(Finding("DAMAGED", text, lost_data=True))
    return findings


def _logged(times: Sequence[tuple[int, int]]) -> str:
    first, last = min(start for start, _ in times), max(end for _, end in times)
    return f"logged between {utc(first)} and {utc(last)}"
