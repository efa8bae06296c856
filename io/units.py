"""Units that the name of a column or field states: "DVL X [m/s]", "Heading (deg)", "stamp_ns"."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from typing import Literal, NamedTuple, TypeAlias

Dimension: TypeAlias = Literal["velocity", "angle", "length", "pressure", "time"]

MPS_PER_UNIT: Mapping[str, float] = {
    "m/s": 1.0,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "km/h": 1 / 3.6,
    "ft/s": 0.3048,
    "knots": 1852 / 3600,
}
PASCALS_PER_UNIT: Mapping[str, float] = {"Pa": 1, "hPa": 100, "kPa": 1e3, "dbar": 1e4, "bar": 1e5, "psi": 6894.75729317}
DEG_PER_UNIT: Mapping[str, float] = {
    "deg": 1.0,
    "rad": 57.29577951308232,  # fixed: by definition
    "gon": 0.9,  # fixed: 400 a circle
    "mil": 0.05625,  # fixed: 6400 a circle
    "0.1deg": 0.1,
    "0.01deg": 0.01,
}
"""Units of headings."""

_UNITS: Mapping[Dimension, Mapping[str, float]] = {
    "velocity": MPS_PER_UNIT,
    "angle": {**DEG_PER_UNIT, "1e-7deg": 1e-7},
    "length": {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048},
    "pressure": PASCALS_PER_UNIT,
    "time": {"ns": 1, "us": 1000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60 * 10**9, "h": 3600 * 10**9},
}
"""Factors to m/s, degrees, metres, pascals and nanoseconds."""

_SPELLINGS: Mapping[str, str] = tomllib.loads((files("usbldr.io") / "units.toml").read_text(encoding="utf-8"))
"""Other spellings."""

_UNIT_OF: Mapping[str, str] = {
    spelling.lower(): unit
    for units in _UNITS.values()
    for unit in units
    for spelling in (unit, *_SPELLINGS.get(unit, "").split())
}
_FACTORS: Mapping[str, tuple[Dimension, float]] = {
    unit: (dimension, factor) for dimension, units in _UNITS.items() for unit, factor in units.items()
}
_TIME = r"(s|h)(?:ec|econds?|r|ours?)?"
_SINCE = re.compile(r" since (the )?((unix )?epoch|1970-0?1-0?1|0?1[/.]0?1[/.]1970)[t0:. ]*(z|utc|gmt)?")
"""Behind a unit of time: of which year the first moment is."""
_PER = re.compile(rf"([a-z]+)(?: ?/ ?| per ){_TIME}|([a-z]+?)[ .*·]?{_TIME}(?:(?:\^|\*\*)?-1|⁻¹)")
"""A length per time, also as UDUNITS and CF write it: "cm s-1", "km.h^-1", "metres per second"."""
_PREFIXES: Mapping[str, float] = {"d": 0.1, "c": 0.01, "m": 1e-3, "u": 1e-6, "µ": 1e-6}
_SCALED = re.compile(rf"(0?\.0*1|1e-\d)[*x]?([a-z°/]+)|([{''.join(_PREFIXES)}])(deg|rad)\w*")
"""A decimal part of a unit: "0.01 deg", and of angles also by a letter, "mrad" and "cdeg"."""
_LABELS = re.compile(r"(.*?)\s*\{([^{}]*[=:][^{}]*)\}\s*")
"""A name with the labels of a time series as Prometheus, Loki and Grafana write them: heading {vehicle="rov1"}."""
_NOTES = frozenset({"t", "true", "utc", "gmt", "wgs84", "wgs-84"})  # in brackets, in lower case: no unit
_NOTATION = re.compile(r"d{2,3}[ °:-]*m{1,2}.*|hhmm.*", re.IGNORECASE)
"""Of angles and times in parts: dd mm.mmm, ddmm.mmmm, hhmmss.ss."""
_NUMBER = r"(\d+(?:\.\d*)?)"
_ANGLE = re.compile(
    rf"([NSEW]?) *([+-]?){_NUMBER}(?: *([°º])T? *| +|[-:](?=\d)|(?=[NSW]|$))"
    rf"(?:{_NUMBER} *(?:['′:]|-(?=\d))? *)?(?:{_NUMBER} *(?:\"|″|'')? *)?([NSEW]?)",
    re.IGNORECASE,
)
"""Sides, degrees, minutes and seconds; "5E" is no angle, but half a number."""
_BRACKETS = re.compile(r"(.*[^\s_])[\s_]*[\[(]([^\[\]()]*[^\d\s\[\]()][^\[\]()]*)[\])]\s*")
_ZONE_BEHIND = re.compile(
    r"(.+?)\s*([\[(][^\[\]()]+[\])])[\s,]*((?:wgs\W?84\W*)?utm\b.*|utm\d.*|wgs\W?84)", re.IGNORECASE
)
"""A name with its grid behind the unit: Easting (m) UTM26N."""
_OF_R = re.compile(r"(.*[^.])\.\.([a-z]+(?:\.[a-z]+)?)\.", re.IGNORECASE)
"""A name with brackets as R's make.names() leaves it: Heading..deg."""
_ELEMENT = re.compile(r"(.*?)((?:\[\d+\]|\.\d+|\.[xyz])?)", re.DOTALL)
_ENDINGS = re.compile(r"(?<=.)(?:[_\s,]+|\.)(?=.)|(?<=[a-z])(?=[A-Z][a-z]+$)")
"""What parts a name from the unit that ends it: heading_deg, headingDeg; heading.deg of R."""
_FIELDS: Sequence[Dimension] = ("time", "pressure")  # behind a dot these are fields of messages: stamp.sec, euler.psi
_LONGEST_ENDING = 2  # words of a unit that ends a name: "mm_s"


