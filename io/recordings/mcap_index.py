"""The index of an MCAP file: for each channel the number, the times and the places of its messages.

After each chunk, the file lists by channel the log time of each message and its place in the chunk. With that a
message is found without reading the others. The index is used as long as it agrees with the file's statistics
and with the messages themselves.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from io import SEEK_END, BufferedReader
from typing import NamedTuple, TypeAlias

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, ChunkIndex, Schema
from mcap.summary import Summary
from numpy.typing import NDArray

from usbldr.io.file_access.container_ends import CHECKSUM_BYTES, MCAP, MCAP_FOOTER, MCAP_HEAD, summary_ends_file
from usbldr.io.file_access.file_view import FileView
from usbldr.io.recordings.mcap_records import DAMAGE, ChunkReader, crc32

Entries: TypeAlias = NDArray[np.uint64]  # (n, 2): log time, place of the message's record in the decompressed chunk
MESSAGE = np.dtype(
    [("op", "u1"), ("size", "<u8"), ("channel", "<u2"), ("number", "<u4"), ("time_ns", "<u8"), ("publish_ns", "<u8")]
)


class IndexMismatchError(Exception):
    """The file disagrees with its index."""


class ChannelSummary(NamedTuple):
    """The messages of a channel."""

    messages: int
    first_ns: int  # log time
    last_ns: int


@dataclass(frozen=True, slots=True)
class Index:
    """The summary at the end of a file, as far as the file has one."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    chunks: Mapping[int, ChunkIndex]  # by their place in the file
    inside: Mapping[int, frozenset[int]]  # place of a chunk -> channels with messages in it
    channel_summaries: Mapping[int, ChannelSummary] | None  # by channel; None: the index does not list every message

    @property
    def absent_schemas(self) -> set[int]:
        """Return the schemas that the channels of the summary name and the summary does not repeat."""
        return {channel.schema_id for channel in self.channels.values()} - self.schemas.keys() - {0}


def read_index(file: BufferedReader) -> Index:
    """Read the index; it is empty if the file has none, or an invalid one."""
    try:
        sound = _summary_is_sound(file)
        file.seek(0)
        summary = make_reader(file).get_summary() if sound else None
    except (*DAMAGE, OSError):  # an OSError: the file is shorter than a footer
        summary = None
    if summary is None:
        return Index({}, {}, {}, {}, None)
    chunks = {chunk.chunk_start_offset: chunk for chunk in summary.chunk_indexes}
    inside: dict[int, frozenset[int]] = {}
    summaries: dict[int, ChannelSummary] | None = {}
    try:
        for place, chunk in chunks.items():
            found = dict(_entries(file, chunk))
            inside[place] = frozenset(found)
            for channel, entries in found.items():
                times = entries[:, 0]
                first, last = int(times.min()), int(times.max())
                known = summaries.get(channel, ChannelSummary(0, first, last))
                summaries[channel] = ChannelSummary(
                    known.messages + len(times), min(known.first_ns, first), max(known.last_ns, last)
                )
    except (*DAMAGE, OSError):
        summaries = None
    if summaries is not None and not _agrees(summaries, summary):
        summaries = None
    return Index(summary.schemas, summary.channels, chunks, inside, summaries)


def _summary_is_sound(file: BufferedReader) -> bool:
    """Return whether the summary ends the file and has the checksum that the footer states, or none is stated."""
    if not summary_ends_file(FileView(file.fileno())):
        return False
    file.seek(-MCAP_FOOTER.size - len(MCAP), SEEK_END)
    end = file.tell() + MCAP_FOOTER.size - CHECKSUM_BYTES
    _, _, start, _, checksum = MCAP_FOOTER.unpack(file.read(MCAP_FOOTER.size))
    if not checksum or not 0 < start < end:
        return not checksum
    file.seek(start)
    return crc32(file.read(end - start)) == checksum


