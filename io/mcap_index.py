"""What an MCAP file's own index tells without a look at the messages: how many of which channel, from when to when."""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedReader
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, ChunkIndex, Schema
from mcap.summary import Summary

from usbldr.io.mcap_records import DAMAGE, HEAD


class Seen(NamedTuple):
    """The messages of a channel."""

    messages: int
    first_ns: int  # log time
    last_ns: int


@dataclass(frozen=True, slots=True)
class Index:
    """The end of a file, as far as the file has it."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    chunks: Mapping[int, ChunkIndex]  # by their place in the file
    seen: Mapping[int, Seen] | None  # by channel; None: the index does not tell of every message
    inside: Mapping[int, Mapping[int, int]]  # place of a chunk -> channel -> messages


def read_index(file: BufferedReader) -> Index:
    """Read the index; it is empty where the file has none, or none that makes sense."""
    try:
        summary = make_reader(file).get_summary()
    except (*DAMAGE, OSError):  # an OSError: the file is shorter than a footer
        summary = None
    if summary is None:
        return Index({}, {}, {}, None, {})
    chunks = {chunk.chunk_start_offset: chunk for chunk in summary.chunk_indexes}
    try:
        seen, inside = _messages(file, chunks)
    except (*DAMAGE, OSError):
        seen, inside = {}, dict[int, Mapping[int, int]]()
    return Index(summary.schemas, summary.channels, chunks, seen if _agrees(seen, summary) else None, inside)


def _messages(
    file: BufferedReader, chunks: Mapping[int, ChunkIndex]
) -> tuple[dict[int, Seen], dict[int, Mapping[int, int]]]:
    """Read the message index behind each chunk: (log time, place) of each message, channel by channel."""
    seen: dict[int, Seen] = {}
    inside: dict[int, Mapping[int, int]] = {}
    for place, chunk in chunks.items():
        file.seek(place + chunk.chunk_length)
        data = file.read(chunk.message_index_length)
        counts: dict[int, int] = {}
        at = 0
        while at < len(data):
            op, length = HEAD.unpack_from(data, at)
            if op != Opcode.MESSAGE_INDEX:
                raise ValueError("no message index")
            body, at = at + HEAD.size, at + HEAD.size + length
            channel, size = int.from_bytes(data[body : body + 2], "little"), (length - 6) // 16 * 16
            times = np.frombuffer(data, "<u8", size // 8, body + 6)[::2]
            if len(times):
                counts[channel] = counts.get(channel, 0) + len(times)
                new = Seen(len(times), int(times.min()), int(times.max()))
                seen[channel] = _together(seen[channel], new) if channel in seen else new
        inside[place] = counts
    return seen, inside


def _together(a: Seen, b: Seen) -> Seen:
    return Seen(a.messages + b.messages, min(a.first_ns, b.first_ns), max(a.last_ns, b.last_ns))


def _agrees(seen: Mapping[int, Seen], summary: Summary) -> bool:
    """Tell whether the index tells of as many messages as the file's statistics, all of channels that are named."""
    if summary.statistics is None:
        return False
    counted = {channel: one.messages for channel, one in seen.items()}
    stated = summary.statistics.channel_message_counts
    named = all(channel in summary.channels for channel in counted)
    possible = all(one.last_ns < 1 << 63 for one in seen.values())
    return named and possible and counted == {channel: count for channel, count in stated.items() if count}
