"""Columns for topics of unknown types that look like a missing sensor, by the names of topic, type and fields.

A proposal, which the user has to confirm: a name states neither axes nor, in most cases, units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.doctor.doctor import Examination, examine
from usbldr.io.messages.configured import TIME_UNITS_NS
from usbldr.io.messages.field_names import NEEDED, RULES, NamedColumn, Rule, named_column, words_of
from usbldr.io.messages.registry import LAYOUTS, message_layout_of
from usbldr.io.messages.roles import ROLES, SENSORS
from usbldr.io.messages.topic_names import NO_SENSOR, SHIP, suggested_sensors
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import ConfigurationFile, Request, open_configured
from usbldr.io.reading.sensors import roles_of
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.toml_text import quoted
from usbldr.io.tables.csv_sheets import ISO, PROPOSED, SINCE_NS, dated_columns, keys_since_1970, of_gps, side_columns
from usbldr.io.tables.unnamed_columns import is_number

NAMES_OF_AXES = {
    "x": "surge|along(_track|ship)?|longitudinal",
    "y": "sway|(across|athwart)(_track|ships?)?|transversal|lateral",
    "z": "heave",
}
VECTORS = tuple(
    Rule("dvl", f"{axis}_mps", "velocity", f"(v|vel|velocity|velocities|speeds?)_?({axis}|{number})|{named}")
    for number, (axis, named) in enumerate(NAMES_OF_AXES.items())
)
YAW = Rule("compass", "heading_deg", "angle", "yaw")  # whose sense the doctor finds
FLAG = Rule("", "valid", None, "valid|bottom_lock|locked")
KEYS = {
    "x_mps": "x",
    "y_mps": "y",
    "z_mps": "z",
    "forward_mps": "x",
    "starboard_mps": "y",
    "up_mps": "z",
    "heading_deg": "heading",
    "pressure_pa": "pressure",
    "east_m": "x",
    "north_m": "y",
}
"""usbldr's own columns and the keys of ``columns`` for them, if these are others."""
AXES = {("forward_mps", 1): "F", ("starboard_mps", 1): "S", ("starboard_mps", -1): "P", ("up_mps", 1): "U"}
WHY = "CHECK: proposed from the names of its fields; confirm quantities, units and axes"


