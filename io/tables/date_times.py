"""Dates and times of day as programs export them, turned into ISO text: "18.05.2026 12:30:00,5" or two columns.

pandas reads the dates; whether the day comes first in "05/06/2026", date_order says. Without a zone a time is UTC. A
time of day without a date counts from 1970-01-01, over midnights. A GPS week beside a time of the week is GPS time.
"""

import re
from calendar import month_abbr
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from itertools import islice
from types import MappingProxyType
from unicodedata import normalize

import numpy as np
import pandas as pd

from usbldr.filters.types import Vector
from usbldr.io.decoding.date_order import NUMERIC_DATE, DateOrder, date_orders
from usbldr.io.messages.field_names import words_of
from usbldr.io.tables.time_columns import ISO
from usbldr.io.tables.time_parts import (
    CLOCK_PARTS,
    DAY_S,
    PARTS_NS,
    WEEK,
    as_text,
    moments_of,
    numbers,
    of_parts,
    of_weeks,
    parted_time,
    week_and_time,
)
from usbldr.io.tables.time_zones import GPS_TIME, in_named_zone, utc_of_gps
from usbldr.io.tables.unnamed_columns import is_number
from usbldr.io.units import named_unit

DATE = (
    r"\d{1,4}(?P<part>[./-])(\d{1,2}|[A-Za-z]{3,9})(?P=part)\d{2,4}|\d{1,2} [A-Za-z]{3,9} \d{4}"
    r"|[A-Za-z]{3,9} \d{1,2},? \d{4}"
)
CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d{1,9}|:\d{3})?)?( ?[AaPp][Mm])?"
ZONE = r"( ?(Z|UTC|GMT|[+-]\d{2}(:?\d{2})?( [A-Z]{3,4})?))?"
ALL_DIGITS = (
    r"(?P<year>(?:19|20)\d\d)(?:(?P<month>0[1-9]|1[0-2])(?P<day>[0-2]\d|3[01])|(?P<of_year>[0-2]\d\d|3[0-6]\d))"
    r"[T _]?(?P<hour>[01]\d|2[0-3])(?P<minute>[0-5]\d)(?P<second>[0-5]\d(?:[.,]\d{1,9})?)"
)
"""A date, or a year and a day of it, and a time of day without marks: 20260514T102000, 2026134102000.5."""
DATE_ONLY, CLOCK_ONLY = re.compile(DATE), re.compile(CLOCK)
DATE_TIME = re.compile(
    rf"({DATE})[T ,_]+{CLOCK}{ZONE}|{CLOCK}[ ,]+({DATE.replace('part', 'mark')})"
    rf"|\d{{4}}[-:/]\d{{3}}[-T:/ ]{CLOCK}{ZONE}|{ALL_DIGITS}{ZONE}|\d{{8}}[-T _]{CLOCK}{ZONE}"
)
DIGITS_THEN_CLOCK = re.compile(r"^(\d{4})(\d\d)(\d\d)[-T _](?=\d\d:)")
WHOLLY_DIGITS = re.compile(rf"^{ALL_DIGITS}(?![\d:])")
DAY_OF_YEAR = re.compile(r"^(\d{4})[-:/](\d{3})[-T:/ ]")
HOUR_24 = r"(?<![\d:.])24(?=:[0-5]\d)"
MILLISECONDS = r"(?<=:\d\d:\d\d):(?=\d{3})"
CLOCK_FIRST = re.compile(rf"^({CLOCK})[ ,]+(?=\d)(.+)$")
DIGITS_DATE = re.compile(r"((?:19|20)\d\d)(0[1-9]|1[0-2])([0-2]\d|3[01])")
SHORT_DATE = re.compile(r"(0?[1-9]|[12]\d|3[01])(0[1-9]|1[0-2])(\d\d)")  # as NMEA 0183 has it, day first
DIGITS_CLOCK = re.compile(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d(?:\.\d+)?)")
DATE_NAME = re.compile(r"(^|[\s_])(date|datum|day|ymd|yyyy)")
CLOCK_NAME = re.compile(r"(^|[\s_])(time|clock|utc|hh?mm)")
SECONDS_OF_DAY = re.compile(
    r"(^|[\s_])(sod|(seconds?|time)[\s_]of[\s_](the[\s_])?day|(ms|(milli)?seconds?|time)[\s_]since[\s_]midnight)"
)
ZONED = re.compile(r"(Z|UTC|GMT|:\d\d([.,]\d+)?[+-]\d\d(:?\d\d)?)$")  # the end of a cell that states its zone
WHOLE_SECONDS = re.compile(r"(\d{10}|\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:[.,]0*)?(Z|[+-]\d\d(?::?\d\d)?)?")
"""Dates and times, or Unix seconds: a column behind them may hold the part of the second."""
PART_OF_SECOND = re.compile(r"(?:.*_)?(milli|micro|nano)_?(?:sec(?:ond)?)?s?|ms(?:ec)?")
WHOLE_MINUTES, SECONDS = re.compile(r"(.*[ T])?\d{1,2}:\d\d"), re.compile(r"(.*_)?(seconds?|secs?|ss?)")
"""Times without seconds, and the name of a column behind them that may hold those."""
WORD = r"[^\W\d_]{2,10}"
MONTHS = (
    *("jan|ene|gen", "fe[bv]", "mar|maer|mrz|mrt|maa", "a[pvb]r", "ma[iyjg]|mei", "jun|juin|giu"),
    *("jul|juil|lug", "aug|aou|ago", "se[pt]", "o[cku]t|ott", "nov", "de[czs]|dic"),
)
"""How the months of a year begin in English and the languages of field_names, without accents."""
WEEKDAY = re.compile(rf"^{WORD}[.,]* +(?=({WORD}\.? +)?\d.*\d:\d\d)(?!\d+,? +\d+[ :])")  # not "May 18, 2026 12:30"
CTIME = re.compile(r"^(\w+) +(\d+) ([\d:.]+)( UTC| GMT)? (\d{4})$")  # "May 18 12:30:00 2026", as C writes it
MONTH_WORD = re.compile(rf"(?<=\d)(?:\.? (?:de )?|([-.]))({WORD})(?:\.? (?:de )?|\1)(?=\d{{4}}|\d\d(?!\d))")
PLACE_BEHIND = re.compile(r"((?<=Z)|(?<=[+-]\d\d:\d\d))\[[A-Z]\w+(/\w+)*\]$")  # of Java, behind the zone
WITH_DAYS = re.compile(rf"^(\d) days?,? (?={CLOCK}$)")  # "0 days 00:00:01.2", as pandas writes a duration
OWN_TIMES = ("time_ns", "received_ns")  # numbers; of another cell it is said what stands there
SHOWN_ROWS = 20  # [rows] by which the kind of a column is known
NUMBER = re.compile(r"\d+(\.\d*)?")


