"""A usbldr.toml for a log that has none: each line with the source of its value.

GPS only excludes the mirror image and proposes a map origin, as a comment; what a log cannot show is left for the
user to fill in.
"""

import math
import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.frames import wrapped
from usbldr.io.conventions.timestamps import LOG_TIME
from usbldr.io.doctor.cross_check import (
    heading_offset_is_significant,
    latency_is_significant,
    scale_is_significant,
)
from usbldr.io.doctor.doctor import Examination
from usbldr.io.doctor.gross_errors import unit_or_scale_key
from usbldr.io.doctor.interpretations import InterpretationResult, recorded_value
from usbldr.io.doctor.map_origin import propose_origin
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log
from usbldr.io.messages.roles import ROLES
from usbldr.io.provenance import chosen_by_text, convention_text
from usbldr.io.settings.configuration import own_configuration, parse_configuration

ConfigLine: TypeAlias = tuple[str, str]  # a key and its value, and where the value comes from
COMMENT_COLUMN = 40  # where the comments of a file begin, so that its keys can be read
SD_KEYS = ("sd_mps", "sd_deg", "sd_m", "sd_rel", "covariance")


def initial_configuration(examination: Examination, joined: tuple[str, ...] = ()) -> str:
    """Return the text of a configuration with which the log can be replayed.

    Raises LogError with what is missing if no configuration could do that.
    """
    log = examination.log
    fatal = [d for d in examination.findings if d.code in ("UNUSABLE", "SENSOR-MISSING")]
    if log is None or fatal:
        raise LogError(fatal[0].text, path=examination.path)
    if _in_radians(examination):
        examination = replace(examination, sensor_check=None)  # its headings were read in another unit
    sections: dict[str, list[ConfigLine]] = {"map": _map(examination, log)}
    for role in ROLES:
        sections[role] = _topic(examination, log, role)
    sections["dvl"] += _dvl(examination, log)
    sections["compass"] += _compass(examination, log)
    sections["usbl"] += _usbl(examination, log)
    sections["truth"] = _truth(log)
    lines = [
        f"# Settings for {examination.path.name}, written by usbldr init from the log alone.",
        "# GPS only excludes the mirror image and proposes the map origin, if that is unknown; no other key uses it.",
        "# Signs: docs/configuration.md. Commented keys cannot be determined from the log; their values are proposals.",
        *_convention_comments(examination),
        "schema = 1",
    ]
    for name, rows in sections.items():
        if rows:
            empty = all(entry.startswith("#") for entry, _ in rows)  # a section without a key may not be allowed
            lines += ["", f"{'# ' if empty else ''}[{name}]", *(_row(*row) for row in rows)]
    for name in joined:
        relative = os.path.relpath(name, examination.path.resolve().parent)
        lines += ["", "[[file]]", _row(f'path = "{Path(relative).as_posix()}"', "option --with")]
    text = "\n".join(lines) + "\n"
    parse_configuration(tomllib.loads(text), own_configuration(log.path, log.path.is_dir()))  # must always be accepted
    return text


def _row(entry: str, why: str) -> str:
    return f"{entry:{COMMENT_COLUMN - 2}}  # {why}" if why else entry


def _convention_comments(examination: Examination) -> list[str]:
    result = examination.sensor_check.result if examination.sensor_check else None
    if result is None:
        why = "too few fixes"
        if _in_radians(examination):
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


def _map(examination: Examination, log: Log) -> list[ConfigLine]:
    if log.origin is None:
        return [("# origin_lat_deg = 0.0", "unknown: no latitude in the log"), ("# origin_lon_deg = 0.0", "")]
    who = log.origin.source
    comment = ""
    lat_deg, lon_deg, check = log.origin.lat_deg, log.origin.lon_deg, examination.sensor_check
    if map_origin_unknown(examination):
        comment, who = "# ", f"CHECK: a guess ({who}); state the origin of the fixes' map, or head under [usbl]"
        guess = propose_origin(log, examination.timeline, check.result if check else None)
        if guess is not None:
            lat_deg, lon_deg = guess.lat_deg, guess.lon_deg
            gap_s = THRESHOLDS.max_pair_gap_s
            who = (
                f"CHECK: proposed from GPS ({guess.pairs} pairs within {gap_s:g} s, ±{guess.sd_m:.1f} m); "
                "do not use it in a run whose truth is GPS"
            )
    return [
        (f"{comment}origin_lat_deg = {lat_deg:.9f}", who),
        (f"{comment}origin_lon_deg = {lon_deg:.9f}", "" if comment else who),
    ]


