"""A usbldr.toml for a log that has none: each line with the source of its value.

GPS only excludes the mirror image and proposes a map origin, as a comment; what a log cannot show is left for the
user to fill in.
"""

import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import RAYLEIGH_MEDIAN, Points, as_points
from usbldr.io.conventions.usbl import STATE_HEAD
from usbldr.io.doctor.doctor import Examination
from usbldr.io.doctor.draft import WHY_HEAD, Draft, not_read
from usbldr.io.doctor.init_sensors import ConfigLine, compass_lines, dvl_lines, grid_lines, ships_gps, usbl_lines
from usbldr.io.doctor.interpretations import reinterpret
from usbldr.io.doctor.sensor_errors import explanation_text
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.geodesy import to_geodetic
from usbldr.io.log import Log
from usbldr.io.messages.roles import ROLES, SENSORS
from usbldr.io.reader import TopicInfo
from usbldr.io.reading.opening import ConfigurationFile
from usbldr.io.settings.configuration import own_configuration, parse_configuration
from usbldr.io.settings.toml_text import comment, inline, quoted
from usbldr.io.tables.text_table import listed
from usbldr.io.tables.time_columns import time_of

COMMENT_COLUMN = 40  # where the comments of a file begin, so that its keys can be read
MAX_TOPICS = 20  # of those that no sensor uses

COLUMNS = {
    "dvl": 'x = "?", y = "?"',
    "compass": 'heading = "?"',
    "usbl": 'lat_deg = "?", lon_deg = "?"',
    "gps": 'lat_deg = "?", lon_deg = "?"',
    "depth": 'depth_m = "?"',
    "truth": 'lat_deg = "?", lon_deg = "?"',
}
"""What a sensor's ``columns`` name at least, besides the time."""


