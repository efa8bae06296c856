"""The NMEA 0183 sentences that are understood, and the quantities in each: degrees and metres.

sentences/*.toml lists them, a file for each maker. pynmeagps parses them all; it knows the fields of the standard's
sentences, those of vendors' own are in the files, by their manuals. If a field of a sentence decides what the others
mean, it is of several kinds, named with that field: PSIMSSB_C_H is Cartesian and head up, PTSAG_ship holds the position
of the ship itself.
"""

import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias, cast

import msgspec

SentenceValues: TypeAlias = tuple[float | str, ...]
Value: TypeAlias = Callable[[Any], float | str]
"""From a sentence, as pynmeagps parsed it, to the value of a column; AttributeError if a text is missing."""


@dataclass(frozen=True, slots=True)
class SentenceKind:
    """The fields of one kind of sentence, or of several that are alike."""

    names: tuple[str, ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict[str, str])  # -> field, or what is made of fields (_value)
    fields: str = ""  # name:type of pynmeagps, a name alone is text; for sentences that it does not know
    invalid: Mapping[str, str] = field(default_factory=dict[str, str])  # field -> the pattern of what is no fix
    time: int | None = None  # which field is the time of day, hhmmss.ss, or ends in it
    date: tuple[int, ...] = ()  # which fields are day, month and year, or the one that is or begins with ddmmyy
    no_fix: tuple[int, str] | None = None  # which field says that a receiver has no fix, and by which letters

    def has_fix(self, fields: Sequence[str]) -> bool | None:
        """Return whether the receiver has a fix, and so the time; None if this kind does not say."""
        if self.no_fix is None:
            return None
        place, letters = self.no_fix
        return place >= len(fields) or fields[place].strip(letters) != ""


def _kinds() -> Iterator[tuple[str, SentenceKind]]:
    folder = Path(str(files("usbldr.io.decoding"))) / "sentences"
    for file in sorted(folder.glob("*.toml")):
        listed = tomllib.loads(file.read_text(encoding="utf-8"))["sentence"]
        for kind in msgspec.convert(listed, tuple[SentenceKind, ...]):
            yield from ((name, kind) for name in kind.names)


SENTENCE_KINDS: Mapping[str, SentenceKind] = dict(_kinds())
"""By name."""
UNKNOWN = SentenceKind()
QUALITIES: Mapping[str, float] = {letter: float(quality) for quality, letter in enumerate("NADPRFEMS")}
"""Qualities of GGA by the letters of other sentences."""
ESTIMATED_QUALITIES = (6.0, 7.0, 8.0)  # fixed: dead reckoning, manual input, simulator
SIGNS: Mapping[str, float] = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}


def _number(m: Any, name: str) -> float:
    """Return a field, NaN if it is empty or missing."""
    value = getattr(m, name, "")
    return math.nan if value == "" else float(value)


def in_hemisphere(degrees: float, letter: str) -> float:
    """Return degrees with the sign of N, S, E or W; NaN without such a letter."""
    return abs(degrees) * SIGNS.get(letter.strip().upper(), math.nan)


def _quality_by_status(m: Any) -> float:
    """Return the quality by a status (A or V), and since NMEA 2.3 a mode."""
    return QUALITIES.get(getattr(m, "posMode", ""), 1.0) if getattr(m, "status", "A") == "A" else 0.0


def _quality_by_systems(m: Any) -> float:
    """Return the quality by a mode for each satellite system: one that measures is enough."""
    modes = [QUALITIES.get(letter, 1.0) for letter in m.posMode] or [0.0]
    return min((mode for mode in modes if mode not in (0.0, *ESTIMATED_QUALITIES)), default=max(modes))


def _corrected(m: Any) -> float:
    """Return a magnetic heading with deviation and variation (positive to the east)."""
    heading = _number(m, "headingM")
    for name in ("deviation", "variation"):
        angle = _number(m, name)
        if not math.isnan(angle):
            heading += -angle if getattr(m, f"{name}EW") == "W" else angle
    return heading


