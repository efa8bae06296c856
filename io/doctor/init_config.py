"""A usbldr.toml for a log that has none: each line with the source of its value.

GPS only excludes the mirror image and proposes a map origin, as a comment; what a log cannot show is left for the
user to fill in.
"""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from usbldr.filters.errors import LogError
from usbldr.io.doctor.doctor import Examination
from usbldr.io.doctor.init_sensors import ConfigLine, compass_lines, dvl_lines, grid_lines, in_radians, usbl_lines
from usbldr.io.doctor.map_origin import propose_origin
from usbldr.io.doctor.proposed_columns import Proposal
from usbldr.io.doctor.sensor_errors import explanation_text
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log
from usbldr.io.messages.roles import ROLES
from usbldr.io.settings.configuration import own_configuration, parse_configuration
from usbldr.io.settings.toml_text import comment, quoted

COMMENT_COLUMN = 40  # where the comments of a file begin, so that its keys can be read

COLUMNS = {
    "dvl": 'x = "?", y = "?"',
    "compass": 'heading = "?"',
    "usbl": 'lat_deg = "?", lon_deg = "?"',
    "gps": 'lat_deg = "?", lon_deg = "?"',
    "depth": 'depth_m = "?"',
}
"""What a sensor's ``columns`` name at least, besides the time."""