def initial_configuration(drafted: Draft, joined: tuple[str, ...], target: Path) -> str:
    """Return the text of a configuration for a log, with which it can be replayed if the draft has no fault.

    Keys that the log's configuration states are kept, and its paths count from the ``target``; for what is missing the
    file asks.
    """
    examination, proposals = drafted.examination, drafted.proposals
    log, path = examination.log, examination.path
    sections: dict[str, list[ConfigLine]] = {"map": _map(examination, log) if log else []}
    for role in ROLES:
        if role in proposals:
            sections[role] = proposals[role].lines
        elif role in drafted.unread:
            sections[role] = _asked(drafted, role)
        elif log is not None:
            sections[role] = _topic(examination, log, role)
        elif role in drafted.chosen:
            topic, chosen_by = drafted.chosen[role].topic, drafted.chosen[role].chosen_by
            why = f"{topic.type}, {topic.count} messages, by {chosen_by}"
            sections[role] = [(f"topic = {quoted(topic.name)}", why)]
    lacks_head = drafted.fault.endswith(STATE_HEAD)
    if lacks_head:
        place = "{ lat_deg = ?, lon_deg = ?, depth_m = ? }"
        sections["usbl"] += [(f"# head = {place}", f"CHECK: {drafted.fault}"), (f"# beacon = {place}", "")]
    source = f"the log and {drafted.stated.file.name}" if drafted.stated.file else "the log alone"
    lines = [
        comment(f"Settings for {path.name}, written by usbldr init from {source}."),
        "# GPS only excludes the mirror image, and proposes its own latency, and the map origin, if that is unknown.",
        "# Signs: docs/configuration.md. Commented keys cannot be determined from the log; their values are proposals.",
    ]
    if log is not None:
        for role, lines_of in (("dvl", dvl_lines), ("compass", compass_lines), ("usbl", usbl_lines)):
            sections[role] += lines_of(examination, log) if role in log.tables else []
        for role, one in proposals.items():
            for key, (value, why) in one.words.items():
                entry = f"{key} = {quoted(value)}"
                if key != "unit" or entry in dict(sections[role]):  # else the fixes show another one
                    _keep(sections[role], entry, key, why)
        for key, value in drafted.of_ship.items():
            _keep(sections["usbl"], f"{key} = {inline(value)}", key, WHY_HEAD if key == "head" else "by the fixes")
        for one in (one for one in examination.findings if one.code == "DEPTH-UNIT"):
            if "depth" in log.tables:
                _keep(sections["depth"], f'unit = "{one.unit}"', "unit", "CHECK: the least pressure is that of the air")
            else:
                named = proposals["depth"].lines if "depth" in proposals else [(f"topic = {quoted(one.topic)}", "")]
                sections["depth"] = [*named, ('# unit = "?"', f"CHECK: {one.text}")]
        sections["gps"] += grid_lines(log, "gps") if "gps" in log.tables else []
        sections["truth"] = _asked(drafted, "truth") if "truth" in drafted.unread else _truth(examination, log)
        late_s = [one.worst or 0.0 for one in examination.findings if one.code == "TRUTH-CLOCK"]
        if log.truth is not None and late_s:
            why = "CHECK: its stamps against the fixes; only if the clock of the other sensors is right"
            sections[log.truth.section].append((f"# latency_s = {log.truth.latency_s + late_s[0]:.2f}", why))
        lines += [*_convention_comments(examination), *_rival_comments(examination)]
    if drafted.fault and drafted.fault not in drafted.unread.values() and not lacks_head:
        lines.append(comment(f"CHECK: {drafted.fault}"))
    missing = any(role not in proposals and (log is None or role not in log.tables) for role in SENSORS)
    lines += _unused_topics([topic for topic in drafted.unused if missing or topic.unused])
    lines.append("schema = 1")
    more = [{"path": Path(os.path.relpath(name, path.resolve().parent)).as_posix()} for name in joined]
    if drafted.stated.left_out:
        lines.insert(1, comment(f"Not converted, for there is no such key: {drafted.stated.left_out}."))
    lines += _keep_stated(sections, drafted.stated, more, target)
    for name, rows in sections.items():
        if rows:
            empty = all(entry.startswith("#") for entry, _ in rows)  # a section without a key may not be allowed
            lines += ["", f"{'# ' if empty else ''}[{name}]", *(_row(*row) for row in rows)]
    text = "\n".join(lines) + "\n"
    parse_configuration(tomllib.loads(text), own_configuration(path, path.is_dir()))  # must always be accepted
    return text


def _asked(drafted: Draft, role: str) -> list[ConfigLine]:
    """Return the lines that ask for the topic of a sensor, unless a file is named for it, and for its columns.

    The columns of a proposal that was refused are commented.
    """
    if role in drafted.refused:
        (first, _), *others = drafted.refused[role].lines
        return [(f"# {first}", f"CHECK: {drafted.unread[role]}"), *((f"# {entry}", why) for entry, why in others)]
    named = [topic for topic in drafted.unused if topic.type == f"usbldr/{role}"]
    only = named or [topic for topic in drafted.unused if len(drafted.unused) == 1]
    key, clock = time_of(only[0]) if only else ("time_unix_s", "?")
    topic = quoted(only[0].name if only else "?")
    keys = [] if named else ['# file = "?"' if role == "truth" else f"# topic = {topic}"]
    first, *others = [*keys, f"# columns = {{ {key} = {quoted(clock)}, {COLUMNS[role]} }}"]
    return [(first, f"CHECK: {drafted.unread[role]}"), *((key, "") for key in others)]


def _unused_topics(topics: Sequence[TopicInfo]) -> list[str]:
    """Return the topics with fields that no sensor uses, for which a section may ask."""
    fields = {one.name: one.unused or [name for name, _ in one.first_row] or one.shown_fields for one in topics}
    numbered = (one for one in topics if one.first_row[:1] and one.first_row[0][0] == "1")
    fields |= {one.name: [f"{number} ({cell})" for number, cell in one.first_row] for one in numbered}
    lines = [comment(f"  {name}: {listed(fields[name])}") for name in list(fields)[:MAX_TOPICS] if fields[name]]
    return ["# Topics and fields that no sensor uses, which topic and columns can name:", *lines] if lines else []


