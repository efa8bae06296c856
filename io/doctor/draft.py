"""A log examined as far as it can be read: by what its configuration states and by what names of columns suggest.

A proposal is kept if the log can be read with it. If it cannot be read without a head, its GPS and one of its headings
are taken for those of the ship that carries the head.
"""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path
from typing import cast

import msgspec

from usbldr.filters.errors import LogError, UsbldrError
from usbldr.io.conventions.compass import BEYOND, LARGER_CIRCLES
from usbldr.io.conventions.usbl import STATE_HEAD
from usbldr.io.doctor.doctor import Examination, examine, with_sensor_errors
from usbldr.io.doctor.proposed_columns import Proposal, proposed_columns, whole_table
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.messages.configured import QUATERNION
from usbldr.io.messages.field_names import ALONG_EARTH, earth_velocities
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import SENSORS, Roles, TopicChoice
from usbldr.io.messages.topic_names import names_ship, suggested_sensors
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import ConfigurationFile, Request, configuration_of, open_configured
from usbldr.io.reading.read import computed_tracks
from usbldr.io.reading.sensors import roles_of
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.tables.csv_sheets import PROPOSED
from usbldr.io.tables.date_times import of_times

WHY_MM = "CHECK: in m/s its velocities are impossible"
WHY_HEAD = "CHECK: the ship that carries the head; if the vehicle does, state beacon; lever_arm_m from antenna to head"


@dataclass(frozen=True, slots=True)
class Draft:
    """A log as far as it can be read by what its configuration states and by what names of columns suggest."""

    examination: Examination
    stated: ConfigurationFile
    proposals: Mapping[str, Proposal]
    unread: Mapping[str, str]  # sensor that the configuration has to name -> why it is not read
    unused: tuple[TopicInfo, ...]  # topics of no sensor
    fault: str  # why the log cannot be replayed as drafted, empty if it can
    of_ship: Mapping[str, object] = field(default_factory=dict[str, object])  # the head on a ship, and frame of fixes
    chosen: Mapping[str, TopicChoice] = field(default_factory=dict[str, TopicChoice])  # sensors without a proposal
    refused: Mapping[str, Proposal] = field(default_factory=dict[str, Proposal])  # with which the log cannot be read


def draft(path: Path, request: Request) -> Draft:
    """Examine a log, with proposed columns for the sensors that it lacks; without them if they cannot be used.

    A truth that cannot be read is left out. Raises LogError if the log cannot be opened, UsageError if its
    configuration is invalid.
    """
    found = _draft(path, request)
    if found.examination.log is None and request.truth != "none":
        without = _draft(path, replace(request, truth="none"))
        if without.examination.log is not None:
            unread = {**without.unread, "truth": found.fault}
            found = replace(without, unread=unread, fault=without.fault or found.fault)
    return replace(found, examination=with_sensor_errors(found.examination))


