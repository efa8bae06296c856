"""Read a file to a Log."""

import math
import os
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError, UsageError
from usbldr.io.conventions import compass
from usbldr.io.conventions.attitude import roll_and_pitch_deg
from usbldr.io.conventions.converted import ConvertedTable
from usbldr.io.conventions.positions import EXCHANGED
from usbldr.io.conventions.sanity import position_findings, underwater_findings
from usbldr.io.conventions.shown_noise import examined
from usbldr.io.conventions.time_series import time_series
from usbldr.io.conventions.usbl import OF_HEAD_COLUMNS
from usbldr.io.conventions.usbl_head import ship_choices
from usbldr.io.findings import Finding
from usbldr.io.log import COLUMNS, Log, missing_sensor_text
from usbldr.io.messages.field_names import ALONG_EARTH, earth_velocities
from usbldr.io.messages.layouts import blocks
from usbldr.io.messages.registry import message_layout_of
from usbldr.io.messages.roles import SENSORS
from usbldr.io.provenance import provenance_lines
from usbldr.io.reader import Reader, TopicInfo, utc
from usbldr.io.reading.opening import DEFAULT_REQUEST, OpenedLog, Request, digest_paths, open_configured
from usbldr.io.reading.sensors import SensorTables, roles_of, sensor_tables
from usbldr.io.reading.truth import read_truth, refuse_as_sensor, truth_source
from usbldr.io.recordings.joined import JoinedLog
from usbldr.io.settings.configuration import parameters
from usbldr.io.settings.toml_text import quoted
from usbldr.io.stages import say, stage

COARSEST_S = 5.0  # of the times of DVL and compass: a vehicle turns about within
SHORTEST_LOG_S, MOST_IN_SHORT = 1.0, 100  # [s], [records] more of them in less time: stamps are of another unit
DAY_NS = 86_400_000_000_000  # fixed
USUAL_INTERVAL_S = 0.2  # [s] of records, to choose that unit: the usual rates lie within a factor 30 of it
HALF_HOUR_S = 1800  # fixed: time zones are so many apart
FARTHEST_ZONE_S = 14 * 3600  # fixed: of the Line Islands, from UTC
ZONE_TOLERANCE_S = 180.0  # [s] by judgement: loggers of a dive start or stop together


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
    choices |= ship_choices(path, topics, configuration.usbl.head, choices) if "usbl" in choices else {}
    refuse_as_sensor(path, choices, None if source.off or source.file else "truth" if source.topic else "gps")
    try:
        sensors = sensor_tables(reader, choices, configuration, source.chosen_by, raw_fields, request.part)
    except SettingError as err:
        raise UsageError(err.text, path=opened.file or path) from err
    _refuse_unit(path, sensors.tables)
    _refuse_coarse(path, sensors)
    _refuse_apart(reader, sensors)
    start_ns = _start_ns(sensors.tables, topics)
    truth, own, more = read_truth(source, request, configuration, sensors, start_ns)
    exchanged = [f.text for f in sensors.findings if f.code == "GPS-INVALID" and f.text.endswith(EXCHANGED)]
    tables, provenance = sensors.tables, sensors.provenance | own
    altitude = _altitude_table(tables["dvl"], start_ns) if "dvl" in tables else None
    findings = [*(Finding("SET", f"{text}, by --set") for text in request.set_keys), *roles.findings, *sensors.findings]
    if opened.left_out:
        text = (
            f"vehicle.yaml and mission.yaml state what usbldr.toml has no key for, and is not used: {opened.left_out}"
        )
        findings.append(Finding("NO-SUCH-KEY", text))
    findings += [*more, *_future_findings(path, start_ns), *position_findings(tables, provenance, sensors.origin)]
    tables = {role: _in_seconds(role, tables.pop(role), start_ns) for role in list(tables)}
    if (gps := provenance.get("gps")) and truth is not None and truth.kind == "gps" and truth.source == gps.topic:
        findings += underwater_findings(tables, gps.topic)
    log = Log(
        path=path,
        sha256=digest_paths(opened.paths),
        format=reader.format,
        start_ns=start_ns,
        tables=tables,
        provenance=provenance,
        parameters=parameters(configuration),
        origin=sensors.origin,
        truth=truth,
        truth_fault="".join(exchanged) if truth is None and not source.off else "",
        configuration=opened.file,
        settings=configuration,
        findings=tuple(dict.fromkeys([*reader.findings(), *findings])),  # sensors of one topic say the same of it
        altitude=altitude,
        attitude=None if sensors.attitude is None else _attitude_table(sensors.attitude, start_ns),
        unread=_unread(path, topics, tables),
        raws=sensors.raws,
    )
    say(*(line for role, one in log.provenance.items() for line in provenance_lines(role, one)))
    say(f"truth: {f'{log.truth.source}, kind {log.truth.kind}' if log.truth else 'none'}")
    return examined(log)