def _keep_stated(
    sections: dict[str, list[ConfigLine]], stated: ConfigurationFile, joined: Sequence[object], target: Path
) -> list[str]:
    """Put the keys that a configuration states in place of those found; return its lines outside sections."""
    who = f"stated in {stated.file.name}" if stated.file else "stated by --set"
    outside: list[str] = []
    files: list[object] = []
    for name, content in (stated.content or {}).items():
        if isinstance(content, dict):
            rows = sections.setdefault(name, [])
            for key, value in cast("dict[str, object]", content).items():
                moved = _moved(value, stated, target) if (name, key) == ("truth", "file") else value
                _keep(rows, f"{key} = {inline(moved)}", key, who)
        elif name == "file":
            others = cast("list[dict[str, object]]", content)
            files = [{**one, "path": _moved(one["path"], stated, target)} for one in others]
        elif name == "layouts":
            moved = [_moved(one, stated, target) for one in cast("list[str]", content)]
            outside.append(_row(f"layouts = {inline(moved)}", who))
    if files or joined:
        why = [who] * bool(files) + ["option --with"] * bool(joined)
        outside.append(_row(f"file = {inline([*files, *joined])}", ", ".join(why)))
    return outside


def _moved(name: object, stated: ConfigurationFile, target: Path) -> object:
    """Return a path that counts from the folder of a configuration as one that counts from the folder of another."""
    there = stated.file.resolve().parent / str(name) if stated.file else Path()
    moved = stated.file is not None and there.exists() and stated.file.resolve().parent != target.resolve().parent
    return Path(os.path.relpath(there, target.resolve().parent)).as_posix() if moved else name


def _keep(rows: list[ConfigLine], entry: str, key: str, who: str) -> None:
    """Put a stated key in its place, with the value found if that is another one."""
    place = next((i for i, row in enumerate(rows) if row[0].removeprefix("# ").partition(" = ")[0] == key), len(rows))
    found, why = rows[place] if place < len(rows) else (entry, "")
    rows[place : place + 1] = [(entry, who if found == entry else f"{who}; found: {found.removeprefix('# ')} ({why})")]


def _row(entry: str, why: str) -> str:
    return f"{entry:{COMMENT_COLUMN - 2}}  {comment(why)}" if why else entry


def _convention_comments(examination: Examination) -> list[str]:
    result = examination.sensor_check.result
    if result is None:
        why = "too few fixes, or they move unlike dead reckoning"
        return [f"# CHECK: axes, convention and frame could not be checked against the fixes: {why}."]
    best, read = result.best, result.as_read
    as_read = "" if best == read else f"; by types and names: {read.residual_m:.2f} m"
    by_best = f"{best.residual_m:.2f} m RMS with these axes, convention and frame"
    lines = [f"# Dead-reckoning-to-fix residual: {by_best}{as_read}."]
    if not result.observable:
        others = [r for r in result.plausible if r.mirror_class != best.mirror_class]
        lines.append(f"# CHECK: the log does not exclude {others[0].description} ({others[0].residual_m:.2f} m).")
    if result.decided_by is not None:
        lines.append(f"# Mirror image excluded by: {result.decided_by.name}.")
    elif result.mirror_image is not None:
        mirrored = result.mirror_image.description
        lines.append(f"# CHECK: their mirror image ({mirrored}) fits as well; nothing in the log decides.")
    return lines


def _rival_comments(examination: Examination) -> list[str]:
    found = examination.sensor_check.identification
    if found is None or len(found.explanations) < 2:
        return []
    explanations = (f"#   {explanation_text(one)}" for one in found.explanations)
    return ["# CHECK: the log does not decide between explanations of its fixes:", *explanations]


