"""Times of validity and log times of NMEA sentences: integer nanoseconds since 1970, UTC.

A sentence holds the time of day. Its date is that of the log time, or of a sentence with a date if nothing else is
known; around midnight it is the date that brings both within half a day.
"""

import re
from collections.abc import Sequence
from datetime import date, datetime

import numpy as np

from usbldr.filters.types import Indices
from usbldr.io.reader import Nanoseconds

SECOND = 1_000_000_000  # fixed: nanoseconds
DAY = 86_400 * SECOND  # fixed
NO_TIME = int(np.iinfo(np.int64).min)  # fixed: a sentence holds no time
CENTURY = 946_684_800 * SECOND  # fixed: the year 2000
LONGEST_GAP_NS = 30 * DAY  # a longer one within a log is no silence of the receiver: its clock was set
SILENCE = 10  # times the usual gap: a longer one says nothing of how far sentences are apart
LATEST = 230 * 366 * DAY  # [ns] digits beyond 2200, or before 1970, are not a date

ISO = re.compile(
    r"(\d{4})[-/](\d\d)[-/](\d\d)[T _,;]+(\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?\s*(Z|[+-]\d\d:?\d\d)?", re.ASCII
)
DAY_FIRST = re.compile(r"(?<!\d)(\d\d)\.(\d\d)\.(\d{4})(?=[T _,;]+\d\d:)", re.ASCII)
SLASHED = re.compile(r"(?<!\d)(\d\d?)/(\d\d?)/(\d{4})(?=[T _,;]+\d\d:)", re.ASCII)
"""A date with the day or the month first, before a time of day."""
CLOCK = re.compile(r"(?<![\d.:])(\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?(?![\d:])", re.ASCII)
EPOCH = re.compile(
    r"(?:(?<![A-Za-z\d.:])|(?<=[\\,]c:))(?:(\d{9,10})(?:\.(\d{1,9}))?|(\d{13})|(\d{16})|(\d{18,19}))(?!:?\d)", re.ASCII
)
"""Digits behind a letter are a serial number, those behind "c:" the time of a tag block of NMEA 4."""


def prefixed_ns(prefix: str, day_first: bool | None = None) -> int:
    """Return the log time before a sentence, NO_TIME without one.

    It is as in ISO 8601 or 31.12.2025 12:00:00, or s, ms, us, ns since 1970 that are a time of this century; or
    12/31/2025 12:00:00, if it is known whether the day is first.
    """
    if len(prefix) < 9:
        return NO_TIME
    if day_first is not None:
        day, month = (1, 2) if day_first else (2, 1)
        prefix = SLASHED.sub(lambda date: f"{date[3]}-{date[month]:0>2}-{date[day]:0>2}", prefix)
    iso = ISO.search(DAY_FIRST.sub(r"\3-\2-\1", prefix))
    if iso:
        *parts, fraction, zone = iso.groups()
        try:
            moment = datetime.fromisoformat("{}-{}-{}T{}:{}:{}".format(*parts) + (zone or "Z"))
        except ValueError:
            return NO_TIME
        return _plausible_date(int(moment.timestamp()) * SECOND + _fraction_ns(fraction))
    epoch = EPOCH.search(prefix)
    if epoch is None:
        return NO_TIME
    seconds, fraction, ms, us, ns = epoch.groups()
    whole_ns = int(seconds) * SECOND if seconds else int(ms) * 1_000_000 if ms else int(us) * 1000 if us else int(ns)
    return _plausible_date(whole_ns + _fraction_ns(fraction)) if whole_ns >= CENTURY else NO_TIME


def prefixed_clock_ns(prefix: str) -> int:
    """Return the time of day before a sentence, NO_TIME without one: [12:00:00.100]."""
    clock = CLOCK.search(prefix)
    return NO_TIME if clock is None else time_of_day_ns("{}{}{}.{}".format(*clock.groups("0")))


def _plausible_date(time_ns: int) -> int:
    return time_ns if 0 <= time_ns < LATEST else NO_TIME