def foreign_time(cell: str) -> bool:
    """Return whether a cell is a date, a time of day or both, in another notation than ISO's."""
    plain = without_words(cell)
    whole = any(kind.fullmatch(plain) for kind in (DATE_ONLY, CLOCK_ONLY, DATE_TIME, DIGITS_DATE, ISO))
    return whole and not ISO.fullmatch(cell)


def without_words(cell: str) -> str:
    """Return a date and time without the words that add nothing to it, and with its month in English.

    "Montag, 18. Mai 2026 12:30:00" is 18 May 2026 12:30:00.
    """
    if not cell or (cell.isascii() and not any(map(str.isalpha, cell))):
        return cell
    plain = PLACE_BEHIND.sub("", WITH_DAYS.sub(lambda days: f"1970-01-0{int(days[1]) + 1} ", WEEKDAY.sub("", cell)))
    return CTIME.sub(r"\1 \2, \5 \3\4", MONTH_WORD.sub(_in_english, plain))


def _in_english(found: re.Match[str]) -> str:
    word = re.sub("[\u0300-\u036f]", "", normalize("NFKD", found[2].lower()))  # without accents
    month = next((k for k, begin in enumerate(MONTHS) if re.match(begin, word)), None)
    mark = found[1] or " "
    return found[0] if month is None else f"{mark}{month_abbr[month + 1]}{mark}"