def _map(examination: Examination, log: Log) -> list[ConfigLine]:
    if log.origin is None:
        return [("# origin_lat_deg = 0.0", "unknown: no latitude in the log"), ("# origin_lon_deg = 0.0", "")]
    lat_deg, lon_deg, who, mark = log.origin.lat_deg, log.origin.lon_deg, log.origin.kind, ""
    if log.map_unknown:
        mark, who = "# ", f"CHECK: a guess ({who}); state the origin of the fixes' map, or head under [usbl]"
        guess = _proposed_origin(examination, log)
        if guess is not None:
            lat_deg, lon_deg, pairs = guess
            who = f"CHECK: proposed from GPS ({pairs}); do not use it in a run whose truth is GPS"
    return [
        (f"{mark}origin_lat_deg = {lat_deg:.9f}", who),
        (f"{mark}origin_lon_deg = {lon_deg:.9f}", "" if mark else who),
    ]


def _proposed_origin(examination: Examination, log: Log) -> tuple[float, float, str] | None:
    """Return the origin that brings the fixes, by their best interpretation, onto the GPS; None for too few pairs.

    It is latitude and longitude in degrees, and of how many pairs it was made: of GPS fixes near in time to USBL fixes.
    GPS is the truth, so the proposal must not reach a run unless the user states it.
    """
    timeline, result = examination.timeline, examination.sensor_check.result
    if timeline is None or log.origin is None or not len(timeline.fix_time_s) or not len(timeline.gps_time_s):
        return None
    line = reinterpret(log, timeline, result.best.flips) if result else timeline
    rows = np.interp(line.fix_time_s, line.gps_time_s, np.arange(len(line.gps_time_s)))
    nearest = np.rint(rows).astype(np.intp)
    paired = np.abs(line.gps_time_s[nearest] - line.fix_time_s) <= THRESHOLDS.max_pair_gap_s
    if paired.sum() < THRESHOLDS.min_pairs:
        return None
    shifts: Points = as_points(line.gps_m)[nearest[paired]] - as_points(line.fix_m)[paired]
    shift = complex(np.median(shifts.real), np.median(shifts.imag))
    lat, lon = to_geodetic(log.origin, np.array([shift.real]), np.array([shift.imag]))
    sd = float(np.median(np.abs(shifts - shift))) / RAYLEIGH_MEDIAN
    pairs = f"{paired.sum()} pairs within {THRESHOLDS.max_pair_gap_s:g} s, ±{sd:.1f} m"
    return float(lat[0]), float(lon[0]), pairs


def _topic(examination: Examination, log: Log, role: str) -> list[ConfigLine]:
    if role not in log.provenance:
        if why := not_read(examination, role):  # which "none" would leave out in silence
            return [('# topic = "?"', f"CHECK: {why}")]
        head = log.settings.usbl.head
        why = f"{head.topic} is the ship's" if role == "gps" and head and head.topic else "no such topic in the log"
        return [('topic = "none"', why)] if role != "usbl" else []
    p = log.provenance[role]
    if p.topic == ships_gps(examination):
        return [('topic = "none"', f"{p.topic} moves unlike the fixes and dead reckoning: it is the ship's")]
    why = f"{p.type}, {p.messages} messages, by {p.chosen_by}"
    if role in examination.alternatives:
        why = "CHECK: of those that move with the other sensors, the topic with the most messages; it could be "
        why += " or ".join(examination.alternatives[role])
    return [(f"topic = {quoted(p.topic)}", why)]


def _truth(examination: Examination, log: Log) -> list[ConfigLine]:
    if log.truth is None or ships_gps(examination):
        return [('# topic = "/gps/fix"', "no GPS of the vehicle in the log; name a truth, if there is one")]
    if "truth" in log.provenance:
        return []
    mark = "# " if log.truth.kind == "gps" else ""  # by the source, so that it stays right with another truth
    return [(f'{mark}kind = "{log.truth.kind}"', f"errors are measured against {log.truth.source}")]
