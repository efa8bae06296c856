"""Read a file to a Log."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError, UsageError
from usbldr.io.conventions import compass, dvl_depth, positions, tilt
from usbldr.io.conventions.attitude import roll_and_pitch_deg
from usbldr.io.conventions.clock_parts import in_time_order
from usbldr.io.conventions.clock_shift import align_clocks
from usbldr.io.conventions.dvl_depth import ConvertedTable
from usbldr.io.conventions.implausible import without_implausible
from usbldr.io.conventions.sanity import (
    covariance_findings,
    position_findings,
    repeated_fix_findings,
    truth_jump_findings,
    truth_overlap_findings,
    truth_underwater_findings,
)
from usbldr.io.conventions.time_series import time_series
from usbldr.io.conventions.timestamps import sorted_by_time
from usbldr.io.conventions.truth import by_fixes, read_truth_file, truth_from_table
from usbldr.io.conventions.usbl import FixContext, usbl
from usbldr.io.conventions.usbl_head import SHIP, ship_choices
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.log import COLUMNS, Log, missing_sensor_text
from usbldr.io.messages.configured import configured_columns
from usbldr.io.messages.layout_columns import columns_of_layouts
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.messages.roles import ROLES, Roles, TopicChoice, choose_roles, find_topic
from usbldr.io.provenance import Provenance, provenance_lines
from usbldr.io.reader import Reader, TopicInfo, utc
from usbldr.io.reading.opening import DEFAULT_REQUEST, OpenedLog, Request, digest_paths, open_configured
from usbldr.io.reading.role_records import read_roles
from usbldr.io.reading.truth_source import place_unknown, refuse_as_sensor, truth_kind, truth_section, truth_source
from usbldr.io.settings.configuration import parameters
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.stages import say, stage


def read_log(path: Path, request: Request = DEFAULT_REQUEST) -> Log:
    """Read a log in any format of detect.FORMATS.

    Raises LogError if it cannot be read or lacks a named topic, UsageError if options, configuration and log do not fit
    together. A missing sensor is no error here (see `require`).
    """
    return read(open_configured(path, request), request)


def require(log: Log, roles: Sequence[str]) -> None:
    """Raise LogError that lists the sensors of the log if one is missing."""
    for role in roles:
        if role not in log.tables:
            raise LogError(missing_sensor_text(log, role), path=log.path)


def configured_topics(configuration: Configuration) -> dict[str, str]:
    """Return role -> topic for the roles whose topic the configuration names."""
    return {role: name for role in ROLES if (name := configuration.topic(role)) is not None}


def roles_of(topics: Sequence[TopicInfo], request: Request, opened: OpenedLog) -> Roles:
    """Fill the roles; a ship's receiver or gyro that the configuration names for the head is not the vehicle's."""
    path, configuration = opened.reader.path, opened.configuration
    head, stated = configuration.usbl.head, configured_topics(configuration)
    ships = [find_topic(topics, name) for name in (head.topic, head.heading_topic) if name] if head else []
    named = [find_topic(topics, name) for name in (*request.topics.values(), *stated.values())]
    others = [topic for topic in topics if topic not in ships or topic in named]
    columns = configured_columns(configuration, request.topics)
    taken = [one.sensor for one in columns]
    more, found = columns_of_layouts(opened.layouts, others, {**stated, **request.topics}, taken)
    roles = choose_roles(path, others, request.topics, stated, (*columns, *more))
    return replace(roles, by_layout=found)


@stage("read the log")
def read(opened: OpenedLog, request: Request, raw_fields: Mapping[str, Sequence[str]] | None = None) -> Log:
    """Read an opened log (see `read_log`).

    With ``raw_fields`` (role -> fields), the log keeps the unconverted records of its roles, with these fields if the
    messages have them.
    """
    reader, configuration = opened.reader, opened.configuration
    if request.truth_frame is not None:
        section = msgspec.structs.replace(configuration.truth, frame=request.truth_frame)
        configuration = msgspec.structs.replace(configuration, truth=section)
    path, topics = reader.path, reader.topics()
    if not any(topic.count or topic.problem for topic in topics):
        raise _without_messages(reader)
    roles = roles_of(topics, request, opened)
    for fault in roles.unresolved.values():
        raise fault
    if not any(topic.count for topic in topics):
        raise _without_messages(reader)
    source = truth_source(path, topics, request, configuration)
    choices = dict(roles.chosen) | ({"truth": source.topic} if source.topic else {})
    choices |= ship_choices(path, topics, configuration.usbl.head) if "usbl" in choices else {}
    refuse_as_sensor(path, choices, None if source.off or source.file else "truth" if source.topic else "gps")
    try:
        tables, provenance, origin, findings, raws, attitude = _sensor_tables(
            reader, choices, configuration, source.chosen_by, raw_fields, request.part
        )
    except SettingError as err:
        raise UsageError(err.text, path=opened.file or path) from err
    _refuse_apart(path, tables)
    start_ns = _start_ns(tables, topics)
    if source.file is not None:
        truth_table, provenance["truth"], *_ = read_truth_file(
            source.file, source.chosen_by, configuration.truth, start_ns, origin
        )
    else:
        truth_table = tables.pop("truth", None if source.off else tables.get("gps"))
        if truth_table is not None and source.topic is None and configuration.truth.frame:
            text = "frame of [truth] is not used: the truth is the log's GPS, which is read by the frame of [gps]"
            findings.append(Finding("KEY-UNUSED", text))
    truth = None
    if truth_table is not None:
        name = provenance["truth" if "truth" in provenance else "gps"].topic
        kind = truth_kind(source, request, configuration)
        truth, more = truth_from_table(truth_table, name, start_ns, configuration.truth, kind)
        findings += more
        truth = replace(truth, place_unknown=place_unknown(provenance, origin))
        if "truth" in provenance and "usbl" in tables:
            truth, provenance["truth"], more = by_fixes(truth, provenance["truth"], tables["usbl"], start_ns)
            findings += more
    findings += [*truth_overlap_findings(truth, tables, start_ns), *truth_jump_findings(truth)]
    findings += position_findings(tables, provenance, origin)
    if truth_table is not None:
        findings += repeated_fix_findings(
            truth_table, provenance["truth" if "truth" in provenance else "gps"], start_ns
        )
    if truth is not None and truth.kind == "gps":
        findings += truth_underwater_findings(truth, provenance, tables)
    log = Log(
        path=path,
        sha256=digest_paths(opened.paths),
        format=reader.format,
        start_ns=start_ns,
        tables={role: _in_seconds(role, tables.pop(role), start_ns) for role in list(tables)},
        provenance=provenance,
        parameters=parameters(configuration),
        origin=origin,
        truth=truth,
        configuration=opened.file,
        settings=configuration,
        findings=(*reader.findings(), *roles.findings, *findings),
        attitude=None if attitude is None else _attitude_table(attitude, start_ns),
        unread={topic.name: topic.problem for topic in topics if topic.problem},
        raws=raws,
    )
    say(*_choices(log))
    return without_implausible(log)


def _choices(log: Log) -> list[str]:
    """Return how each sensor and the truth are read, and who chose it."""
    lines = [line for role, one in log.provenance.items() for line in provenance_lines(role, one)]
    return [*lines, f"truth: {f'{log.truth.source}, kind {log.truth.kind}' if log.truth else 'none'}"]


def _without_messages(reader: Reader) -> LogError:
    lost = "; ".join(finding.text for finding in reader.findings())
    unread = [f"{topic.name}: {topic.problem}" for topic in reader.topics() if topic.problem]
    if unread and not lost:
        more = f" (and {len(unread) - 1} more)" if len(unread) > 1 else ""
        return LogError(f"no topic can be read: {unread[0]}{more}", path=reader.path)
    return LogError("holds no messages" + (f" ({lost})" if lost else ""), path=reader.path)


def _timed_by_log(configuration: Configuration) -> frozenset[str]:
    sections = {role: configuration.section(role) for role in ROLES}
    return frozenset(role for role, section in sections.items() if section.time == "log")


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


def _sensor_tables(
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
    by_log = _timed_by_log(configuration)
    as_logged, found = in_time_order(in_file, by_log, part or configuration.part)
    del in_file
    raws, findings = align_clocks(as_logged, by_log)
    origin = plane_origin(configuration, raws)
    invalid = covariance_findings(raws)
    asked = {} if raw_fields is None else {role: raw for role, raw in as_logged.items() if role in ROLES} | evidence
    del as_logged  # the compass's records end in _converted
    made, more = _converted(configuration, raws, origin, truth_by)
    findings = [*found, *findings, *more]
    attitude = made["compass"].attitude if "compass" in made else None
    tables: dict[str, pd.DataFrame] = {}
    provenance: dict[str, Provenance] = {}
    for role in list(made):
        sensor = made.pop(role)
        tables[role], more = sorted_by_time(sensor.table, choices[role].topic.name, role)
        findings += [*sensor.findings, *more]
        provenance[role] = _provenance(choices[role], sensor, tables[role])
    return SensorTables(tables, provenance, origin, [*findings, *invalid], asked, attitude)


def _tilted(configuration: Configuration, choices: Mapping[str, TopicChoice]) -> bool:
    """Return whether roll and pitch of the compass may be used: to turn velocities or lever arms level."""
    levelled = configuration.dvl.level is not False and ("depth" in choices or configuration.dvl.level is True)
    levelled = levelled or (configuration.usbl.level and "usbl" in choices)
    return levelled or any((*configuration.usbl.lever_arm_m, *configuration.gps.lever_arm_m))


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
        depths = time_series(made["depth"], "depth", ["depth_m"]) if "depth" in made else None
        fixes = usbl(raws["usbl"], configuration.usbl, origin, FixContext(raws, made.get("compass"), depths))
        made["usbl"] = tilt.level_lever_arm(fixes, made.get("compass"), configuration.usbl.lever_arm_m)
    if "gps" in raws:
        try:
            surfaced = positions.gps(raws["gps"], configuration.gps, origin)
            made["gps"] = tilt.level_lever_arm(surfaced, made.get("compass"), configuration.gps.lever_arm_m)
        except LogError as err:
            findings.append(Finding("GPS-INVALID", str(err), err.topic))
    if "truth" in raws:
        made["truth"] = positions.gps(raws["truth"], truth_section(configuration, raws, truth_by), origin)
    return {role: made[role] for role in (*ROLES, "truth") if role in made}, findings


def _start_ns(tables: Mapping[str, pd.DataFrame], topics: Sequence[TopicInfo]) -> int:
    """Return the earliest stamp of the DVL, compass and USBL records used; without any, of all records."""
    used = [tables[role] for role in ("dvl", "compass", "usbl") if role in tables]
    used = [table[table["valid"]] if "valid" in table else table for table in used] or list(tables.values())
    if used:
        return min(int(table["stamp_ns"].min()) for table in used)
    return min(topic.first_ns for topic in topics if topic.first_ns is not None)


def _refuse_apart(path: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Raise LogError with each sensor's span if DVL, compass and USBL do not overlap in time."""
    spans = {
        role: (int(tables[role]["time_ns"].min()), int(tables[role]["time_ns"].max()))
        for role in ("dvl", "compass", "usbl")
        if role in tables
    }
    if spans and max(first for first, _ in spans.values()) > min(last for _, last in spans.values()):
        spans_text = ", ".join(f"{role} {utc(first)} to {utc(last)}" for role, (first, last) in spans.items())
        hint = 'if a clock is wrong, try time = "log" or state latency_s'
        hint += "; of a file without dates, state date under [[file]]" * (" 1970-" in spans_text)
        raise LogError(f"the sensors do not overlap in time: {spans_text}; {hint}", path=path)


