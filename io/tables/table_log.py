"""Logs of tables in binary files: Parquet, HDF5 (also netCDF-4) and MATLAB, read like the columns of CSV files.

Each kind of file lists its tables; what their columns mean, topic_sheets says. A column may be masked: those rows have
no value.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.errors import LogError
from usbldr.io.decoding.date_order import DateOrder
from usbldr.io.file_access.optional_library import reading
from usbldr.io.findings import Finding
from usbldr.io.limits import BeyondLimitError, UnpackingBudget
from usbldr.io.messages.configured import ConfiguredColumns
from usbldr.io.messages.field_names import named_column, sensors_by_name
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import MAX_TIME_NS, Column, Nanoseconds, Records, TopicInfo, name_of
from usbldr.io.tables.cells import ParsedColumn, numbers, times
from usbldr.io.tables.cf_times import whole_ns
from usbldr.io.tables.csv_sheets import Sheet, first_telling, open_angle, plain_names, sheet_of
from usbldr.io.tables.date_times import orders_of, with_iso_times
from usbldr.io.tables.long_tables import long_columns, widened
from usbldr.io.tables.text_table import TextTable, listed
from usbldr.io.tables.time_columns import ISO, TimeColumn, is_date
from usbldr.io.tables.time_parts import parted_time, week_and_time
from usbldr.io.tables.topic_sheets import (
    FirstRow,
    TableHead,
    TopicSheet,
    time_findings,
    time_formats,
    topic_sheets,
    unmatched_text,
)
from usbldr.io.units import named_unit

TEXT = "OUT"  # fixed: the kinds of NumPy's arrays of texts
MOST_ELEMENTS = 36  # [columns] of a matrix whose rows are records: a covariance of six quantities
Mask: TypeAlias = NDArray[np.bool_]
Array: TypeAlias = tuple[str, tuple[int, ...], Callable[[Any], Column]]
"""Its name, its shape, and a function that reads a part of it."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a file, whose columns are read one by one."""

    file: Path
    topic: str
    rows: int
    columns: Mapping[str, Callable[[], Column]]  # name as written -> a function that reads it, (rows,)
    dated: frozenset[str] = frozenset()  # columns of dates and times, datetime64[ns]
    texts: frozenset[str] = frozenset()  # columns of texts, which are read as the cells of a CSV file
    unread: Sequence[str] = ()  # what else is there
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])  # what else its file holds -> why


def tables_of(file: Path, name: str, arrays: Iterable[Array], dated: frozenset[str] = frozenset()) -> list[Table]:
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
    return [Table(file, topics[rows], rows, columns, dated & columns.keys()) for rows, columns in by_length.items()]


def _may_tell(name: str) -> bool:
    """Return whether the first value of a column may tell its unit, by its plain name: a time, date or angle."""
    column = named_column(name)
    timed = named_unit(name).dimension == "time" or (column and column.rule.dimension == "time")
    return bool(timed or open_angle(name) or is_date(name))


def _cells(values: Column) -> list[str]:
    """Return a column as the cells of a CSV file."""
    return ["" if value is None else str(value).strip() for value in values]


def _own_sheet(table: Table) -> Sheet | None:
    """Return how usbldr's own names interpret the columns of a table."""
    return sheet_of(table.topic.rpartition("/")[2], list(table.columns))


