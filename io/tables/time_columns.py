"""Which column of a table is its time, and in which unit: by its name, by a date in its first row, or by its size.

A number without a unit is a time if it lies in this century in one of the units of ``columns``.
"""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from usbldr.io.gps_time import WEEK_S
from usbldr.io.messages.configured import AT_1970, TIME_UNITS_NS
from usbldr.io.messages.field_names import RULES, TIME_OF_WEEK, NamedColumn, words_of
from usbldr.io.reader import TopicInfo
from usbldr.io.tables.cf_times import clock_of
from usbldr.io.tables.text_table import MAX_CHARACTERS
from usbldr.io.tables.unnamed_columns import is_number
from usbldr.io.units import NamedUnit, named_unit, unit_of

SECOND_NS = 1_000_000_000  # fixed: nanoseconds
SINCE_NS, UNTIL_NS = 946_684_800 * 10**9, 4_102_444_800 * 10**9  # fixed: the years 2000 and 2100, in ns since 1970
OWN_CLOCK_S = 1e6  # [s] since power-on, of a column without a unit: eleven days; a larger number may count milliseconds
DAY_DECIMALS = 5  # of a day: a second; seconds of a log's own clock have fewer, in general
NAME_THEM = "name its columns with the key columns of a sensor's section"
IF_1970 = "if from 1970, name it as time_unix_s with the key columns of a sensor's section, else convert it"
ISO = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d(?::?\d\d)?)?")
"""A date and time."""
DAYS = "1970-01-0"  # with which times of day without a date, and durations, begin
OF_BOOT = re.compile(r"(^|_)(boot|uptime|power_on)(_|$)")
"""Words of times since power-on."""


class TimeColumn(NamedTuple):
    """A column of times."""

    column: str
    unit_ns: int = 1  # 1: whole nanoseconds; else with decimals
    at_1970: float = 0  # the time 1970-01-01 in this unit


def dated_columns(cells: Mapping[str, str], named: Sequence[NamedColumn]) -> Sequence[NamedColumn]:
    """Return those of columns named as times whose first cells (by column) state a date or time, else all of them.

    Times without a date count only if no column has one.

    If none is named so: the columns of dates and times, whatever their names, of dates that are day numbers, and of
    times since 1970 in the unit of their names; else those since power-on (time_boot_us).
    """
    if not named:
        dates = [name for name, cell in cells.items() if ISO.fullmatch(cell)]
        dates = [name for name in dates if not cells[name].startswith(DAYS)] or dates
        dates = dates or [name for name, cell in cells.items() if is_date(name) and keys_since_1970(cell)]
        since = [NamedColumn(name, RULES[0], named_unit(name)) for name in cells]
        since = [one for one in since if one.known]
        of_boot = [one for one in since if OF_BOOT.search(words_of(one.name)) and is_number(cells[one.name])]
        since = [one for one in since if _since_1970(one, cells[one.name])] or of_boot
        return [NamedColumn(name, RULES[0], NamedUnit(name)) for name in dates] or since
    first = [(column, cells.get(column.name, "")) for column in named]
    stated = [column for column, cell in first if ISO.fullmatch(cell) or _since_1970(column, cell)]
    return [column for column in stated if not cells[column.name].startswith(DAYS)] or stated or named


def _since_1970(column: NamedColumn, cell: str) -> bool:
    """Return whether a number is a time of this century in the unit of its column, if that states one."""
    return any(not column.known or TIME_UNITS_NS[key] == column.factor for key in keys_since_1970(cell))


def is_date(name: str) -> bool:
    """Return whether a column is named for a date, which may be a day number."""
    return re.search(r"(^|_)(date|day|jd|mjd|julian|doy|[jy]day)(_|$)", words_of(name)) is not None


def time_fault(stamps: Sequence[NamedColumn], arrivals: Sequence[NamedColumn], cells: Mapping[str, str]) -> str:
    """Return why a table's columns of times and of arrivals are not one time with a known unit, empty if they are."""
    for what, columns in (("time", stamps), ("arrival", arrivals)):
        if len(columns) > 1 or (what == "time" and not columns):
            names = ", ".join(column.name for column in columns) or "none"
            if days := [name for name, cell in cells.items() if is_date(name) and re.fullmatch(r"\d{1,3}\.\d+", cell)]:
                return f'has a column {days[0]} of days of a year, without the year; add a column "year"'
            if dates := [name for name, cell in cells.items() if is_date(name) and cell and not is_number(cell)]:
                return _unknown_time(dates[0], cells[dates[0]])
            return f"has not one column of {what} ({names}); {NAME_THEM}"
        for column in columns:
            if of_gps(column, cells.get(column.name, "")):
                return f"has a column {column.name} that may count from 1970 or, as GPS time, from 1980; {IF_1970}"
            if _unit(column, cells) is None:
                return _unknown_time(column.name, cells.get(column.name, ""))
    return ""


