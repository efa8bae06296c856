"""Columns for topics of unknown types that look like a missing sensor, by the names of topic, type and fields.

A proposal, which the user has to confirm: a name states neither axes nor, in most cases, units.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from usbldr.filters.errors import UsbldrError
from usbldr.io.doctor.doctor import Examination, examine
from usbldr.io.messages.configured import TIME_UNITS_NS
from usbldr.io.messages.field_names import NEEDED, RULES, NamedColumn, Rule, named_column, words_of
from usbldr.io.messages.registry import LAYOUTS, message_layout_of
from usbldr.io.messages.roles import ROLES
from usbldr.io.messages.topic_names import NO_SENSOR, SHIP, suggested_sensors
from usbldr.io.opening import ConfigurationFile, Request, open_configured
from usbldr.io.read import roles_of
from usbldr.io.reader import TopicInfo
from usbldr.io.settings.sensor_sections import Configuration

VECTORS = tuple(
    Rule("dvl", f"{axis}_mps", "velocity", f"(v|vel|velocity|velocities|speeds?)_?({axis}|{number})")
    for number, axis in enumerate("xyz")
)
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
        text = ", ".join(f"{key} = {json.dumps(path)}" for key, path in self.columns.items())
        which = f"; it could be {' or '.join(self.others)}" if self.others else ""
        return [
            (f"topic = {json.dumps(self.topic.name)}", f"{self.topic.type}, {self.topic.count} messages{which}"),
            (f"columns = {{ {text} }}", WHY),
        ]


def examine_with_proposals(path: Path, request: Request) -> tuple[Examination, Mapping[str, Proposal]]:
    """Examine a log without a configuration, with proposed columns for the sensors that it lacks, if those can be read.

    Raises LogError if it cannot be opened.
    """
    proposals = proposed_columns(path, request)
    sections = {
        role: {"topic": one.topic.name, "columns": dict(one.columns), **({"axes": one.axes} if one.axes else {})}
        for role, one in proposals.items()
    }
    if proposals:
        stated = ConfigurationFile(None, msgspec.convert(sections, Configuration))
        try:
            found = examine(path, replace(request, configuration=stated))
            if found.log is not None:
                return found, proposals
        except UsbldrError:
            pass  # the names misled
    return examine(path, request), {}


def proposed_columns(path: Path, request: Request) -> dict[str, Proposal]:
    """Return role -> proposal for the roles that no topic fills and no option names."""
    opened = open_configured(path, request)
    topics = opened.reader.topics()
    roles = roles_of(path, topics, request, opened.configuration)
    unknown = [topic for topic in topics if _unknown(topic)]
    found: dict[str, Proposal] = {}
    for role in ROLES:
        if role not in roles.chosen and role not in roles.unresolved and role not in request.topics:
            fitting = [(topic, columns) for topic in unknown if (columns := _columns(role, topic))]
            fitting.sort(key=lambda one: (role not in suggested_sensors(one[0].name), -one[0].count))
            if fitting:
                (topic, columns), *others = fitting
                found[role] = _proposal(topic, columns, tuple(other.name for other, _ in others))
    return found


def _unknown(topic: TopicInfo) -> bool:
    name = topic.name.lower()
    known = any(message_layout_of(role, topic) for role in LAYOUTS)
    return (
        bool(topic.count) and not topic.problem and not known and not NO_SENSOR.search(name) and not SHIP.search(name)
    )


def _columns(role: str, topic: TopicInfo) -> dict[str, NamedColumn]:
    """Return own column -> field for a topic that looks like a sensor, empty if it does not."""
    paths = [path for field in topic.fields for path in _elements(field, topic)]
    found: dict[str, NamedColumn] = {}
    for column in filter(None, (named_column(path, (*VECTORS, *RULES, FLAG)) for path in paths)):
        of_any = not column.rule.sensor and column.rule.dimension in ("time", None)
        hinted = role in suggested_sensors(f"{topic.name} {topic.type} {words_of(column.name)}")
        if of_any or (hinted and column.rule.sensor in (role, "")):
            found.setdefault(column.rule.key, column)
    return found if any(needed <= found.keys() for needed in NEEDED[role]) else {}


def _elements(field: str, topic: TopicInfo) -> Sequence[str]:
    return [f"{field}[{number}]" for number in range(3)] if field in topic.arrays else [field]


def _proposal(topic: TopicInfo, found: Mapping[str, NamedColumn], others: tuple[str, ...]) -> Proposal:
    columns: dict[str, str] = {}
    if "forward_mps" in found:
        found = {key: column for key, column in found.items() if key not in ("x_mps", "y_mps", "z_mps")}
    for key, column in found.items():
        if key == "time":
            keys = [one for one, unit_ns in TIME_UNITS_NS.items() if column.known and unit_ns == column.factor]
            if keys and not topic.has("header.stamp"):
                columns[keys[0]] = column.name
        elif key != "received":
            columns[KEYS.get(key, key)] = column.name
    signs = {key: round(column.rule.sign) for key, column in found.items()}
    named = [(key, signs.get(key, 1)) for key in ("forward_mps", "starboard_mps", "up_mps")]
    axes = "".join(AXES.get(one, "D") for one in named) if "forward_mps" in found else ""
    return Proposal(topic, columns, axes, others)