def _unread(path: Path, topics: Sequence[TopicInfo], sensors: Collection[str]) -> dict[str, str]:
    """Return topics that give no records, and why.

    Beside no sensor at all, also those of a computed track; without a DVL, tables with velocities along earth axes.
    """
    found = {topic.name: f"cannot be read: {topic.problem}" for topic in topics if topic.problem}
    earth = {topic.table: one for topic in topics if "dvl" not in sensors and (one := earth_velocities(topic.unused))}
    found |= {name: f"has {', '.join(one)}: {ALONG_EARTH}" for name, one in earth.items()}
    return found | ({} if sensors else computed_tracks(path, topics))


def computed_tracks(path: Path, topics: Sequence[TopicInfo]) -> dict[str, str]:
    """Return the topics of a computed track, and which command judges it."""
    judged = f"is a track: usbldr evaluate LOG --estimate {path.name} judges it beside the sensors of LOG"
    return {topic.name: judged for topic in topics if topic.count and message_layout_of("truth", topic)}


def _without_messages(reader: Reader) -> LogError:
    findings = [finding for finding in reader.findings() if not finding.code.startswith("DATE-")]
    lost = "; ".join(finding.text for finding in findings)
    unread = [f"{topic.name}: {topic.problem}" for topic in reader.topics() if topic.problem]
    if unread and not lost:
        more = f" (and {len(unread) - 1} more)" if len(unread) > 1 else ""
        return LogError(f"no topic can be read: {unread[0]}{more}", path=reader.path)
    return LogError("holds no messages" + (f" ({lost})" if lost else ""), path=reader.path)


def _start_ns(tables: Mapping[str, pd.DataFrame], topics: Sequence[TopicInfo]) -> int:
    """Return the earliest stamp of the DVL, compass and USBL records used; without any, of all records."""
    used = [tables[role] for role in SENSORS if role in tables]
    used = [table[table["valid"]] if "valid" in table else table for table in used] or list(tables.values())
    if used:
        return min(int(table["stamp_ns"].min()) for table in used)
    return min(topic.first_ns for topic in topics if topic.first_ns is not None)


def _future_findings(path: Path, start_ns: int) -> list[Finding]:
    """Report a log that begins after today: its times count from another moment than they were taken to."""
    if start_ns <= time.time_ns() + DAY_NS:
        return []
    text = f"{path.name}: its records begin at {utc(start_ns)}, after today by the clock of this computer; "
    text += "do their times count from another moment than 1970, as from 1904 (LabVIEW)?"
    return [Finding("CLOCK-FUTURE", text)]


