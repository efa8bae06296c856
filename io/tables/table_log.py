"""Logs of tables: text files, and files that hold arrays. What their columns mean, topic_sheets says.

A row with a cell that cannot be read is left out. One long table may hold several sensors: its column ``sensor`` names
each row's sensor, which is the topic.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.decoding.date_order import DateOrder
from usbldr.io.findings import Finding
from usbldr.io.limits import BeyondLimitError
from usbldr.io.messages.configured import ConfiguredColumns, plain
from usbldr.io.messages.field_names import sensors_by_name, utm_code, words_of
from usbldr.io.messages.registry import FRAMES
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import Records, TopicInfo, name_of
from usbldr.io.tables.array_column import ArrayColumn
from usbldr.io.tables.cells import ParsedColumn, numbers, times, with_whole_angles
from usbldr.io.tables.csv_begin import stated_date, stated_start
from usbldr.io.tables.csv_sheets import NO_HEADER, Sheet, first_informative, open_angle, plain_names, sheet_of
from usbldr.io.tables.date_times import SECONDS_OF_DAY, clock_digits, foreign_time, orders_of, with_iso_times
from usbldr.io.tables.long_tables import long_columns, widened
from usbldr.io.tables.text_table import TextTable, line_findings, listed, row_findings
from usbldr.io.tables.time_columns import ISO, SECOND_NS, SINCE_NS, TimeColumn, is_date
from usbldr.io.tables.time_parts import parted_time, week_and_time
from usbldr.io.tables.topic_sheets import (
    OF_WORDS,
    FirstRow,
    TableHead,
    TopicSheet,
    time_findings,
    time_formats,
    topic_sheets,
    unmatched_text,
)

Value = TypeVar("Value")
WORDS = FRAMES | {"name", "lat_dir", "lon_dir", "fixtype", "bi_status"}
"""Fields of messages that are texts."""
SEVERAL = re.compile(r"([A-Z]+ ?)?[\[{(].*[,: ].*[\]})]|.*\d\W*[NS]?[,;] .*\d.*|.*[NS][,; ]+\d.*[EW]")
"""A cell that holds an array, an object of JSON, a geometry, or a latitude and a longitude."""
SUMMARY = re.compile(
    r"\W*(mean|average|avg|mittel(wert)?|moyenne|media|min(imum)?|max(imum)?|range|st(an)?d(ard)?\W?(dev(iation)?)?|sum(me)?|"
    r"total|median|count|n)\W*",
    re.IGNORECASE,
)  # in place of a time: "Mean:"
EASTING = re.compile(r"(^|_)e(ast(ing)?s?)?(_|$)")  # "USBL E (m)"
ENDS = 500  # [characters] of a cell from either end: matching takes their square


@dataclass(frozen=True, eq=False, slots=True)
class TableSource:
    """A table as its file holds it, which is read when it is asked for; LogError says why that is not possible."""

    file: Path
    name: str  # the topic without its first slash
    stem: str  # which may suggest the sensor
    title: str  # what it is called in a sentence
    where: str  # before what is said of a row in an error: of a file's only table nothing
    row: str  # what a row is called
    encoding: str
    begin: Callable[[], tuple[Sequence[str], Sequence[str]]]  # names as written, first cells if they are known
    read: Callable[[], TextTable]
    remarks: Callable[[], Sequence[str]] = lambda: ()  # the lines before the names
    rows: int | None = None  # None: unknown before it is read
    unread: Sequence[str] = ()  # what else is there
    left_out: Mapping[str, str] = field(default_factory=dict[str, str])  # what else its file holds -> why


@dataclass(frozen=True, slots=True)
class TopicRows:
    """The table and rows that hold the records of one topic."""

    source: TableSource
    header: tuple[str, ...]  # names as written
    sensor: str | None = None  # of a table with several sensors: whose rows


class TableLog:
    """The tables of a file or folder."""

    def __init__(
        self, path: Path, kind: str, sources: Sequence[TableSource], configured: Sequence[ConfiguredColumns] = ()
    ) -> None:
        self.path, self.format, self._sources = path, kind, tuple(sources)
        self._configured, self._formats = tuple(configured), time_formats(configured)
        self._read: dict[TableSource, TextTable] = {}
        self._raw = cache(self._wide_texts)
        self._begin = cache(self._header_and_row)
        self._row = cache(self._first_cells)
        self._times = cache(self._parsed_times)
        self._left_out: dict[str, Mapping[int, str]] = {}  # topic -> line or row -> why
        self._summaries: dict[str, Collection[int]] = {}  # topic -> lines behind its last row
        self._starts: dict[TableSource, str] = {}  # the stated starts from which times count

    def with_columns(self, configured: Sequence[ConfiguredColumns]) -> "TableLog":
        """Return this log with the columns that the configuration states."""
        return TableLog(self.path, self.format, self._sources, configured)

    @cached_property
    def _topics(self) -> Mapping[str, TopicSheet]:
        heads = {topic: self._head(rows) for topic, rows in self._rows.items()}
        return topic_sheets(heads, self._configured, self.path)

    def _head(self, rows: TopicRows) -> TableHead:
        source, header = rows.source, rows.header
        if rows.sensor is not None:
            names = self._table(source).columns
            filled = [name for name in names if name == "time_ns" or any(self._cells(rows, name))]
            return TableHead(source.file, source.stem, header, sheet_of(rows.sensor.replace("/", "__"), filled))
        own, first_row = sheet_of(source.stem, header), self._row(source)
        worded = len({*header}) == len(header) and any(map(OF_WORDS.match, first_row))  # else it cannot be read
        texts = self._table(source).columns if worded else dict[str, Sequence[str]]()
        alike = [one for one in self._sources if one.rows == source.rows is not None and one is not source]
        elsewhere = [f"/{one.name}/{name}" for one in alike for name in self._begin(one)[0]]
        timed = source.rows is None or any(map(ISO.fullmatch, first_row)) or any(map(is_date, header))
        timed = timed or "" in sensors_by_name(plain_names(header), source.stem)  # else they are parameters
        return TableHead(source.file, source.stem, header, own, first_row if timed else None, elsewhere, texts)

    def _wide_texts(self, source: TableSource) -> TextTable:
        """Return the cells of a table; those of a long one made wide."""
        read = source.read()
        long = long_columns(list(read.columns))
        return widened(read, long) if long else read

    def _header_and_row(self, source: TableSource) -> tuple[Sequence[str], Sequence[str]]:
        """Return a table's column names as written, and the cells of its first row; those of a long one made wide."""
        names, cells = source.begin()
        if long_columns(names) is None:
            return names, cells
        columns = self._table(source).columns
        return list(columns), [next(iter(column), "") for column in columns.values()]

    def _first_cells(self, source: TableSource) -> Sequence[str]:
        """Return the first filled cell of each column; dates and times as ISO text, for which all rows are read."""
        names, cells = self._begin(source)
        read = self._formats or any(map(foreign_time, cells)) or week_and_time(names) or parted_time(names)
        read = read or any(map(SECONDS_OF_DAY.search, map(str.lower, names)))
        read = read or any(map(clock_digits, names, cells)) or "" in cells[: len(names)] or any(map(open_angle, names))
        if not read or len({*names}) < len(names) or not len(self._table(source).lines):
            return cells
        first, examined = dict(zip(plain_names(names), cells, strict=False)), self._examined(source).keys()
        columns = self._table(source).columns.items()
        return [first_informative(name, column) if name in examined else first[name] for name, column in columns]

    def _examined(self, source: TableSource) -> Mapping[str, Sequence[str]]:
        """Return the columns whose cells are looked at."""
        columns = self._raw(source).columns
        return {name: one for name, one in columns.items() if not isinstance(one, ArrayColumn) or one.is_examined}

    @cached_property
    def _orders(self) -> Mapping[str, DateOrder]:
        """Separator -> how dates with it are read in all tables."""
        dated = [one for one in self._sources if one.rows is not None or any(map(foreign_time, one.begin()[1]))]
        return orders_of(map(self._examined, dated), self._formats)

    @cached_property
    def _rows(self) -> Mapping[str, TopicRows]:
        found: dict[str, TopicRows] = {}
        for source in self._sources:
            for topic, rows in self._topics_of(source).items():
                if topic in found:
                    files = dict.fromkeys((found[topic].source.file.name, source.file.name))
                    twice = f"{' and '.join(files)} are both" if len(files) > 1 else "has two tables"
                    raise LogError(f"{twice} {topic}; rename one", path=self.path)
                found[topic] = rows
        return found

    def _topics_of(self, source: TableSource) -> Mapping[str, TopicRows]:
        header = tuple(self._begin(source)[0])
        names = [*map(plain, header)]
        several = "sensor" in names and "sensor" in self._examined(source)
        sensors = dict.fromkeys(self._table(source).columns["sensor"]) if several else ()
        roles = set[str]().union(*map(suggested_sensors, sensors))
        if not sensors or ("time_ns" not in names and len(roles) < 2):  # else it names devices of one sensor
            return {"/" + name_of(source.name): TopicRows(source, header)}
        return {"/" + name_of(sensor.lstrip("/")): TopicRows(source, header, sensor) for sensor in sensors if sensor}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics; one whose columns match no sensor has no type."""
        return tuple(self._info(topic, one) for topic, one in self._topics.items())

    def _info(self, topic: str, one: TopicSheet) -> TopicInfo:
        rows, sheet = self._rows[one.table], one.sheet
        source = rows.source
        if sheet is None or sheet.received is None:
            return one.unread_info(topic, source.encoding, self._problem(rows, sheet), self._first_row(rows))
        try:
            times, faults = self._times(rows, sheet.received)
        except LogError as fault:
            if source.rows is None or isinstance(fault, BeyondLimitError):
                raise
            fields = (*(("header.stamp",) if sheet.stamp else ()), *sheet.columns)
            return TopicInfo(topic, sheet.type, source.encoding, 0, None, None, fields, fault.text)
        lines = self._own_rows(rows, self._table(source).lines)
        times = np.delete(times, list(faults)) if faults else times
        problem = ""
        if faults and not len(times):
            self._left_out[topic] = {lines[row]: text for row, text in faults.items()}
            where = source.where or f"{source.file}: "
            problem = f"{where}{source.row} {lines[min(faults)]}: {faults[min(faults)]}"
        return one.info(topic, source.encoding, times, problem, lambda: self._first_row(rows))

    def _problem(self, rows: TopicRows, sheet: Sheet | None) -> str:
        source, cells = rows.source, self._begin(rows.source)[1]
        for name, cell in zip(plain_names(rows.header), cells, strict=False):
            if SEVERAL.fullmatch(cell[:ENDS] + cell[ENDS:][-ENDS:]) and not foreign_time(cell):
                text = f"holds several values in the cells of {name} ({cell}); write each in a column of its own"
                return f"{source.title} {text}"
        if sheet:
            empty = cells in ([], [""]) if source.rows is None else not source.rows
            beside = f"; beside these: {listed(source.unread)}" if source.unread else ""
            return f"{source.title} {'has no rows' if empty else sheet.problem + beside}"
        unnamed = rows.header[:1] == ("1",)
        return f"{source.title} {NO_HEADER}" if unnamed else unmatched_text([*rows.header, *source.unread])

    @property
    def first_row(self) -> FirstRow:
        """The columns and first cells of a log of one table."""
        (source,) = self._sources
        return self._first_row(TopicRows(source, tuple(self._begin(source)[0])))

    def _first_row(self, rows: TopicRows) -> FirstRow:
        """Return the columns and first cells of a table with one sensor."""
        cells = () if rows.sensor else self._row(rows.source)
        return tuple(zip(plain_names(rows.header), cells, strict=False))

    def _table(self, source: TableSource) -> TextTable:
        if source not in self._read:
            raw = self._raw(source)
            iso = with_iso_times(self._examined(source), self._formats, self._orders, stated_date(source.remarks()))
            self._read[source] = raw._replace(columns=with_whole_angles({**raw.columns, **iso}))
        return self._read[source]

    def _cells(self, rows: TopicRows, name: str) -> Sequence[str]:
        """Return the cells of a column, which may be one of another table of as many rows: "/group/time"."""
        names = ((one, name.removeprefix(f"/{one.name}/")) for one in (rows.source, *self._sources))
        source, own = next((one, own) for one, own in names if own in self._table(one).columns)
        return self._own_rows(rows, self._table(source).columns[own])

    def _own_rows(self, rows: TopicRows, values: Sequence[Value]) -> Sequence[Value]:
        """Return the values of a table's rows that belong to the sensor."""
        if rows.sensor is None:
            return values
        sensors = self._table(rows.source).columns["sensor"]
        return [value for value, sensor in zip(values, sensors, strict=True) if sensor == rows.sensor]

    def _parsed_times(self, rows: TopicRows, clock: TimeColumn) -> ParsedColumn:
        """Return times; those before 2000 count from the start that a line before the names states."""
        found = times(self._cells(rows, clock.column), *clock)
        start = stated_start(rows.source.remarks())
        if not start or np.any(found.values >= SINCE_NS):
            return found
        (start_ns,) = times(with_iso_times({"": [start]}, {}, self._orders)[""], "", SECOND_NS).values
        self._starts[rows.source] = start
        return found._replace(values=found.values + start_ns)

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the wanted columns; rows with an invalid cell in one of them are left out."""
        for topic, paths in wanted.items():
            yield topic, self._records(topic, paths)

    def _records(self, topic: str, paths: Sequence[str]) -> Records:
        rows, (sheet, clock) = self._rows[self._topics[topic].table], self._topics[topic].readable(topic, self.path)
        source, received = rows.source, self._times(rows, clock)
        columns = {path: self._column(rows, sheet, path) for path in paths}
        faults: dict[int, str] = {}
        wholly = False
        for parsed in (received, *columns.values()):
            faults = {**parsed.faults, **faults}
            wholly |= bool(parsed.faults) and parsed.values.dtype.kind == "f" and not np.isfinite(parsed.values).any()
        lines = self._own_rows(rows, self._table(source).lines)
        known = [np.isfinite(parsed.values) for parsed in columns.values() if parsed.values.dtype.kind == "f"]
        blank = {row for row in received.faults if known and not any(column[row] for column in known)}
        if wholly or (faults and len(faults) == len(lines)):
            text = f"{source.where}{source.row} {lines[min(faults)]}: {faults[min(faults)]}"
            raise LogError(text, path=source.file)
        self._left_out[topic] = {lines[row]: text for row, text in faults.items() if row not in blank}
        clocks = self._cells(rows, clock.column) if len(lines) - 1 in received.faults else ()
        ends = takewhile(lambda row: SUMMARY.fullmatch(clocks[row]), reversed(range(len(clocks))))
        self._summaries[topic] = {lines[row] for row in ends}
        good = np.delete(np.arange(len(lines)), list(faults)) if faults else slice(None)
        return Records(received.values[good], {path: parsed.values[good] for path, parsed in columns.items()})

    def _column(self, rows: TopicRows, sheet: Sheet, path: str) -> ParsedColumn:
        if path == "header.stamp" and sheet.stamp:
            return self._times(rows, sheet.stamp)
        name = sheet.columns[path]
        cells = self._cells(rows, name)
        if path in WORDS | sheet.texts:
            return ParsedColumn(np.array(list(cells)), {})
        parsed = numbers(cells, name, self._table(rows.source).by_commas)
        with np.errstate(invalid="ignore"):  # damage may make any number
            return parsed._replace(values=parsed.values * sheet.scale[path]) if path in sheet.scale else parsed

    def _stated_before(self, topic: str, one: TopicSheet) -> list[Finding]:
        """Report what lines before the names of a file's columns state: a start, and of eastings their grid."""
        source = self._rows[one.table].source
        code = next((code for line in source.remarks() if (code := utm_code(line))), "")
        eastings = one.sheet and any(EASTING.search(words_of(name)) for name in one.sheet.columns.values())
        found = [f"grid, {code}"] if code and eastings else []
        found += [f"start, {start}, from which its times count"] if (start := self._starts.get(source)) else []
        begun = f"{topic}: a line before its columns states their "
        return [Finding("COLUMNS-BY-NAME", begun + text, topic) for text in found]

    def findings(self) -> tuple[Finding, ...]:
        """Report what is not read, the rows that are left out, and dates that have two readings."""
        of_files = {source.file: source.left_out for source in self._sources}
        unread = [(file, path, why) for file, left_out in of_files.items() for path, why in left_out.items()]
        found = [
            Finding("NOT-READ", f"{file.name}: {path} is not read: {why}", lost_data=bool(suggested_sensors(path)))
            for file, path, why in unread
        ]
        first: dict[str, str] = {}
        for one in self._topics.values():
            if clock := one.sheet and one.sheet.received:
                rows = self._rows[one.table]
                first[rows.source.title] = dict(self._first_row(rows)).get(clock.column, "")
        found += time_findings(self.path.name, self._orders, first)
        for topic, one in self._topics.items():
            found += [*one.findings(topic), *self._stated_before(topic, one)] if topic in self._left_out else []
            if self._left_out.get(topic):
                source = self._rows[one.table].source
                lost = bool(self._left_out[topic].keys() - self._summaries.get(topic, ()))
                title = topic if source.where else source.title
                found += row_findings(title, self._table(source), self._left_out[topic], source.row, topic, lost)
        for source, table in self._read.items():
            found += line_findings(source.file, table)
        return tuple(found)