def orders_of(tables: Iterable[Mapping[str, Sequence[str]]], stated: Mapping[str, str]) -> Mapping[str, DateOrder]:
    """Return separator -> how dates with it are read in all tables. ``stated``: column -> its format by strptime."""
    dates = [
        (name, cells)
        for columns in tables
        for name, cells in columns.items()
        if name not in stated and (_are(cells, DATE_TIME) or (_are(cells, DATE_ONLY) and _has_clock(columns)))
    ]
    return date_orders((cells for _, cells in dates), [*(name for name, _ in dates), *stated.values()])


def _has_clock(columns: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a table has times of day, which a column of dates belongs to."""
    return any(_are(cells, CLOCK_ONLY) or _of_day(name.lower(), cells) for name, cells in columns.items())


def with_iso_times(
    columns: Mapping[str, Sequence[str]],
    stated: Mapping[str, str] = MappingProxyType({}),
    orders: Mapping[str, DateOrder] = MappingProxyType({}),
    date: str = "",
) -> dict[str, Sequence[str]]:
    """Return the columns of a table with dates and times as ISO text; a column of dates goes into that of its times.

    ``stated``: column -> its format by strptime. ``orders``: of the dates in all tables, if there are others. ``date``:
    of the table, for times of day without one.
    """
    columns = {name: cells if name in stated else _without_words(cells) for name, cells in columns.items()}
    found = dict(columns)
    own = orders_of([columns], stated)
    orders = {**own, **{mark: order for mark, order in orders.items() if mark not in own or own[mark].example}}
    pair = week_and_time(columns)
    if pair and all(_are(columns[name], NUMBER) for name in pair) and _are(columns[pair[0]], WEEK):
        found[pair[1]] = of_weeks(*pair, columns)
    dates = [name for name, cells in columns.items() if _are(cells, DATE_ONLY)]
    of_digits = [(name, cells) for name, cells in columns.items() if DATE_NAME.search(name.lower())]
    dates += [name for name, cells in of_digits if _are(cells, DIGITS_DATE) or _are(cells, SHORT_DATE)]

    def on_days(clocks: Sequence[str], cells: Sequence[str]) -> list[str]:
        one = len(dates) == 1
        return _on_days(clocks, columns[dates[0]], cells, orders) if one else _without_date(clocks, orders, date)

    parts = parted_time(columns)
    if parts and all(_are(columns[name], NUMBER) for name in parts.values()):
        name = list(parts.values())[-1]
        found[name] = whole = of_parts(parts, columns)
        if not {*CLOCK_PARTS, "second_of_day"} & parts.keys() and any(
            _are(cells, CLOCK_ONLY) for cells in columns.values()
        ):
            dates, columns = [name], {**columns, name: [text[:10] for text in whole]}
        if "hour" in parts and "year" not in parts:
            found[name] = on_days([ISO.sub(r"\2.\3", text) for text in whole], whole)
    clocks = [name for name, cells in columns.items() if _are(cells, CLOCK_ONLY)]
    rounded = {name for name in clocks if _are(columns[name], WHOLE_MINUTES)}
    for name, cells in columns.items():
        if name in OWN_TIMES or (name in rounded and len(rounded) < len(clocks)):  # HH:MM beside HH:MM:SS
            continue
        if name in stated:
            found[name] = as_text(moments_of(cells, stated[name]), cells)
        elif _are(cells, DATE_TIME):
            found[name] = _iso(list(cells), cells, orders)
        elif not dates and clock_digits(name, next(iter(cells), "")) and (digits := _clocks_of_digits(cells)):
            found[name] = _without_date(digits, orders, date)
        elif _are(cells, CLOCK_ONLY) or ((len(dates) == 1 or date) and _of_day(name.lower(), cells)):
            found[name] = on_days(_clocks(name, cells), cells)
    names = [*columns, ""]
    for time, part, behind in zip(names, names[1:], names[2:], strict=False):
        label = words_of(re.sub(r"[\[(].*", "", part))
        of_ros2 = time.isdigit() and not is_number(next(iter(columns.get(behind, ())), "0"))  # unnamed, a frame behind
        if SECONDS.fullmatch(label) and _are(columns.get(time, ()), WHOLE_MINUTES) and _are(columns[part], NUMBER):
            minutes = moments_of(found[time], utc=False)
            found[time] = as_text(minutes + pd.to_timedelta(numbers(columns[part]), unit="s"), found[time])
        unit = PART_OF_SECOND.fullmatch("nano" if of_ros2 else label)
        if (
            unit
            and time not in OWN_TIMES
            and _are(found[time], WHOLE_SECONDS, or_iso=True)
            and _are(columns[part], NUMBER)
        ):
            found[time] = _with_parts(found[time], numbers(columns[part]) * PARTS_NS[f"{unit[1] or 'milli'}second"])
    for name in columns:
        if not any(map(ZONED.search, islice(iter(columns[name]), SHOWN_ROWS))):
            found[name] = in_named_zone(name, found[name])
        if GPS_TIME.search(name) and _are(found[name], ISO, or_iso=True):
            found[name] = utc_of_gps(found[name])
    return found


def _without_words(cells: Sequence[str]) -> Sequence[str]:
    """Return the cells of a column, those of times without words."""
    shown = [cell for cell in islice(iter(cells), SHOWN_ROWS) if cell]
    worded = any(without_words(cell) != cell and foreign_time(cell) for cell in shown)
    return [without_words(cell) for cell in cells] if worded else cells


def _with_parts(cells: Sequence[str], part_ns: Vector) -> list[str]:
    """Return the texts of times with fractions of a second added, (n,) in ns; a text is unchanged if it has none."""
    good = (part_ns >= 0) & (part_ns < 1e9)
    return [
        f"{whole[1]}.{round(ns):09d}{whole[2] or ''}" if known and (whole := WHOLE_SECONDS.fullmatch(cell)) else cell
        for cell, ns, known in zip(cells, part_ns, good, strict=True)
    ]


def of_times(names: Sequence[str]) -> set[str]:
    """Return the columns of dates, of weeks, and of other parts of times."""
    dates = {name for name in names if DATE_NAME.search(words_of(name))}
    return dates.union(parted_time(names).values(), week_and_time(names) or ())


def _of_day(name: str, cells: Sequence[str]) -> bool:
    return bool(SECONDS_OF_DAY.search(name) or (CLOCK_NAME.search(name) and _are(cells, DIGITS_CLOCK)))


def clock_digits(name: str, cell: str) -> bool:
    """Return whether a cell may be a time of day in digits, 235320.5, by its column's name, which states no unit."""
    return not named_unit(name).unit and bool(CLOCK_NAME.search(name.lower()) and DIGITS_CLOCK.fullmatch(cell))


def _clocks_of_digits(cells: Sequence[str]) -> list[str]:
    """Return times of day in digits, over a minute or more, with colons; empty if a number is no such time.

    Seconds would have reached 60 in the last two digits.
    """
    found = {cell: DIGITS_CLOCK.fullmatch(cell) for cell in cells}
    clocks = {cell: f"{clock[1]}:{clock[2]}:{clock[3]}" for cell, clock in found.items() if clock}
    others = any(NUMBER.fullmatch(cell) for cell in found.keys() - clocks.keys())
    return [clocks.get(cell, cell) for cell in cells] if not others and len({cell[:4] for cell in clocks}) > 1 else []


def _are(cells: Sequence[str], kind: re.Pattern[str], or_iso: bool = False) -> bool:
    """Return whether the first cells are of a kind, and of another than ISO's notation unless that may be, too."""
    shown = [cell for cell in islice(iter(cells), SHOWN_ROWS) if cell]
    return bool(shown) and all(kind.fullmatch(cell) and (or_iso or not ISO.fullmatch(cell)) for cell in shown)


def _clocks(name: str, cells: Sequence[str]) -> list[str]:
    """Return times of day in digits, or seconds or milliseconds of it, with colons."""
    if _are(cells, DIGITS_CLOCK) and not SECONDS_OF_DAY.search(name.lower()):
        return [DIGITS_CLOCK.sub(r"\1:\2:\3", cell) for cell in cells]
    thousands = 3 * bool(re.search(r"milli|\bms\b", name.lower()))
    return [_clock(cell, thousands) for cell in cells]


def _on_days(
    clocks: Sequence[str], dates: Sequence[str], cells: Sequence[str], orders: Mapping[str, DateOrder]
) -> list[str]:
    """Return times of day with their dates."""
    short = _are(dates, SHORT_DATE)
    if sum(map(bool, dates)) * 2 < len(dates):  # a spreadsheet's merged cells: the first row of a day has its date
        dates = pd.Series(list(dates), dtype="str").replace("", None).ffill().fillna("").tolist()
    days = [SHORT_DATE.sub(r"20\3-\2-\1", day) if short else DIGITS_DATE.sub(r"\1-\2-\3", day) for day in dates]
    return _iso([day and f"{day} {clock}" for day, clock in zip(days, clocks, strict=True)], cells, orders)


def _clock(cell: str, places: int) -> str:
    """Return parts of 1e-``places`` s of the day as hours, minutes and seconds; another text as it is."""
    if not NUMBER.fullmatch(cell) or not 0 <= Decimal(cell).scaleb(-places) < DAY_S:
        return cell
    whole, _, fraction = f"{Decimal(cell).scaleb(-places):f}".partition(".")
    minutes, second = divmod(int(whole), 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}.{fraction or '0'}"


def _without_date(cells: Sequence[str], orders: Mapping[str, DateOrder], date: str) -> list[str]:
    texts = _iso([f"{date or '1970-01-01'} {cell}" for cell in cells], cells, orders)
    moments = moments_of(texts)
    back = (moments.diff() < -pd.Timedelta(seconds=DAY_S / 2)).cumsum()
    later = (moments + pd.to_timedelta(back, unit="D")).dt.strftime("%Y-%m-%dT%H:%M:%S.%f")
    return [text if pd.isna(new) or not day else str(new) for text, new, day in zip(texts, later, back, strict=True)]


def _iso(texts: list[str], cells: Sequence[str], orders: Mapping[str, DateOrder]) -> list[str]:
    """Return dates and times as ISO text; the cell as it stands if it is none."""
    plain = pd.Series(texts, dtype="str").str.replace(WHOLLY_DIGITS, _of_digits, regex=True)
    plain = plain.str.replace(DIGITS_THEN_CLOCK, r"\1-\2-\3 ", regex=True)
    plain = plain.str.replace(DAY_OF_YEAR, _of_year, regex=True)
    plain = plain.str.replace(rf"(?<=\d),(?=\d)|{MILLISECONDS}", ".", regex=True)
    plain = plain.str.replace(CLOCK_FIRST, lambda found: f"{found.groups()[-1]} {found[1]}", regex=True)
    plain = plain.str.replace("_", " ", regex=False)
    zoned = plain.str.replace(r"(?<=[+-]\d{4}) [A-Z]{3,4}$", "", regex=True)  # Go: "+0200 CEST"
    zoned = zoned.str.replace(r" ?(UTC|GMT|Z)$", "+00:00", regex=True)
    mark = next((found[2] for found in map(NUMERIC_DATE.search, texts) if found), "")
    day_first = mark in orders and orders[mark].day_first
    late = zoned.str.contains(HOUR_24, regex=True).to_numpy(np.bool_)  # of the day before
    zoned = zoned.str.replace(HOUR_24, "00", regex=True)
    moments = pd.to_datetime(zoned, format="mixed", dayfirst=day_first, utc=True, errors="coerce")
    return as_text(moments + pd.to_timedelta(late.astype(int), unit="D"), cells)


def _of_digits(found: re.Match[str]) -> str:
    """Return a date and time without marks with them."""
    day = found["of_year"] or f"{found['month']}-{found['day']}"
    return f"{found['year']}-{day} {found['hour']}:{found['minute']}:{found['second']}"


def _of_year(found: re.Match[str]) -> str:
    """Return a year and a day of it as a date."""
    return f"{np.datetime64(found[1], 'D') + (int(found[2]) - 1)} "
