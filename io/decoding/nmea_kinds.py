"""The NMEA 0183 sentences that are understood, and the quantities in each: degrees and metres.

pynmeagps parses them all; the fields of vendors' own sentences are listed here from their manuals: Kongsberg's HiPAP
and APOS (PSIMSSB, PSIMSNS), iXblue's GAPS (PTSAG, PTSAX), Sonardyne's Ranger 2 (PSONLLD), EvoLogics (PEVOSSB),
Cerulean's ROV Locator (USRTH, USTLC). If a field of a sentence decides what the others mean, it is of several kinds,
named with that field: PSIMSSB_C_H is Cartesian and head up, PTSAG_ship holds the position of the ship itself.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

SentenceValues: TypeAlias = tuple[float | str, ...]


class Fields:
    """The fields of a sentence parsed by pynmeagps."""

    def __init__(self, message: Any) -> None:
        self._message = message

    def text(self, name: str, usual: str | None = None) -> str:
        """Return a field as text; raise AttributeError if it is missing and has no usual value."""
        return str(getattr(self._message, name) if usual is None else getattr(self._message, name, usual))

    def number(self, name: str) -> float:
        """Return a field, NaN if it is empty or missing."""
        value = getattr(self._message, name, "")
        return math.nan if value == "" else float(value)

    def place(self, good: bool, of: str = "") -> tuple[float, float, float]:
        """Return the values of PLACE, NaN if a hemisphere is not stated; ``of`` begins the names of the fields."""
        sides = (f"{of}latNS", f"{of}lonEW") if of else ("NS", "EW")
        lat = in_hemisphere(self.number(f"{of}lat"), self.text(sides[0], ""))
        return lat, in_hemisphere(self.number(f"{of}lon"), self.text(sides[1], "")), _status(good)

    def received(self, quality: float) -> SentenceValues:
        """Return the values of RECEIVED."""
        return *self.place(quality > 0), quality

    def offset(self) -> tuple[float, float, float]:
        """Return the values of OFFSET."""
        return self.number("x"), self.number("y"), self.number("z")


@dataclass(frozen=True, slots=True)
class SentenceKind:
    """The fields of one kind of sentence."""

    columns: tuple[str, ...] = ()
    decode: Callable[[Fields], SentenceValues] | None = None  # in the order of the columns
    time: int | None = None  # which field is the time of day, hhmmss.ss, or ends in it
    date: tuple[int, ...] = ()  # which fields are day, month and year, or the one that is or begins with ddmmyy
    fields: str = ""  # name:type of pynmeagps, a name alone is text; for sentences that it does not know
    no_fix: tuple[int, str] | None = None  # which field says that a receiver has no fix, and by which letters

    def has_fix(self, fields: Sequence[str]) -> bool | None:
        """Return whether the receiver has a fix, and so the time; None if this kind does not say."""
        if self.no_fix is None:
            return None
        place, letters = self.no_fix
        return place >= len(fields) or fields[place].strip(letters) != ""


PLACE = ("lat_deg", "lon_deg", "fix_status")  # status -1: no fix
RECEIVED = (*PLACE, "quality")  # as GGA counts it
QUALITIES: Mapping[str, float] = {letter: float(quality) for quality, letter in enumerate("NADPRFEMS")}
"""Qualities of GGA by the letters of other sentences."""
ESTIMATED_QUALITIES = (6.0, 7.0, 8.0)  # fixed: dead reckoning, manual input, simulator
SIGNS: Mapping[str, float] = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}
OFFSET = ("x", "y", "z")
ELLIPSE = ("cov_xx", "cov_xy", "cov_yy")  # east, north, m^2


def _status(good: bool) -> float:
    return 0.0 if good else -1.0


def in_hemisphere(degrees: float, letter: str) -> float:
    """Return degrees with the sign of N, S, E or W; NaN without such a letter."""
    return abs(degrees) * SIGNS.get(letter.strip().upper(), math.nan)


def _active(m: Fields) -> SentenceValues:
    """Return the place of a sentence with a status (A or V), and since NMEA 2.3 a mode."""
    return m.received(QUALITIES.get(m.text("posMode", ""), 1.0) if m.text("status", "A") == "A" else 0.0)


def _by_systems(m: Fields) -> SentenceValues:
    """Return the place of a sentence with a mode for each satellite system: one that measures is enough."""
    modes = [QUALITIES.get(letter, 1.0) for letter in m.text("posMode")] or [0.0]
    return m.received(min((mode for mode in modes if mode not in (0.0, *ESTIMATED_QUALITIES)), default=max(modes)))


def _magnetic(m: Fields) -> SentenceValues:
    """Return the heading with deviation and variation (positive to the east), and 1 if the variation was stated."""
    heading = m.number("headingM")
    for name in ("deviation", "variation"):
        angle = m.number(name)
        if not math.isnan(angle):
            heading += -angle if m.text(f"{name}EW") == "W" else angle
    return heading, 0.0 if math.isnan(m.number("variation")) else 1.0


HIPAP = "time target status error system orientation filter x:DE y:DE z:DE accuracy:DE"
HIPAP_DEGREES = "time target status error system orientation filter lat:LA NS:LAD lon:LN EW:LND z:DE accuracy:DE"


def _measured(m: Fields) -> bool:
    """Accept status A; not with an error code (NRy: no reply), and not predictions."""
    return m.text("status") == "A" and not m.text("error") and m.text("filter") != "P"


def _hipap_radians(m: Fields) -> SentenceValues:
    place = (math.degrees(m.number(axis)) for axis in "xy")
    return m.text("target"), *place, _status(_measured(m)), m.number("accuracy")


EVOLOGICS = "time target head frame origin transformation x:DE y:DE z:DE accuracy:DE rssi:DE integrity:DE"


def _evologics(*axes: str) -> Callable[[Fields], SentenceValues]:
    def decode(m: Fields) -> SentenceValues:
        accuracy = m.number("accuracy")
        return m.text("target"), *map(m.number, axes), _status(not accuracy < 0), accuracy

    return decode


GAPS = "frame time day month year target"


def _received(m: Fields) -> bool:
    """Accept any of the four hydrophones: the code is 0 if none received."""
    return m.text("validity").strip("0") != ""


def _ranger(m: Fields) -> SentenceValues:
    """Return the place, and the covariance of east and north: the major axis is clockwise from north."""
    a, b, direction = m.number("major") ** 2, m.number("minor") ** 2, math.radians(m.number("direction"))
    s, c = math.sin(direction), math.cos(direction)
    ellipse = a * s * s + b * c * c, (a - b) * s * c, a * c * c + b * s * s
    return m.text("target"), m.number("lat"), m.number("lon"), _status(m.text("status") == "A"), *ellipse


LOCATOR = "version device channel compass head_lat head_lon heading qw qx qy qz range bearing elevation"


_timed = SentenceKind(time=0)  # known, but not usable: messages/usbl.py says why

SENTENCE_KINDS: Mapping[str, SentenceKind] = {
    "GGA": SentenceKind(RECEIVED, lambda m: m.received(m.number("quality")), time=0, no_fix=(5, "0")),
    "GNS": SentenceKind(RECEIVED, _by_systems, time=0, no_fix=(5, "N")),
    "RMC": SentenceKind(RECEIVED, _active, time=0, date=(8,), no_fix=(1, "V")),
    "GLL": SentenceKind(RECEIVED, _active, time=4, no_fix=(5, "V")),
    "TLL": SentenceKind(  # L: lost, Q: still in acquisition
        ("target", *PLACE),
        lambda m: (m.text("targetnum"), *m.place(m.text("status") not in ("L", "Q"), "target")),
        time=6,
    ),
    "ZDA": SentenceKind(time=0, date=(1, 2, 3)),
    "HDT": SentenceKind(("heading_deg",), lambda m: (m.number("headingT"),)),
    "THS": SentenceKind(("heading_deg",), lambda m: (math.nan if m.text("mi", "A") == "V" else m.number("headt"),)),
    "HDG": SentenceKind(("magnetic_deg", "corrected"), _magnetic),
    "HDM": SentenceKind(("magnetic_deg", "corrected"), _magnetic),
    **dict.fromkeys(
        ("PSIMSSB_C_H", "PSIMSSB_C_N", "PSIMSSB_C_E"),
        SentenceKind(
            ("target", *OFFSET, "fix_status", "sd_m"),
            lambda m: (m.text("target"), *m.offset(), _status(_measured(m)), m.number("accuracy")),
            time=0,
            fields=HIPAP,
        ),
    ),
    "PSIMSSB_R": SentenceKind(("target", *PLACE, "sd_m"), _hipap_radians, time=0, fields=HIPAP),
    "PSIMSSB_D": SentenceKind(
        ("target", *PLACE, "sd_m"),
        lambda m: (m.text("target"), *m.place(_measured(m)), m.number("accuracy")),
        time=0,
        fields=HIPAP_DEGREES,
    ),
    **dict.fromkeys(("PSIMSSB_R_E", "PSIMSSB_C_G", "PSIMSSB_U", "PSIMSSB_P", "PSONALL"), _timed),
    "PSIMSNS": SentenceKind(
        ("heading_deg",),
        lambda m: (m.number("heading"),),
        time=0,
        fields="time target transceiver transducer roll:DE pitch:DE heave:DE heading:DE",
    ),
    **dict.fromkeys(
        ("PTSAG", "PTSAG_ship"),
        SentenceKind(
            ("target", *PLACE),
            lambda m: (m.text("target"), *m.place(_received(m))),
            time=1,
            date=(2, 3, 4),
            fields=f"{GAPS} lat:LA NS:LAD lon:LN EW:LND validity z:DE",
        ),
    ),
    "PTSAX": SentenceKind(
        ("target", *OFFSET, "fix_status"),
        lambda m: (m.text("target"), *m.offset(), _status(_received(m))),
        time=1,
        date=(2, 3, 4),
        fields=f"{GAPS} x:DE y:DE validity z:DE",
    ),
    "PTSAY": SentenceKind(time=1, date=(2, 3, 4)),
    "PTSAH": SentenceKind(),  # known, but its fields are not
    **dict.fromkeys(
        ("PSONLLD", "PSONLLD_ship"),
        SentenceKind(
            ("target", *PLACE, *ELLIPSE),
            _ranger,
            time=0,
            fields="time target status lat:DE lon:DE z:DE major:DE minor:DE direction:DE",
        ),
    ),
    **dict.fromkeys(
        ("PEVOSSB_H", "PEVOSSB_N", "PEVOSSB_E"),
        SentenceKind(("target", *OFFSET, "fix_status", "sd_m"), _evologics("x", "y", "z"), time=0, fields=EVOLOGICS),
    ),
    "PEVOSSB_G": SentenceKind(("target", *PLACE, "sd_m"), _evologics("x", "y"), time=0, fields=EVOLOGICS),
    **dict.fromkeys(("PEVOSSB_T", "PEVOSSB_B", "PEVOSSA"), _timed),
    "RTH": SentenceKind(  # according to the manual, fields are only ever added
        ("slant_range_m", "bearing_deg", "elevation_deg"),  # bearing and elevation are true, elevation positive up
        lambda m: (m.number("range"), m.number("bearing"), m.number("elevation")),
        fields="math compass apparent_elevation range:DE math_bearing bearing:DE elevation:DE",
    ),
    "TLC": SentenceKind(
        ("lat_deg", "lon_deg"),
        lambda m: (m.number("lat"), m.number("lon")),
        time=18,
        date=(18,),
        fields=f"{LOCATOR} lat:DE lon:DE gain since moment",
    ),
}
"""One line per kind."""


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


def kind_of(address: str) -> str:
    """Return the name of a sentence without its talker: GGA of GPGGA; a vendor's own name is all of it."""
    return address if address.startswith("P") else address[2:]


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
    rows: list[SentenceValues | None] = []
    for content in contents:
        try:
            message = parse(f"${content}*00\r\n".encode(), validate=0, userdefined=own)
            rows.append(known.decode(Fields(message)) if known.decode else None)
        except (NMEAMessageError, NMEAParseError, NMEATypeError, AttributeError, ValueError):
            rows.append(None)
    return rows
