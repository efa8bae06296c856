"""Columns for topics of unknown types that look like a missing sensor, by the names of topic, type and fields.

A proposal, which the user has to confirm: a name states neither axes nor, in most cases, units.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from usbldr.io.messages.configured import ARRIVALS, QUATERNION, TIME_UNITS_NS, configured_columns
from usbldr.io.messages.field_names import (
    DIRECTION,
    KEYS,
    NEEDED,
    OF_USBL,
    RULES,
    NamedColumn,
    Rule,
    named_column,
    rules_for,
    true_ones,
    words_of,
)
from usbldr.io.messages.registry import LAYOUTS, message_layout_of
from usbldr.io.messages.roles import ROLES, Roles
from usbldr.io.messages.topic_names import GPS_ITSELF, NO_SENSOR, SECOND_CHOICE, names_ship, suggested_sensors
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import Request
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.toml_text import quoted
from usbldr.io.tables.csv_sheets import CANONICAL, side_columns
from usbldr.io.tables.text_table import listed
from usbldr.io.tables.time_columns import dated_columns, keys_since_1970, time_key
from usbldr.io.tables.unnamed_columns import is_number

NAMES_OF_AXES = {
    "x": "u|surge|langs|along(_track|ship)?|longitudinal|(fore|forward|fwd)_aft",
    "y": "v|sway|quer|(across|athwart)(_track|ships?)?|transvers(e|al)|lateral|port_(starboard|stbd)|"
    "(starboard|stbd)_port",
    "z": "w|heave|vertical|up_down",
}
MOTIONS = "(bt_?)?v(el|elocity|elocities)?(_(body|bt|vehicle))?|speeds?|linear|dvl"  # of axes
VECTORS = tuple(
    Rule("dvl", f"{axis}_mps", "velocity", f"({MOTIONS})_?({axis}|{number})|{named}")
    for number, (axis, named) in enumerate(NAMES_OF_AXES.items())
)
PLACES = (Rule("", "east_m", "length", "e"), Rule("", "north_m", "length", "n"))
PAIRS = "position|pos|coordinates?|location|point"  # arrays of metres, or of latitude and longitude in either order
AXES_OF_PLACES = (  # the doctor finds the frame
    Rule("", "east_m", "length", f"x(_enu|_ned)?|({PAIRS})_0"),
    Rule("", "north_m", "length", f"y(_enu|_ned)?|({PAIRS})_1"),
)
YAW = Rule(
    "compass", "heading_deg", "angle", "yaw(_enu)?|kurs|psi|gyro|(attitude|euler|rpy|rph)_(z|2)"
)  # whose sense the doctor finds
IN_METRES = tuple(one for one in NEEDED["usbl"] if "horizontal_range_m" not in one)  # which no key names
COMPLETE = {**NEEDED, "usbl": IN_METRES, "compass": (*NEEDED["compass"], frozenset(QUATERNION))}
FLAG = Rule("", "valid", None, "valid|bottom_lock|lock|locked")
QUATERNIONS = tuple(
    Rule("compass", key, None, f"(q|quat|quaternion|orientation)_?({key[1]}|{number})")
    for key, number in zip(QUATERNION, (1, 2, 3, 0), strict=True)  # the scalar comes first, as PX4 writes it
)
AXES = {("forward_mps", 1): "F", ("starboard_mps", 1): "S", ("starboard_mps", -1): "P", ("up_mps", 1): "U"}
FROM_SHIP: Mapping[str, Mapping[str, str]] = {
    "relative_bearing_deg": {"frame": "body"},
    "starboard_m": {"frame": "body", "axes": "SFU"},
    "east_offset_m": {"relative_to": "head"},
}
"""The keys that columns of fixes from a ship need."""
BY_NAMES = "by the names of its columns"
OF_VEHICLE = re.compile(r"(^|_)(target|rov|towfish|crawler)(_|$)")
"""Words of positions, in one table of all sensors, that a USBL may have measured."""
OF_ROV = re.compile(r"(^|_)rov(_|$)")  # in the name of a table whose positions are acoustic: it has no GPS under water
FIX_FLAGS = {"fix_type", "fix_status", "quality"}  # whose numbers say whether there is a fix; words say something else
DIGITS = re.compile(r"\d+")
WHY = "CHECK: proposed from the names of its fields; confirm quantities, units and axes"


@dataclass(frozen=True, slots=True)
class Proposal:
    """The columns that a topic of an unknown type could have."""

    topic: TopicInfo
    columns: Mapping[str, str]
    others: tuple[str, ...] = ()  # topics that look like the sensor, too
    words: Mapping[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])  # key -> value, and why
    further: tuple[str, ...] = ()  # columns of further devices

    @property
    def keys(self) -> dict[str, object]:
        """Return the proposal as keys of the sensor's section."""
        words = {key: value for key, (value, _) in self.words.items()}
        return {"topic": self.topic.name, "columns": dict(self.columns), **words}

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Return the keys and their reasons for a configuration."""
        text = ", ".join(f"{key} = {quoted(path)}" for key, path in self.columns.items())
        which = f"; it could be {' or '.join(self.others)}" if self.others else ""
        why = f"{WHY}; of several devices, the first ({listed(self.further)})" if self.further else WHY
        what = f"{self.topic.type}, {self.topic.count} messages" if self.topic.count else BY_NAMES
        return [(f"topic = {quoted(self.topic.name)}", f"{what}{which}"), (f"columns = {{ {text} }}", why)]


def proposed_columns(
    topics: Sequence[TopicInfo], roles: Roles, request: Request, configuration: Configuration
) -> dict[str, Proposal]:
    """Return role -> proposal for the roles that no topic fills and no option names.

    A table has one time: that of the sections that state columns of it. If a table has no time but that of the
    vehicle's own clock, others that have this one, too, are timed by it.
    """
    stated: dict[str, dict[str, str]] = {}
    for one in configured_columns(configuration, request.topics):
        if one.sensor in roles.chosen:
            clock = {key: name for key, name in one.columns.items() if key in (*TIME_UNITS_NS, *ARRIVALS)}
            stated[roles.chosen[one.sensor].topic.name] = clock
    found = _proposed(topics, roles, request, set(), stated)
    clocks = {one.columns.get(key) for one in found.values() for key in ("time_s", "time_unix_us")}
    cells = {name: cell for one in found.values() for name, cell in one.topic.first_row if name in clocks}
    own = {name for name, cell in cells.items() if not keys_since_1970(cell)}
    return _proposed(topics, roles, request, own, stated) if own else found


def _proposed(
    topics: Sequence[TopicInfo],
    roles: Roles,
    request: Request,
    own_clocks: Collection[str],
    stated: Mapping[str, Mapping[str, str]],
) -> dict[str, Proposal]:
    unknown = [topic for topic in dict.fromkeys(map(whole_table, topics)) if _unknown(topic)]
    unread = [topic.type for topic in topics if topic.first_row and topic.problem]
    found: dict[str, Proposal] = {}
    for role in ROLES:
        own = f"usbldr/{role}" in unread  # a file or columns that a name gives to the sensor
        if role not in roles.chosen and (own or role not in roles.unresolved) and role not in request.topics:
            fitting = [
                (topic, columns)
                for topic in unknown
                if (columns := _columns(role, topic, own_clocks, topic.name in stated))
            ]
            fitting.sort(
                key=lambda one: (
                    role not in suggested_sensors(one[0].name),
                    bool(SECOND_CHOICE.search(one[0].name)),
                    -one[0].count,
                )
            )
            if fitting:
                (topic, columns), *others = fitting
                clock = stated.get(topic.name, {})
                found[role] = _proposal(topic, columns, tuple(other.name for other, _ in others), clock)
    return found


def whole_table(topic: TopicInfo) -> TopicInfo:
    """Return the table of a topic that the names of its columns give, else the topic itself."""
    if not topic.table:
        return topic
    row, unused = topic.first_row, topic.unused
    return TopicInfo(topic.table, "", topic.encoding, 0, None, None, first_row=row, unused=unused)


def _unknown(topic: TopicInfo) -> bool:
    name = topic.name.lower()
    known = any(message_layout_of(role, topic) for role in LAYOUTS)
    readable = bool(topic.count) and not topic.problem and not topic.type.startswith(CANONICAL)
    named = not NO_SENSOR.search(name) and (not names_ship(topic.name) or "usbl" in suggested_sensors(name))
    return (readable or bool(topic.first_row)) and not known and named


def _columns(role: str, topic: TopicInfo, own_clocks: Collection[str], timed: bool) -> dict[str, NamedColumn]:
    """Return own column -> field for a topic that looks like a sensor, empty if it does not."""
    paths = [name for name, _ in topic.first_row] or [
        path for one in topic.fields for path in ([f"{one}[{k}]" for k in range(4)] if one in topic.arrays else [one])
    ]
    found: dict[str, NamedColumn] = {}
    suggested = suggested_sensors(f"{topic.name} {topic.type}")
    if role == "depth" and "usbl" in suggested and role not in suggested:
        return {}  # the depth of a transponder is a fix's
    rules = (*QUATERNIONS, *VECTORS, *rules_for(paths, topic.name), YAW, FLAG, *PLACES, *AXES_OF_PLACES)
    columns = [column for path in paths if (column := named_column(path, rules))]
    columns = _of_one_device(columns)
    headings = [column for column in columns if column.rule.key == "heading_deg"]
    columns = [column for column in columns if column not in headings or column in true_ones(headings)]
    if topic.unused:  # the others are a sensor's already
        columns = [one for one in columns if one.rule.dimension == "time" or one.name in topic.unused]
    times = [column for column in columns if column.rule.key == "time"]
    if topic.first_row:
        others = (column for column in columns if column not in times)
        cells = dict(topic.first_row)
        clocks = [one for one in times if one.name in own_clocks] or dated_columns(cells, times)
        since_1970 = [one for one in clocks if keys_since_1970(cells[one.name])]  # a date beside it may have a zone
        columns = [*(since_1970[:1] or clocks), *others]
    of_all = bool(topic.first_row) and not suggested_sensors(topic.name)  # one table of all sensors
    columns = [one for one in columns if one.rule.dimension or role in (_of_flag(one.name) or {role})]
    acoustic = any(OF_USBL.search(words_of(path)) for path in paths)
    named = {one.rule.key for one in columns if role in suggested_sensors(words_of(one.name))}
    of_rov = of_all and bool(OF_ROV.search(words_of(topic.name)))
    of_fixes = acoustic and not any(one.rule.dimension == "velocity" or one in headings for one in columns)
    from_gps = of_all and role == "gps" and not (acoustic or of_rov)
    plain = {"lat_deg", "lon_deg"} - named if from_gps or (role == "usbl" and of_rov) else set[str]()  # lat, lon
    if role not in ("usbl", "gps"):
        columns = [one for one in columns if one.rule.sensor or one.rule.key in ("time", "received", "valid")]
    stated = {column.rule.key for column in columns if column.rule not in AXES_OF_PLACES}
    for column in columns:
        if column.rule in AXES_OF_PLACES and column.rule.key in stated:
            continue  # of another frame, beside east and north
        of_any = not column.rule.sensor and column.rule.dimension in ("time", None)
        certain = column.rule in RULES and column.known and column.rule.dimension == "velocity"  # forward_kn
        certain = certain or (of_all and (column.rule.dimension == "velocity" or column.rule in (YAW, DIRECTION)))
        certain = certain or column.rule in QUATERNIONS
        hinted = certain or role in suggested_sensors(f"{topic.name} {topic.type} {words_of(column.name)}")
        of_vehicle = of_all and role == "usbl" and column.rule.key not in named
        hinted = hinted or (of_vehicle and (of_fixes or bool(OF_VEHICLE.search(words_of(column.name)))))
        hinted |= column.rule.key in plain and bool(re.fullmatch(column.rule.words, words_of(column.unit.label)))
        if of_any or (hinted and column.rule.sensor in (role, "")):
            if topic.first_row and column.rule.key in found and column.rule.dimension:
                return {}  # two columns of one quantity
            found.setdefault(column.rule.key, column)
    if topic.first_row and not timed and time_key(topic, found.get("time")) is None:
        return {}
    complete = [needed for needed in COMPLETE[role] if needed <= found.keys()]
    others = frozenset[str]().union(*COMPLETE[role]).difference(*complete[:1])  # columns of another kind of position
    others |= frozenset({"elevation_deg"} if "slant_range_m" in others else ())
    cells = dict(topic.first_row)
    others |= {key for key in FIX_FLAGS & found.keys() if not is_number(cells.get(found[key].name, "0"))}
    return {key: column for key, column in found.items() if key not in others} if complete else {}


def _of_one_device(columns: Sequence[NamedColumn]) -> list[NamedColumn]:
    """Return the columns without those of further devices: usbl2_lat, usbl2_lon beside usbl1_lat, usbl1_lon."""
    alike: dict[tuple[str, str], list[str]] = {}
    for column in columns:
        alike.setdefault((column.rule.key, DIGITS.sub("#", column.name)), []).append(_device(column.name))
    further = {one for devices in alike.values() for one in devices if one != devices[0]}
    return [column for column in columns if _device(column.name) not in further]


def _device(name: str) -> str:
    """Return the name of a column up to the end of its first number."""
    number = DIGITS.search(name)
    return name[: number.end()] if number else name


def _of_flag(name: str) -> set[str]:
    """Return the sensors that the name of a flag suggests; a "fix" is one of GPS or USBL."""
    sensors = suggested_sensors(words_of(name))
    return sensors | {"usbl"} if "gps" in sensors and not re.search(GPS_ITSELF, words_of(name)) else sensors


def _frame(east: NamedColumn) -> str:
    """Return the frame that the name of a position's first coordinate states, empty if it states none."""
    stated = re.search("(enu|ned)$", words_of(east.unit.label))
    return stated[1].upper() if stated else "" if east.rule in AXES_OF_PLACES else "ENU"


