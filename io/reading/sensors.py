"""From the topics of a log to canonical records of each sensor: which topic is which sensor, by what conventions."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError
from usbldr.io.conventions import compass, dvl_depth, positions, tilt
from usbldr.io.conventions.clock_parts import in_time_order
from usbldr.io.conventions.converted import ConvertedTable
from usbldr.io.conventions.grids import off_grids
from usbldr.io.conventions.sanity import covariance_findings
from usbldr.io.conventions.timestamps import align_clocks, sorted_by_time
from usbldr.io.conventions.usbl import usbl
from usbldr.io.conventions.usbl_head import SHIP
from usbldr.io.conventions.usbl_selection import records_of_one
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.messages.configured import ConfiguredColumns, configured_columns, field_of
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import ROLES, Roles, TopicChoice, candidates, choose_roles, find_topic
from usbldr.io.provenance import Convention, Provenance
from usbldr.io.reader import Reader, TopicInfo
from usbldr.io.reading.opening import OpenedLog, Request
from usbldr.io.reading.role_records import read_roles
from usbldr.io.reading.unread_positions import unread_positions
from usbldr.io.settings.layout_files import LayoutEntry, LayoutFile
from usbldr.io.settings.sensor_sections import Configuration, GpsSection


def roles_of(topics: Sequence[TopicInfo], request: Request, opened: OpenedLog) -> Roles:
    """Fill the roles; a ship's receiver or gyro that the configuration names for the head is not the vehicle's."""
    path, configuration = opened.reader.path, opened.configuration
    head = configuration.usbl.head
    stated = {role: name for role in ROLES if (name := configuration.topic(role)) is not None}
    ships = [find_topic(topics, name) for name in (head.topic, head.heading_topic) if name] if head else []
    named = [find_topic(topics, name) for name in (*request.topics.values(), *stated.values())]
    others = [topic for topic in topics if topic not in ships or topic in named]
    columns = configured_columns(configuration, request.topics)
    taken = [one.sensor for one in columns]
    more, found = columns_of_layouts(opened.layouts, others, {**stated, **request.topics}, taken)
    roles = choose_roles(path, others, request.topics, stated, (*columns, *more))
    left = {role for role, name in {**stated, **request.topics}.items() if name == "none"}
    truth = f"/{Path(request.truth or configuration.truth.file or '').stem}"
    free = [topic for topic in others if (topic.table or topic.name) != truth]
    unread = unread_positions(free, {"usbl", "gps"} - roles.chosen.keys() - roles.unresolved.keys() - left)
    return replace(roles, findings=(*found, *roles.findings, *unread))


def plane_origin(configuration: Configuration, raws: Mapping[str, RawRecords]) -> Origin | None:
    """Return the plane's origin: [map], else the fixed USBL head or beacon, else the first valid fix, else none.

    The GPS, which may be the truth, comes after the USBL.
    """
    if configuration.map is not None:
        return Origin(configuration.map.origin_lat_deg, configuration.map.origin_lon_deg, OriginKind.MAP)
    ends = ((configuration.usbl.head, OriginKind.HEAD), (configuration.usbl.beacon, OriginKind.BEACON))
    for end, kind in ends:
        if end is not None and end.lat_deg is not None and end.lon_deg is not None:
            return Origin(end.lat_deg, end.lon_deg, kind)
    firsts = {
        "usbl": OriginKind.FIRST_USBL,
        "gps": OriginKind.FIRST_GPS,
        "truth": OriginKind.FIRST_TRUTH,
        SHIP: OriginKind.FIRST_GPS,
    }
    for role, kind in firsts.items():
        wanted = raws[role].layout.required if role == "usbl" and role in raws else ("lat_deg",)
        if role in raws and "lat_deg" in raws[role].values and "lat_deg" in wanted:
            bad = np.any(list(positions.place_causes(raws[role]).values()), axis=0)
            lat, lon = (degrees[~bad] for degrees in positions.geodetic(raws[role]))
            if len(lat):
                return Origin(float(lat[0]), float(lon[0]), kind)
    return None


class SensorTables(NamedTuple):
    """Canonical records by role, how they were read, and the unconverted records if they were asked for."""

    tables: dict[str, pd.DataFrame]
    provenance: dict[str, Provenance]
    origin: Origin | None
    findings: list[Finding]
    raws: dict[str, RawRecords]
    attitude: ConvertedTable | None


def sensor_tables(
    reader: Reader,
    choices: Mapping[str, TopicChoice],
    configuration: Configuration,
    truth_by: str,
    raw_fields: Mapping[str, Sequence[str]] | None,
    part: str | None,
) -> SensorTables:
    """Read and convert the chosen topics; the unconverted records, larger than the tables, end here unless asked for.

    Raises SettingError for a setting that does not fit a topic.
    """
    in_file, evidence = read_roles(reader, choices, raw_fields or {}, _tilted(configuration, choices))
    by_log = frozenset(role for role in ROLES if configuration.section(role).time == "log")
    devices, one_device = of_devices(in_file, configuration)
    as_logged, found = in_time_order(in_file, by_log, part or configuration.part)
    del in_file
    raws, findings = align_clocks(as_logged, by_log)
    raws, configuration, grids = off_grids(raws, configuration)
    origin = plane_origin(configuration, raws)
    invalid = covariance_findings(raws)
    asked = {} if raw_fields is None else {role: raw for role, raw in as_logged.items() if role in ROLES} | evidence
    del as_logged  # the compass's records end in _converted
    made, more = _converted(configuration, raws, origin, truth_by)
    findings = [*one_device, *found, *findings, *more]
    attitude = made["compass"].attitude if "compass" in made else None
    tables: dict[str, pd.DataFrame] = {}
    provenance: dict[str, Provenance] = {}
    for role in list(made):
        sensor = made.pop(role)
        tables[role], more = sorted_by_time(sensor.table, choices[role].topic.name, role)
        findings += [*sensor.findings, *more]
        topic, by, records = choices[role].topic, choices[role].chosen_by, tables[role]
        how = (*devices.get(role, ()), *sensor.conventions, *([grids[role]] if role in grids else ()))
        used = int(records["valid"].sum()) if "valid" in records else len(records)
        provenance[role] = Provenance(topic.name, topic.type, by, how, choices[role].count, used, sensor.geodetic)
    return SensorTables(tables, provenance, origin, [*findings, *invalid], asked, attitude)


def of_devices(
    raws: dict[str, RawRecords], configuration: Configuration
) -> tuple[dict[str, list[Convention]], list[Finding]]:
    """Leave of each sensor the records of one device; raise UsageError if several measured and none is named."""
    chosen: dict[str, list[Convention]] = {}
    findings: list[Finding] = []
    for role in [one for one in raws if one != "usbl"]:  # whose targets are chosen when their clocks are compared
        of = "gps" if "gps" in raws and raws[role].topic == raws["gps"].topic else role
        stated = getattr(configuration.section(of), "device", None) if of in ROLES else None
        raws[role], chosen[role], found = records_of_one(raws[role], of, stated)
        findings += found if role == of else []
    return chosen, findings


def _tilted(configuration: Configuration, choices: Mapping[str, TopicChoice]) -> bool:
    """Return whether roll and pitch of the compass may be used: to turn velocities or lever arms level."""
    levelled = configuration.dvl.level is not False and ("depth" in choices or configuration.dvl.level is True)
    levelled = levelled or (configuration.usbl.level and "usbl" in choices)
    head_m = configuration.usbl.head.lever_arm_m if configuration.usbl.head else ()
    return levelled or any((*configuration.usbl.lever_arm_m, *configuration.gps.lever_arm_m, *head_m))


def _converted(
    configuration: Configuration, raws: dict[str, RawRecords], origin: Origin | None, truth_by: str
) -> tuple[dict[str, ConvertedTable], list[Finding]]:
    """Turn each sensor to canonical columns; take the compass, the largest, out of ``raws``.

    Depth and GPS without a valid record are findings, not errors.
    """
    made: dict[str, ConvertedTable] = {}
    findings: list[Finding] = []
    if "dvl" in raws:
        made["dvl"] = dvl_depth.dvl(raws["dvl"], configuration.dvl)
    if "compass" in raws:
        made["compass"] = compass.compass(raws.pop("compass"), configuration.compass, origin)
    if "depth" in raws:
        try:
            depth = dvl_depth.depth(raws["depth"], configuration.depth)
        except LogError as err:
            depth = Finding("DEPTH-INVALID", str(err), err.topic)
        if isinstance(depth, Finding):
            findings.append(depth)
        else:
            made["depth"] = depth
    if "dvl" in made:
        made["dvl"] = tilt.level_velocities(
            made["dvl"], made.get("compass"), made.get("depth"), configuration.dvl.level
        )
    if "usbl" in raws:
        fixes = usbl(configuration.usbl, raws, made, origin)
        made["usbl"] = tilt.level_lever_arm(fixes, made.get("compass"), configuration.usbl.lever_arm_m)
    if "gps" in raws:
        try:
            surfaced = positions.gps(raws["gps"], configuration.gps, origin)
            made["gps"] = tilt.level_lever_arm(surfaced, made.get("compass"), configuration.gps.lever_arm_m)
        except LogError as err:
            findings.append(Finding("GPS-INVALID", str(err), err.topic))
    if "truth" in raws:
        made["truth"] = positions.gps(raws["truth"], _truth_section(configuration, raws, truth_by), origin)
    return {role: made[role] for role in (*ROLES, "truth") if role in made}, findings


def _truth_section(configuration: Configuration, raws: Mapping[str, RawRecords], truth_by: str) -> GpsSection:
    """Return how a truth topic is read: as the GPS, if it is that, else by [truth] frame.

    A topic of latitudes that an option puts instead of the configured truth does not have that truth's frame.
    """
    same = "gps" in raws and raws["gps"].topic == raws["truth"].topic
    section = configuration.gps if same else GpsSection()
    if truth_by == "option" and "lat_deg" in raws["truth"].layout.required:
        return section
    return msgspec.structs.replace(section, frame=configuration.truth.frame or section.frame)


def columns_of_layouts(
    files: Sequence[LayoutFile], topics: Sequence[TopicInfo], named: Mapping[str, str], taken: Collection[str]
) -> tuple[tuple[ConfiguredColumns, ...], tuple[Finding, ...]]:
    """Return the columns of sensors that a layout file defines, and a finding for each.

    ``named``: sensor -> topic by option or configuration; ``taken``: sensors whose columns the configuration states. A
    file of the user comes before the types that usbldr knows, one of usbldr's own after them.
    """
    stated: dict[str, ConfiguredColumns] = {}
    findings: list[Finding] = []
    for file in files:
        for entry in file.entries:
            sensor, name = entry.sensor, named.get(entry.sensor)
            if sensor in stated or sensor in taken or name == "none":
                continue
            among = [topic for topic in (find_topic(topics, name),) if topic] if name else topics
            fitting = [topic for topic in among if topic.count and not topic.problem and _absent(entry, topic) == []]
            known = name and fitting and message_layout_of(sensor, fitting[0])
            if file.origin == "usbldr" and (known or (not name and candidates(sensor, topics).best)):
                continue
            if fitting:
                topic = max(fitting, key=lambda topic: topic.count).name
                stated[sensor] = ConfiguredColumns(sensor, topic, entry.columns, entry.unit, entry.conventions)
                text = f"by the layout file {file.path.name} ({file.origin}, sha256 {file.sha256[:16]})"
                findings.append(Finding("LAYOUT-FILE", f"{topic}: read as {sensor} {text}", topic))
            elif file.origin != "usbldr":
                findings += _unfitting(entry, file, among)
    return tuple(stated.values()), tuple(findings)


def _unfitting(entry: LayoutEntry, file: LayoutFile, topics: Sequence[TopicInfo]) -> Iterator[Finding]:
    """Report the topics that an entry defines without having its fields."""
    for topic in topics:
        if topic.count and (absent := _absent(entry, topic)):
            text = f"{topic.name}: not read as {entry.sensor} by the layout file {file.path.name}: it has no "
            yield Finding("LAYOUT-FILE", f"{text}{' and no '.join(absent)}", topic.name)


def _absent(entry: LayoutEntry, topic: TopicInfo) -> list[str] | None:
    """Return the fields of an entry that a topic of its type lacks; None if it is of another type."""
    stated = f"nmea/{entry.sentence.replace(',', '_')}" if entry.sentence else str(entry.type).replace("/msg/", "/")
    kind = topic.type.replace("/msg/", "/").replace(".", "/")
    same = kind.lower() == stated.lower() or (entry.type is not None and kind.lower().endswith(f"/{stated.lower()}"))
    names = entry.columns.values()
    return [name for name in names if not field_of(name, topic.fields, topic.arrays)] if same else None