def _refuse_unit(path: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Raise LogError if all stamps are the same, or, with the unit that fits, if they are not in the one assumed."""
    stamps_s = [np.sort(tables[role]["stamp_ns"].to_numpy()) / 1e9 for role in SENSORS if role in tables]
    span_s = max((float(np.ptp(each)) for each in stamps_s if len(each)), default=0.0)
    records = sum(map(len, stamps_s))
    if span_s >= SHORTEST_LOG_S or records <= MOST_IN_SHORT:
        return
    if not span_s:
        raise LogError(f"{records} records have one and the same time; export their times with more digits", path=path)
    interval_s = float(np.median(np.diff(max(stamps_s, key=len))))
    unit = min((1e3, 1e6, 1e9), key=lambda factor: abs(math.log(max(interval_s, 1e-12) * factor / USUAL_INTERVAL_S)))
    name, key = {1e3: ("microseconds", "us"), 1e6: ("milliseconds", "ms"), 1e9: ("seconds", "s")}[unit]
    text = (
        f"{records} records within {span_s:.2g} s: their stamps are probably {name}, not nanoseconds, of a log of "
        f'{span_s * unit:.0f} s; state columns = {{ time_unix_{key} = "time_ns", ... }} for each sensor'
    )
    raise LogError(text, path=path)


def _refuse_coarse(path: Path, sensors: SensorTables) -> None:
    """Raise LogError if the times of DVL or compass are so coarse that their records say little of the motion."""
    moving = {sensors.provenance[role].topic for role in ("dvl", "compass") if role in sensors.provenance}
    for found in sensors.findings:
        if found.code == "COARSE-TIMES" and found.topic in moving and (found.worst or 0.0) >= COARSEST_S:
            raise LogError(found.text, path=path)


def _refuse_apart(reader: Reader, sensors: SensorTables) -> None:
    """Raise LogError with each sensor's span if DVL, compass and USBL do not overlap in time."""
    tables = {role: sensors.tables[role]["time_ns"] for role in SENSORS if role in sensors.tables}
    spans = {role: (int(times.min()), int(times.max())) for role, times in tables.items()}
    if spans and max(first for first, _ in spans.values()) > min(last for _, last in spans.values()):
        spans_text = ", ".join(f"{role} {utc(first)} to {utc(last)}" for role, (first, last) in spans.items())
        role, other = max(spans, key=lambda one: spans[one][0]), min(spans, key=lambda one: spans[one][1])
        late, early = (
            [one for one, (first, last) in spans.items() if first <= spans[ref][1] and last >= spans[ref][0]]
            for ref in (role, other)
        )
        ahead = [one for one in late if one not in early]
        zone_s = _zone_s([spans[one] for one in ahead], [spans[one] for one in early if one not in late])
        files = {one: _file_of(reader, sensors.provenance[one].topic) for one in spans}
        moved = sorted({files[one] for one in ahead})
        named = " and ".join(f"[{one}]" for one in ahead)
        zone = f"of a time zone {zone_s / 3600:g} h ahead"
        if not {*moved}.isdisjoint(files[one] for one in early):
            hint = 'if a clock is wrong, try time = "log" or state latency_s'
            hint += f" ({zone_s} under {named}, if these times are {zone})" * (zone_s > 0)
        elif zone_s:
            paths = (os.path.relpath(file.resolve(), reader.path.resolve().parent) for file in moved)
            stated = " and ".join(f"path = {quoted(Path(one).as_posix())}" for one in paths)
            hint = f"if the times of {' and '.join(ahead)} are {zone}, state clock_offset_s = {zone_s} beside {stated}"
            hint += " under [[file]]" + ", one for each" * (len(moved) > 1)
        else:
            hint = "if a clock is wrong, state path and clock_offset_s of its file under [[file]]"
        (year, month, day), exchanged = (utc(spans[one][0])[:10].split("-") for one in (role, other))
        if month != day and exchanged == [year, day, month]:
            hint = f"day and month of {role} and {other} are exchanged: state time_format for one of them"
        hint += "; of files without dates, state path and date of each under [[file]]" * (" 1970-" in spans_text)
        raise LogError(f"the sensors do not overlap in time: {spans_text}; {hint}", path=reader.path)


def _zone_s(ahead: Sequence[tuple[int, int]], behind: Sequence[tuple[int, int]]) -> int:
    """Return by how many half hours the spans begin later, or else end later; 0 if by no number of them."""
    begin_ns = min(first for first, _ in ahead) - min(first for first, _ in behind)
    end_ns = max(last for _, last in ahead) - max(last for _, last in behind)
    for apart_s in (begin_ns / 1e9, end_ns / 1e9):
        zone_s = HALF_HOUR_S * round(apart_s / HALF_HOUR_S)
        if abs(apart_s - zone_s) < ZONE_TOLERANCE_S and 0 < zone_s <= FARTHEST_ZONE_S:
            return zone_s
    return 0


def _file_of(reader: Reader, topic: str) -> Path:
    """Return the file that holds a topic: of a folder of tables, the one that is named so."""
    if isinstance(reader, JoinedLog):
        held = [part.reader for part in reader.parts if topic in [one.name for one in part.reader.topics()]]
        return _file_of(held[0], topic) if held else reader.path
    files = sorted(reader.path.iterdir()) if reader.path.is_dir() else []
    return next((file for file in files if f"{topic}/".startswith(f"/{file.stem.replace('__', '/')}/")), reader.path)


def _attitude_table(made: ConvertedTable, start_ns: int) -> pd.DataFrame:
    series = time_series(made, "compass", compass.VERTICAL)
    roll, pitch = roll_and_pitch_deg(series.values).T
    time_s = (series.time_ns - start_ns) / 1e9
    return pd.DataFrame({"time_s": time_s, "roll_deg": roll, "pitch_deg": pitch}, copy=False)


def _altitude_table(dvl: pd.DataFrame, start_ns: int) -> pd.DataFrame | None:
    """Return the altitudes of a DVL's table by time; None if it has none."""
    if "altitude_m" not in dvl:
        return None
    known = dvl.loc[dvl["altitude_m"].notna(), ["time_ns", "altitude_m"]].sort_values("time_ns")
    seconds = (known["time_ns"].to_numpy(dtype=np.int64) - start_ns) / 1e9
    return pd.DataFrame({"time_s": seconds, "altitude_m": known["altitude_m"].to_numpy()})


def _in_seconds(role: str, table: pd.DataFrame, start_ns: int) -> pd.DataFrame:
    """Return the table with times in seconds; of its own, only the columns in use stay in memory."""
    columns = {str(name): column.to_numpy() for name, column in table.items()}
    del table, columns["stamp_ns"]
    for name in ("time", "received"):
        time_ns = columns.pop(f"{name}_ns")
        columns[f"{name}_s"] = seconds = np.empty(len(time_ns))
        for rows in blocks(len(seconds)):
            seconds[rows] = (time_ns[rows] - start_ns) / 1e9
    kept = COLUMNS[role] + tuple(name for name in OF_HEAD_COLUMNS if name in columns)
    return pd.DataFrame({name: columns[name] for name in kept}, copy=False)