def _fraction_ns(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0"))


def time_of_day_ns(text: str) -> int:
    """Return nanoseconds since midnight of hhmmss.ss, NO_TIME if it is none."""
    whole, _, fraction = text.partition(".")
    if len(whole) != 6 or not whole.isdecimal() or not (fraction + "0").isdecimal():
        return NO_TIME
    hour, minute, second = int(whole[:2]), int(whole[2:4]), int(whole[4:])
    if hour > 23 or minute > 59 or second > 60:  # 60: a leap second
        return NO_TIME
    return (hour * 3600 + minute * 60 + second) * SECOND + _fraction_ns(fraction[:9])


def date_ns(parts: Sequence[str]) -> int:
    """Return midnight of a date, NO_TIME if it is none: day, month, year, or one ddmmyy."""
    if len(parts) == 1:
        (text,) = parts
        century = 1900 if text[4:] >= "80" else 2000  # GPS began in 1980
        parts = (text[:2], text[2:4], str(century + int(text[4:])) if text[4:].isdecimal() else "")
    try:
        day, month, year = map(int, parts)
        return _plausible_date((date(year, month, day) - date(1970, 1, 1)).days * DAY)
    except ValueError:
        return NO_TIME


def on_nearest_date(time_of_day: Nanoseconds, near_ns: Nanoseconds) -> Nanoseconds:
    """Return times of day (n,) on the date that brings them within half a day of ``near_ns``; NO_TIME stays."""
    midnight = near_ns - near_ns % DAY
    away = time_of_day - near_ns % DAY
    days = np.where(away > DAY // 2, -1, np.where(away < -DAY // 2, 1, 0))
    return np.where(time_of_day == NO_TIME, NO_TIME, midnight + days * DAY + time_of_day)


def times_from_sentences(time_of_day: Nanoseconds, midnight: Nanoseconds) -> tuple[Nanoseconds, bool]:
    """Return log times (n,) of sentences without a log time, and whether any holds a date.

    A sentence with a time of day uses it, on the date of the nearest sentence that holds one; from there on, midnight
    passes if the time of day jumps back by more than half a day. So dates that go back are those of the log. The other
    sentences are spaced evenly between; before the first, after the last and up to a step of the clock, as far apart as
    the mean. ``midnight`` (n,) is NO_TIME if a sentence holds no date. Raises ValueError if no sentence holds a time.
    """
    timed = np.flatnonzero(time_of_day != NO_TIME)
    if not len(timed):
        raise ValueError("no sentence holds a time")
    day = time_of_day[timed]
    jumps = np.diff(day)
    days = np.concatenate([[0], np.cumsum(np.where(jumps < -DAY // 2, 1, np.where(jumps > DAY // 2, -1, 0)))])
    running = day + days * DAY
    dated = np.flatnonzero(midnight[timed] != NO_TIME)
    if len(dated):
        nearest = _nearest(running, dated)
        running = running + midnight[timed][nearest] - days[nearest] * DAY
    first = int(running[0])
    since = (running - first).astype(np.float64)
    gaps = np.diff(since)
    steps = np.flatnonzero((gaps < 0) | (gaps > LONGEST_GAP_NS))
    usual_ns = np.median(gaps[gaps > 0]) if np.any(gaps > 0) else 0
    steady = (gaps >= 0) & (gaps <= SILENCE * usual_ns)
    mean_ns = np.sum(gaps[steady]) / max(1, np.sum(np.diff(timed)[steady]))
    ends = timed[steps + 1] - 0.5  # of what comes before a step
    before_step = since[steps] + (ends - timed[steps]) * mean_ns
    lines = np.arange(len(time_of_day))
    outside = np.minimum(lines - timed[0], 0) + np.maximum(lines - timed[-1], 0)
    known = np.insert(timed.astype(np.float64), steps + 1, ends), np.insert(since, steps + 1, before_step)
    received = np.rint(np.interp(lines, *known) + outside * mean_ns).astype(np.int64)
    received[timed] = running - first  # these exactly
    return received + first, bool(len(dated))


def _nearest(times: Nanoseconds, some: Indices) -> Indices:
    """Return of each row (n,) that of ``some`` rows before or behind it whose time is nearer."""
    rows = np.arange(len(times))
    before = some[np.maximum(np.searchsorted(some, rows, side="right") - 1, 0)]
    behind = some[np.minimum(np.searchsorted(some, rows), len(some) - 1)]
    return np.where(np.abs(times - times[behind]) < np.abs(times - times[before]), behind, before)
