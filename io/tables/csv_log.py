"""CSV logs: a folder with one text file for each topic, or one file; its stem is the topic ("dvl.csv" is "/dvl").

A "__" in a stem is a "/" of the topic. A file in a folder of its own has that folder's name. One long file may hold
several sensors: its column ``sensor`` names each row's sensor, which is the topic. csv_sheets lists the columns that
are understood.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.io.decoding.date_order import DateOrder
from usbldr.io.findings import Finding
from usbldr.io.messages.configured import ConfiguredColumns, plain
from usbldr.io.messages.field_names import utm_code, words_of
from usbldr.io.messages.registry import FRAMES
from usbldr.io.messages.topic_names import suggested_sensors
from usbldr.io.reader import Records, TopicInfo, name_of
from usbldr.io.tables.cells import ParsedColumn, numbers, times, with_whole_angles
from usbldr.io.tables.csv_begin import begin_of_table, header_and_row, stated_date, stated_start
from usbldr.io.tables.csv_sheets import NO_HEADER, Sheet, first_telling, open_angle, plain_names, sheet_of
from usbldr.io.tables.csv_text import read_texts, text_files
from usbldr.io.tables.date_times import SECONDS_OF_DAY, clock_digits, foreign_time, orders_of, with_iso_times
from usbldr.io.tables.long_tables import long_columns, widened
from usbldr.io.tables.text_table import TextTable, line_findings, row_findings
from usbldr.io.tables.time_columns import SECOND_NS, SINCE_NS, TimeColumn
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


@dataclass(frozen=True, slots=True)
class CsvSource:
    """The file and rows that hold the records of one topic."""

    file: Path
    header: tuple[str, ...]  # names as written
    sensor: str | None = None  # of a file with several sensors: whose rows


class CsvLog:
    """A folder of CSV files, or one such file."""

    def __init__(
        self,
        path: Path,
        configured: Sequence[ConfiguredColumns] = (),
        files: Sequence[Path] = (),
        cells: TextTable | None = None,
    ) -> None:
        """Take a file or a folder, and if the caller knows them, which files to read, or the cells of the only one."""
        self.path, self._given, self._given_cells = path, files, cells
        self._configured, self._formats = tuple(configured), time_formats(configured)
        self._read: dict[Path, TextTable] = {}
        self._raw = cache(self._wide_texts)
        self._begin = cache(self._header_and_row)
        self._row = cache(self._first_cells)
        self._left_out: dict[str, Mapping[int, str]] = {}  # topic -> line -> why
        self._summaries: dict[str, Collection[int]] = {}  # topic -> lines behind its last row
        self._starts: dict[Path, str] = {}  # file -> the stated start from which its times count

    @property
    def format(self) -> str:
        """The name of the format as shown to a user."""
        return "CSV folder" if self.path.is_dir() else "CSV file"

    def with_columns(self, configured: Sequence[ConfiguredColumns]) -> "CsvLog":
        """Return this log with the columns that the configuration states."""
        return CsvLog(self.path, configured, self._given)

    @cached_property
    def _topics(self) -> Mapping[str, TopicSheet]:
        heads = {topic: self._head(source) for topic, source in self._files.items()}
        return topic_sheets(heads, self._configured, self.path)

    def _head(self, source: CsvSource) -> TableHead:
        file, header = source.file, source.header
        if source.sensor is None:
            own, first_row = sheet_of(stem := self._stem(file), header), self._row(file)
            worded = len({*header}) == len(header) and any(map(OF_WORDS.match, first_row))  # else it cannot be read
            texts = self._table(file).columns if worded else dict[str, Sequence[str]]()
            return TableHead(file, stem, header, own, first_row, texts=texts)
        names = self._table(file).columns
        filled = [name for name in names if name == "time_ns" or any(self._cells(source, name))]
        return TableHead(file, self._stem(file), header, sheet_of(source.sensor.replace("/", "__"), filled))

    def _wide_texts(self, file: Path) -> TextTable:
        """Return the cells of a file; those of a long table made wide."""
        read = self._given_cells or read_texts(file, beside=self._texts)
        long = long_columns(list(read.columns))
        return widened(read, long) if long else read

    def _header_and_row(self, file: Path) -> tuple[Sequence[str], Sequence[str]]:
        """Return a file's column names as written, and the cells of its first row; those of a long table made wide."""
        if self._given_cells is None:
            names, cells = header_and_row(file, self._texts)
            if long_columns(names) is None:
                return names, cells
        columns = self._table(file).columns
        return list(columns), [next(iter(column), "") for column in columns.values()]

    def _first_cells(self, file: Path) -> Sequence[str]:
        """Return the first filled cell of each column; dates and times as ISO text, for which all rows are read."""
        names, cells = self._begin(file)
        read = self._formats or any(map(foreign_time, cells)) or week_and_time(names) or parted_time(names)
        read = read or any(map(SECONDS_OF_DAY.search, map(str.lower, names)))
        read = read or any(map(clock_digits, names, cells)) or "" in cells[: len(names)] or any(map(open_angle, names))
        if not read or len({*names}) < len(names) or not len(self._table(file).lines):
            return cells
        columns = self._table(file).columns
        return [first_telling(name, column) for name, column in columns.items()]

    @cached_property
    def _texts(self) -> Sequence[Path]:
        return self._given or (list(text_files(self.path)) if self.path.is_dir() else [self.path])

    @cached_property
    def _orders(self) -> Mapping[str, DateOrder]:
        """Separator -> how dates with it are read in all files."""
        dated = [file for file in self._texts if any(map(foreign_time, header_and_row(file)[1]))]
        return orders_of([self._raw(file).columns for file in dated], self._formats)

    @cached_property
    def _files(self) -> Mapping[str, CsvSource]:
        found: dict[str, CsvSource] = {}
        for file in self._texts:
            for topic, source in self._topics_of(file).items():
                if topic in found:
                    raise LogError(
                        f"{found[topic].file.name} and {file.name} are both {topic}; rename one", path=self.path
                    )
                found[topic] = source
        return found

    def _stem(self, file: Path) -> str:
        """Return the name of a file, if it lies in a folder within this one the name of that, alone or before it."""
        folder = file.parent
        if folder == self.path or folder.parent != self.path:  # "." is its own parent
            return file.stem
        alone = [other.parent for other in self._given].count(folder) == 1
        return folder.name if alone else f"{folder.name}__{file.stem}"

    def _topics_of(self, file: Path) -> Mapping[str, CsvSource]:
        header = tuple(self._begin(file)[0])
        names = [*map(plain, header)]
        sensors = dict.fromkeys(self._table(file).columns["sensor"]) if "sensor" in names else ()
        roles = set[str]().union(*map(suggested_sensors, sensors))
        if not sensors or ("time_ns" not in names and len(roles) < 2):  # else it names devices of one sensor
            return {"/" + name_of(self._stem(file).replace("__", "/")): CsvSource(file, header)}
        return {"/" + name_of(sensor.lstrip("/")): CsvSource(file, header, sensor) for sensor in sensors if sensor}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics; one whose columns match no sensor has no type."""
        return tuple(self._info(topic, one) for topic, one in self._topics.items())

    def _info(self, topic: str, one: TopicSheet) -> TopicInfo:
        source, sheet = self._files[one.table], one.sheet
        if sheet is None or sheet.received is None:
            return one.unread_info(topic, "csv", self._problem(source, sheet), self._first_row(source))
        times, faults = self._times(source, sheet.received)
        lines = self._own_rows(source, self._table(source.file).lines)
        times = np.delete(times, list(faults)) if faults else times
        problem = ""
        if faults and not len(times):
            self._left_out[topic] = {lines[row]: text for row, text in faults.items()}
            problem = f"{source.file}: line {lines[min(faults)]}: {faults[min(faults)]}"
        return one.info(topic, "csv", times, problem, lambda: self._first_row(source))

    def _problem(self, source: CsvSource, sheet: Sheet | None) -> str:
        for name, cell in zip(plain_names(source.header), self._begin(source.file)[1], strict=False):
            if SEVERAL.fullmatch(cell[:ENDS] + cell[ENDS:][-ENDS:]) and not foreign_time(cell):
                text = f"holds several values in the cells of {name} ({cell}); write each in a column of its own"
                return f"{source.file.name} {text}"
        if sheet:
            empty = self._begin(source.file)[1] in ([], [""])
            return f"{source.file.name} {'has no rows' if empty else sheet.problem}"
        return f"{source.file.name} {NO_HEADER}" if source.header[:1] == ("1",) else unmatched_text(source.header)

    @property
    def first_row(self) -> FirstRow:
        """The columns and first cells of a log of one file."""
        return self._first_row(CsvSource(self.path, tuple(self._begin(self.path)[0])))

    def _first_row(self, source: CsvSource) -> FirstRow:
        """Return the columns and first cells of a file with one sensor."""
        cells = () if source.sensor else self._row(source.file)
        return tuple(zip(plain_names(source.header), cells, strict=False))

    def _table(self, file: Path) -> TextTable:
        if file not in self._read:
            raw = self._raw(file)
            date = stated_date(begin_of_table(file).remarks)
            columns = with_iso_times(raw.columns, self._formats, self._orders, date)
            self._read[file] = raw._replace(columns=with_whole_angles(columns))
        return self._read[file]

    def _cells(self, source: CsvSource, name: str) -> Sequence[str]:
        return self._own_rows(source, self._table(source.file).columns[name])

    def _own_rows(self, source: CsvSource, values: Sequence[Value]) -> Sequence[Value]:
        """Return the values of a file's rows that belong to the sensor."""
        if source.sensor is None:
            return values
        sensors = self._table(source.file).columns["sensor"]
        return [value for value, sensor in zip(values, sensors, strict=True) if sensor == source.sensor]

    def _times(self, source: CsvSource, clock: TimeColumn) -> ParsedColumn:
        """Return times; those before 2000 count from the start that a line before the names states."""
        found = times(self._cells(source, clock.column), *clock)
        start = stated_start(begin_of_table(source.file).remarks)
        if not start or np.any(found.values >= SINCE_NS):
            return found
        (start_ns,) = times(with_iso_times({"": [start]}, {}, self._orders)[""], "", SECOND_NS).values
        self._starts[source.file] = start
        return found._replace(values=found.values + start_ns)

    def blocks(self, wanted: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Records]]:
        """Read the wanted columns; rows with an invalid cell in one of them are left out."""
        for topic, paths in wanted.items():
            yield topic, self._records(topic, paths)

    def _records(self, topic: str, paths: Sequence[str]) -> Records:
        source, (sheet, clock) = self._files[self._topics[topic].table], self._topics[topic].readable(topic, self.path)
        received = self._times(source, clock)
        columns = {path: self._column(source, sheet, path) for path in paths}
        faults: dict[int, str] = {}
        wholly = False
        for parsed in (received, *columns.values()):
            faults = {**parsed.faults, **faults}
            wholly |= bool(parsed.faults) and parsed.values.dtype.kind == "f" and not np.isfinite(parsed.values).any()
        lines = self._own_rows(source, self._table(source.file).lines)
        known = [np.isfinite(parsed.values) for parsed in columns.values() if parsed.values.dtype.kind == "f"]
        blank = {row for row in received.faults if known and not any(column[row] for column in known)}
        if wholly or (faults and len(faults) == len(lines)):
            raise LogError(f"line {lines[min(faults)]}: {faults[min(faults)]}", path=source.file)
        self._left_out[topic] = {lines[row]: text for row, text in faults.items() if row not in blank}
        clocks = self._cells(source, clock.column) if len(lines) - 1 in received.faults else ()
        ends = takewhile(lambda row: SUMMARY.fullmatch(clocks[row]), reversed(range(len(clocks))))
        self._summaries[topic] = {lines[row] for row in ends}
        good = np.delete(np.arange(len(lines)), list(faults)) if faults else slice(None)
        return Records(received.values[good], {path: parsed.values[good] for path, parsed in columns.items()})

    def _column(self, source: CsvSource, sheet: Sheet, path: str) -> ParsedColumn:
        if path == "header.stamp" and sheet.stamp:
            return self._times(source, sheet.stamp)
        name = sheet.columns[path]
        cells = self._cells(source, name)
        if path in WORDS | sheet.texts:
            return ParsedColumn(np.array(list(cells)), {})
        parsed = numbers(cells, name, self._table(source.file).by_commas)
        return parsed._replace(values=parsed.values * sheet.scale[path]) if path in sheet.scale else parsed

    def _stated_before(self, topic: str, one: TopicSheet) -> list[Finding]:
        """Report what lines before the names of a file's columns state: a start, and of eastings their grid."""
        file = self._files[one.table].file
        remarks = begin_of_table(file).remarks
        code = next((code for line in remarks if (code := utm_code(line))), "")
        eastings = one.sheet and any(EASTING.search(words_of(name)) for name in one.sheet.columns.values())
        found = [f"grid, {code}"] if code and eastings else []
        found += [f"start, {start}, from which its times count"] if (start := self._starts.get(file)) else []
        begun = f"{topic}: a line before its columns states their "
        return [Finding("COLUMNS-BY-NAME", begun + text, topic) for text in found]

    def findings(self) -> tuple[Finding, ...]:
        """Report the rows that are left out, and dates that have two readings."""
        first: dict[str, str] = {}
        for one in self._topics.values():
            if clock := one.sheet and one.sheet.received:
                source = self._files[one.table]
                first[source.file.name] = dict(self._first_row(source)).get(clock.column, "")
        found = time_findings(self.path.name, self._orders, first)
        for topic, one in self._topics.items():
            found += [*one.findings(topic), *self._stated_before(topic, one)] if topic in self._left_out else []
            if self._left_out.get(topic):
                file = self._files[one.table].file
                lost = bool(self._left_out[topic].keys() - self._summaries.get(topic, ()))
                found += row_findings(file, self._table(file), self._left_out[topic], topic, lost)
        for file, table in self._read.items():
            found += line_findings(file, table)
        return tuple(found)