def _ellipse(m: Any) -> tuple[float, float, float]:
    """Return the covariance of east and north, m^2; the major axis is clockwise from north."""
    a, b, direction = _number(m, "major") ** 2, _number(m, "minor") ** 2, math.radians(_number(m, "direction"))
    s, c = math.sin(direction), math.cos(direction)
    return a * s * s + b * c * c, (a - b) * s * c, a * c * c + b * s * s


CALCULATED: Mapping[str, Value] = {
    "quality by status": _quality_by_status,
    "quality by systems": _quality_by_systems,
    "corrected heading": _corrected,
    "1 if variation": lambda m: 0.0 if math.isnan(_number(m, "variation")) else 1.0,
    "heading unless V": lambda m: math.nan if getattr(m, "mi", "A") == "V" else _number(m, "headt"),
    "-1 if accuracy is negative": lambda m: -1.0 if _number(m, "accuracy") < 0 else 0.0,
    "ellipse xx": lambda m: _ellipse(m)[0],
    "ellipse xy": lambda m: _ellipse(m)[1],
    "ellipse yy": lambda m: _ellipse(m)[2],
}
"""What is made of the fields of few sentences, by the name that the files call it."""


def _value(known: SentenceKind, column: str) -> Value:
    """Return what reads a column: a field, "lat NS" with its side, "x [rad]" in degrees, or what CALCULATED has.

    "-1 if invalid" and "-1 if quality is 0" are those of no fix.
    """
    source = known.columns[column]
    name, _, behind = source.partition(" ")
    if source in CALCULATED:
        return CALCULATED[source]
    if source == "-1 if invalid":
        patterns = [(name, re.compile(pattern)) for name, pattern in known.invalid.items()]
        return lambda m: -1.0 if any(no_fix.fullmatch(getattr(m, name)) for name, no_fix in patterns) else 0.0
    if source == "-1 if quality is 0":
        quality = cast("Callable[[Any], float]", _value(known, "quality"))
        return lambda m: 0.0 if quality(m) > 0 else -1.0
    if column == "target":
        return lambda m: str(getattr(m, name))
    if behind == "[rad]":
        return lambda m: math.degrees(_number(m, name))
    if behind:
        return lambda m: in_hemisphere(_number(m, name), getattr(m, behind, ""))
    return lambda m: _number(m, name)


def _hipap_variant(fields: Sequence[str]) -> str:
    system, orientation = fields[4], fields[5]
    return f"_{system}_{orientation}" if system == "C" or (system, orientation) == ("R", "E") else f"_{system}"


VARIANTS: Mapping[str, Callable[[Sequence[str]], str]] = {
    "PSIMSSB": _hipap_variant,
    "PEVOSSB": lambda fields: f"_{fields[3]}",
    "PTSAG": lambda fields: "" if fields[5].strip("0") else "_ship",
    "PSONLLD": lambda fields: "_ship" if fields[1].lower().startswith("ship") else "",
}
"""What a sentence's fields add to its name; IndexError if it is too short."""


def decode_sentences(kind: str, contents: Sequence[str]) -> list[SentenceValues | None]:
    """Return the rows of sentences (from name to checksum, without it) of one kind, None if they do not match.

    A row has the kind's columns.
    """
    from pynmeagps import NMEAMessageError, NMEAParseError, NMEAReader, NMEATypeError  # pyright: ignore

    parse = cast("Callable[..., Any]", NMEAReader.parse)  # pyright: ignore[reportUnknownMemberType]

    known = SENTENCE_KINDS[kind]
    pairs = (field.partition(":") for field in known.fields.split())
    name_of = kind.partition("_")[0].removeprefix("P")
    own = {name_of: {name: code or "ST" for name, _, code in pairs}} if known.fields else {}
    values = [_value(known, column) for column in known.columns]
    rows: list[SentenceValues | None] = []
    for content in contents:
        try:
            message = parse(f"${content}*00\r\n".encode(), validate=0, userdefined=own)
            rows.append(tuple([value(message) for value in values]))
        except (NMEAMessageError, NMEAParseError, NMEATypeError, AttributeError, ValueError):
            rows.append(None)
    return rows