def map_origin_unknown(examination: Examination) -> bool:
    """Tell whether the fixes are local positions on a map whose origin is not stated."""
    return any(d.code == "MAP-UNKNOWN" for d in examination.findings)


def _topic(examination: Examination, log: Log, role: str) -> list[ConfigLine]:
    if role not in log.provenance:
        return [] if role in ("dvl", "compass", "usbl") else [('topic = "none"', "no such topic in the log")]
    p = log.provenance[role]
    why = f"{p.type}, {p.messages} messages, by {p.chosen_by}"
    if role in examination.alternatives:
        others = " or ".join(examination.alternatives[role])
        why = f"CHECK: the readable topic with the most messages; it could be {others}"
    return [(f'topic = "{p.topic}"', why)]


def _dvl(examination: Examination, log: Log) -> list[ConfigLine]:
    result = examination.sensor_check.result if examination.sensor_check else None
    velocity_ratio = next((d.worst for d in examination.findings if d.code == "DVL-UNIT"), None)
    key, key_value = unit_or_scale_key(log, velocity_ratio) if velocity_ratio is not None else ("", "")
    unit = _recorded_line(log, "dvl", "unit")
    if key == "unit":
        unit = (f"unit = {key_value}", "CHECK: estimated from the distances between fixes")
    lines = [_convention(log, result, "dvl", "axes"), unit]
    if result and heading_offset_is_significant(result):
        why = f"fitted to the fixes, ±{max(result.offset_sd_deg, 0.1):.1f}; or a heading bias (bias_deg)"
        lines.append((f"mount_deg = {wrapped(result.best.offset_deg, 180.0):.1f}", why))
    else:
        lines.append(("mount_deg = 0.0", _no_offset(result)))
    c = examination.sensor_check.calibration if examination.sensor_check else None
    if velocity_ratio is not None and key != "unit":
        why = f"CHECK: velocities are {velocity_ratio:.3g} times those between fixes"
        lines.append((f"{key} = {key_value}" if key else "# unit = ?", why))
    elif c and scale_is_significant(c):
        why = f"fitted to the fixes, ±{c.scale_sd:.3f}; calibrate it before use"
        lines.append((f"# scale_error = {c.scale:.3f}", why))
    else:
        why = f"not significant (±{c.scale_sd:.3f})" if c and math.isfinite(c.scale_sd) else "not observable"
        lines.append(("scale_error = 0.0", why))
    timeline = examination.timeline
    lines.append(_sd("dvl", "sd_mps", log, 0.0 if timeline is None else float(np.median(timeline.dvl_sd_mps))))
    lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", "starboard, forward, up: measure it on the vehicle"))
    return [line for line in lines if line[0]]


def _compass(examination: Examination, log: Log) -> list[ConfigLine]:
    result = examination.sensor_check.result if examination.sensor_check else None
    unit = _recorded_line(log, "compass", "unit")
    if _in_radians(examination):
        unit = (
            'unit = "rad"',
            f"by the fixes, instead of deg ({chosen_by_text(log.convention('compass', 'unit'))})",
        )
    lines = [_convention(log, result, "compass", "convention"), unit]
    lines.append(("bias_deg = 0.0", "the log does not distinguish it from mount_deg"))
    declination = log.convention("compass", "declination_deg")
    if declination.value:
        lines.append(('declination_deg = "auto"', convention_text(declination)))
    else:
        lines.append(("# declination_deg = 0.0", "needed if the heading is magnetic; unknown from the log"))
    lines.append(_sd("compass", "sd_deg", log, float(np.nanmedian(log.tables["compass"]["sd_deg"]))))
    topic = log.provenance["compass"].topic
    offset = [d for d in examination.findings if d.code == "CLOCK-OFFSET" and d.topic == topic]
    if offset and offset[0].worst is not None:
        headless = log.convention("compass", "time").value == LOG_TIME
        why = "as the DVL's delay" + (": it has no stamps" if headless else "; only if both have the same delay")
        lines.append((f"{'' if headless else '# '}latency_s = {-offset[0].worst:.3f}", why))
    return [line for line in lines if line[0]]