def _unknown_time(name: str, cell: str) -> str:
    if not cell:  # binary files show dates alone
        return f'has a column {name} of which neither a unit nor a date is known; write the unit behind it ("Time [s]")'
    with suppress(ValueError):
        float(cell)
        return f'has a column {name} without a known unit; write it behind the name ("Time [s]")'
    if re.fullmatch(r"\d{3}[:/T -]\d\d:\d\d:\d\d[.,\d]*", cell):
        return f'has "{cell}" in the first row of the column {name}: a day of a year, without the year; write it before'
    if re.fullmatch(r"\d\d:\d\d[.,]\d", cell):
        how = "as spreadsheets show times; give its cells the format yyyy-mm-dd hh:mm:ss.000, and save it again"
        return f'has "{cell}" in the first row of the column {name}: minutes and seconds without the hour, {how}'
    stopped = f'has "{cell[:MAX_CHARACTERS]}" in the first row of the column {name}'
    return f"{stopped}, which is neither a date and time nor a number; state time_format"


def time_column(column: NamedColumn, cells: Mapping[str, str]) -> TimeColumn:
    """Return a column of times with its unit; in seconds since 1970 if the unit is unknown."""
    return TimeColumn(column.name, *(_unit(column, cells) or (SECOND_NS, 0)))


def _unit(column: NamedColumn, cells: Mapping[str, str]) -> tuple[int, float] | None:
    """Return the unit of a time in ns and 1970 in it: of its name, of a date and time, or as it is in this century.

    Its name may state a unit since any day.
    """
    cell = cells.get(column.name, "")
    epoch = named_epoch(column, cell)
    if ISO.fullmatch(cell) or (column.known and not (epoch and TIME_UNITS_NS[epoch] == column.factor)):
        return round(column.factor) if column.known else SECOND_NS, 0
    if (unit := unit_of(cell)).dimension == "time":
        return round(unit.factor), 0
    if (clock := clock_of(column.unit.unit)) is not None:
        return clock.unit_ns, -clock.since_ns / clock.unit_ns
    key = epoch or next(iter(keys_since_1970(cell)), None)
    return (TIME_UNITS_NS[key], AT_1970.get(key, 0)) if key else None


def named_epoch(column: NamedColumn, cell: str) -> str | None:
    """Return the key of ``columns`` for times from another year than 1970 that a column is named for, None if for none.

    LabVIEW's X_Value may also count from the start of the measurement.
    """
    words = words_of(column.name)
    if words == "x_value":
        return "time_labview" if is_number(cell) and float(cell) >= AT_1970["time_labview"] else None
    return next((key for key in AT_1970 if re.search(f"{key.removeprefix('time_')}(_time|_s)?$", words)), None)


def of_gps(column: NamedColumn, cell: str) -> bool:
    """Return whether a number is named for GPS time and no time of the week: it may count from 1970 or from 1980."""
    if not re.search(rf"(^|_)({TIME_OF_WEEK})$", words_of(column.unit.label)):
        return False
    with suppress(ValueError):
        return float(cell) * column.factor > WEEK_S * SECOND_NS if column.known else bool(keys_since_1970(cell))
    return False


def keys_since_1970(cell: str) -> list[str]:
    """Return the keys of ``columns`` by which a number is a time of this century, that of the earliest one first.

    Days, and seconds since 1904, must have an exact time.
    """
    try:
        value = float(cell)
    except ValueError:
        return []
    exact = len(cell.partition(".")[2]) >= DAY_DECIMALS
    keys = [key for key, ns in TIME_UNITS_NS.items() if exact or key not in AT_1970 or ns < SECOND_NS]
    keys = [key for key in keys if key != "time_ntp"]  # four years before LabVIEW's: only a name tells
    times_ns = {key: (value - AT_1970.get(key, 0)) * TIME_UNITS_NS[key] for key in keys}
    return sorted((key for key in keys if SINCE_NS <= times_ns[key] < UNTIL_NS), key=times_ns.__getitem__)


def time_key(topic: TopicInfo, column: NamedColumn | None) -> str | None:
    """Return the key of ``columns`` for the time of a table by its unit and first value, None if they do not tell."""
    cell = dict(topic.first_row).get(column.name, "") if column else ""
    if column is None or ISO.fullmatch(cell) or not is_number(cell):
        return "time_unix_s" if ISO.fullmatch(cell) else None
    if words_of(column.name) == "timestamp" and cell.isdigit() and OWN_CLOCK_S <= int(cell) < SINCE_NS / 1e6:
        # too large for seconds: microseconds since power-on, as PX4 counts
        return "time_unix_us"
    if of_gps(column, cell):
        return None
    if epoch := named_epoch(column, cell):
        return epoch
    units = {key for key, ns in TIME_UNITS_NS.items() if not column.known or ns == column.factor}
    longest_s = SINCE_NS / 1e9 if column.known else OWN_CLOCK_S
    own_clock = "time_s" if "time_s" in units and abs(float(cell)) < longest_s else None
    return next((key for key in keys_since_1970(cell) if key in units), own_clock)


def time_of(topic: TopicInfo) -> tuple[str, str]:
    """Return the key of ``columns`` and the column of a table's time by its first row, whatever the columns' names."""
    for name, cell in topic.first_row:
        column = NamedColumn(name, RULES[0], NamedUnit(name))
        if (ISO.fullmatch(cell) or keys_since_1970(cell)) and (key := time_key(topic, column)):
            return key, name
    return "time_unix_s", "?"
