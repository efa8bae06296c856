"""A file of an instrument whose records are all read when its topics are first listed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from usbldr.io.findings import Finding
from usbldr.io.reader import Records, TopicInfo


class RecordsLog:
    """A log of records that stay in memory."""

    def __init__(
        self, path: Path, kind: str, encoding: str, read: Callable[[Path, list[Finding]], Mapping[str, Records]]
    ) -> None:
        """Take a file and what reads its topics, which appends what was lost to the findings.

        The type of the topic "/depth" is "pd0/pd0_depth" if ``encoding`` is "pd0".
        """
        self.path, self.format, self._encoding, self._reads = path, kind, encoding, read
        self._findings: list[Finding] = []

    @cached_property
    def _tables(self) -> Mapping[str, Records]:
        return self._reads(self.path, self._findings)

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics."""
        return tuple(self._info(name, records) for name, records in self._tables.items())

    def _info(self, name: str, records: Records) -> TopicInfo:
        times, kind = records.received_ns, f"{self._encoding}/{self._encoding}_{name[1:].lower()}"
        counted = len(times), int(times.min()), int(times.max())
        return TopicInfo(name, kind, self._encoding, *counted, tuple(records.columns))

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Return the wanted columns."""
        for topic, paths in wanted.items():
            yield topic, self._tables[topic].only(paths)

    def findings(self) -> tuple[Finding, ...]:
        """Report what was left out."""
        _ = self._tables
        return tuple(self._findings)
