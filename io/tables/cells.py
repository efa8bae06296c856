"""The cells of a column as integer nanoseconds, numbers or angles, and the rows whose cells are none."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from itertools import islice
from typing import NamedTuple, TypeVar

import numpy as np

from usbldr.io.messages.field_names import named_column
from usbldr.io.reader import MAX_TIME_NS, Column
from usbldr.io.tables.text_table import MAX_CHARACTERS, Cells
from usbldr.io.tables.time_columns import ISO, SECOND_NS
from usbldr.io.units import stated_degrees, unit_of

NO_VALUE = re.compile(
    r"|[-*?]+([.:][-*?]+)*|\\n|<?n/?a>?|\(?null\)?|none|nil|nat|no[ _]?(data|value|fix)|missing|invalid|undefined|"
    r"#[\w/]+[!?]?|[+-]?nan(\(\w*\))?|[+-]?1\.#\w+",  # errors of spreadsheets; of printf by glibc, and by Microsoft
    re.IGNORECASE,
)
"""What programs write for no number."""
WORDS: Mapping[str, str] = {"true": "1", "false": "0"}
THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([., '\xa0\u202f])\d{3})(?:\1\d{3})*(?!\1)[.,]\d+")
"""A number whose thousands are parted by another character than its decimals."""
GROUPED, UNGROUPED = re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}"), re.compile(r"[+-]?[1-9]\d{0,2}")
"""Numbers as they are if points part thousands."""
DOUBLE = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d+$)")
"""The letter before an exponent as Fortran writes it: 1.5D+03."""
PART_OF_ANGLE = re.compile(r"(.+?)[\s_.(\[]+(deg|min|sec)[a-z]*[)\]]?", re.IGNORECASE)
"""The name of a column of degrees, minutes or seconds: "Lat Min"."""
Number = TypeVar("Number", int, float)


class ParsedColumn(NamedTuple):
    """The values of a column."""

    values: Column  # (n,)
    faults: Mapping[int, str]  # row -> what is wrong with its cell; its value means nothing


def times(texts: Sequence[str], name: str, unit_ns: int = 1, at_1970: float = 0) -> ParsedColumn:
    """Return a column of times in a unit, with decimals, or of dates and times, as nanoseconds since 1970.

    Those in nanoseconds are whole numbers. ``at_1970``: that moment in the unit. Exact: 1474477150.374442 is not
    representable in float64.
    """

    known = texts.times(unit_ns, at_1970, MAX_TIME_NS) if isinstance(texts, Cells) else None
    if known is not None:
        values, bad = known
        cell = next(islice(texts, bad[0], None)) if bad else ""
        return ParsedColumn(values, dict.fromkeys(bad, f'{name} is "{cell}", no time before 2116 in its unit'))

    def exact(text: str) -> int:
        if unit_ns == 1:
            return _in_range(int(text))
        if ISO.fullmatch(text):
            return _in_range(_iso_ns(text))
        if (unit := unit_of(text)).unit:  # "0.2 sec", as MATLAB writes durations
            if unit.dimension != "time" or unit.factor != unit_ns:
                raise ValueError
            text = unit.label
        return _in_range(int(((Decimal(DOUBLE.sub("e", text)) - Decimal(at_1970)) * unit_ns).to_integral_value()))

    whats = {1: "a whole number of nanoseconds", SECOND_NS: "a number of seconds before 2116"}
    return _parsed(texts, name, exact, 0, whats.get(unit_ns, "a number or a date and time"))


def numbers(texts: Sequence[str], name: str, by_commas: bool = True) -> ParsedColumn:
    """Return a column of numbers; an empty cell, and a word such as NA, is NaN, True and False are 1 and 0.

    ``by_commas``: commas part the columns; else all cells are faults if their points may part thousands.
    """
    if isinstance(texts, Cells) and (known := texts.numbers()) is not None:
        return ParsedColumn(known, {})
    if not by_commas and (unclear := _unclear_points(texts)):
        text = f"{name} holds {unclear}: is that a thousands separator or a decimal point? Write all numbers alike"
        return ParsedColumn(np.full(len(texts), np.nan), dict.fromkeys(range(len(texts)), text))

    def number(text: str) -> float:
        text = text.replace("\u2212", "-")  # a minus sign as typographers have it
        try:
            value = float("nan" if NO_VALUE.fullmatch(text) else WORDS.get(text.lower(), text))
        except ValueError:
            if THOUSANDS.fullmatch(text):
                whole, _, decimals = text.replace(",", ".").rpartition(".")
                return float(re.sub(r"[^\d+-]", "", whole) + "." + decimals)
            if DOUBLE.search(text):
                return float(DOUBLE.sub("e", text))
            if (unit := unit_of(text))[2:] == own:
                return float(unit.label) * factor
            return stated_degrees(text[:-1] + " E" if sided and text[-1:] in "Ee" else text)
        if factor != 1 and not math.isnan(value):
            raise ValueError  # other cells state their unit, and this one may have another
        return value

    column = named_column(name)
    unit = unit_of(next(filter(None, texts), "")) if column and not column.unit.unit else None  # "995.6 mm/s"
    factor = unit.factor if unit and column and unit.dimension == column.rule.dimension else 1.0
    own = (column.rule.dimension, factor) if column and column.unit.factor == 1 else ()  # "1.5 m/s", as of Grafana
    sided = len(texts) > 1 and all(text[-1:].upper() in ("", "E", "W") for text in texts)  # "5E" is else half a number

    return _parsed(texts, name, number, float("nan"), "a number")


def with_whole_angles(columns: Mapping[str, Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the columns of a table, with the minutes and seconds of latitudes and longitudes beside their degrees."""
    parts: dict[str, dict[str, str]] = {}
    for name in columns:
        if part := PART_OF_ANGLE.fullmatch(name):
            parts.setdefault(part[1].lower(), {})[part[2].lower()] = name
    whole = dict(columns)
    for label, names in parts.items():
        column = named_column(f"{label} [deg]")
        if column and column.rule.key in ("lat_deg", "lon_deg") and names.keys() >= {"deg", "min"}:
            cells = zip(*(columns[names[part]] for part in ("deg", "min", "sec") if part in names), strict=True)
            whole[names["deg"]] = [degrees and f"{degrees}°{' '.join(rest)}" for degrees, *rest in cells]
    return whole


