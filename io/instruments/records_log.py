"""A file of an instrument or vehicle, whose topics are all found when they are first listed."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usbldr.io.decoding.columns import counted
from usbldr.io.findings import Finding
from usbldr.io.reader import Records, TopicInfo

VARYING = ("heading_deg", "depth_m")  # columns that say nothing if always the same: without a sensor they are zeros


class Topic(NamedTuple):
    """A topic of a file, and the function that reads some of its fields; one with a problem has none."""

    info: TopicInfo
    records: Callable[[Sequence[str]], Records] = lambda _: Records(np.empty(0, np.int64), {})


class RecordsLog:
    """A log of such topics."""

    def __init__(self, path: Path, kind: str, find: Callable[[Path, list[Finding]], Iterable[Topic]]) -> None:
        """Take a file, its format, and what finds its topics: it appends what is lost to the findings."""
        self.path, self.format, self._find = path, kind, find
        self._findings: list[Finding] = []

    @cached_property
    def _topics(self) -> Mapping[str, Topic]:
        return {topic.info.name: topic for topic in self._find(self.path, self._findings)}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        return tuple(topic.info for topic in self._topics.values())

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the wanted fields, one topic after the other."""
        for topic, paths in wanted.items():
            yield topic, self._topics[topic].records(paths)

    def findings(self) -> tuple[Finding, ...]:
        """Report what was left out."""
        _ = self._topics
        return tuple(dict.fromkeys(self._findings))  # what is read again is lost again


def log_in_memory(
    path: Path, kind: str, encoding: str, read: Callable[[Path, list[Finding]], Mapping[str, Records]]
) -> RecordsLog:
    """Return the log of a file whose records are all read at once, by topic; those that say nothing are no topics.

    The type of the topic "/depth" is "pd0/pd0_depth" if ``encoding`` is "pd0".
    """

    def find(file: Path, findings: list[Finding]) -> Iterator[Topic]:
        for name, records in read(file, findings).items():
            if not len(records.received_ns) or any(np.ptp(records.columns.get(one, [0, 1])) == 0 for one in VARYING):
                continue
            type_name, span = f"{encoding}/{encoding}_{name[1:].lower()}", counted(records.received_ns)
            yield Topic(TopicInfo(name, type_name, encoding, *span, tuple(records.columns)), records.only)

    return RecordsLog(path, kind, find)


def damaged_bytes(lost: int, total: int, first: int, what: str) -> list[Finding]:
    """Report the bytes of a file, from one on, that are none of its messages, ``what`` these are."""
    text = f"{lost} of {total} bytes, from byte {first} on, are damaged or cut; their {what} are missing"
    return [Finding("DAMAGED", text, lost_data=True)] if lost else []
