"""The updates of a whole run as columns: a fifth of the memory of an object for each, and quick to count.

Rows are updates, or their parts: an update of a fix whose axes were used in sequence has two parts, any other is its
own part. A table is a sequence, too: it makes an Update when one is asked for.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import chain
from typing import Any, cast, overload

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.types import OUTCOMES, Array, Indices, Mask, Update, Vector

CHUNK = 4096  # [updates] kept as objects before they become columns: two megabytes
Codes = NDArray[np.uint8]


@dataclass(frozen=True)
class Parts:
    """Columns of P parts, named as in Update; a vector of one scalar has NaN in its second column, "()" only NaN."""

    sensor: Codes  # (P,) index into the table's names
    axis: Codes  # (P,) likewise
    outcome: Codes  # (P,) index into OUTCOMES
    row: NDArray[np.int32]  # (P,)
    time_s: Vector  # (P,)
    nis: Vector  # (P,)
    dof: Codes  # (P,)
    nominal_probability: Vector  # (P,)
    innovation: Array  # (P, 2)
    innovation_sd: Array  # (P, 2)
    nominal_sd: Array  # (P, 2)
    scores: Array  # (P, 2)
    shift: NDArray[np.int32]  # (P,) row of the table's shifts, -1: none

    def __getitem__(self, rows: Indices | Mask | slice) -> "Parts":
        return Parts(*(getattr(self, name)[rows] for name in COLUMNS))


COLUMNS = tuple(one.name for one in fields(Parts))
NONE = np.empty((0, 0))


class UpdateTable(Sequence[Update]):
    """U updates as columns."""

    def __init__(self, parts: Parts, first: Indices, names: tuple[str, ...], shifts: Array) -> None:
        self.parts, self.first, self.names, self.shifts = parts, first, names, shifts  # first: (U,) part of each update

    @classmethod
    def of(cls, updates: Sequence[Update]) -> "UpdateTable":
        """Return updates as a table."""
        if isinstance(updates, UpdateTable):
            return updates
        builder = UpdateTableBuilder()
        builder.add(updates)
        return builder.table()

    def of_sensor(self, sensor: str) -> "UpdateTable":
        """Return the updates of one sensor."""
        code = self.names.index(sensor) if sensor in self.names else len(self.names)
        mine = self.parts.sensor == code
        is_first = np.zeros(len(mine), np.bool_)
        is_first[self.first] = True
        return UpdateTable(self.parts[mine], np.flatnonzero(is_first[mine]), self.names, self.shifts)

    @property
    def sensors(self) -> list[str]:
        """The sensors that have updates, in alphabetical order."""
        present: list[int] = np.unique(self.parts.sensor).tolist()
        return sorted(self.names[code] for code in present)

    @property
    def axis(self) -> NDArray[np.str_]:
        """The axis of each update, (U,)."""
        axis = np.array([*self.names, "position"])
        return axis[np.where(self.counts == 2, len(self.names), self.parts.axis[self.first])]

    @property
    def last(self) -> Indices:
        """The last part of each update, (U,)."""
        return self.first + self.counts - 1

    @cached_property
    def outcome(self) -> NDArray[np.str_]:
        """The worst outcome of each update, (U,)."""
        return np.array(OUTCOMES)[self._reduced(np.maximum, self.parts.outcome)]

    @property
    def nis(self) -> Vector:
        """The summed NIS of each update, (U,)."""
        return self._reduced(np.add, self.parts.nis)

    @property
    def dof(self) -> Indices:
        """How many scalars each update has, (U,)."""
        return self._reduced(np.add, self.parts.dof.astype(np.intp))

    @property
    def nominal_probability(self) -> Vector:
        """The least probability of the nominal noise in each update, (U,)."""
        return self._reduced(np.minimum, self.parts.nominal_probability)

    @property
    def time_s(self) -> Vector:
        """When each update was made, (U,)."""
        return self.parts.time_s[self.first]

    @property
    def row(self) -> Indices:
        """Which fix or epoch each update is of, (U,)."""
        return self.parts.row[self.first].astype(np.intp)

    def vectors(self, name: str) -> Array:
        """Return ``innovation``, ``innovation_sd``, ``nominal_sd`` or ``scores`` of each update, (U, 2)."""
        column = getattr(self.parts, name)
        joined = column[self.first].copy()
        two = np.flatnonzero(self.counts == 2)
        joined[two, 1] = column[self.first[two] + 1, 0]
        return joined

    def shift(self, state: int) -> Vector:
        """Return by how much each update changed a state, (U,); NaN: not of a position fix."""
        known = np.append(self.shifts[:, state], np.nan) if self.shifts.size else np.array([np.nan])
        return self._reduced(np.add, known[self.parts.shift])

    @property
    def counts(self) -> Indices:
        """How many parts each update has, (U,)."""
        return np.diff(self.first, append=len(self.parts.row))

    def _reduced(self, by: np.ufunc, column: NDArray[Any]) -> NDArray[Any]:
        return by.reduceat(column, self.first) if len(self.first) else column[:0]

    def __len__(self) -> int:
        return len(self.first)

    @overload
    def __getitem__(self, index: int) -> Update: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Update, ...]: ...
    def __getitem__(self, index: int | slice) -> Update | tuple[Update, ...]:
        if isinstance(index, slice):
            return tuple(self[k] for k in range(len(self))[index])
        first = self.first[index]
        end = self.first[index + 1] if -1 != index < len(self) - 1 else len(self.parts.row)
        return Update.combined([self._part(k) for k in range(first, end)])

    def __iter__(self) -> Iterator[Update]:
        return (self[k] for k in range(len(self)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        return tuple(self) == tuple(cast(Sequence[object], other))

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    def _part(self, k: int) -> Update:
        parts = self.parts
        shift = parts.shift[k]
        return Update(
            self.names[parts.sensor[k]],
            self.names[parts.axis[k]],
            int(parts.row[k]),
            float(parts.time_s[k]),
            _known(parts.innovation[k]),
            _known(parts.innovation_sd[k]),
            float(parts.nis[k]),
            int(parts.dof[k]),
            OUTCOMES[parts.outcome[k]],
            float(parts.nominal_probability[k]),
            None if shift < 0 else tuple(self.shifts[shift].tolist()),
            (),
            _known(parts.nominal_sd[k]),
            _known(parts.scores[k]),
        )


def _known(vector: Vector) -> tuple[float, ...]:
    return tuple(vector[~np.isnan(vector)].tolist())


class UpdateTableBuilder:
    """Collects updates into a table."""

    def __init__(self, expected: int = 0) -> None:
        """Take the number of parts that are expected; memory is used only as they come."""
        self._expected = expected
        self._waiting: list[Update] = []
        self._columns: dict[str, NDArray[Any]] = {}  # longer than what is in use
        self._lengths = dict.fromkeys(("counts", "shifts", *COLUMNS), 0)
        self._names: dict[str, int] = {}
        self._shifted = 0  # parts with a shift

    def add(self, updates: Iterable[Update]) -> None:
        """Append updates, or a table of them."""
        if isinstance(updates, UpdateTable):
            self._add_table(updates)
            return
        self._waiting += updates
        if len(self._waiting) >= CHUNK:
            self._convert()

    def table(self) -> UpdateTable:
        """Return all updates, and keep none."""
        self._convert()
        columns = {name: column[: self._lengths[name]] for name, column in self._columns.items()}
        self._columns = {}
        counts: Indices = columns["counts"]
        parts = Parts(*(columns[name] for name in COLUMNS))
        return UpdateTable(parts, np.cumsum(counts) - counts, tuple(self._names), columns.get("shifts", NONE))

    def _add_table(self, table: UpdateTable) -> None:
        self._convert()
        codes = np.array([self._code(name) for name in table.names], np.uint8)
        columns: dict[str, NDArray[Any]] = {name: getattr(table.parts, name) for name in COLUMNS}
        shift = columns["shift"]
        columns |= {"sensor": codes[table.parts.sensor], "axis": codes[table.parts.axis]}
        columns |= {"shift": np.where(shift < 0, -1, self._shifted + shift).astype(np.int32), "counts": table.counts}
        if table.shifts.size:
            columns["shifts"] = table.shifts
        self._append(columns, len(table.shifts))

    def _convert(self) -> None:
        if not self._waiting and self._columns:
            return
        updates, self._waiting = self._waiting, []
        parts = [part for update in updates for part in update.in_sequence or (update,)]
        shifts = [part.shift for part in parts if part.shift is not None]
        has_shift = np.array([part.shift is not None for part in parts], np.bool_)
        columns: dict[str, NDArray[Any]] = {
            "counts": np.array([len(one.in_sequence) or 1 for one in updates], np.intp),
            "sensor": np.array([self._code(part.sensor) for part in parts], np.uint8),
            "axis": np.array([self._code(part.axis) for part in parts], np.uint8),
            "outcome": np.array([OUTCOMES.index(part.outcome) for part in parts], np.uint8),
            "row": np.array([part.row for part in parts], np.int32),
            "time_s": np.array([part.time_s for part in parts], np.float64),
            "nis": np.array([part.nis for part in parts], np.float64),
            "dof": np.array([part.dof for part in parts], np.uint8),
            "nominal_probability": np.array([part.nominal_probability for part in parts], np.float64),
            "innovation": _pairs([part.innovation for part in parts]),
            "innovation_sd": _pairs([part.innovation_sd for part in parts]),
            "nominal_sd": _pairs([part.nominal_sd for part in parts]),
            "scores": _pairs([part.scores for part in parts]),
            "shift": np.where(has_shift, self._shifted + np.cumsum(has_shift) - 1, -1).astype(np.int32),
        }
        if shifts:
            columns["shifts"] = np.array(shifts)
        self._append(columns, len(shifts))

    def _append(self, columns: Mapping[str, NDArray[Any]], shifts: int) -> None:
        self._shifted += shifts
        for name, column in columns.items():
            rows, first = self._columns.get(name, column[:0]), self._lengths[name]
            end = self._lengths[name] = first + len(column)
            if end > len(rows) or name not in self._columns:
                longer = np.empty((max(self._expected, 2 * end), *column.shape[1:]), column.dtype)
                longer[:first] = rows[:first]
                self._columns[name] = rows = longer
            rows[first:end] = column

    def _code(self, name: str) -> int:
        return self._names.setdefault(name, len(self._names))


def _pairs(vectors: Sequence[tuple[float, ...]]) -> Array:
    """Return vectors of at most two numbers as rows, filled with NaN."""
    lengths = np.array([len(vector) for vector in vectors], dtype=np.intp)
    rows = np.full((len(vectors), 2), np.nan)
    rows[np.arange(2) < lengths[:, None]] = np.fromiter(chain.from_iterable(vectors), np.float64)
    return rows
