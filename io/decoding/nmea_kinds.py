"""The NMEA 0183 sentences that are understood, and the quantities in each: degrees and metres.

pynmeagps parses them all; the fields of vendors' own sentences are listed here from their manuals: Kongsberg's HiPAP
and APOS (PSIMSSB, PSIMSNS), iXblue's GAPS (PTSAG, PTSAX), Sonardyne's Ranger 2 (PSONLLD), EvoLogics (PEVOSSB),
Cerulean's ROV Locator (USRTH, USTLC). If a field of a sentence decides what the others mean, it is of several kinds,
named with that field: PSIMSSB_C_H is Cartesian and head up, PTSAG_ship holds the position of the ship itself.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

SentenceValues: TypeAlias = tuple[float | str, ...]


class SentenceKind(NamedTuple):
    """The fields of one kind of sentence."""

    columns: tuple[str, ...] = ()
    decode: Callable[[Any], SentenceValues] | None = (
        None  # of a sentence parsed by pynmeagps, in the order of the columns
    )
    time: int | None = None  # which field is the time of day, hhmmss.ss, or ends in it
    date: tuple[int, ...] = ()  # which fields are day, month and year, or the one that is or begins with ddmmyy
    fields: str = ""  # name:type of pynmeagps, a name alone is text; for sentences that it does not know


PLACE = ("lat_deg", "lon_deg", "fix_status")  # status -1: no fix
OFFSET = ("x", "y", "z")
ELLIPSE = ("cov_xx", "cov_xy", "cov_yy")  # east, north, m^2


def _number(message: Any, name: str) -> float:
    """Return a field, NaN if it is empty or missing."""
    value = getattr(message, name, "")
    return math.nan if value == "" else float(value)


def _status(good: bool) -> float:
    return 0.0 if good else -1.0


def _place(message: Any, good: bool) -> tuple[float, float, float]:
    return _number(message, "lat"), _number(message, "lon"), _status(good)


def _magnetic(message: Any) -> SentenceValues:
    """Return the heading with deviation and variation (positive to the east), and 1 if the variation was stated."""
    heading = _number(message, "headingM")
    for name in ("deviation", "variation"):
        angle = _number(message, name)
        if not math.isnan(angle):
            heading += -angle if getattr(message, f"{name}EW") == "W" else angle
    return heading, 0.0 if math.isnan(_number(message, "variation")) else 1.0


def _gga(m: Any) -> SentenceValues:
    return _place(m, _number(m, "quality") > 0)


def _gns(m: Any) -> SentenceValues:
    return _place(m, m.posMode.strip("N") != "")


def _rmc(m: Any) -> SentenceValues:
    return _place(m, getattr(m, "status", "A") == "A")


def _tll(m: Any) -> SentenceValues:
    tracked = _status(m.status not in ("L", "Q"))  # lost, or still in acquisition
    return str(m.targetnum), _number(m, "targetlat"), _number(m, "targetlon"), tracked


def _hdt(m: Any) -> SentenceValues:
    return (_number(m, "headingT"),)


def _ths(m: Any) -> SentenceValues:
    return (math.nan if getattr(m, "mi", "A") == "V" else _number(m, "headt"),)


def _heading(m: Any) -> SentenceValues:
    return (_number(m, "heading"),)


HIPAP = "time target status error system orientation filter x:DE y:DE z:DE accuracy:DE"
HIPAP_DEGREES = "time target status error system orientation filter lat:LA NS:LAD lon:LN EW:LND z:DE accuracy:DE"


def _measured(message: Any) -> bool:
    """Accept status A; not with an error code (NRy: no reply), and not predictions."""
    return message.status == "A" and not message.error and message.filter != "P"


def _hipap(m: Any) -> SentenceValues:
    return m.target, *(_number(m, axis) for axis in OFFSET), _status(_measured(m)), _number(m, "accuracy")


def _hipap_radians(m: Any) -> SentenceValues:
    place = (math.degrees(_number(m, axis)) for axis in "xy")
    return m.target, *place, _status(_measured(m)), _number(m, "accuracy")


def _hipap_degrees(m: Any) -> SentenceValues:
    return m.target, *_place(m, _measured(m)), _number(m, "accuracy")


EVOLOGICS = "time target head frame origin transformation x:DE y:DE z:DE accuracy:DE rssi:DE integrity:DE"


def _evologics(m: Any) -> SentenceValues:
    accuracy = _number(m, "accuracy")
    return m.target, *(_number(m, axis) for axis in OFFSET), _status(not accuracy < 0), accuracy


def _evologics_place(m: Any) -> SentenceValues:
    accuracy = _number(m, "accuracy")
    return m.target, _number(m, "x"), _number(m, "y"), _status(not accuracy < 0), accuracy


GAPS = "frame time day month year target"


def _received(message: Any) -> bool:
    """Accept any of the four hydrophones: the code is 0 if none received."""
    return message.validity.strip("0") != ""


def _gaps(m: Any) -> SentenceValues:
    return m.target, *_place(m, _received(m))


def _gaps_offset(m: Any) -> SentenceValues:
    return m.target, *(_number(m, axis) for axis in OFFSET), _status(_received(m))


def _ellipse(major_m: float, minor_m: float, direction_deg: float) -> SentenceValues:
    """Return the covariance of east and north, the major axis being clockwise from north."""
    s, c = math.sin(math.radians(direction_deg)), math.cos(math.radians(direction_deg))
    a, b = major_m**2, minor_m**2
    return a * s * s + b * c * c, (a - b) * s * c, a * c * c + b * s * s


def _ranger(m: Any) -> SentenceValues:
    ellipse = _ellipse(*(_number(m, name) for name in ("major", "minor", "direction")))
    return m.target, *_place(m, m.status == "A"), *ellipse


LOCATOR = "version device channel compass head_lat head_lon heading qw qx qy qz range bearing elevation"


def _locator(m: Any) -> SentenceValues:
    """Return slant range, true bearing clockwise from north, and true elevation, positive up."""
    return _number(m, "range"), _number(m, "bearing"), _number(m, "elevation")


def _located(m: Any) -> SentenceValues:
    return _number(m, "lat"), _number(m, "lon")


_hipap_offset = SentenceKind(("target", *OFFSET, "fix_status", "sd_m"), _hipap, time=0, fields=HIPAP)
_evologics_offset = SentenceKind(("target", *OFFSET, "fix_status", "sd_m"), _evologics, time=0, fields=EVOLOGICS)
_gaps_place = SentenceKind(
    ("target", *PLACE),
    _gaps,
    time=1,
    date=(2, 3, 4),
    fields=f"{GAPS} lat:LA NS:LAD lon:LN EW:LND validity z:DE",
)
_ranger_place = SentenceKind(
    ("target", *PLACE, *ELLIPSE),
    _ranger,
    time=0,
    fields="time target status lat:DE lon:DE z:DE major:DE minor:DE direction:DE",
)
_timed = SentenceKind(time=0)  # known, but not usable: messages/usbl.py says why

SENTENCE_KINDS: Mapping[str, SentenceKind] = {
    "GGA": SentenceKind(PLACE, _gga, time=0),
    "GNS": SentenceKind(PLACE, _gns, time=0),
    "RMC": SentenceKind(PLACE, _rmc, time=0, date=(8,)),
    "GLL": SentenceKind(PLACE, _rmc, time=4),
    "TLL": SentenceKind(("target", *PLACE), _tll, time=6),
    "ZDA": SentenceKind(time=0, date=(1, 2, 3)),
    "HDT": SentenceKind(("heading_deg",), _hdt),
    "THS": SentenceKind(("heading_deg",), _ths),
    "HDG": SentenceKind(("magnetic_deg", "corrected"), _magnetic),
    "HDM": SentenceKind(("magnetic_deg", "corrected"), _magnetic),
    "PSIMSSB_C_H": _hipap_offset,
    "PSIMSSB_C_N": _hipap_offset,
    "PSIMSSB_C_E": _hipap_offset,
    "PSIMSSB_R": SentenceKind(("target", *PLACE, "sd_m"), _hipap_radians, time=0, fields=HIPAP),
    "PSIMSSB_D": SentenceKind(
        ("target", *PLACE, "sd_m"),
        _hipap_degrees,
        time=0,
        fields=HIPAP_DEGREES,
    ),
    "PSIMSSB_R_E": _timed,
    "PSIMSSB_C_G": _timed,
    "PSIMSSB_U": _timed,
    "PSIMSSB_P": _timed,
    "PSIMSNS": SentenceKind(
        ("heading_deg",),
        _heading,
        time=0,
        fields="time target transceiver transducer roll:DE pitch:DE heave:DE heading:DE",
    ),
    "PTSAG": _gaps_place,
    "PTSAG_ship": _gaps_place,
    "PTSAX": SentenceKind(
        ("target", *OFFSET, "fix_status"),
        _gaps_offset,
        time=1,
        date=(2, 3, 4),
        fields=f"{GAPS} x:DE y:DE validity z:DE",
    ),
    "PTSAY": SentenceKind(time=1, date=(2, 3, 4)),
    "PTSAH": SentenceKind(),  # known, but its fields are not
    "PSONLLD": _ranger_place,
    "PSONLLD_ship": _ranger_place,
    "PSONALL": _timed,
    "PEVOSSB_H": _evologics_offset,
    "PEVOSSB_N": _evologics_offset,
    "PEVOSSB_E": _evologics_offset,
    "PEVOSSB_G": SentenceKind(("target", *PLACE, "sd_m"), _evologics_place, time=0, fields=EVOLOGICS),
    "PEVOSSB_T": _timed,
    "PEVOSSB_B": _timed,
    "PEVOSSA": _timed,
    "RTH": SentenceKind(  # according to the manual, fields are only ever added
        ("slant_range_m", "bearing_deg", "elevation_deg"),
        _locator,
        fields="math compass apparent_elevation range:DE math_bearing bearing:DE elevation:DE",
    ),
    "TLC": SentenceKind(
        ("lat_deg", "lon_deg"),
        _located,
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
            rows.append(known.decode(message) if known.decode else None)
        except (NMEAMessageError, NMEAParseError, NMEATypeError, AttributeError, ValueError):
            rows.append(None)
    return rows
