"""What a column or field holds, by its name and the unit that the name states: "DVL X [m/s]", "Heading (deg)".

Only words whose meaning and sign are the same everywhere count: no yaw, sway or heave.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple
from unicodedata import normalize

from usbldr.io.messages.topic_names import GPS_ITSELF, NO_SENSOR, SHIP, suggested_sensors
from usbldr.io.units import Dimension, NamedUnit, named_unit


class Rule(NamedTuple):
    """A quantity and the names of its columns; types/columns.toml explains the keys."""

    sensor: str
    key: str
    dimension: Dimension | None
    words: str
    sign: float = 1.0
    alone: bool = True


_NAMES = tomllib.loads((files("usbldr.io.messages") / "types" / "columns.toml").read_text(encoding="utf-8"))
_UNSTATED: Mapping[str, Any] = {"sensor": "", "dimension": None}
RULES: Sequence[Rule] = tuple(Rule(**{**_UNSTATED, **rule}) for rule in _NAMES["rule"])
TIME_OF_WEEK = RULES[1].words  # GPS time
DIRECTION = Rule("compass", "heading_deg", "angle", "azimuth|bearing|course|kurs")
"""A heading in a table of the vehicle's attitude; the direction of a transponder or of a motion in others."""
FIX_TYPE = Rule("", "fix_type", None, "^status")
"""A status in a table of ArduPilot's GPS messages, which these columns tell:"""
OF_ARDUPILOT = re.compile("nsats|gwk|gms")
NEUTRAL: Mapping[Dimension | None, str] = {
    "velocity": "v|vel|velocity|velocities|speed|spd|bottom_track|bt|body|vehicle",
    "angle": "angle|gps|gnss|usbl|dms|ddm|dmm?|dd|d{2,3}mm(ss)?(_?[ms]*)?",
    "length": "position|pos|coordinate|distance|gps|gnss|usbl",
}
"""Words behind a quantity that add nothing: its dimension, its system, and that a velocity is over the bottom."""
NEEDED: Mapping[str, Sequence[frozenset[str]]] = {
    sensor: tuple(frozenset(columns.split()) for columns in rows) for sensor, rows in _NAMES["needed"].items()
}
"""A sensor is there if all columns of one of these are."""

OF_SHIP: Mapping[str, str] = {"lat_deg": "ship/gps", "lon_deg": "ship/gps", "heading_deg": "ship/compass"}
"""The sensors that columns named for a ship belong to."""
OF_FIXES = "usbl/depth"
"""The depth that a USBL gives with its fixes, which is no depth sensor's."""
KEYS: Mapping[str, str] = _NAMES["columns_key"]
"""usbldr's own columns and the keys of ``columns`` for them, if these are others."""
OTHER = re.compile(
    r"(^|_)(set|target_(heading|hdg|depth|course|bearing|azimuth)|earth|gyro(?!_heading|_hdg|(_\d)?(_deg|_rad)?$)|local_position|ned|des|rate|acc|"
    r"accel|wind|water|wt|current|sound|error|err|fom|var|cmd|command|setpoint|desired|ekf|filtered|"
    r"estimated?|truth|(?<!heading_)(?<!hdg_)(?<!deg_)true(?!_[hb])|altitude|"  # of true north
    r"course(?!$|_(deg|rad)[a-z]*$)|"  # over the ground
    r"(lat|latitude|long?|lng|longitude)_(min|sec)[a-z]*|"  # beside degrees
    r"time_vel\d*|"  # of Nortek: the time that a velocity took
    r"(sd|std|std_?dev|stdev|sigma|rms|accuracy|uncertainty|precision)_(east|north|lat|lon|heading|hdg|roll|pitch|depth)\w*|"
    r"batt(ery)?|voltage|thruster|motor)(_|$)"
)
"""Words of columns that are no measurement of these sensors."""