def _unclear_points(texts: Sequence[str]) -> str:
    """Return two cells that show that points may part thousands, empty if they do not: 1.170 beside 788."""
    grouped, ungrouped = "", set[str]()
    for text in texts:
        if GROUPED.fullmatch(text):
            grouped = grouped or text
        elif UNGROUPED.fullmatch(text):
            ungrouped.add(text)
        elif text not in ("", "0"):
            return ""
    return f'"{grouped}" and "{min(ungrouped)}"' if grouped and len(ungrouped) > 1 else ""  # one may mean no data


def _parsed(
    texts: Sequence[str], name: str, parse: Callable[[str], Number], unknown: Number, what: str
) -> ParsedColumn:
    faults: dict[int, str] = {}

    def values() -> Iterator[Number]:
        for row, text in enumerate(texts):
            value = unknown
            try:
                if "_" in text:  # which Python takes for part of a number
                    raise ValueError
                value = parse(text)
            except (InvalidOperation, ValueError, OverflowError):
                faults[row] = f'{name} is "{text[:MAX_CHARACTERS]}", not {what}'
            yield value

    kind = np.int64 if isinstance(unknown, int) else np.float64
    return ParsedColumn(np.fromiter(values(), dtype=kind, count=len(texts)), faults)


def _in_range(time_ns: int) -> int:
    """Return a time; raise OverflowError if differences of such times would exceed 64 bits."""
    if abs(time_ns) >= MAX_TIME_NS:
        raise OverflowError
    return time_ns


def _iso_ns(text: str) -> int:
    """Return a date and time as nanoseconds since 1970; without a zone it is UTC."""
    match = ISO.fullmatch(text)
    assert match is not None
    date, clock, fraction, zone = match.groups()
    moment = datetime.fromisoformat(f"{date}T{clock}{zone or 'Z'}")
    return int(moment.timestamp()) * 1_000_000_000 + int((fraction or "").ljust(9, "0"))
