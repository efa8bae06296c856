"""Tables whose columns are arrays, of Parquet, HDF5 (also netCDF-4), MATLAB and JSON files: each file lists its own."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.file_access.optional_library import reading
from usbldr.io.limits import UnpackingBudget
from usbldr.io.messages.field_names import named_column
from usbldr.io.reader import Column
from usbldr.io.tables.array_column import ArrayColumn
from usbldr.io.tables.csv_sheets import open_angle, plain_names, sheet_of
from usbldr.io.tables.table_log import TableLog, TableSource
from usbldr.io.tables.text_table import TextTable
from usbldr.io.tables.time_columns import is_date
from usbldr.io.tables.time_parts import parted_time, week_and_time
from usbldr.io.units import named_unit

TEXT = "OUT"  # fixed: the kinds of NumPy's arrays of texts
MOST_ELEMENTS = 36  # [columns] of a matrix whose rows are records: a covariance of six quantities
Array: TypeAlias = tuple[str, tuple[int, ...], Callable[[Any], Column]]
"""Its name, its shape, and a function that reads a part of it."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a file, whose columns are read one by one."""

    file: Path
    topic: str
    rows: int
    columns: Mapping[str, Callable[[], Column]]  # name as written -> a function that reads it, (rows,)
    texts: frozenset[str] = frozenset()  # columns of texts and dates, which are looked at as cells of a CSV file are
    unread: Sequence[str] = ()  # what else is there
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])  # what else its file holds -> why


def tables_of(file: Path, name: str, arrays: Iterable[Array], texts: Collection[str] = ()) -> list[Table]:
    """Return the tables of a group from its arrays.

    Arrays of one length are the columns of one table. A matrix is as many columns as its shorter side: "velocity.0".
    Arrays of one element are no columns, unless there are no others.
    """
    by_length: dict[int, dict[str, Callable[[], Column]]] = {}
    for label, shape, read in arrays:
        sides = [side for side in shape if side != 1] or [1]
        if len(sides) == 1 and len(shape) <= 2:
            by_length.setdefault(sides[0], {})[label] = lambda read=read: np.ravel(read(()))
        elif len(shape) == 2 and min(shape) <= MOST_ELEMENTS:
            column, bracket, unit = label.partition(" [")  # which stays at the end
            for k in range(min(shape)):
                part = (slice(None), k) if shape[0] >= shape[1] else (k, slice(None))
                columns = by_length.setdefault(max(shape), {})
                columns[f"{column}.{k}{bracket}{unit}"] = lambda read=read, part=part: read(part)
    if len(by_length) > 1:
        by_length.pop(1, None)
    several = len(by_length) > 1
    topics = {rows: f"{name}/{rows}_rows" if several else name for rows in by_length}
    return [
        Table(file, topics[rows], rows, columns, frozenset(columns.keys() & {*texts}))
        for rows, columns in by_length.items()
    ]


def array_log(path: Path, kind: str, tables: Sequence[Table]) -> TableLog:
    """Return the log of the tables of a file, or of the files of a folder.

    A table of a single row holds parameters, unless all do.
    """
    budget = UnpackingBudget(path, sum(file.stat().st_size for file in {table.file for table in tables}))
    kept = [one for one in tables if one.rows > 1 or (not one.rows and sheet_of(_stem(one), list(one.columns)))]
    return TableLog(path, kind, [_source(table, kind, budget) for table in kept or tables])


def _stem(table: Table) -> str:
    return table.topic.rpartition("/")[2]


def _source(table: Table, kind: str, budget: UnpackingBudget) -> TableSource:
    """Return a table for a log; its columns are read one by one."""
    names = plain_names(list(table.columns))
    examined = {*parted_time(names).values(), *(week_and_time(names) or ()), *filter(_may_state_unit, names)}
    columns = {
        short: ArrayColumn(
            partial(_read, table, name, kind, budget), table.rows, name in table.texts or short in examined
        )
        for short, name in zip(names, table.columns, strict=True)
    }
    return TableSource(
        file=table.file,
        name=table.topic,
        stem=_stem(table),
        title=table.topic,
        where=f"/{table.topic}: ",
        row="row",
        encoding="table",
        begin=lambda: (list(table.columns), [""] * len(names)),
        read=lambda: TextTable(columns, range(1, table.rows + 1), {}),
        rows=table.rows,
        unread=table.unread,
        left_out=table.left_out,
    )


def _may_state_unit(name: str) -> bool:
    """Return whether the first value of a column may state its unit, by its plain name: a time, date or angle."""
    column = named_column(name)
    timed = named_unit(name).dimension == "time" or (column and column.rule.dimension == "time")
    return bool(timed or open_angle(name) or is_date(name))


def _read(table: Table, name: str, kind: str, budget: UnpackingBudget) -> Column:
    """Return a column as its file holds it; raise LogError if that is not possible."""
    budget.take_bytes(table.rows * 8)
    with reading(table.file, kind):
        values = table.columns[name]()
    if len(values) != table.rows:
        count = f"{len(values)} of {table.rows} values"
        raise LogError(f"/{table.topic}: the column {name} has {count}: the file is damaged", path=table.file)
    long = values.dtype.kind == "f" and values.dtype.itemsize > np.float64().itemsize
    return values.astype(np.float64) if long else values
