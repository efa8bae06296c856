"""Columns for topics of unknown types that look like a missing sensor, by the names of topic, type and fields.

A proposal, which the user has to confirm: a name states neither axes nor, in most cases, units.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path
from typing import cast

import msgspec

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.doctor.doctor import Examination, examine
from usbldr.io.messages.configured import TIME_UNITS_NS
from usbldr.io.messages.field_names import NEEDED, RULES, NamedColumn, Rule, named_column, words_of
from usbldr.io.messages.registry import LAYOUTS, message_layout_of
from usbldr.io.messages.roles import ROLES, SENSORS, Roles
from usbldr.io.messages.topic_names import NO_SENSOR, SHIP, suggested_sensors
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import ConfigurationFile, Request, configuration_of, open_configured
from usbldr.io.reading.sensors import roles_of
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.toml_text import quoted
from usbldr.io.tables.csv_sheets import PROPOSED, side_columns
from usbldr.io.tables.time_columns import ISO, SINCE_NS, dated_columns, keys_since_1970, named_epoch, of_gps
from usbldr.io.tables.unnamed_columns import is_number

NAMES_OF_AXES = {
    "x": "u|surge|along(_track|ship)?|longitudinal|(fore|forward|fwd)_aft",
    "y": "v|sway|(across|athwart)(_track|ships?)?|transversal|lateral|port_(starboard|stbd)|(starboard|stbd)_port",
    "z": "w|heave|vertical|up_down",
}
VECTORS = tuple(
    Rule("dvl", f"{axis}_mps", "velocity", f"(v|vel|velocity|velocities|speeds?)_?({axis}|{number})|{named}")
    for number, (axis, named) in enumerate(NAMES_OF_AXES.items())
)
PLACES = (
    Rule("", "east_m", "length", "x|e"),  # the doctor finds the frame
    Rule("", "north_m", "length", "y|n"),
)
TARGET = re.compile(r"(^|_)target(_|$)")  # of a USBL system; of a controller it is where the vehicle should be
YAW = Rule("compass", "heading_deg", "angle", "yaw|kurs")  # whose sense the doctor finds; the second is German
FLAG = Rule("", "valid", None, "valid|bottom_lock|lock|locked")
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
WHY_MM = "CHECK: in m/s its velocities are impossible"
WHY_HEAD = "CHECK: the ship that carries the head; if the vehicle does, state beacon; lever_arm_m from antenna to head"
WHY = "CHECK: proposed from the names of its fields; confirm quantities, units and axes"


@dataclass(frozen=True, slots=True)
class Proposal:
    """The columns that a topic of an unknown type could have."""

    topic: TopicInfo
    columns: Mapping[str, str]
    others: tuple[str, ...] = ()  # topics that look like the sensor, too
    words: Mapping[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])  # key -> value, and why

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
        what = f"{self.topic.type}, {self.topic.count} messages" if self.topic.count else "by the names of its columns"
        return [
            (f"topic = {quoted(self.topic.name)}", f"{what}{which}"),
            (f"columns = {{ {text} }}", WHY),
        ]


@dataclass(frozen=True, slots=True)
class Draft:
    """A log as far as it can be read by what its configuration states and by what names of columns suggest."""

    examination: Examination
    stated: ConfigurationFile
    proposals: Mapping[str, Proposal]
    unread: Mapping[str, str]  # sensor that the configuration has to name -> why it is not read
    unused: tuple[TopicInfo, ...]  # topics of no sensor
    fault: str  # why the log cannot be replayed as drafted, empty if it can
    head: Mapping[str, object] = field(default_factory=dict[str, object])  # a ship's position and heading for the head


def draft(path: Path, request: Request) -> Draft:
    """Examine a log, with proposed columns for the sensors that it lacks; without them if they cannot be used.

    A truth that cannot be read is left out. Raises LogError if the log cannot be opened, UsageError if its
    configuration is invalid.
    """
    found = _draft(path, request)
    if found.examination.log is None and request.truth != "none":
        without = _draft(path, replace(request, truth="none"))
        if without.examination.log is not None:
            return replace(without, unread={**without.unread, "truth": found.fault}, fault=without.fault or found.fault)
    return found


def _draft(path: Path, request: Request) -> Draft:
    stated = configuration_of(path, request)
    request = replace(request, configuration=stated, set_keys=())
    opened = open_configured(path, request)
    topics = opened.reader.topics()
    roles = roles_of(topics, request, opened)
    proposals = proposed_columns(topics, roles, request)
    faults = {role: why for role, why in roles.unresolved.items() if isinstance(why, LogError)}
    unread = {role: why.text_beside(path) for role, why in faults.items() if role not in proposals}
    examination, fault = _with_proposals(path, request, stated, proposals) if proposals else (None, "")
    if "dvl" in proposals and (examination is None or examination.log is None):
        dvl = proposals["dvl"]
        in_mm = {**proposals, "dvl": replace(dvl, words={**dvl.words, "unit": ("mm/s", WHY_MM)})}
        again, _ = _with_proposals(path, request, stated, in_mm)
        if again is not None and again.log is not None:
            examination, proposals = again, in_mm
    head: Mapping[str, object] = {}
    if examination is None or examination.log is None:
        tried = [
            (keys, _with_proposals(path, request, _stating(stated, keys), proposals)[0])
            for keys in _of_ship(topics, roles, stated)
        ]
        readable = [(keys, found) for keys, found in tried if found is not None and found.log is not None]
        if readable:
            keys, examination = min(readable, key=lambda one: _unlike_fixes_m(one[1]))
            head = cast("Mapping[str, object]", keys["usbl"]["head"])
    if examination is None or examination.log is None:
        without = _examined(path, request, stated)
        if examination is None or without.log is not None:
            why = f"the columns that the names suggest cannot be used: {fault}"
            unread |= {role: why for role in proposals if role in SENSORS}
            examination, proposals = without, {}
    used = {role: choice.topic.name for role, choice in roles.chosen.items()}
    used |= {role: one.topic.name for role, one in proposals.items()}
    present = used if examination.log is None else examination.log.tables
    unusable = [one.text for one in examination.findings if one.code == "UNUSABLE"]
    left = [role for role in SENSORS if "none" in (request.topics.get(role), stated.settings.topic(role))]
    missing = [role for role in SENSORS if role not in (*present, *unread, *left)]
    absent = f"no topic is known to be {' or '.join(missing)}" if missing else ""
    absent += "; without it, only --filter usbl works" if missing and "usbl" in present else ""
    unread |= dict.fromkeys(missing, absent)
    unread = {role: why.removesuffix(f"; {PROPOSED}") for role, why in unread.items()}
    fault = next(filter(None, (*(why for why in unread.values() if why != absent), *unusable, absent)), "")
    unused = _unused(topics, used, {name for one in proposals.values() for name in one.columns.values()})
    return Draft(examination, stated, proposals, unread, unused, fault.removesuffix(f"; {PROPOSED}"), head)


def _unused(topics: Sequence[TopicInfo], used: Mapping[str, str], named: Collection[str]) -> tuple[TopicInfo, ...]:
    """Return the topics of no sensor, and tables with columns of none; those that proposals have ``named`` are used."""
    found: dict[TopicInfo, None] = {}
    for topic in topics:
        left = tuple(name for name in topic.unused if name not in named)
        if left or not (topic.table or (topic.name in used.values() and not topic.first_row)):
            found.setdefault(replace(_whole(topic), unused=left))
    return tuple(found)


def _of_ship(
    topics: Sequence[TopicInfo], roles: Roles, stated: ConfigurationFile
) -> list[dict[str, dict[str, object]]]:
    """Return sections that give the only GPS, and one of two headings, to the ship that carries the head.

    None if fixes do not count from a head by their type, or if the configuration states where the head is.
    """
    content = cast("Mapping[str, Mapping[str, object]]", stated.content or {})
    gps, headings = ([one.name for one in topics if message_layout_of(role, one)] for role in ("gps", "compass"))
    fixes = roles.chosen.get("usbl")
    from_head = fixes and (fixes.layout.defaults.get("relative_to") == "head" or "bearing_deg" in fixes.layout.required)
    if not from_head or len(gps) != 1 or not {"head", "beacon"}.isdisjoint(content.get("usbl", ())):
        return []
    if len(headings) != 2:
        return [{"usbl": {"head": {"topic": gps[0]}}}]
    return [
        {"usbl": {"head": {"topic": gps[0], "heading_topic": ship}}, "compass": {"topic": own}}
        for ship, own in permutations(headings)
    ]


def _unlike_fixes_m(found: Examination) -> float:
    """Return the residual of the fixes against dead reckoning."""
    return found.sensor_check.result.best.residual_m if found.sensor_check.result else math.inf


def _with_proposals(
    path: Path, request: Request, stated: ConfigurationFile, proposals: Mapping[str, Proposal]
) -> tuple[Examination | None, str]:
    """Return what the doctor finds with proposed columns, and why the log cannot be read with them."""
    proposed = _stating(stated, {role: one.keys for role, one in proposals.items()})
    try:
        found = _examined(path, replace(request, configuration=proposed), proposed)
    except UsbldrError as err:  # the names misled
        return None, err.text_beside(path)
    return found, next((one.text for one in found.findings if one.code == "UNUSABLE"), "")


def _examined(path: Path, request: Request, stated: ConfigurationFile) -> Examination:
    """Examine a log, again with headings in radians if the fixes show that they are; the first finding stays."""
    found = examine(path, request)
    radians = tuple(one for one in found.findings if one.code == "HEADING-RADIANS")
    if not radians:
        return found
    again = examine(path, replace(request, configuration=_stating(stated, {"compass": {"unit": "rad"}})))
    return replace(again, findings=(*radians, *again.findings))


def _stating(stated: ConfigurationFile, sections: Mapping[str, Mapping[str, object]]) -> ConfigurationFile:
    """Return a configuration with further keys."""
    content = dict(stated.content or {})
    for name, keys in sections.items():
        content[name] = {**cast("dict[str, object]", content.get(name, {})), **keys}
    return ConfigurationFile(stated.file, msgspec.convert(content, Configuration), content)


def proposed_columns(topics: Sequence[TopicInfo], roles: Roles, request: Request) -> dict[str, Proposal]:
    """Return role -> proposal for the roles that no topic fills and no option names."""
    unknown = [topic for topic in dict.fromkeys(map(_whole, topics)) if _unknown(topic)]
    unread = [topic.type for topic in topics if topic.first_row and topic.problem]
    found: dict[str, Proposal] = {}
    for role in ROLES:
        own = f"usbldr/{role}" in unread  # a file or columns that a name gives to the sensor
        if role not in roles.chosen and (own or role not in roles.unresolved) and role not in request.topics:
            fitting = [(topic, columns) for topic in unknown if (columns := _columns(role, topic))]
            fitting.sort(key=lambda one: (role not in suggested_sensors(one[0].name), -one[0].count))
            if fitting:
                (topic, columns), *others = fitting
                found[role] = _proposal(topic, columns, tuple(other.name for other, _ in others))
    return found


def _whole(topic: TopicInfo) -> TopicInfo:
    """Return the table of a topic that the names of its columns give, else the topic itself."""
    row = topic.first_row
    return TopicInfo(topic.table, "", topic.encoding, 0, None, None, first_row=row) if topic.table else topic


def _unknown(topic: TopicInfo) -> bool:
    name = topic.name.lower()
    known = any(message_layout_of(role, topic) for role in LAYOUTS)
    readable = bool(topic.count) and not topic.problem
    named = not NO_SENSOR.search(name) and (not SHIP.search(name) or "usbl" in suggested_sensors(name))
    return (readable or bool(topic.first_row)) and not known and named


def _columns(role: str, topic: TopicInfo) -> dict[str, NamedColumn]:
    """Return own column -> field for a topic that looks like a sensor, empty if it does not."""
    paths = [name for name, _ in topic.first_row] or [path for one in topic.fields for path in _elements(one, topic)]
    found: dict[str, NamedColumn] = {}
    suggested = suggested_sensors(f"{topic.name} {topic.type}")
    if role == "depth" and "usbl" in suggested and role not in suggested:
        return {}  # the depth of a transponder is a fix's
    columns = [column for path in paths if (column := named_column(path, (*VECTORS, *RULES, YAW, FLAG, *PLACES)))]
    times = [column for column in columns if column.rule.key == "time"]
    if topic.first_row:
        others = (column for column in columns if column not in times)
        columns = [*dated_columns(dict(topic.first_row), times), *others]
    of_all = bool(topic.first_row) and not suggested_sensors(topic.name)  # one table of all sensors
    for column in columns:
        of_any = not column.rule.sensor and column.rule.dimension in ("time", None)
        certain = column.rule in RULES and column.known and column.rule.dimension == "velocity"  # forward_kn
        certain = certain or (of_all and column.rule.dimension == "velocity")
        hinted = certain or role in suggested_sensors(f"{topic.name} {topic.type} {words_of(column.name)}")
        hinted = hinted or (of_all and role == "usbl" and bool(TARGET.search(words_of(column.name))))
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
    if epoch := named_epoch(column, cell):
        return epoch
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
    axes = "".join(AXES.get(one, "D") for one in named)
    words = {"axes": (axes, "by the names of its columns")} if "forward_mps" in found else {}
    return Proposal(topic, columns, others, words)
