"""The topics of a log of tables: each table by usbldr's own names, by names with units, or by the configuration."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

from usbldr.filters.errors import LogError
from usbldr.io.decoding.columns import counted
from usbldr.io.decoding.date_order import DateOrder
from usbldr.io.findings import UNDATED, Finding
from usbldr.io.messages.configured import TIME_UNITS_NS, ConfiguredColumns, field_of, plain, topic_with_columns
from usbldr.io.messages.field_names import OF_SHIP, words_of
from usbldr.io.messages.layouts import FLAG_WORDS
from usbldr.io.reader import Nanoseconds, TopicInfo
from usbldr.io.tables.csv_sheets import PROPOSED, Sheet, configured_sheet, foreign_sheets, plain_names, side_columns
from usbldr.io.tables.date_times import of_times
from usbldr.io.tables.text_table import listed
from usbldr.io.tables.time_columns import DAYS, TimeColumn
from usbldr.io.tables.time_zones import UNKNOWN_ZONE, named_zone


@dataclass(frozen=True, slots=True)
class TableHead:
    """What a table's columns are called."""

    file: Path
    stem: str  # the table's name, which may suggest the sensor
    names: Sequence[str]  # as written
    own: Sheet | None  # how they are interpreted by usbldr's or rostopic's names
    first_row: Sequence[str] | None = None  # cells, which may show a date and time; None: names with units do not count
    elsewhere: Sequence[str] = ()  # columns of other tables, which only the configuration names
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])  # columns of texts


DEVICE = re.compile(
    r"(device|sensor|instrument|dvl|compass|imu|gps|depth|vehicle|unit|node|source|system|receiver|antenna)_(id|no|number|serial|name)|"
    r"device|sensor|instrument|receiver|antenna|vehicle|source|serial(_(no|number))?"
)
"""The name of a column that may say which of several devices measured."""
OF_WORDS = re.compile(r"[^\W\d]\w")  # how a cell begins that may name a device
OF_STATE = re.compile(
    r"(^|_)(mode|state|status|solution|quality|type|fix|crc|checksum|check|comment|remark|note)s?(_|$)"
)
"""The name of a column whose words say something else than a device."""
MOST_DEVICES = 8  # by judgement: a column of more words names no devices that take turns
OF_BEAM = re.compile(r"(^|_)(beam_?\d_?v(el(ocity)?)?|v(el(ocity)?)?_?(bt_)?b(ea)?m?_?\d|b\d_vel)(_|$)")
ALIKE = ("vehicle", "source")  # in most tables the same in all rows: the name of another column comes first
SheetOrNone = TypeVar("SheetOrNone", Sheet, Sheet | None)
FirstRow: TypeAlias = tuple[tuple[str, str], ...]  # columns and their first cells