class NamedUnit(NamedTuple):
    """A name without its unit, and that unit."""

    label: str
    unit: str = ""  # as written; empty: the name states none
    dimension: Dimension | None = None  # None: the unit is unknown
    factor: float = 1.0  # to usbldr's own unit


def _known(unit: str) -> tuple[Dimension, float] | None:
    """Return the dimension of a unit in any spelling, and its factor to usbldr's own one; None if it is unknown."""
    text = " ".join(unit.lower().split())
    text = text[: since.start()] if (since := _SINCE.search(text)) and since.end() == len(text) else text
    if per := _PER.fullmatch(text):
        length, time = filter(None, per.groups())
        text = f"{_UNIT_OF.get(length, length)}/{time}"
    text = text.replace(" ", "")
    if text in _UNIT_OF or not (scaled := _SCALED.fullmatch(text)):
        return _FACTORS.get(_UNIT_OF.get(text, ""))
    known = _known(scaled[2] or scaled[4])
    return known and (known[0], known[1] * (_PREFIXES[scaled[3]] if scaled[3] else float(scaled[1])))


def named_unit(name: str) -> NamedUnit:
    """Return what a name states: a unit in brackets, known or not, or a known one after its last "_", blank or comma.

    Of elements, the unit is that of the whole: "velocity_mm_s[0]", "velocity_mm_s.x".
    """
    if series := _LABELS.fullmatch(name):
        labels = dict(re.findall(r'(\w+)\s*[=:]\s*"?([^",]*)', series[2]))
        metric = labels.pop("__name__", series[1])
        return named_unit(" ".join([*labels.values(), metric]))
    if zone := _ZONE_BEHIND.fullmatch(name):
        return named_unit(f"{zone[1]} {zone[3]} {zone[2]}")
    brackets = _BRACKETS.fullmatch(name) or _OF_R.fullmatch(name)
    if brackets and (brackets[2].strip().lower() in _NOTES or _NOTATION.fullmatch(brackets[2])):
        return named_unit(brackets[1])
    if brackets:
        dimension, factor = _known(brackets[2]) or (None, 1.0)
        return NamedUnit(brackets[1], brackets[2].strip(), dimension, factor)
    parts = _ELEMENT.fullmatch(name)
    whole, element = parts.groups() if parts else (name, "")
    for ending in list(_ENDINGS.finditer(whole))[-_LONGEST_ENDING:]:
        unit = whole[ending.end() :]
        if (known := _known(unit)) and not (ending[0] == "." and known[0] in _FIELDS):
            return NamedUnit(whole[: ending.start()] + element, unit, *known)
    return NamedUnit(name)


def unit_of(cell: str) -> NamedUnit:
    """Return the text of a cell and the unit behind it: "0.2 sec"."""
    value, _, unit = cell.partition(" ")
    return named_unit(f"{value} [{unit}]") if unit else NamedUnit(cell)


def stated_degrees(text: str) -> float:
    """Return an angle with a side or a degree sign: "45 12.5 N", "W 5°30'18\""; raise ValueError if it is none."""
    angle = _ANGLE.fullmatch(text.replace(",", "."))
    if angle is None:
        raise ValueError
    before, sign, degrees, mark, minutes, seconds, behind = angle.groups("")
    side = (before + behind).upper()
    if len(side) > 1 or not (side or mark) or (side and sign):
        raise ValueError
    parts = float(minutes or 0), float(seconds or 0)
    if max(parts) > 60:  # programs write 59.9999 as 60.000
        raise ValueError
    size = float(degrees) + parts[0] / 60 + parts[1] / 3600
    return -size if sign == "-" or side in ("S", "W") else size


def states_degrees(text: str) -> bool:
    """Return whether a text is an angle with a side or a degree sign."""
    with suppress(ValueError):
        stated_degrees(text)
        return True
    return False


def spellings(dimension: Dimension) -> str:
    """Return the units of a dimension as a text."""
    return ", ".join(_UNITS[dimension])
