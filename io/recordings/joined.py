"""Several logs as one: the parts of a split recording, or the files of one dive, each with a clock of its own."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.definitions import ros2_name
from usbldr.io.findings import Finding
from usbldr.io.messages.registry import STAMPS
from usbldr.io.reader import NamedColumns, Reader, Records, TopicInfo, with_keys
from usbldr.io.recordings.counts import count_findings

UNDATED = ("NMEA-DATE", "NO-DATE")
"""Codes of the finding that the times of a log have no date."""


@dataclass(frozen=True, slots=True)
class LogPart:
    """A log, and its clock minus the clock of the joined log, which is subtracted from its times."""

    reader: Reader
    offset_ns: int = 0
    dated: bool = False  # whether the offset has the date that the log lacks
    name: str = ""  # by which its findings are distinguished; "": its file
    later_ns: Mapping[str, int] = field(default_factory=dict[str, int])  # topic -> what is added to its times besides

    def offset_of(self, topic: str) -> int:
        """Return what is subtracted from the times of a topic."""
        return self.offset_ns - self.later_ns.get(topic, 0)


@dataclass(frozen=True, slots=True)
class JoinedLog:
    """Logs read as one; topics of the same name and type are one topic."""

    path: Path
    parts: tuple[LogPart, ...]
    joining_findings: tuple[Finding, ...] = ()  # findings of the parts together
    stated_messages: int | None = None  # number of messages that the parts should hold together
    time_units_ns: Mapping[str, int] = field(default_factory=dict[str, int])  # of the fields that the user calls times
    kind: str = ""  # what the user calls it; "": the formats of the parts

    @property
    def format(self) -> str:
        """What a user calls it."""
        return self.kind or " + ".join(dict.fromkeys(part.reader.format for part in self.parts))

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics of all parts."""
        found: dict[tuple[str, str], TopicInfo] = {}
        for part in self.parts:
            for stated in part.reader.topics():
                topic, key = moved_topic(stated, part.offset_of(stated.name)), _key(stated)
                topic = topic if part.reader.path == self.path else replace(topic, file=part.reader.path.name)
                found[key] = _together(found[key], topic) if key in found else topic
        return with_keys(found.values())

    def with_columns(self, configured: Sequence[Any]) -> "JoinedLog":
        """Return this log with the columns of its tables that the configuration states."""
        faults: dict[int, UsageError] = {}  # columns -> why a part does not have them
        parts: list[LogPart] = []
        accepted: set[int] = set()
        for part in self.parts:
            if not isinstance(part.reader, NamedColumns):
                parts.append(part)
                continue
            fitting: list[int] = []
            for number, one in enumerate(configured):
                try:
                    part.reader.with_columns([one]).topics()
                    fitting.append(number)
                except UsageError as fault:
                    faults.setdefault(number, fault)
            accepted |= set(fitting)
            named = part.reader.with_columns([configured[number] for number in fitting])
            parts.append(replace(part, reader=named))
        for number in faults.keys() - accepted:
            raise faults[number]
        return replace(self, parts=tuple(parts))

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read one part after the other block by block, and shift its times."""
        keys = {_key(topic): topic.key for topic in self.topics()}
        for part in self.parts:
            own = {topic.key: topic for topic in part.reader.topics() if topic.count and keys[_key(topic)] in wanted}
            paths = {key: wanted[keys[_key(topic)]] for key, topic in own.items()}
            for key, records in part.reader.blocks(paths) if own else ():
                offset_ns = part.offset_of(own[key].name)
                yield keys[_key(own[key])], moved_records(records, offset_ns, self.time_units_ns)

    def findings(self) -> tuple[Finding, ...]:
        """Report what was lost or unusual in each part."""
        own = [
            finding
            if (not part.name and part.reader.path == self.path) or finding.text.startswith(part.reader.path.name)
            else replace(finding, text=f"{part.name or part.reader.path.name}: {finding.text}")
            for part in self.parts
            for finding in part.reader.findings()
            if not (part.dated and finding.code in UNDATED)
        ]
        orders = {one.text.partition(": ")[2]: one for one in reversed(own) if one.code == "DATE-ORDER"}
        own = [one for one in own if one.code != "DATE-ORDER" or one in orders.values()]  # once for all parts
        counted: list[Finding] = []
        if self.stated_messages is not None and not any(finding.lost_data for finding in own):
            found = sum(topic.count for topic in self.topics())
            counted = count_findings("metadata.yaml", {"": self.stated_messages}, {"": found})
        return (*self.joining_findings, *counted, *own)


def readable_parts(
    files: Sequence[Path], open_file: Callable[[Path], Reader], names: Sequence[str] = ()
) -> tuple[tuple[LogPart, ...], list[Finding]]:
    """Return the files that can be read, and a finding for each other; raise LogError if there is none.

    ``names``: by which they are distinguished, if not their files.
    """
    parts: list[LogPart] = []
    unread: list[Finding] = []
    faults: list[LogError] = []
    for file, name in zip(files, names or [file.name for file in files], strict=True):
        try:
            reader = open_file(file)
            reader.topics()
            parts.append(LogPart(reader, name=name))
        except LogError as fault:
            unread.append(Finding("DAMAGED", f"{name} cannot be read: {fault.text}", lost_data=True))
            faults.append(fault)
    if not parts and faults:
        raise faults[0]
    return tuple(parts), unread


def _key(topic: TopicInfo) -> tuple[str, str]:
    """Return the key of a topic: its name and its type, which ROS 1 and ROS 2 spell differently."""
    return topic.name, ros2_name(topic.type)


def _together(a: TopicInfo, b: TopicInfo) -> TopicInfo:
    times = [t for t in (a.first_ns, b.first_ns, a.last_ns, b.last_ns) if t is not None]
    return replace(
        a,
        count=a.count + b.count,
        first_ns=min(times, default=None),
        last_ns=max(times, default=None),
        fields=tuple(f for f in a.fields if f in b.fields) if a.count and b.count else (a if a.count else b).fields,
        problem=a.problem or b.problem,
        arrays=a.arrays | b.arrays,
    )


def moved_topic(topic: TopicInfo, offset_ns: int) -> TopicInfo:
    """Subtract a clock's offset from a topic's times."""
    first, last = (t if t is None else t - offset_ns for t in (topic.first_ns, topic.last_ns))
    return replace(topic, first_ns=first, last_ns=last)


def moved_records(records: Records, offset_ns: int, units_ns: Mapping[str, int]) -> Records:
    """Subtract a clock's offset from log times and stamps; a stamp of zero is unset and stays so."""
    if not offset_ns:
        return records
    columns = dict(records.columns)
    for path in (STAMPS | units_ns.keys()) & columns.keys():
        unit_ns = units_ns.get(path, 1)
        if columns[path].dtype.kind in ("iu" if path in STAMPS else "iuf"):
            offset = offset_ns if unit_ns == 1 else offset_ns / unit_ns
            columns[path] = np.where(columns[path] == 0, 0, columns[path] - offset)
    return Records(records.received_ns - offset_ns, columns)
