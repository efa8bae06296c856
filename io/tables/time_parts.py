"""Times that several columns make up, as ISO text: year, month, day, hour; a GPS week and a time of the week."""

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from usbldr.filters.types import Mask, Vector
from usbldr.io.gps_time import LAST_WEEK, WEEK_S, utc_ns
from usbldr.io.messages.field_names import TIME_OF_WEEK, words_of
from usbldr.io.reader import Nanoseconds
from usbldr.io.units import named_unit

WEEK = re.compile(r"[1-5]\d{3}(\.0*)?")
WEEK_NAME, TIME_OF_WEEK_NAME = r"(^|_)(gps_?)?(week|wk|wn)(_?(no|num|number))?$", rf"(^|_)({TIME_OF_WEEK})$|^seconds$"
PARTS: Mapping[str, str] = {
    "year": "(?<!of_)year|yr|yyyy",
    "month": "month|mon|^mo",
    "day": "day|day_of_month|^da",
    "day_of_year": "doy|day_of_year|year_?day|julian_day|jday|yday",
    "hour": "hours?|hr|^hh|h",
    "minute": "minutes?|mins?|^mm",
    "second": "(?<!milli_)(?<!micro_)(?<!nano_)(seconds?|secs?|s)|^ss",
    "second_of_day": r"sod|seconds?_of_(the_)?day",
    "nanosecond": "nano(_?sec(ond)?)?s?|nsecs?",
    "microsecond": "micro(_?sec(ond)?)?s?|usecs?",
    "millisecond": "milli(_?sec(ond)?)?s?|msecs?|^ms",
    "hundredth": "^hh_100|hundredths?|hsecs?|centi_?sec(ond)?s?",
}
"""Parts of a time that have a column each, and the names of these."""
DATES = ("year", "month", "day"), ("year", "day_of_year")
PARTS_NS = {"nanosecond": 1, "microsecond": 1000, "millisecond": 1_000_000, "hundredth": 10_000_000}  # fixed
CLOCK_PARTS = ("hour", "minute", "second")
CLOCKS = *((part, *CLOCK_PARTS) for part in PARTS_NS), CLOCK_PARTS, ("second_of_day",)
PARTED: Sequence[Sequence[str]] = (
    *((*d, *c) for d in DATES for c in CLOCKS),
    *CLOCKS[:-1],  # beside a column of dates
    *DATES,  # beside a column of times of day
    ("nanosecond", "second"),
    ("microsecond", "second"),
)
"""The parts of a whole time, whose days may have decimals. The last one's column becomes that of the time."""
DAY_S = 86400  # fixed
CENTURY = 2000  # fixed: years that are within 100 of it are some


def week_and_time(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the columns of the GPS week and of the time of the week, None if there is not one of each."""
    words = {name: words_of(named_unit(name).label) for name in names}
    times = [name for name, word in words.items() if re.search(TIME_OF_WEEK_NAME, word)]
    weeks = [name for name, word in words.items() if re.search(WEEK_NAME, word) and name not in times]
    return (weeks[0], times[0]) if len(weeks) == len(times) == 1 else None


def parted_time(names: Iterable[str]) -> Mapping[str, str]:
    """Return part -> column of a time that several columns make up, empty if there are none, or several of a part."""
    words = {name: words_of(re.sub(r"[\[(].*", "", name)) for name in names}
    found = {
        part: [name for name, word in words.items() if re.search(f"(^|_)({kind})$", word)]
        for part, kind in PARTS.items()
    }
    whole = next((parts for parts in PARTED if all(len(found[part]) == 1 for part in parts)), ())
    return {part: found[part][0] for part in whole}


def of_parts(parts: Mapping[str, str], columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Return times that several columns make up as ISO text."""
    value = {p: numbers(columns[name]) for p, name in parts.items()}
    if "year" in value:  # which some write as 26
        value["year"] = value["year"] + CENTURY * (value["year"] < 100)
    good = (np.abs(sum(value.values())) < 1e12) & (np.abs(value.get("year", np.array(CENTURY)) - CENTURY) < 100)
    whole = {p: np.where(good, numbers, 1).astype(np.int64) for p, numbers in value.items()}
    month = (whole.get("year", 1970) - np.int64(1970)) * 12 + whole.get("month", 1) - 1
    day = month.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    day += whole.get("day", whole.get("day_of_year", 1)) - 1
    units_ns = {"hour": 3600e9, "minute": 60e9, "second": 1e9, "second_of_day": 1e9, **PARTS_NS}
    rounded = [np.round(value.get("day_of_year", np.zeros(1)) % 1 * DAY_S * 1e9)]
    rounded += [np.round(value[p] * unit_ns) for p, unit_ns in units_ns.items() if p in parts]
    ns = day * (DAY_S * 10**9) + sum(np.where(good, part, 0).astype(np.int64) for part in rounded)
    return moments_text(ns, good, columns[list(parts.values())[-1]])


def numbers(cells: Sequence[str]) -> Vector:
    """Return cells as numbers, (n,); NaN if one is none."""
    return pd.to_numeric(pd.Series(list(cells), dtype="str"), errors="coerce").to_numpy(float)


def moments_of(texts: Sequence[str], form: str = "ISO8601", utc: bool = True) -> "pd.Series[pd.Timestamp]":
    """Return texts of a form, by strptime, as moments, (n,); NaT if one is none."""
    return pd.to_datetime(pd.Series(list(texts), dtype="str"), format=form, utc=utc, errors="coerce")


def moments_text(ns: Nanoseconds, good: Mask, cells: Sequence[str]) -> list[str]:
    """Return Unix times, (n,), as ISO text; a cell that is not ``good``, (n,), as it is."""
    return as_text(pd.Series(pd.to_datetime(ns, utc=True)).where(pd.Series(good)), cells)


def of_weeks(week: str, time: str, columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Return times of the week as ISO text; in seconds, or the unit of their name, or milliseconds by their size."""
    weeks, times = (numbers(columns[name]) for name in (week, time))
    unit = named_unit(time)
    seconds = times * (unit.factor / 1e9 if unit.dimension == "time" else 1.0 if np.nanmax(times) <= WEEK_S else 1e-3)
    good = np.isfinite(weeks + seconds) & (weeks < LAST_WEEK) & (np.abs(seconds) <= WEEK_S)
    ns = utc_ns(np.where(good, weeks, 0).astype(np.int64), np.where(good, seconds, 0.0))
    return moments_text(ns, good, columns[time])


def as_text(moments: "pd.Series[pd.Timestamp]", cells: Sequence[str]) -> list[str]:
    """Return moments, (n,), as ISO text; a cell that is none as it is."""
    iso = moments.dt.strftime("%Y-%m-%dT%H:%M:%S.%f").to_numpy(dtype=object)
    known = moments.notna().to_numpy(dtype=np.bool_)
    return [str(new) if good else old for new, good, old in zip(iso, known, cells, strict=True)]