def initial_configuration(
    examination: Examination,
    joined: tuple[str, ...] = (),
    proposals: Mapping[str, Proposal] = MappingProxyType({}),
    unread: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the text of a configuration for a log, with which it can be replayed if nothing is ``unread``.

    ``proposals`` were used to read it; what is missing of ``unread``, sensor -> why it cannot be read, is asked for.
    Raises LogError with what is missing if no configuration could help.
    """
    log, path = examination.log, examination.path
    fatal = [d.text for d in examination.findings if d.code in ("UNUSABLE", "SENSOR-MISSING")]
    if log is not None and "usbl" in log.tables:  # raw fixes can be judged without DVL and compass
        fatal = [d.text for d in examination.findings if d.code == "UNUSABLE"]
    if (log is None or fatal) and not (unread or (log is None and proposals)):
        raise LogError(fatal[0], path=path)
    if in_radians(examination):
        examination = replace(examination, sensor_check=None)  # its headings were read in another unit
    sections: dict[str, list[ConfigLine]] = {"map": _map(examination, log) if log else []}
    for role in ROLES:
        if role in proposals:
            sections[role] = proposals[role].lines
        elif role in unread:
            columns = f'time_unix_s = "?", {COLUMNS[role]}'
            sections[role] = [(f"# columns = {{ {columns} }}", f"CHECK: {unread[role]}")]
        elif log is not None:
            sections[role] = _topic(examination, log, role)
    lines = [
        comment(f"Settings for {path.name}, written by usbldr init from the log alone."),
        "# GPS only excludes the mirror image and proposes the map origin, if that is unknown; no other key uses it.",
        "# Signs: docs/configuration.md. Commented keys cannot be determined from the log; their values are proposals.",
    ]
    if log is not None:
        for role, lines_of in (("dvl", dvl_lines), ("compass", compass_lines), ("usbl", usbl_lines)):
            sections[role] += lines_of(examination, log) if role in log.tables else []
        sections["gps"] += grid_lines(log, "gps") if "gps" in log.tables else []
        sections["truth"] = _truth(log)
        lines += [*_convention_comments(examination), *_rival_comments(examination)]
    elif not unread:
        lines.append(comment(f"CHECK: {fatal[0]}"))
    lines.append("schema = 1")
    for name, rows in sections.items():
        if rows:
            empty = all(entry.startswith("#") for entry, _ in rows)  # a section without a key may not be allowed
            lines += ["", f"{'# ' if empty else ''}[{name}]", *(_row(*row) for row in rows)]
    for name in joined:
        relative = os.path.relpath(name, path.resolve().parent)
        lines += ["", "[[file]]", _row(f"path = {quoted(Path(relative).as_posix())}", "option --with")]
    text = "\n".join(lines) + "\n"
    parse_configuration(tomllib.loads(text), own_configuration(path, path.is_dir()))  # must always be accepted
    return text


def _row(entry: str, why: str) -> str:
    return f"{entry:{COMMENT_COLUMN - 2}}  {comment(why)}" if why else entry


def _convention_comments(examination: Examination) -> list[str]:
    result = examination.sensor_check.result if examination.sensor_check else None
    if result is None:
        why = "too few fixes, or they move unlike dead reckoning"
        if in_radians(examination):
            why = "headings were read as degrees, but are radians; run doctor with this file"
        return [f"# CHECK: axes, convention and frame could not be checked against the fixes: {why}."]
    best, read = result.best, result.as_read
    as_read = "" if best == read else f"; by types and names: {read.residual_m:.2f} m"
    by_best = f"{best.residual_m:.2f} m RMS with these axes, convention and frame"
    lines = [f"# Dead-reckoning-to-fix residual: {by_best}{as_read}."]
    if not result.observable:
        others = [r for r in result.plausible if r.mirror_class != best.mirror_class]
        lines.append(f"# CHECK: {others[0].description} fits nearly as well ({others[0].residual_m:.2f} m).")
    if result.decided_by is not None:
        lines.append(f"# Mirror image excluded by: {result.decided_by.name}.")
    elif result.mirror_image is not None:
        lines.append(
            f"# CHECK: their mirror image ({result.mirror_image.description}) fits as well; nothing in the log decides."
        )
    return lines


def _rival_comments(examination: Examination) -> list[str]:
    found = examination.sensor_check.identification if examination.sensor_check else None
    if found is None or len(found.explanations) < 2:
        return []
    return ["# CHECK: the log does not decide between explanations of its fixes:"] + [
        f"#   {explanation_text(one)}" for one in found.explanations
    ]


def _map(examination: Examination, log: Log) -> list[ConfigLine]:
    if log.origin is None:
        return [("# origin_lat_deg = 0.0", "unknown: no latitude in the log"), ("# origin_lon_deg = 0.0", "")]
    who = log.origin.kind
    mark = ""
    lat_deg, lon_deg, check = log.origin.lat_deg, log.origin.lon_deg, examination.sensor_check
    if log.map_unknown:
        mark, who = "# ", f"CHECK: a guess ({who}); state the origin of the fixes' map, or head under [usbl]"
        guess = propose_origin(log, examination.timeline, check.result if check else None)
        if guess is not None:
            lat_deg, lon_deg = guess.lat_deg, guess.lon_deg
            gap_s = THRESHOLDS.max_pair_gap_s
            who = (
                f"CHECK: proposed from GPS ({guess.pairs} pairs within {gap_s:g} s, ±{guess.sd_m:.1f} m); "
                "do not use it in a run whose truth is GPS"
            )
    return [
        (f"{mark}origin_lat_deg = {lat_deg:.9f}", who),
        (f"{mark}origin_lon_deg = {lon_deg:.9f}", "" if mark else who),
    ]


def _topic(examination: Examination, log: Log, role: str) -> list[ConfigLine]:
    if role not in log.provenance:
        why = "no such topic in the log" + ("; only --filter usbl works" if role in ("dvl", "compass") else "")
        return [('topic = "none"', why)] if role != "usbl" else []
    p = log.provenance[role]
    why = f"{p.type}, {p.messages} messages, by {p.chosen_by}"
    if role in examination.alternatives:
        others = " or ".join(examination.alternatives[role])
        why = (
            f"CHECK: of those that move with the other sensors, the topic with the most messages; it could be {others}"
        )
    return [(f"topic = {quoted(p.topic)}", why)]


def _truth(log: Log) -> list[ConfigLine]:
    if log.truth is None or "truth" in log.provenance:
        return (
            [('# topic = "/gps/fix"', "no GPS in the log; name a truth, if there is one")] if log.truth is None else []
        )
    mark = "# " if log.truth.kind == "gps" else ""  # by the source, so that it stays right with another truth
    return [(f'{mark}kind = "{log.truth.kind}"', f"errors are measured against {log.truth.source}")]
