"""The records of each sensor, read in one pass over a log, block by block; only what is used of them is kept."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.conventions.attitude import attitudes, with_yaw
from usbldr.io.conventions.usbl_head import SHIP_HEADING
from usbldr.io.decoding.collected import CollectedRecords
from usbldr.io.messages.layouts import RawRecords, raw_records, wanted_paths
from usbldr.io.messages.roles import TopicChoice
from usbldr.io.reader import BeginAgainError, Reader, Records

EVIDENCE_RECORDS = 100_000  # [records] of which the medians of messages are taken: these are sure to 0.4 % of a sigma
MAX_ATTITUDES = 1_000_000  # [records] of which roll and pitch are kept, 40 MB: 28 per second in 10 hours
REPORTED_ATTITUDES = 200_000  # [records] kept if they are only reported: 5 per second in 10 hours


def read_roles(
    reader: Reader, choices: Mapping[str, TopicChoice], more_fields: Mapping[str, Sequence[str]], tilted: bool
) -> tuple[dict[str, RawRecords], dict[str, RawRecords]]:
    """Read the topics chosen, each once; return the records of each sensor, and the evidence: some of its records.

    ``more_fields`` (role -> fields) become quantities of the evidence, which only their roles have. ``tilted``: roll
    and pitch of the compass are used, not only reported. Raises LogError if no message of a topic can be read.
    """
    while True:
        kept = {
            role: _Collected(reader.path, role, choice, more_fields.get(role), tilted, _is_shared(choice, choices))
            for role, choice in choices.items()
        }
        wanted: dict[str, list[str]] = {}
        for one in kept.values():
            for key, paths in one.fields.items():
                wanted[key] = list(dict.fromkeys([*wanted.get(key, ()), *paths]))
        try:
            for topic, block in reader.blocks(wanted):
                for one in kept.values():
                    if topic in one.fields and len(block.received_ns):
                        one.add(topic, block)
        except BeginAgainError:
            continue
        break
    for role, one in kept.items():
        if not one.count:
            why = "; ".join(finding.text for finding in reader.findings()) or "none fits its definition"
            raise LogError(f"no message of {one.topic.name} ({role}) could be read: {why}", path=reader.path)
    evidence = {role: one.evidence() for role, one in kept.items() if role in more_fields}
    return {role: kept.pop(role).raws() for role in list(kept)}, evidence


def _is_shared(choice: TopicChoice, choices: Mapping[str, TopicChoice]) -> bool:
    """Return whether records of a topic may hold other sensors alone: rows of a table, or JSON objects."""
    by_columns = [one for one in choices.values() if one.topic == choice.topic and one.layout.by_columns]
    several = len({frozenset(one.layout.required.values()) for one in by_columns}) > 1
    return choice.topic.is_shared or (choice.topic.encoding == "json" and choice.layout.by_columns and several)


class _Collected:
    """The records of a sensor, as far as they have been read."""

    def __init__(
        self,
        log: Path,
        role: str,
        choice: TopicChoice,
        more_fields: Sequence[str] | None,
        tilted: bool,
        is_shared: bool,
    ) -> None:
        self.topic, self._layout, self._is_shared = choice.topic, choice.layout, is_shared
        self._log, self._role, self._tilted, self._expected = log, role, tilted, choice.count
        self._types = {one.topic.key: one for one in (choice, *choice.continued)}
        self._paths = wanted_paths(choice.topic, choice.layout)
        self._evidence_fields = [f for f in more_fields or () if choice.topic.has(f)]
        self._evidence_fields += [f for f in (choice.layout.stamp, choice.layout.frame) if choice.topic.has(f)]
        self._records: CollectedRecords | None = None
        self._evidence = CollectedRecords(0, self._evidence_fields)
        self._every = _every(choice.count, EVIDENCE_RECORDS) if more_fields is not None else None
        self._attitudes: CollectedRecords | None = None
        self.count = 0

    @property
    def fields(self) -> Mapping[str, Sequence[str]]:
        """The fields to read, by the keys of the topic's types."""
        found = {key: [*wanted_paths(one.topic, one.layout).values()] for key, one in self._types.items()}
        found[self.topic.key] += self._evidence_fields if self._every else ()
        return found

    def add(self, key: str, block: Records) -> None:
        """Add a block of records of one of the topic's types."""
        block = self._filled(block) if self._is_shared else block
        raw = self._raw(block, self._paths) if key == self.topic.key else self._of_other_type(self._types[key], block)
        if self._role in ("compass", SHIP_HEADING):
            self._add_attitudes(raw)
            raw = with_yaw(raw)
        if self._records is None:
            self._records = CollectedRecords(self._expected, list(raw.values))
        self._records.add(Records(block.received_ns, raw.values))
        if self._every and key == self.topic.key:
            rows = slice(-self.count % self._every, None, self._every)
            some = {field: block.columns[field][rows] for field in self._evidence_fields}
            self._evidence.add(Records(block.received_ns[rows], some))
        self.count += len(block.received_ns)

    def _of_other_type(self, choice: TopicChoice, block: Records) -> RawRecords:
        """Return records by the quantities, and the names of stamp and frame, of the first type."""
        layout, count = choice.layout, len(block.received_ns)
        paths = wanted_paths(choice.topic, layout)
        names = {self._layout.stamp: layout.stamp, self._layout.frame: layout.frame}
        absent = {self._layout.stamp: np.zeros(count, np.int64), self._layout.frame: np.full(count, "")}  # 0: unset
        columns = {
            path: block.columns[paths[own]] if (own := names.get(quantity, quantity)) in paths
            else absent.get(path, np.full(count, np.nan))
            for quantity, path in self._paths.items()
        }  # fmt: skip
        return self._raw(Records(block.received_ns, columns), self._paths)

    def _filled(self, block: Records) -> Records:
        """Return the records of several sensors that have a value of this one; all if none has."""
        own = set(self._paths.values()) - {self._layout.stamp, self._layout.frame, self._paths.get("device")}
        values = [column for path, column in block.columns.items() if path in own]
        rows = np.any([column != "" if column.dtype.kind == "U" else ~np.isnan(column) for column in values], axis=0)
        if not np.any(rows):
            return block
        return Records(block.received_ns[rows], {path: column[rows] for path, column in block.columns.items()})

    def _add_attitudes(self, raw: RawRecords) -> None:
        """Keep the attitudes of some records, evenly spread over the log."""
        every = _every(self._expected, MAX_ATTITUDES if self._tilted else REPORTED_ATTITUDES)
        some = attitudes(raw.part(slice(-self.count % every, None, every)))
        if some is not None and len(some.received_ns):
            names = list(some.values)
            self._attitudes = self._attitudes or CollectedRecords(-(-self._expected // every), names)
            self._attitudes.add(Records(some.received_ns, some.values))

    def raws(self) -> RawRecords:
        """Return all records."""
        assert self._records is not None
        raw = self._named(self._records.whole())
        return raw if self._attitudes is None else replace(raw, attitude=self._named(self._attitudes.whole()))

    def evidence(self) -> RawRecords:
        """Return some records, evenly spread over the log."""
        return self._named(self._evidence.whole())

    def _named(self, records: Records) -> RawRecords:
        return self._raw(records, {name: name for name in records.columns})

    def _raw(self, records: Records, paths: Mapping[str, str]) -> RawRecords:
        return raw_records(self._log, self.topic, self._layout, records, paths)


def _every(count: int, most: int) -> int:
    """Return of how many records one is kept, so that there are no more than ``most``."""
    return max(1, -(-count // most))
