"""ROS 1 bags, version 2.0: uncompressed, bz2 or lz4.

A bag is read front to back, without its index, so that an unclosed or truncated bag can be read, too. Messages are
decoded with the definitions that the bag carries.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from usbldr.io.decoding.decoders import (
    DecoderSet,
    Stream,
    StreamMessage,
    TopicType,
    decode_blocks,
    definition_hash,
    stream_infos,
)
from usbldr.io.file_access.decompression import unread_text
from usbldr.io.file_access.open_file import opened
from usbldr.io.findings import Finding
from usbldr.io.reader import Records, TopicInfo, name_of, utc
from usbldr.io.recordings.bag_records import BagScan, Connection
from usbldr.io.recordings.counts import count_findings, lost_messages


class BagLog:
    """A ROS 1 bag."""

    format = "ROS 1 bag"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._unfit: dict[str, Finding] = {}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics from one pass over the bag."""
        return stream_infos(self._scan[0])

    @cached_property
    def _scan(self) -> tuple[dict[TopicType, Stream], dict[int, Stream], BagScan]:
        """Return the stream of each (topic, type) and of each connection, and the finished scan."""
        streams: dict[TopicType, Stream] = {}
        connections: dict[int, Stream] = {}
        decoders = DecoderSet(self.path)
        with opened(self.path) as file:
            scan = BagScan(file, self.path.stat().st_size)
            for record in scan:
                if isinstance(record, Connection):
                    if (key := _key(record)) not in streams:
                        decoders.add_topic()
                        decoder = decoders.of(record.type, record.definition, "ros1", "ros1msg")
                        streams[key] = Stream(*key[:2], "ros1", decoder)
                    connections[record.number] = streams[key]
                elif record.connection in connections:
                    connections[record.connection].add_messages(1, record.time_ns, record.time_ns)
        return streams, connections, scan

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Decode the wanted topics block by block."""
        self._unfit = {}
        return decode_blocks(self.path, self._scan[0], wanted, self._messages(), self._unfit)

    def _messages(self) -> Iterator[StreamMessage]:
        connections: dict[int, TopicType] = {}
        with opened(self.path) as file:
            for record in BagScan(file, self.path.stat().st_size):
                if isinstance(record, Connection):
                    connections[record.number] = _key(record)
                elif record.connection in connections:
                    yield connections[record.connection], record.time_ns, record.data

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the bag."""
        streams, connections, scan = self._scan
        findings: list[Finding] = []
        last = max((stream.last_ns for stream in streams.values() if stream.last_ns is not None), default=None)
        until = f", the last of {utc(last)}" if last is not None else ""
        stated = scan.stated
        total = f" of {scan.in_index.total()}" if scan.in_index else ""
        readable = f"{scan.messages}{total} messages could be read"
        lost = lost_messages(stated, scan.found)
        if not scan.complete:
            where = scan.size if scan.broken_at is None else scan.broken_at
            text = f"the bag is truncated or damaged at byte {where} of {scan.size}: {readable}{until}"
            findings.append(Finding("TRUNCATED", text, lost_data=bool(lost) or not scan.all_chunks_found))
        elif not scan.indexed:
            text = f"the bag was never closed, its index is missing; {readable}{until} (rosbag reindex repairs it)"
            findings.append(Finding("UNINDEXED", text))
        if scan.lost_chunks:
            text = f"{len(scan.lost_chunks)} chunks are damaged{unread_text(scan.unknown, scan.oversized)}"
            text += f", the first at byte {scan.lost_chunks[0]}: {readable}"
            findings.append(Finding("DAMAGED", text, lost_data=True))
        elif scan.complete and scan.broken_at is not None:
            text = f"the bag is damaged at byte {scan.broken_at} of {scan.size}: {readable}"
            findings.append(Finding("DAMAGED", text, lost_data=lost > 0))
        elif scan.complete and stated:
            findings += count_findings("the bag's index", stated, scan.found)
        if scan.contradictions:
            text = f"{scan.contradictions} connections are defined again as another topic or type; the first is used"
            findings.append(Finding("DAMAGED", text, lost_data=True))
        if nowhere := sum(count for number, count in scan.found.items() if number not in connections):
            text = f"{nowhere} messages belong to a connection that the bag does not define; left out"
            findings.append(Finding("DAMAGED", text, lost_data=True))
        return (*findings, *self._unfit.values())


def _key(connection: Connection) -> TopicType:
    definition = definition_hash(connection.definition, "ros1msg")
    return name_of(connection.topic), name_of(connection.type), definition
