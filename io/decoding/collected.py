"""Columns that grow block by block; one of equal values needs the memory of a single value."""

from collections.abc import Mapping, Sequence

import numpy as np

from usbldr.io.reader import BeginAgainError, Column, Reader, Records


class GrowingColumn:
    """The values of a field, a block of messages after the other."""

    def __init__(self, expected: int) -> None:
        """Take the number of values that are expected; memory is used only as they come."""
        self._expected = expected
        self._count = 0
        self._one: Column | None = None  # the value that all have, as an array of one
        self._rows: Column | None = None  # all values, if they differ

    def add(self, block: Column) -> None:
        """Add the values of a block."""
        if not len(block):
            return
        self._one = block[:1].copy() if self._one is None else self._one
        if self._rows is None and not _all_equal(block, self._one):
            self._rows = np.empty(max(self._expected, self._count + len(block)), dtype=self._one.dtype)
            self._rows[: self._count] = self._one
        if self._rows is None:
            self._count += len(block)
            return
        kind = np.result_type(self._rows.dtype, block.dtype)
        if kind != self._rows.dtype or self._count + len(block) > len(self._rows):
            longer = np.empty(max(len(self._rows), (self._count + len(block)) * 3 // 2), dtype=kind)
            longer[: self._count] = self._rows[: self._count]
            self._rows = longer
        self._rows[self._count : self._count + len(block)] = block
        self._count += len(block)

    def whole(self) -> Column:
        """Return all values (n,); if they are equal, an array of stride 0 that must not be written to."""
        if self._rows is not None:
            return self._rows[: self._count]
        return np.broadcast_to(np.empty(1) if self._one is None else self._one, self._count)


def _all_equal(block: Column, one: Column) -> bool:
    """Return whether all values of a block are this one, to the bit."""
    if block.dtype != one.dtype:
        return False
    if block.dtype.kind == "f":
        bits = f"i{block.dtype.itemsize}"
        block, one = np.ascontiguousarray(block).view(bits), one.view(bits)
    return bool(block[-1] == one[0] and np.all(block == one))


class CollectedRecords:
    """The records of a topic, collected from blocks."""

    def __init__(self, expected: int, names: Sequence[str]) -> None:
        """Take the number of records that are expected, and the names of their columns."""
        self._received = GrowingColumn(expected)
        self._columns = {name: GrowingColumn(expected) for name in names}

    def add(self, block: Records) -> None:
        """Add a block."""
        self._received.add(block.received_ns)
        for name, column in self._columns.items():
            column.add(block.columns[name])

    def whole(self) -> Records:
        """Return the records in the order of the file."""
        received = self._received.whole().astype(np.int64, copy=False)
        columns = {name: column.whole() for name, column in self._columns.items()}
        self._columns = {}
        return Records(received, columns)


def read_whole(reader: Reader, wanted: Mapping[str, Sequence[str]]) -> dict[str, Records]:
    """Read the fields of the topics; return the records of each topic."""
    counts = {topic.key: topic.count for topic in reader.topics()}
    while True:
        found = {topic: CollectedRecords(counts.get(topic, 0), paths) for topic, paths in wanted.items()}
        try:
            for topic, block in reader.blocks(wanted):
                found[topic].add(block)
        except BeginAgainError:
            continue
        return {topic: records.whole() for topic, records in found.items()}