ALONG_EARTH = "velocities along north and east; usbldr needs those that the DVL measures along its own axes"
WRAPPED = re.compile(r"(?<=[a-z0-9]{2}_)(data|value)$")
"""The last word of a field of a message that wraps a number, as std_msgs/Float64: the words before say what it is."""
TARGET = re.compile(r"(^|_)target(_|$)")  # of a USBL system; of a controller it is where the vehicle should be
OF_USBL = re.compile(
    r"(^|_)(target_(name|id|type|depth|address)|slant_range|beacon|transponder|(vessel|ship)_(east|north|lat|lon))"
)
"""Words of columns beside the positions of targets, in a table of a USBL system."""
OF_ATTITUDE = re.compile(r"(^|_)(compass|attitude|ahrs|roll|pitch|surge|forward|fwd|starboard|stbd|v_?x)(_|$)")
"""Words of a table, or of its columns, whose azimuth is the vehicle's heading, unless another word is of these:"""
NO_ATTITUDE = re.compile(
    r"(^|_)(usbl|ssbl|gps|gnss|r|range|slant|dist(ance)?|target|beacon|transponder|tp|elevation|el|depression|travel|"
    r"lat(itude)?|lon|longitude|east(ing)?|north(ing)?|heading|hdg|yaw|ship|vessel)(_|$)|^(pos(ition)?_)?[xy](_m)?$"
)
UTM = re.compile(r"(?:(?:^|_)wgs_?84)?(?:^|_)utm(?:_?zone)?(?:_?(\d{1,2})_?(?:([ns])(?:orth|outh)?(?:ern)?)?)?(?=_|$)")
"""A grid in the name of an easting or northing, its zone and hemisphere, in the words of the name."""


class NamedColumn(NamedTuple):
    """A column whose name says what it holds."""

    name: str
    rule: Rule
    unit: NamedUnit

    @property
    def factor(self) -> float:
        """The factor to the quantity's own unit."""
        return self.rule.sign * self.unit.factor

    @property
    def known(self) -> bool:
        """Whether the name states a unit of this quantity."""
        return self.unit.dimension == self.rule.dimension


ENGLISH: Mapping[str, str] = {word: name for name, words in _NAMES["english"].items() for word in words.split()}
"""Words of other languages."""
FOREIGN = re.compile(rf"(?<![a-z0-9])({'|'.join(sorted(ENGLISH, key=len, reverse=True))})(?![a-z0-9])")


def words_of(label: str) -> str:
    """Return a name in English and lower case, its words parted by "_": "DVL X", "dvlX" and "dvl.x" are dvl_x.

    "Länge" is lange, "Vitesse avant" is velocity_forward.
    """
    bare = label if label.isascii() else normalize("NFKD", label.translate(str.maketrans("øØ", "oO")))
    plain = re.sub("[\u0300-\u036f]", "", bare)  # without accents
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", plain)
    words = re.sub(r"[^a-z0-9]+", "_", parted.lower()).strip("_")
    return FOREIGN.sub(lambda found: ENGLISH[found[1]], words)


def utm_code(text: str) -> str:
    """Return the code of the grid that a text names, "EPSG:32631" of "UTM 31N"; empty if it names none."""
    if code := re.search(r"\bEPSG:(\d{4,5})\b", text):
        return code[0]
    words = re.sub(
        r"(utm)_(n(?:orth)?|s(?:outh)?)_zone_(\d+)", r"\1_\3_\2", words_of(text)
    )  # UTM North, Zone 26; UTM (N) zone 26
    zones = [zone for zone in UTM.finditer(words) if zone[2] and 0 < int(zone[1]) <= 60]
    return f"EPSG:32{6 if zones[0][2] == 'n' else 7}{int(zones[0][1]):02d}" if zones else ""


def named_column(
    name: str, rules: Sequence[Rule] = RULES, others: Sequence[re.Pattern[str]] = (OTHER, SHIP)
) -> NamedColumn | None:
    """Return what a column holds, None if its name does not tell, or has words of ``others``."""
    unit = named_unit(name)
    words = WRAPPED.sub("", UTM.sub("", words_of(unit.label))).strip("_")
    if any(other.search(part) for other in others for part in (words, words_of(name))):
        return None
    for rule in rules:
        certain = unit.dimension == rule.dimension or (rule.alone and unit.dimension is None)
        certain |= rule.dimension == "velocity" and unit.unit == "ms"  # m/s, as some write it; its unit stays unknown
        neutral = f"(_({NEUTRAL[rule.dimension]}))*" if rule.dimension in NEUTRAL else ""
        if certain and re.search(f"(^|_)({rule.words}){neutral}$", words):
            return NamedColumn(name, rule, unit)
    return None


def earth_velocities(names: Iterable[str]) -> list[str]:
    """Return the columns of velocities along north and east, empty if there are not both."""
    velocities = [name for name in names if named_unit(name).dimension == "velocity"]
    found = [[n for n in velocities if words_of(named_unit(n).label).endswith(axis)] for axis in ("north", "east")]
    return [*found[0], *found[1]] if all(found) else []