def _in_radians(examination: Examination) -> bool:
    return any(d.code == "HEADING-RADIANS" for d in examination.findings)


def _usbl(examination: Examination, log: Log) -> list[ConfigLine]:
    result = examination.sensor_check.result if examination.sensor_check else None
    kind = _recorded_line(log, "usbl", "kind")
    lines = [kind]
    if recorded_value(log, "usbl", "frame"):
        lines.append(_convention(log, result, "usbl", "frame"))
        lines.append(_recorded_line(log, "usbl", "relative_to"))
        if lines[-1][0]:
            lines.append(("# head = { lat_deg = 0.0, lon_deg = 0.0, depth_m = 0.0 }", "if fixes count from a head"))
    c = examination.sensor_check.calibration if examination.sensor_check else None
    scatter = f"; fixes scatter by {c.sd_m:.2f} m within two minutes" if c else ""
    stated_m = float(np.sqrt(np.median(log.tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].mean(axis=1))))
    key, why = _sd("usbl", "sd_m", log, stated_m)
    lines.append((key, why + scatter))
    if c and latency_is_significant(c):
        why = f"fitted to dead reckoning, ±{c.latency_sd_s:.2f}; only if the DVL's clock is right"
        lines.append((f"# latency_s = {c.latency_s:.2f}", why))
    else:
        why = f"not significant (±{c.latency_sd_s:.2f})" if c and math.isfinite(c.latency_sd_s) else "not observable"
        lines.append(("latency_s = 0.0", why))
    lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", "starboard, forward, up: measure it on the vehicle"))
    lines.append(('noise = { kind = "contamination" }', "default: 5 % of the fixes are off by 10 m"))
    return [line for line in lines if line[0]]


def _truth(log: Log) -> list[ConfigLine]:
    if log.truth is None or "truth" in log.provenance:
        return (
            [('# topic = "/gps/fix"', "no GPS in the log; name a truth, if there is one")] if log.truth is None else []
        )
    comment = "# " if log.truth.kind == "gps" else ""  # by the source, so that it stays right with another truth
    return [(f'{comment}kind = "{log.truth.kind}"', f"errors are measured against {log.truth.source}")]


def _convention(log: Log, result: InterpretationResult | None, role: str, key: str) -> ConfigLine:
    """Return a convention as it should be: as it was read, unless another fits the fixes better."""
    value, who = recorded_value(log, role, key), chosen_by_text(log.convention(role, key))
    if result is None or not value:
        return _recorded_line(log, role, key)
    best = {"axes": result.best.axes, "convention": result.best.convention, "frame": result.best.frame}[key]
    return f'{key} = "{best}"', who if best == value else f"by the fixes, instead of {value} ({who})"


def _recorded_line(log: Log, role: str, key: str) -> ConfigLine:
    value = recorded_value(log, role, key)
    return (f'{key} = "{value}"', chosen_by_text(log.convention(role, key))) if value else ("", "")


def _sd(role: str, key: str, log: Log, value: float) -> ConfigLine:
    """Return a sensor's noise as a comment: without the key, replay uses the same."""
    why = next((convention_text(c) for c in log.provenance[role].conventions if c.key in SD_KEYS and not c.of), "")
    return (f"# {key} = {value:.3g}" if value > 0 else "", why)


def _no_offset(result: InterpretationResult | None) -> str:
    if result is None or not result.heading_sense_known:
        return "not observable"
    return f"fitted to the fixes: {result.best.offset_deg:+.1f} deg, ±{result.offset_sd_deg:.1f}: not significant"