def with_schemas(index: Index, records: Iterable[object]) -> Index:
    """Add the absent schemas from the records of the file, up to the last of them.

    If one is not there, the index is not used.
    """
    schemas, absent = dict(index.schemas), set(index.absent_schemas)
    for record in records:
        if isinstance(record, Schema) and record.id in absent:
            schemas[record.id] = record
            absent.remove(record.id)
            if not absent:
                return replace(index, schemas=schemas)
    return replace(index, schemas=schemas, channel_summaries=None)


def _entries(file: BufferedReader, chunk: ChunkIndex) -> Iterator[tuple[int, Entries]]:
    """Yield the channels that have messages in a chunk, and the places of those."""
    file.seek(chunk.chunk_start_offset + chunk.chunk_length)
    data = file.read(chunk.message_index_length)
    at = 0
    while at < len(data):
        op, length = MCAP_HEAD.unpack_from(data, at)
        if op != Opcode.MESSAGE_INDEX:
            raise ValueError("no message index")
        body, at = at + MCAP_HEAD.size, at + MCAP_HEAD.size + length
        entries = np.frombuffer(data, "<u8", (length - 6) // 16 * 2, body + 6).reshape(-1, 2)
        if len(entries):
            yield int.from_bytes(data[body : body + 2], "little"), entries


def _agrees(summaries: Mapping[int, ChannelSummary], summary: Summary) -> bool:
    """Return whether the index lists as many messages as the file's statistics, all of known channels."""
    if summary.statistics is None:
        return False
    stated = {channel: count for channel, count in summary.statistics.channel_message_counts.items() if count}
    possible = all(one.last_ns < 1 << 63 for one in summaries.values())
    named = summary.channels.keys() >= summaries.keys()
    return named and possible and stated == {channel: one.messages for channel, one in summaries.items()}


def indexed_messages(
    file: BufferedReader, index: Index, channels: Collection[int]
) -> Iterator[tuple[int, int, memoryview]]:
    """Yield channel, log time and bytes of the messages of some channels; the bytes are valid until the next.

    Raises IndexMismatchError if the file disagrees with the index; chunks without such a message are not read.
    """
    chunks = ChunkReader(file)
    for place, chunk in sorted(index.chunks.items()):
        if index.inside[place].isdisjoint(channels):
            continue
        try:
            found = [(channel, entries) for channel, entries in _entries(file, chunk) if channel in channels]
            numbers = np.repeat([channel for channel, _ in found], [len(entries) for _, entries in found])
            entries = np.concatenate([entries for _, entries in found])
            in_file = np.argsort(entries[:, 1], kind="stable")
            numbers, entries = numbers[in_file], entries[in_file]
            file.seek(place)
            op, length = MCAP_HEAD.unpack(file.read(MCAP_HEAD.size))
            data = chunks.read(length, length)
        except DAMAGE as err:
            raise IndexMismatchError from err
        if op != Opcode.CHUNK or not data.sound:
            raise IndexMismatchError
        starts, ends = _places(data.data, numbers, entries)
        for channel, time_ns, start, end in zip(numbers.tolist(), entries[:, 0].tolist(), starts, ends, strict=True):
            yield channel, time_ns, data.data[start:end]


def _places(data: memoryview, channels: NDArray[np.int64], entries: Entries) -> tuple[list[int], list[int]]:
    """Return where messages begin and end in a chunk; raise IndexMismatchError if there is none, or another one.

    ``channels`` (n,): of each entry.
    """
    at = entries[:, 1].astype(np.int64)
    if at.min() < 0 or at.max() + MESSAGE.itemsize > len(data):
        raise IndexMismatchError
    rows = np.frombuffer(data, np.uint8)[at[:, np.newaxis] + np.arange(MESSAGE.itemsize)]
    heads = rows.view(MESSAGE)[:, 0]
    right = (heads["op"] == Opcode.MESSAGE) & (heads["channel"] == channels) & (heads["time_ns"] == entries[:, 0])
    right &= heads["size"] <= len(data)
    ends = at + MCAP_HEAD.size + heads["size"].astype(np.int64)
    if not right.all() or ends.max() > len(data):
        raise IndexMismatchError
    return (at + MESSAGE.itemsize).tolist(), ends.tolist()
