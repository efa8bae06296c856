"""Whether the day or the month comes first in dates like 05/06/2026: one answer for all tables of a log.

What decides, in this order: a date with one reading only, a notation that a name, a unit or ``time_format`` states
("dd/mm/yyyy"), the reading under which the dates have the shorter span, and else what is usual.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import date
from typing import NamedTuple

from usbldr.io.findings import Finding

NUMERIC_DATE = re.compile(r"(?<![\d./:-])(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d\d)(?![\d./-])")
STATED = {True: r"(^|[^a-z])dd?[./_ -]?mm?[./_ -]?y", False: r"(^|[^a-z])mm?[./_ -]?dd?[./_ -]?y"}
"""Day first -> the notation in lower case."""
DAY_FIRST = {".": True, "-": True, "/": False}
"""What is usual, by the separator."""
CENTURY = 2000  # fixed: of years of two digits


class DateOrder(NamedTuple):
    """How the dates with one separator are read."""

    day_first: bool
    example: str = ""  # a date that has two readings; empty: none has
    why: str = ""  # empty: nothing decided

    def finding(self, log: str, remedy: str = "state time_format") -> Finding:
        """Return what is said of a log whose days and months could be exchanged, and what to do."""
        other, taken = (_day(self.example, first) for first in (not self.day_first, self.day_first))
        text = f"{log}: {self.example} is read as {taken}, and not as {other}"
        if self.why:
            return Finding("DATE-ORDER", f"{text}: {self.why}; {remedy} if it is wrong")
        return Finding("DATE-AMBIGUOUS", f"{text}; nothing in the log decides this: {remedy}")


def stated_order(text: str) -> bool | None:
    """Return whether a notation such as dd/mm/yyyy or %d/%m/%Y has the day first, None if a text holds none."""
    plain = text.lower().replace("%", "")
    return next((first for first, notation in STATED.items() if re.search(notation, plain)), None)


def date_orders(columns: Iterable[Sequence[str]], notations: Iterable[str] = ()) -> Mapping[str, DateOrder]:
    """Return separator -> how dates with it are read, from columns of dates and texts that may state a notation."""
    dates: dict[str, dict[str, None]] = {}
    for cells in columns:
        for found in filter(None, map(NUMERIC_DATE.search, cells)):
            dates.setdefault(found[2], {})[found[0]] = None
    stated = next((first for first in map(stated_order, notations) if first is not None), None)
    return {separator: _order(list(texts), DAY_FIRST[separator], stated) for separator, texts in dates.items()}


def _order(texts: Sequence[str], usual: bool, stated: bool | None) -> DateOrder:
    days = {first: [_day(text, first) for text in texts] for first in (True, False)}
    pairs = list(zip(days[True], days[False], strict=True))
    if any(bool(day) != bool(month) for day, month in pairs):  # then it has one reading
        return DateOrder(any(day and not month for day, month in pairs))
    example = next((text for text, (day, month) in zip(texts, pairs, strict=True) if day != month), "")
    if stated is not None:
        return DateOrder(stated, example, "a name, a unit or time_format states it")
    spans = {first: (max(known) - min(known)).days for first, d in days.items() if (known := list(filter(None, d)))}
    if len(set(spans.values())) == 2:
        shorter = spans[True] < spans[False]
        return DateOrder(shorter, example, f"so the dates span {spans[shorter]} instead of {spans[not shorter]} days")
    return DateOrder(usual, example, "the day is usually first between points" if "." in example else "")


def _day(text: str, day_first: bool) -> date | None:
    """Return a date under one reading, None if there is no such day."""
    if found := NUMERIC_DATE.fullmatch(text):
        first, second, year = (int(found[k]) for k in (1, 3, 4))
        with suppress(ValueError):
            return date(year + CENTURY * (year < 100), *((second, first) if day_first else (first, second)))
    return None