def _proposal(
    topic: TopicInfo, found: Mapping[str, NamedColumn], others: tuple[str, ...], clock: Mapping[str, str]
) -> Proposal:
    columns = dict(clock)
    if "forward_mps" in found:
        found = {key: column for key, column in found.items() if key not in ("x_mps", "y_mps", "z_mps")}
    for key, column in found.items():
        if key == "time" and topic.first_row and not clock:
            columns[str(time_key(topic, found.get("time")))] = column.name
        elif key == "time" and not clock:
            keys = [one for one, unit_ns in TIME_UNITS_NS.items() if column.known and unit_ns == column.factor]
            if keys and not topic.has("header.stamp"):
                columns[keys[0]] = column.name
        elif key not in ("time", "received"):
            columns[KEYS.get(key, key)] = column.name
    columns |= side_columns(columns, dict(topic.first_row))
    signs = {key: round(column.rule.sign) for key, column in found.items()}
    named = [(key, signs.get(key, 1)) for key in ("forward_mps", "starboard_mps", "up_mps")]
    axes = "".join(AXES.get(one, "D") for one in named)
    words = {"axes": (axes, BY_NAMES)} if "forward_mps" in found else {}
    if "x" in columns and "east_m" in found and (frame := _frame(found["east_m"])):
        words["frame"] = (frame, BY_NAMES)
    if "heading_deg" in found and words_of(found["heading_deg"].unit.label).endswith("_enu"):
        words["convention"] = ("ENU", BY_NAMES)
    for key in FROM_SHIP.keys() & found.keys():
        words |= {name: (value, BY_NAMES) for name, value in FROM_SHIP[key].items()}
    chosen = {DIGITS.sub("#", name) for name in columns.values()}
    further = [one for one, _ in topic.first_row if DIGITS.sub("#", one) in chosen and one not in columns.values()]
    return Proposal(topic, columns, others, words, tuple(further))