class TableLog:
    """A log of tables; one of a single row holds parameters, unless all do."""

    def __init__(
        self, path: Path, kind: str, tables: Sequence[Table], configured: Sequence[ConfiguredColumns] = ()
    ) -> None:
        """Take the tables of a file, or of the files of a folder."""
        self.path, self.format = path, kind
        self._configured, self._formats = tuple(configured), time_formats(configured)
        self._left_out: dict[str, str] = {}  # topic -> how many rows, and why
        self._faults: dict[tuple[str, str], Mapping[int, str]] = {}  # table and column of texts -> row -> its fault
        self._columns: dict[tuple[str, str], Column] = {}
        self._read = cache(self._read_column)
        tables = [self._widened(one) for one in tables]
        self._all = [one for one in tables if one.rows > 1 or (not one.rows and _own_sheet(one))] or tables
        sizes = {table.file: table.file.stat().st_size for table in tables}
        self._budget = UnpackingBudget(path, sum(sizes.values()))

    def _widened(self, table: Table) -> Table:
        """Return a long table (topic, field, value) with a column for each name, any other as it is."""
        if (long := long_columns(list(table.columns))) is None:
            return table
        with reading(table.file, self.format):
            cells = {name: _cells(read()) for name, read in table.columns.items()}
        wide = widened(read := TextTable(cells, range(table.rows), {}), long)
        if wide is read:
            return table
        reads = {name: lambda cells=cells: np.array(cells, dtype=object) for name, cells in wide.columns.items()}
        return Table(table.file, table.topic, len(wide.lines), reads, texts=frozenset(reads))

    def with_columns(self, configured: Sequence[ConfiguredColumns]) -> "TableLog":
        """Return this log with the columns that the configuration states."""
        return TableLog(self.path, self.format, self._all, configured)

    @cached_property
    def _tables(self) -> Mapping[str, Table]:
        found: dict[str, Table] = {}
        for table in self._all:
            topic = "/" + name_of(table.topic)
            if topic in found:
                raise LogError(f"has two tables {topic}; rename one", path=self.path)
            found[topic] = table
        return found

    @cached_property
    def _topics(self) -> Mapping[str, TopicSheet]:
        heads: dict[str, TableHead] = {}
        for topic, table in self._tables.items():
            stem, names = table.topic.rpartition("/")[2], list(table.columns)
            date = [self._date(table, name) for name in names]
            timed = "" in sensors_by_name(names, stem) or any(map(ISO.fullmatch, date)) or any(map(is_date, names))
            alike = [one for one in self._all if one.rows == table.rows and one is not table]
            elsewhere = [f"/{one.topic}/{name}" for one in alike for name in one.columns]
            own, first_row, texts = _own_sheet(table), date if timed else None, self._iso.get(table.topic, {})
            heads[topic] = TableHead(table.file, stem, names, own, first_row, elsewhere, texts)
        return topic_sheets(heads, self._configured, self.path)

    @cached_property
    def _raw(self) -> Mapping[str, Mapping[str, Sequence[str]]]:
        """Table -> the cells of its texts, and of numbers that make up a time; one that cannot be read is left out."""
        found: dict[str, dict[str, Sequence[str]]] = {}
        for table in self._all:
            names = plain_names(list(table.columns))
            parts = {*parted_time(names).values(), *(week_and_time(names) or ())}
            texts = {short for name, short in zip(table.columns, names, strict=True) if name in table.texts}
            stem = table.topic.rpartition("/")[2]
            for name in texts | parts if self._configured or sensors_by_name(names, stem) else ():
                with suppress(LogError):
                    found.setdefault(table.topic, {})[name] = _cells(self._read(table.topic, name))
        return found

    @cached_property
    def _orders(self) -> Mapping[str, DateOrder]:
        """Separator -> how dates with it are read in all tables."""
        return orders_of(self._raw.values(), self._formats)

    @cached_property
    def _iso(self) -> Mapping[str, Mapping[str, Sequence[str]]]:
        """The same with dates and times in ISO's notation."""
        return {topic: with_iso_times(cells, self._formats, self._orders) for topic, cells in self._raw.items()}

    def _date(self, table: Table, name: str) -> str:
        """Return a date and time for a column of dates, the first value of texts and times; else an empty text."""
        if name in table.dated:
            return "2000-01-01 00:00:00"
        (short,) = plain_names([name])
        shown = short in self._iso.get(table.topic, ()) or _may_tell(short)
        return self._first_value(table, short) if shown else ""

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the tables, or their parts."""
        return tuple(self._info(topic, one) for topic, one in self._topics.items())

    def _info(self, topic: str, one: TopicSheet) -> TopicInfo:
        table, sheet = self._tables[one.table], one.sheet
        if sheet is None or sheet.received is None:
            beside = f"; beside these: {listed(table.unread)}" if table.unread else ""
            known = sheet and f"{table.topic} {sheet.problem + beside if table.rows else 'has no rows'}"
            problem = known or unmatched_text([*table.columns, *table.unread])
            return one.unread_info(topic, "table", problem, self._first_row(table))
        try:
            times, good = self._times(table, sheet.received)
        except BeyondLimitError:
            raise
        except LogError as fault:
            fields = (*(("header.stamp",) if sheet.stamp else ()), *sheet.columns)
            return TopicInfo(topic, sheet.type, "table", 0, None, None, fields, fault.text)
        times = times[good]
        none = f"/{table.topic}: no value of the column {sheet.received.column} is a time before 2116 in its unit"
        none = none if table.rows > len(times) == 0 else ""
        return one.info(topic, "table", times, none, lambda: self._first_row(table))

    def _first_row(self, table: Table) -> FirstRow:
        """Return the columns, and the first value of those that may be times; the others are not read."""
        names = plain_names(list(table.columns))
        return tuple((short, self._date(table, name)) for short, name in zip(names, table.columns, strict=True))

    def _first_value(self, table: Table, name: str) -> str:
        """Return the first value of a column as text, empty if there is none or it cannot be read."""
        values: Column = np.empty(0)
        with suppress(LogError):
            values = self._column(table, name)
            if open_angle(name):
                return first_telling(name, map(str, np.ma.compressed(values)))
            values = values[values != ""][:1] if values.dtype.kind in TEXT else values[:1]
        if values.dtype.kind == "M":
            values = np.datetime_as_string(values, unit="ms")
        return "" if np.ma.getmaskarray(values).any() else "".join(map(str, values))

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the wanted columns; rows without a time are left out."""
        for topic, paths in wanted.items():
            yield topic, self._records(topic, paths)

    def _records(self, topic: str, paths: Sequence[str]) -> Records:
        table, (sheet, clock) = self._tables[self._topics[topic].table], self._topics[topic].readable(topic, self.path)
        received, good = self._times(table, clock)
        columns: dict[str, Column] = {}
        for path in paths:
            if path == "header.stamp" and sheet.stamp:
                columns[path], stamped = self._times(table, sheet.stamp)
                good = good & stamped
            else:
                columns[path] = self._values(table, sheet, path)
        used = [sheet.columns[path] for path in columns if path in sheet.columns]
        faults = [self._faults.get((table.topic, name), {}) for name in (clock.column, *used)]
        if unread := {row: cell for found in reversed(faults) for row, cell in found.items()}:
            good = good & ~np.isin(np.arange(len(good)), list(unread))
        if not good.all():
            why = f"are left out: row {min(unread) + 1}: {unread[min(unread)]}" if unread else "have no time; left out"
            self._left_out[topic] = f"{int(np.sum(~good))} of {len(good)} rows {why}"
        return Records(received[good], {path: column[good] for path, column in columns.items()})

    def _values(self, table: Table, sheet: Sheet, path: str) -> Column:
        values = self._column(table, sheet.columns[path])
        if path in sheet.texts:
            return np.array([str(value) for value in values])
        if values.dtype.kind in TEXT:
            values = self._parsed(table, sheet.columns[path], numbers(values.tolist(), sheet.columns[path])).values
        if values.dtype.kind not in "biuf":
            raise LogError(f"/{table.topic}: the column {sheet.columns[path]} holds no numbers", path=table.file)
        if np.ma.isMaskedArray(values):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        with np.errstate(invalid="ignore"):  # damage may make any number
            return values * sheet.scale[path] if path in sheet.scale else values

    def _times(self, table: Table, clock: TimeColumn) -> tuple[Nanoseconds, Mask]:
        """Return a column of times as nanoseconds since 1970, and which of them are times; integers stay exact."""
        values = self._column(table, clock.column)
        if values.dtype.kind in TEXT:
            parsed = self._parsed(table, clock.column, times(values.tolist(), *clock))
            return parsed.values.astype(np.int64), ~np.isin(np.arange(len(values)), list(parsed.faults))
        masked, values = np.ma.getmaskarray(values), np.ma.getdata(values)
        if values.dtype.kind not in "iufM":
            raise LogError(f"/{table.topic}: the column {clock.column} holds no times", path=table.file)
        dated = values.dtype.kind == "M"
        if clock.at_1970 and not dated:
            values = (values.astype(np.int64) if values.dtype.kind in "iu" else values) - clock.at_1970
        values, unit_ns = (values.astype(np.int64), 1) if dated else (values, clock.unit_ns)
        good = (np.abs(values.astype(np.float64)) * unit_ns < MAX_TIME_NS) & ~masked  # False for NaN, and for no date
        return whole_ns(np.where(good, values, 0), unit_ns), good

    def _parsed(self, table: Table, name: str, parsed: ParsedColumn) -> ParsedColumn:
        """Return a column of texts; raise LogError that names the first cell if none can be read."""
        self._faults[table.topic, name] = faults = parsed.faults
        if faults and len(faults) == len(parsed.values):
            raise LogError(f"/{table.topic}: row {min(faults) + 1}: {faults[min(faults)]}", path=table.file)
        return parsed

    def _column(self, table: Table, name: str) -> Column:
        if (key := (table.topic, name)) not in self._columns:
            values = self._read(*key)
            raw, iso = self._raw.get(table.topic, {}), self._iso.get(table.topic, {})
            if name in iso and (values.dtype.kind in TEXT or iso[name] is not raw[name]):
                values = np.array(iso[name], dtype=object)
            elif values.dtype.kind in TEXT:
                values = np.array(with_iso_times({name: _cells(values)}, self._formats)[name], dtype=object)
            self._columns[key] = values
        return self._columns[key]

    def _read_column(self, topic: str, name: str) -> Column:
        """Return a column as its file holds it; raise LogError if that is not possible."""
        table = next(one for one in self._all if one.topic == topic)
        self._budget.take_bytes(table.rows * 8)
        with reading(table.file, self.format):
            own = dict(zip(plain_names(list(table.columns)), table.columns.values(), strict=True))
            values = (own.get(name) or self._by_full_name[name])()
        if len(values) != table.rows:
            count = f"{len(values)} of {table.rows} values"
            raise LogError(f"/{table.topic}: the column {name} has {count}: the file is damaged", path=table.file)
        long = values.dtype.kind == "f" and values.dtype.itemsize > np.float64().itemsize
        return values.astype(np.float64) if long else values

    @cached_property
    def _by_full_name(self) -> Mapping[str, Callable[[], Column]]:
        """The functions that read the columns of all tables."""
        return {f"/{one.topic}/{name}": read for one in self._all for name, read in one.columns.items()}

    def findings(self) -> tuple[Finding, ...]:
        """Report what is not read, the rows that are left out, and what the names of columns were taken for."""
        found = [
            Finding("NOT-READ", f"{file.name}: {path} is not read: {why}", lost_data=bool(suggested_sensors(path)))
            for file, left_out in {table.file: table.left_out for table in self._all}.items()
            for path, why in left_out.items()
        ]
        first: dict[str, str] = {}
        for one in self._topics.values():
            table, clock = self._tables[one.table], one.sheet and one.sheet.received
            if clock and clock.column in self._iso.get(table.topic, ()):
                first[table.topic] = self._first_value(table, clock.column)
        found += time_findings(self.path.name, self._orders, first)
        for topic, one in self._topics.items():
            found += one.findings(topic)
            if why := self._left_out.get(topic):
                found.append(Finding("UNDECODED", f"{topic}: {why}", topic, lost_data=True))
        return tuple(found)