class TopicSheet(NamedTuple):
    """A topic: a table, or some of its columns."""

    table: str  # its topic
    sheet: Sheet | None  # None: its columns match no sensor
    by_name: bool = False  # whether names and their units tell
    is_shared: bool = False  # whether the table's rows hold other sensors, too
    unused: tuple[str, ...] = ()  # columns that no sensor uses, of a table that others than usbldr named

    def readable(self, topic: str, log: Path) -> tuple[Sheet, TimeColumn]:
        """Return the meaning of its columns, and the one of log times; raise LogError if they match no sensor."""
        if self.sheet is None or self.sheet.received is None:
            raise LogError(f"{topic} cannot be read: its columns match no sensor; {PROPOSED}", path=log)
        return self.sheet, self.sheet.received

    def unread_info(self, topic: str, encoding: str, problem: str, first_row: FirstRow) -> TopicInfo:
        """Return a topic that cannot be read for the user, with its first row."""
        kind = self.sheet.type if self.sheet else ""
        return self._described(TopicInfo(topic, kind, encoding, 0, None, None, problem=problem), first_row)

    def info(
        self, topic: str, encoding: str, times: Nanoseconds, problem: str, first_row: Callable[[], FirstRow]
    ) -> TopicInfo:
        """Return a topic with records at times (n,) for the user; if the names of columns tell, with its first row."""
        assert self.sheet is not None
        fields = (*(("header.stamp",) if self.sheet.stamp else ()), *self.sheet.columns)
        counts = counted(times)
        info = TopicInfo(topic, self.sheet.type, encoding, *counts, fields, problem, is_shared=self.is_shared)
        return self._described(info, first_row()) if self.by_name or self.unused else info

    def _described(self, info: TopicInfo, first_row: FirstRow) -> TopicInfo:
        table = self.table if self.by_name or self.unused else ""
        return replace(info, first_row=first_row, table=table, unused=self.unused)

    def findings(self, topic: str) -> list[Finding]:
        """Report what the names of columns were taken for."""
        if not (self.by_name and self.sheet and self.sheet.stamp):
            return []
        named = {**self.sheet.columns, "time": self.sheet.stamp.column}
        text = ", ".join(f"{key} from {column}" for key, column in named.items())
        if UNKNOWN_ZONE.search(named["time"]) and not named_zone(named["time"]):
            text += " as UTC: of zones in names, only those such as UTC+2 are known"
        return [Finding("COLUMNS-BY-NAME", f"{topic}: read by the names of its columns: {text}", topic)]


def unmatched_text(names: Sequence[str]) -> str:
    """Return why a table with these columns cannot be read."""
    if sum(bool(OF_BEAM.search(words_of(name))) for name in names) > 2:
        return f"its velocities are along beams ({listed(names)}); convert them to axes of the instrument"
    return f"its columns match no sensor ({listed(names)}); {PROPOSED}"


def time_formats(configured: Sequence[ConfiguredColumns]) -> Mapping[str, str]:
    """Return the columns of times whose format the configuration states."""
    of_times = [(one, key) for one in configured if one.time_format for key in TIME_UNITS_NS]
    return {plain(one.columns[key]): one.time_format for one, key in of_times if key in one.columns}


def time_findings(log: str, orders: Mapping[str, DateOrder], first: Mapping[str, str]) -> list[Finding]:
    """Report dates that have two readings, and tables (name -> the first cell of their times) without dates."""
    found = [order.finding(log) for order in orders.values() if order.example]
    undated = sorted(name for name, cell in first.items() if cell.startswith(DAYS))
    return [*found, *([Finding("NO-DATE", f"{listed(undated)}: {UNDATED}")] if undated else [])]


def topic_sheets(
    tables: Mapping[str, TableHead], configured: Sequence[ConfiguredColumns], log: Path
) -> Mapping[str, TopicSheet]:
    """Return the topics of a log from its tables; a table whose columns name several sensors has a topic for each.

    Raises UsageError if the columns that the configuration states do not exist, or in several tables.
    """
    stated: dict[str, list[ConfiguredColumns]] = {}
    for one in configured:
        topic = _topic(tables, one, log)
        if topic is not None:
            stated.setdefault(topic, []).append(one)
    found: dict[str, TopicSheet] = {}
    for topic, table in tables.items():
        sensors = stated.get(topic, [])
        own, by_units = _interpreted(table)
        by_name = {s: _with_device(one, table) for s, one in by_units.items() if s not in [at.sensor for at in sensors]}
        shared = len(sensors) + len(by_name) > 1
        names = [*table.names, *table.elsewhere]
        sheet = configured_sheet(sensors, names, table.file, topic) if sensors else None
        sheet, own = _with_device(sheet, table), _with_device(own, table)
        sheet = _with_sides(sheet, sensors, table)
        foreign = by_name or (sheet and table.first_row is not None)
        unused = _unused(table, [*by_name.values(), sheet]) if foreign else ()
        if sheet or not by_name:
            found[topic] = TopicSheet(topic, sheet or own, False, shared, unused)
        apart = sensors or sum(s not in OF_SHIP.values() for s in by_name) > 1
        found |= {
            f"{topic}/{s}" if apart or s in OF_SHIP.values() else topic: TopicSheet(topic, one, True, shared, unused)
            for s, one in by_name.items()
        }
    return found