def rules_for(names: Iterable[str], place: str) -> Sequence[Rule]:
    """Return the rules of a table: an azimuth, bearing or course is the heading if attitudes are there and no fixes.

    ``place``: the name of its file or topic. ArduPilot's status is a type of fix.
    """
    words = [words_of(place), *map(words_of, names)]
    rules = (FIX_TYPE, *RULES) if any(map(OF_ARDUPILOT.fullmatch, words)) else RULES
    fixes = "usbl" in suggested_sensors(place) or any(NO_ATTITUDE.search(one) or OF_USBL.search(one) for one in words)
    return (DIRECTION, *rules) if not fixes and any(map(OF_ATTITUDE.search, words)) else rules


def sensors_by_name(names: Iterable[str], place: str) -> Mapping[str, Mapping[str, Sequence[NamedColumn]]]:
    """Return sensor -> own column -> the columns that could hold it; "" has the times.

    A position belongs to the USBL or the GPS that its name suggests, or that of its ``place``, the file; another may be
    an estimate. A depth that is named for the USBL, or in a table of it alone, is that of its fixes. The ship has
    sensors of its own.
    """
    names = list(names)
    acoustic = any(OF_USBL.search(words_of(name)) for name in names)
    found: dict[str, dict[str, list[NamedColumn]]] = {}
    if NO_SENSOR.search(place):
        return found
    rules = rules_for(names, place)
    for name in names:
        first = re.sub(r"\.\d+$", "", name)  # of which pandas names a second one Time.1
        wrapped = words_of(named_unit(name).label) in ("value", "data")  # whose file is named for what it holds
        ship = bool(SHIP.search(words_of(name)))
        others = (OTHER,) if ship else (OTHER, SHIP)
        column = named_column(f"{place} {name}" if wrapped else first if first in names else name, rules, others)
        if column is None:
            continue
        column = column._replace(name=name)
        own, file = (_positioning(words) for words in (words_of(column.unit.label), words_of(place)))
        sensor = column.rule.sensor
        if ship:
            sensor = OF_SHIP.get(column.rule.key, "?")
        elif column.rule.dimension != "time" and not sensor:
            sensor = own or file or ("usbl" if acoustic and TARGET.search(words_of(column.name)) else "?")
        if sensor == "depth" and own == "usbl":
            sensor = OF_FIXES
        if sensor != "?":
            found.setdefault(sensor, {}).setdefault(column.rule.key, []).append(column)
    if _positioning(words_of(place)) == "usbl" and not {"dvl", "compass"} & found.keys():
        found.setdefault(OF_FIXES, found.pop("depth", {}))
    depths = [one for one in found.pop(OF_FIXES, {}).get("depth_m", ()) if one.known]
    if depths and "usbl" in found:  # one without a unit is not needed, and refuses no fix
        found["usbl"]["depth_m"] = depths
    for columns in found.values():
        for key in ("east_m", "north_m") if columns.keys() >= {"lat_deg", "lon_deg"} else ():  # offsets, or residuals
            columns.pop(key, None)
    if headings := found.get("compass", {}).get("heading_deg"):
        found["compass"]["heading_deg"] = list(true_ones(headings))
        for key in ("roll_deg", "pitch_deg"):
            if len(found["compass"].get(key, ())) > 1:  # which of them is the compass's is unknown, and not needed
                del found["compass"][key]
    return {
        sensor: columns
        for sensor, columns in found.items()
        if not sensor or any(needed <= columns.keys() for needed in NEEDED[sensor])
    }


def true_ones(headings: Sequence[NamedColumn]) -> Sequence[NamedColumn]:
    """Return the only one of several headings that is named true and not for the GPS, else all that are not, or all."""
    headings = [one for one in headings if _positioning(words_of(one.name)) != "gps"] or headings
    true = [heading for heading in headings if re.search(r"(^|_)true(_|$)", words_of(heading.name))]
    return true if len(true) == 1 else headings


def _positioning(words: str) -> str:
    """Return which positioning system a name suggests, of a ship its receiver; empty if none."""
    receiver = re.search(GPS_ITSELF, words) or SHIP.search(words)
    return "usbl" if "usbl" in suggested_sensors(words) else "gps" if receiver else ""