def _draft(path: Path, request: Request) -> Draft:
    """Return the draft without the errors of the sensors, which choose nothing."""
    stated = configuration_of(path, request)
    request = replace(request, configuration=stated, set_keys=())
    opened = open_configured(path, request)
    topics = opened.reader.topics()
    roles = roles_of(topics, request, opened)
    proposals = proposed_columns(topics, roles, request, stated.settings)
    faults = {role: why for role, why in roles.unresolved.items() if isinstance(why, LogError)}
    unread = {role: why.text_beside(path) for role, why in faults.items() if role not in proposals}
    examination, fault = _with_proposals(path, request, stated, proposals) if proposals else (None, "")
    needed = {role: one for role, one in proposals.items() if role in SENSORS}
    if needed and len(needed) < len(proposals) and (examination is None or examination.log is None):
        without, why = _with_proposals(path, request, stated, needed)
        if without is not None and without.log is not None:
            examination, proposals, fault = without, needed, why
    if "dvl" in proposals and (examination is None or examination.log is None):
        dvl = proposals["dvl"]
        in_mm = {**proposals, "dvl": replace(dvl, words={**dvl.words, "unit": ("mm/s", WHY_MM)})}
        again, _ = _with_proposals(path, request, stated, in_mm)
        if again is not None and again.log is not None:
            examination, proposals = again, in_mm
    if examination is not None and proposals:
        others = [*_in_angles(proposals, examination), *_scalar_elsewhere(proposals)]
        again = [(_with_proposals(path, request, stated, one)[0], one) for one in others]
        again = [(examination, proposals), *again]
        fitting = [(one, read) for one, read in again if one and one.log is not None and "DVL-UNIT" not in _codes(one)]
        if fitting:
            usual, less = proposals, THRESHOLDS.clearly_better_ratio
            examination, proposals = min(
                fitting, key=lambda one: _unlike_fixes_m(one[0]) * (less if one[1] is usual else 1.0)
            )
    counters = {one.topic for one in examination.findings if one.code == "FLAG-COUNTS"} if examination else set[str]()
    for role in [role for role, one in proposals.items() if one.topic.name in counters]:
        kept = {key: name for key, name in proposals[role].columns.items() if key != "valid"}
        proposals = {**proposals, role: replace(proposals[role], columns=kept)}
    of_ship: Mapping[str, object] = {}
    refused: Mapping[str, Proposal] = {}
    read = examination if examination is not None and examination.log is not None else None
    tried = [
        (
            keys["usbl"],
            read if read and not keys["usbl"] else _with_proposals(path, request, _stating(stated, keys), proposals)[0],
        )
        for keys in _of_ship(topics, roles, proposals, stated)
    ]
    readable = [(keys, found) for keys, found in tried if found is not None and found.log is not None]
    if readable:  # the more keys, the better the fit has to be
        ratio = THRESHOLDS.clearly_better_ratio
        of_ship, examination = min(readable, key=lambda one: _unlike_fixes_m(one[1]) / ratio ** len(one[0]))
    # if only the place of the head lacks, the proposals may be right
    if examination is None or (examination.log is None and not fault.endswith(STATE_HEAD)):
        without = _examined(path, request, stated)
        if examination is None or without.log is not None:
            why = f"the columns that the names suggest cannot be used: {fault}"
            unread |= {role: why for role in proposals if role in SENSORS}
            examination, proposals, refused = without, {}, proposals
    used = {role: choice.topic.name for role, choice in roles.chosen.items()}
    used |= {role: one.topic.name for role, one in proposals.items()}
    present = used if examination.log is None else examination.log.tables
    unusable = [one.text for one in examination.findings if one.code in ("UNUSABLE", "DVL-EARTH")]
    left = [role for role in SENSORS if "none" in (request.topics.get(role), stated.settings.topic(role))]
    missing = [role for role in SENSORS if role not in (*present, *unread, *left)]
    absent = f"no topic is known to be {' or '.join(missing)}" if missing else ""
    absent += "; without it, only --filter usbl works" if missing and "usbl" in present else ""
    if absent and not present:
        absent += "".join(f"; {name} {judged}" for name, judged in computed_tracks(path, topics).items())
    unread |= dict.fromkeys(missing, absent)
    earth = [names for topic in topics if (names := earth_velocities(topic.unused))]
    if "dvl" in missing and earth:
        unread["dvl"] = f"{absent}; {', '.join(earth[0])} are {ALONG_EARTH}"
    unread |= {role: text for role in missing if (text := not_read(examination, role))}
    unread = {role: why.replace(f"; {PROPOSED}", "") for role, why in unread.items()}
    fault = next(filter(None, (*(why for why in unread.values() if why != absent), *unusable, absent)), "")
    unused = _unused(topics, used, {name for one in proposals.values() for name in one.columns.values()})
    fault = fault.replace(f"; {PROPOSED}", "")
    return Draft(examination, stated, proposals, unread, unused, fault, of_ship, roles.chosen, refused)


def not_read(found: Examination, role: str) -> str:
    """Return the finding on a file or topic named for a sensor that is not read, empty if there is none."""
    unread = (one.text for one in found.findings if one.code in ("NOT-READ", "TOPIC-UNREAD"))
    return next((text for text in unread if role in suggested_sensors(text.partition(" ")[0])), "")


def _unused(topics: Sequence[TopicInfo], used: Mapping[str, str], named: set[str]) -> tuple[TopicInfo, ...]:
    """Return the topics of no sensor, and tables with columns of none; those that proposals have ``named`` are used."""
    found: dict[TopicInfo, None] = {}
    for topic in topics:
        columns = topic.unused if topic.table else [name for name, _ in topic.first_row]
        given = named if named.isdisjoint(columns) else named | of_times(columns)
        left = tuple(name for name in columns if name not in given)
        if left or not (columns or topic.table or topic.name in used.values()):
            found.setdefault(replace(whole_table(topic), unused=left))
    return tuple(found)


def _of_ship(
    topics: Sequence[TopicInfo], roles: Roles, proposals: Mapping[str, Proposal], stated: ConfigurationFile
) -> list[dict[str, dict[str, object]]]:
    """Return sections that give the ship that carries the head its GPS and heading: those named for a ship, else the
    only GPS and one of two headings.

    Fixes in metres may count from a named ship, or not; bearings and X, Y from its bow. None if the fixes do not count
    from a head, or if the configuration states where it is.
    """
    section = cast("Mapping[str, Mapping[str, object]]", stated.content or {}).get("usbl", {})
    gps, headings = ([one.name for one in topics if message_layout_of(role, one)] for role in ("gps", "compass"))
    ships, gyros = ([one for one in names if names_ship(one)] for names in (gps, headings))
    gps = ships or gps
    fixes, proposed = roles.chosen.get("usbl"), proposals.get("usbl")
    by_type: Mapping[str, object] = {**fixes.layout.defaults, **fixes.layout.fixed} if fixes else {}
    keys = proposed.keys if proposed else by_type
    quantities: Mapping[str, str] = fixes.layout.required if fixes else proposed.columns if proposed else {}
    from_head = keys.get("relative_to") == "head" or "bearing_deg" in quantities
    in_metres = ships and quantities and "lat_deg" not in quantities
    if not (from_head or in_metres) or len(gps) != 1 or not {"head", "beacon", "relative_to"}.isdisjoint(section):
        return []
    if len(gyros) != 1 and len(headings) == 2:
        return [
            {"usbl": {"head": {"topic": gps[0], "heading_topic": ship}}, "compass": {"topic": own}}
            for ship, own in permutations(headings)
        ]
    head = {"topic": gps[0]} | ({"heading_topic": gyros[0]} if len(gyros) == 1 else {})
    bows: list[dict[str, object]] = [{"frame": "body", "axes": axes} for axes in ("SFU", "FSD")]
    bows = [{"frame": "body"}] if "bearing_deg" in quantities else bows
    bows = [] if "frame" in {**keys, **section} or len(gyros) != 1 else bows
    found: list[dict[str, dict[str, object]]] = [{"usbl": {"head": head, **frame}} for frame in ({}, *bows)]
    return found if from_head else [{"usbl": {}}, *found]