def _provenance(choice: TopicChoice, made: ConvertedTable, table: pd.DataFrame) -> Provenance:
    used = int(table["valid"].sum()) if "valid" in table else len(table)
    topic = choice.topic
    return Provenance(topic.name, topic.type, choice.chosen_by, made.conventions, topic.count, used, made.geodetic)


def _attitude_table(made: ConvertedTable, start_ns: int) -> pd.DataFrame:
    series = time_series(made, "compass", compass.VERTICAL)
    roll_deg, pitch_deg = roll_and_pitch_deg(series.values).T
    return pd.DataFrame(
        {"time_s": (series.time_ns - start_ns) / 1e9, "roll_deg": roll_deg, "pitch_deg": pitch_deg}, copy=False
    )


def _in_seconds(role: str, table: pd.DataFrame, start_ns: int) -> pd.DataFrame:
    """Return the table with times in seconds; of its own, only the columns in use stay in memory."""
    columns = {str(name): column.to_numpy() for name, column in table.items()}
    del table, columns["stamp_ns"]
    for name in ("time", "received"):
        time_ns = columns.pop(f"{name}_ns")
        columns[f"{name}_s"] = seconds = np.empty(len(time_ns))
        for rows in blocks(len(seconds)):
            seconds[rows] = (time_ns[rows] - start_ns) / 1e9
    return pd.DataFrame({name: columns[name] for name in COLUMNS[role]}, copy=False)