@dataclass(frozen=True, slots=True)
class Proposal:
    """The columns that a topic of an unknown type could have."""

    topic: TopicInfo
    columns: Mapping[str, str]
    axes: str = ""  # that the names state
    others: tuple[str, ...] = ()  # topics that look like the sensor, too

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Return the keys and their reasons for a configuration."""
        text = ", ".join(f"{key} = {quoted(path)}" for key, path in self.columns.items())
        which = f"; it could be {' or '.join(self.others)}" if self.others else ""
        what = f"{self.topic.type}, {self.topic.count} messages" if self.topic.count else "by the names of its columns"
        return [
            (f"topic = {quoted(self.topic.name)}", f"{what}{which}"),
            (f"columns = {{ {text} }}", WHY),
        ]


def examine_with_proposals(
    path: Path, request: Request
) -> tuple[Examination, Mapping[str, Proposal], Mapping[str, str]]:
    """Examine a log without a configuration, with proposed columns for the sensors that it lacks.

    If these cannot be used, the log is examined without them; then also why, for each sensor without which it cannot be
    replayed. Raises LogError if the log cannot be opened.
    """
    proposals = proposed_columns(path, request)
    sections = {
        role: {"topic": one.topic.name, "columns": dict(one.columns), **({"axes": one.axes} if one.axes else {})}
        for role, one in proposals.items()
    }
    tried, fault = None, ""
    if proposals:
        stated = ConfigurationFile(None, msgspec.convert(sections, Configuration))
        try:
            tried = examine(path, replace(request, configuration=stated))
        except UsbldrError as err:  # the names misled
            fault = err.text_beside(path)
        if tried is not None and tried.log is not None:
            return tried, proposals, {}
    without = examine(path, request)
    if tried is not None and without.log is None:
        return tried, proposals, {}
    if tried is not None:
        fault = next((one.text for one in tried.findings if one.code == "UNUSABLE"), "")
    why = f"the columns that the names suggest cannot be used: {fault}"
    return without, {}, {role: why for role in proposals if role in SENSORS and fault}


def unread_sensors(path: Path, request: Request) -> Mapping[str, str]:
    """Return sensor -> why the topic that is named for it cannot be read."""
    opened = open_configured(path, request)
    unresolved = roles_of(opened.reader.topics(), request, opened).unresolved
    faults = {role: fault for role, fault in unresolved.items() if isinstance(fault, LogError)}
    return {role: fault.text_beside(path).removesuffix(f"; {PROPOSED}") for role, fault in faults.items()}


def proposed_columns(path: Path, request: Request) -> dict[str, Proposal]:
    """Return role -> proposal for the roles that no topic fills and no option names."""
    opened = open_configured(path, request)
    topics = opened.reader.topics()
    roles = roles_of(topics, request, opened)
    unknown = [topic for topic in topics if _unknown(topic)]
    found: dict[str, Proposal] = {}
    for role in ROLES:
        own = any(topic.type == f"usbldr/{role}" for topic in unknown)  # a file that its name gives to the sensor
        if role not in roles.chosen and (own or role not in roles.unresolved) and role not in request.topics:
            fitting = [(topic, columns) for topic in unknown if (columns := _columns(role, topic))]
            fitting.sort(key=lambda one: (role not in suggested_sensors(one[0].name), -one[0].count))
            if fitting:
                (topic, columns), *others = fitting
                found[role] = _proposal(topic, columns, tuple(other.name for other, _ in others))
    return found


def _unknown(topic: TopicInfo) -> bool:
    name = topic.name.lower()
    known = any(message_layout_of(role, topic) for role in LAYOUTS)
    readable = bool(topic.count) and not topic.problem
    named = not NO_SENSOR.search(name) and not SHIP.search(name)
    return (readable or bool(topic.first_row)) and not known and named


def _columns(role: str, topic: TopicInfo) -> dict[str, NamedColumn]:
    """Return own column -> field for a topic that looks like a sensor, empty if it does not."""
    paths = [name for name, _ in topic.first_row] or [path for one in topic.fields for path in _elements(one, topic)]
    found: dict[str, NamedColumn] = {}
    suggested = suggested_sensors(f"{topic.name} {topic.type}")
    if role == "depth" and "usbl" in suggested and role not in suggested:
        return {}  # the depth of a transponder is a fix's
    columns = [column for path in paths if (column := named_column(path, (*VECTORS, *RULES, YAW, FLAG)))]
    times = [column for column in columns if column.rule.key == "time"]
    if topic.first_row:
        others = (column for column in columns if column not in times)
        columns = [*dated_columns(dict(topic.first_row), times), *others]
    for column in columns:
        of_any = not column.rule.sensor and column.rule.dimension in ("time", None)
        hinted = role in suggested_sensors(f"{topic.name} {topic.type} {words_of(column.name)}")
        if of_any or (hinted and column.rule.sensor in (role, "")):
            if topic.first_row and column.rule.key in found:
                return {}  # two columns of one quantity
            found.setdefault(column.rule.key, column)
    if topic.first_row and _time_key(topic, found) is None:
        return {}
    complete = [needed for needed in NEEDED[role] if needed <= found.keys()]
    others = frozenset[str]().union(*NEEDED[role]).difference(*complete[:1])  # columns of another kind of position
    others |= frozenset({"elevation_deg"} if "slant_range_m" in others else ())
    return {key: column for key, column in found.items() if key not in others} if complete else {}


def _time_key(topic: TopicInfo, found: Mapping[str, NamedColumn]) -> str | None:
    """Return the key of ``columns`` for the time of a table by its unit and first value, None if they do not tell."""
    column = found.get("time")
    cell = dict(topic.first_row).get(column.name, "") if column else ""
    if column is None or ISO.fullmatch(cell) or not is_number(cell):
        return "time_unix_s" if ISO.fullmatch(cell) else None
    if of_gps(column, cell):
        return None
    units = {key for key, ns in TIME_UNITS_NS.items() if not column.known or ns == column.factor}
    own_clock = "time_s" if "time_s" in units and abs(float(cell)) * 1e9 < SINCE_NS else None
    return next((key for key in keys_since_1970(cell) if key in units), own_clock)


def _elements(field: str, topic: TopicInfo) -> Sequence[str]:
    return [f"{field}[{number}]" for number in range(3)] if field in topic.arrays else [field]


def _proposal(topic: TopicInfo, found: Mapping[str, NamedColumn], others: tuple[str, ...]) -> Proposal:
    columns: dict[str, str] = {}
    if "forward_mps" in found:
        found = {key: column for key, column in found.items() if key not in ("x_mps", "y_mps", "z_mps")}
    for key, column in found.items():
        if key == "time" and topic.first_row:
            columns[str(_time_key(topic, found))] = column.name
        elif key == "time":
            keys = [one for one, unit_ns in TIME_UNITS_NS.items() if column.known and unit_ns == column.factor]
            if keys and not topic.has("header.stamp"):
                columns[keys[0]] = column.name
        elif key != "received":
            columns[KEYS.get(key, key)] = column.name
    columns |= side_columns(columns, dict(topic.first_row))
    signs = {key: round(column.rule.sign) for key, column in found.items()}
    named = [(key, signs.get(key, 1)) for key in ("forward_mps", "starboard_mps", "up_mps")]
    axes = "".join(AXES.get(one, "D") for one in named) if "forward_mps" in found else ""
    return Proposal(topic, columns, axes, others)