def _with_device(sheet: SheetOrNone, table: TableHead) -> SheetOrNone:
    """Return a sheet with the column that says which device measured, if there is one that it does not use.

    It is named so, or its words are others than those before in most rows: ship, ROV, ship, ROV. This holds for stated
    columns, too, as `init` writes them: fixes of two vehicles would look like those of one.
    """
    if sheet is None or "device" in sheet.columns:
        return sheet
    names = [one for one in plain_names(table.names) if one not in sheet.columns.values()]
    named = [one for one in names if DEVICE.fullmatch(words_of(one))]
    named.sort(key=lambda one: words_of(one) in ALIKE)
    shown = dict(zip(plain_names(table.names), table.first_row or (), strict=False))
    worded = (one for one in names if OF_WORDS.match(shown.get(one, "")) and not OF_STATE.search(words_of(one)))
    named = named or [one for one in worded if _alternate(table.texts.get(one, ()))]
    columns = {**sheet.columns, "device": named[0]} if named else sheet.columns
    return replace(sheet, columns=columns, texts=sheet.texts | {"device"})


def _with_sides(sheet: SheetOrNone, sensors: Sequence[ConfiguredColumns], table: TableHead) -> SheetOrNone:
    """Return a stated sheet with the columns of N or S and of E or W beside the only position that states none."""
    places = [one.columns for one in sensors if "lat_deg" in one.columns]
    if sheet is None or len(places) != 1 or "lat_side" in places[0]:
        return sheet
    cells = dict(zip(plain_names(table.names), table.first_row or (), strict=False))
    place = {
        key: field_of(name, list(cells), ()) or "" for key, name in places[0].items() if key in ("lat_deg", "lon_deg")
    }
    sides = side_columns(place, cells) if {*place.values()} <= cells.keys() else {}
    return replace(sheet, columns={**sheet.columns, **sides}, texts=sheet.texts | sides.keys())


def _alternate(cells: Sequence[str]) -> bool:
    """Return whether few words mostly change from row to row, and none of them calls a record valid or invalid."""
    words, changes = {*map(str.lower, cells)}, sum(one != other for one, other in pairwise(cells))
    return 2 * changes >= len(cells) > len(words) <= MOST_DEVICES and not words & FLAG_WORDS.keys()


def _unused(table: TableHead, sheets: Iterable[Sheet | None]) -> tuple[str, ...]:
    """Return the plain names of a table's columns that no sheet uses, without those of times and their parts."""
    names = plain_names(table.names)
    used = of_times(names) | {""}
    for sheet in filter(None, sheets):
        used |= {*sheet.columns.values(), *(clock.column for clock in (sheet.received, sheet.stamp) if clock)}
    return tuple(name for name in names if name not in used)


def _interpreted(table: TableHead) -> tuple[Sheet | None, Mapping[str, Sheet]]:
    """Return how usbldr's own names interpret a table, and by sensor how its names with units do, if those do not.

    The problem of one that has no time_ns is that of other names.
    """
    own = table.own
    if table.first_row is None or (own is not None and not own.problem):
        return own, {}
    sheets = foreign_sheets(table.stem, table.names, table.first_row)
    problems = [sheet.problem for sheet in sheets.values()]
    if own is None or not problems or not all(problems):
        return own, sheets
    return own if "time_ns" in plain_names(table.names) else replace(own, problem=problems[0]), {}


def _topic(tables: Mapping[str, TableHead], stated: ConfiguredColumns, log: Path) -> str | None:
    """Return the topic that the configuration names, None if it is not in this log."""
    if stated.topic is not None:
        slashed = "/" + stated.topic.lstrip("/")
        last = "/" + slashed.rpartition("/")[2]
        return next((topic for topic in (slashed, last) if topic in tables), None)
    names = [(topic, plain_names([*table.names, *table.elsewhere]), ()) for topic, table in tables.items()]
    return topic_with_columns(stated, names, log)