def _unlike_fixes_m(found: Examination) -> float:
    """Return the residual of the fixes against dead reckoning."""
    return found.sensor_check.result.best.residual_m if found.sensor_check.result else math.inf


def _codes(found: Examination) -> set[str]:
    return {one.code for one in found.findings}


def _in_angles(proposals: Mapping[str, Proposal], found: Examination) -> list[Mapping[str, Proposal]]:
    """Return proposals with positions in other angles, if velocities are impossible with these.

    Latitudes and longitudes become radians if they can be some; x and y become longitude and latitude, or these
    exchanged.
    """
    impossible = found.log is not None and "DVL-UNIT" in _codes(found)
    topics = {one.topic for one in found.findings if one.code == "POSITION-RADIANS"}
    readings: list[Mapping[str, str]] = []
    if topics and (impossible or found.log is None):
        readings.append({"lat_deg": "lat_deg", "lon_deg": "lon_deg"})
    if impossible:
        readings += [{"lat_deg": "y", "lon_deg": "x"}, {"lat_deg": "x", "lon_deg": "y"}]
    places = {role: one for role, one in proposals.items() if role in ("usbl", "gps")}
    turned = [{role: _read_as(reading, one, topics) for role, one in places.items()} for reading in readings]
    return [{**proposals, **one} for one in turned if one != places]


def _scalar_elsewhere(proposals: Mapping[str, Proposal]) -> list[Mapping[str, Proposal]]:
    """Return proposals with the scalar of a quaternion behind its vector, if its parts have numbers alone."""
    heading = proposals.get("compass")
    parts = [heading.columns.get(key, "") for key in QUATERNION] if heading else []
    if heading is None or not all(re.search(r"\d\]?$", one) for one in parts):
        return []
    columns = {**heading.columns, **dict(zip(QUATERNION, (parts[-1], *parts[:-1]), strict=True))}
    return [{**proposals, "compass": replace(heading, columns=columns)}]


def _read_as(angles: Mapping[str, str], proposal: Proposal, in_radians: Collection[str]) -> Proposal:
    """Return a proposal with positions as angles from those of its columns, unchanged if it has others."""
    radians = "lat_deg" in angles.values()
    possible = proposal.topic.name in in_radians if radians else "frame" not in proposal.words
    if not possible or not {*angles.values()} <= proposal.columns.keys():
        return proposal
    own = {key: proposal.columns[of] + " [rad]" * radians for key, of in angles.items()}
    others = {key: name for key, name in proposal.columns.items() if key not in angles.values()}
    return replace(proposal, columns={**others, **own})


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
    """Examine a log, again with headings and pressures in a unit that fits, if the fixes or the values show another.

    The first findings stay.
    """
    found = examine(path, request, with_errors=False)
    units = {one: ("compass", "rad") for one in found.findings if one.code == "HEADING-RADIANS"}
    units |= {one: ("depth", one.unit) for one in found.findings if one.code == "DEPTH-UNIT" and one.unit}
    if units:
        again = examine(path, _in_units(request, stated, units.values()), with_errors=False)
        return replace(again, findings=(*units, *again.findings))
    if any(one.code == "UNUSABLE" and BEYOND in one.text for one in found.findings):
        requests = [_in_units(request, stated, [("compass", unit)]) for unit in LARGER_CIRCLES]
        tried = [examine(path, one, with_errors=False) for one in requests]
        return min((found, *tried), key=_unlike_fixes_m)
    return found


def _in_units(request: Request, stated: ConfigurationFile, units: Iterable[tuple[str, str]]) -> Request:
    """Return a request that states the units of sensors, too."""
    return replace(request, configuration=_stating(stated, {sensor: {"unit": unit} for sensor, unit in units}))


def _stating(stated: ConfigurationFile, sections: Mapping[str, Mapping[str, object]]) -> ConfigurationFile:
    """Return a configuration with further keys."""
    content = dict(stated.content or {})
    for name, keys in sections.items():
        content[name] = {**cast("dict[str, object]", content.get(name, {})), **keys}
    return ConfigurationFile(stated.file, msgspec.convert(content, Configuration), content)
