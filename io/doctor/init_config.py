"""A usbldr.toml for a log that has none: what the log itself tells, each line with where its value comes from.

No key in it is fitted to GPS or another truth; what no log can tell is there to be filled in.
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


def initial_configuration(found: Examination, joined: tuple[str, ...] = ()) -> str:
    """Return the text of a configuration by which the log replays.

    Raises LogError with what is missing where no configuration could do that.
    """
    log = found.log
    hopeless = [d for d in found.findings if d.code in ("UNUSABLE", "SENSOR-MISSING")]
    if log is None or hopeless:
        raise LogError(hopeless[0].text, path=found.path)
    if _in_radians(found):
        found = replace(found, sensor_check=None)  # held against the fixes by headings of another unit
    sections: dict[str, list[ConfigLine]] = {"map": _map(found, log)}
    for role in ROLES:
        sections[role] = _topic(found, log, role)
    sections["dvl"] += _dvl(found, log)
    sections["compass"] += _compass(found, log)
    sections["usbl"] += _usbl(found, log)
    sections["truth"] = _truth(log)
    lines = [
        f"# Settings for {found.path.name}, written by usbldr init from the log alone; no key was fitted to GPS.",
        "# Signs: docs/configuration.md. Lines that start with # say what no log can tell, or what is only a guess.",
        *_convention_comments(found),
        "schema = 1",
    ]
    for name, rows in sections.items():
        if rows:
            empty = all(entry.startswith("#") for entry, _ in rows)  # a section without a key may not be allowed
            lines += ["", f"{'# ' if empty else ''}[{name}]", *(_row(*row) for row in rows)]
    for name in joined:
        relative = os.path.relpath(name, found.path.resolve().parent)
        lines += ["", "[[file]]", _row(f'path = "{Path(relative).as_posix()}"', "option --with")]
    text = "\n".join(lines) + "\n"
    parse_configuration(
        tomllib.loads(text), own_configuration(log.path, log.path.is_dir())
    )  # must be accepted, whatever the log
    return text


def _row(entry: str, why: str) -> str:
    return f"{entry:{COMMENT_COLUMN - 2}}  # {why}" if why else entry


def _convention_comments(found: Examination) -> list[str]:
    """Say how well the conventions fit, and who ruled their mirror image out."""
    verdict = found.sensor_check.result if found.sensor_check else None
    if verdict is None:
        why = "there are too few"
        if _in_radians(found):
            why = "headings were read as degrees, but are radians; let doctor examine the log by this file"
        return [f"# CHECK: axes, convention and frame could not be held against fixes: {why}."]
    best, read = verdict.best, verdict.as_read
    usual = "" if best == read else f"; as types and names have it, {read.residual_m:.2f} m"
    lies = f"dead reckoning lies {best.residual_m:.2f} m from the fixes"
    lines = [f"# With these axes, convention and frame, {lies}{usual} (rms)."]
    if not verdict.observable:
        others = [r for r in verdict.plausible if r.mirror_class != best.mirror_class]
        lines.append(f"# CHECK: {others[0].description} fits nearly as well ({others[0].residual_m:.2f} m).")
    if verdict.decided_by is not None:
        lines.append(f"# Their mirror image is ruled out by this: {verdict.decided_by.name}.")
    elif verdict.mirror_image is not None:
        lines.append(
            f"# CHECK: their mirror image ({verdict.mirror_image.description}) fits as well; nothing in the log "
            "decides."
        )
    return lines


def _map(found: Examination, log: Log) -> list[ConfigLine]:
    if log.origin is None:
        return [("# origin_lat_deg = 0.0", "unknown: no latitude in the log"), ("# origin_lon_deg = 0.0", "")]
    who = log.origin.source
    comment = ""
    lat_deg, lon_deg = log.origin.lat_deg, log.origin.lon_deg
    if map_origin_unknown(found):
        comment, who = "# ", f"a guess ({who}); CHECK: state where the fixes' map begins, or head under [usbl]"
        guess = propose_origin(log, found.timeline, found.sensor_check.result if found.sensor_check else None)
        if guess is not None:
            lat_deg, lon_deg = guess.lat_deg, guess.lon_deg
            gap_s = THRESHOLDS.max_pair_gap_s
            who = (
                f"CHECK: a guess; there the fixes meet the GPS ({guess.pairs} within {gap_s:g} s of each "
                f"other, +-{guess.sd_m:.1f} m). Fitted to GPS: not for a run that GPS judges"
            )
    return [
        (f"{comment}origin_lat_deg = {lat_deg:.9f}", who),
        (f"{comment}origin_lon_deg = {lon_deg:.9f}", "" if comment else who),
    ]


def map_origin_unknown(found: Examination) -> bool:
    """Tell whether the fixes are local positions and nobody states where their map begins."""
    return any(d.code == "MAP-UNKNOWN" for d in found.findings)


def _topic(found: Examination, log: Log, role: str) -> list[ConfigLine]:
    if role not in log.provenance:
        return [] if role in ("dvl", "compass", "usbl") else [('topic = "none"', "no such topic in the log")]
    p = log.provenance[role]
    why = f"{p.type}, {p.messages} messages, by {p.chosen_by}"
    if role in found.alternatives:
        why = f"CHECK: the fullest that can be read; it could be {' or '.join(found.alternatives[role])}"
    return [(f'topic = "{p.topic}"', why)]


def _dvl(found: Examination, log: Log) -> list[ConfigLine]:
    verdict = found.sensor_check.result if found.sensor_check else None
    far = next((d.worst for d in found.findings if d.code == "DVL-UNIT"), None)
    key, key_value = unit_or_scale_key(log, far) if far is not None else ("", "")
    unit = _recorded_line(log, "dvl", "unit")
    if key == "unit":
        unit = (f"unit = {key_value}", "CHECK: by the distances between fixes")
    lines = [_convention(log, verdict, "dvl", "axes"), unit]
    if verdict and heading_offset_is_significant(verdict):
        said = f"fitted to the fixes, +-{max(verdict.offset_sd_deg, 0.1):.1f}; the heading may err instead (bias_deg)"
        lines.append((f"mount_deg = {wrapped(verdict.best.offset_deg, 180.0):.1f}", said))
    else:
        lines.append(("mount_deg = 0.0", _no_offset(verdict)))
    c = found.sensor_check.calibration if found.sensor_check else None
    if far is not None and key != "unit":
        lines.append(
            (
                f"{key} = {key_value}" if key else "# unit = ?",
                f"CHECK: velocities are {far:.3g} times those between fixes",
            )
        )
    elif c and scale_is_significant(c):
        lines.append((f"# scale_error = {c.scale:.3f}", f"fits the fixes, +-{c.scale_sd:.3f}; calibrate it before use"))
    else:
        known = f"the fixes see none (+-{c.scale_sd:.3f})" if c and math.isfinite(c.scale_sd) else "not seen"
        lines.append(("scale_error = 0.0", known))
    lines.append(
        _sd("dvl", "sd_mps", log, 0.0 if found.timeline is None else float(np.median(found.timeline.dvl_sd_mps)))
    )
    lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", "starboard, forward, up: measure it, no log tells"))
    return [line for line in lines if line[0]]


def _compass(found: Examination, log: Log) -> list[ConfigLine]:
    verdict = found.sensor_check.result if found.sensor_check else None
    unit = _recorded_line(log, "compass", "unit")
    if _in_radians(found):
        unit = (
            'unit = "rad"',
            f"by the fixes, instead of deg ({chosen_by_text(log.convention('compass', 'unit'))})",
        )
    lines = [_convention(log, verdict, "compass", "convention"), unit]
    lines.append(("bias_deg = 0.0", "not told apart from mount_deg by the log"))
    declination = log.convention("compass", "declination_deg")
    if declination.value:
        lines.append(('declination_deg = "auto"', convention_text(declination)))
    else:
        lines.append(("# declination_deg = 0.0", "needed if the heading is magnetic; not known from the log"))
    lines.append(_sd("compass", "sd_deg", log, float(np.nanmedian(log.tables["compass"]["sd_deg"]))))
    topic = log.provenance["compass"].topic
    offset = [d for d in found.findings if d.code == "CLOCK-OFFSET" and d.topic == topic]
    if offset and offset[0].worst is not None:
        headless = log.convention("compass", "time").value == LOG_TIME
        said_s = "log time against the DVL's" + (
            ": it has no stamps" if headless else "; only if both are logged at once"
        )
        lines.append((f"{'' if headless else '# '}latency_s = {-offset[0].worst:.3f}", said_s))
    return [line for line in lines if line[0]]


def _in_radians(found: Examination) -> bool:
    """Tell whether headings that were read as degrees are radians."""
    return any(d.code == "HEADING-RADIANS" for d in found.findings)


def _usbl(found: Examination, log: Log) -> list[ConfigLine]:
    verdict = found.sensor_check.result if found.sensor_check else None
    kind = _recorded_line(log, "usbl", "kind")
    lines = [kind]
    if recorded_value(log, "usbl", "frame"):
        lines.append(_convention(log, verdict, "usbl", "frame"))
        lines.append(_recorded_line(log, "usbl", "relative_to"))
        if lines[-1][0]:
            lines.append(("# head = { lat_deg = 0.0, lon_deg = 0.0, depth_m = 0.0 }", "if fixes count from a head"))
    c = found.sensor_check.calibration if found.sensor_check else None
    scatter = f"; fixes scatter by {c.sd_m:.2f} m within two minutes" if c else ""
    stated_m = float(np.sqrt(np.median(log.tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].mean(axis=1))))
    key, why = _sd("usbl", "sd_m", log, stated_m)
    lines.append((key, why + scatter))
    if c and latency_is_significant(c):
        why = f"fits dead reckoning, +-{c.latency_sd_s:.2f}; relative to the DVL's clock, so only if that is right"
        lines.append((f"# latency_s = {c.latency_s:.2f}", why))
    else:
        known = (
            f"dead reckoning sees none (+-{c.latency_sd_s:.2f})" if c and math.isfinite(c.latency_sd_s) else "not seen"
        )
        lines.append(("latency_s = 0.0", known))
    lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", "starboard, forward, up: measure it, no log tells"))
    lines.append(('noise = { kind = "contamination" }', "default: 5 % of the fixes are off by 10 m"))
    return [line for line in lines if line[0]]


def _truth(log: Log) -> list[ConfigLine]:
    if log.truth is None or "truth" in log.provenance:
        return (
            [('# topic = "/gps/fix"', "no GPS in the log; name a truth, if there is one")] if log.truth is None else []
        )
    return [(f'kind = "{log.truth.kind}"', f"errors are measured against {log.truth.source}")]


def _convention(log: Log, verdict: InterpretationResult | None, role: str, key: str) -> ConfigLine:
    """Return a convention as it should be: as it was read, unless the fixes say otherwise."""
    value, who = recorded_value(log, role, key), chosen_by_text(log.convention(role, key))
    if verdict is None or not value:
        return _recorded_line(log, role, key)
    best = {"axes": verdict.best.axes, "convention": verdict.best.convention, "frame": verdict.best.frame}[key]
    return f'{key} = "{best}"', who if best == value else f"by the fixes, instead of {value} ({who})"


def _recorded_line(log: Log, role: str, key: str) -> ConfigLine:
    value = recorded_value(log, role, key)
    return (f'{key} = "{value}"', chosen_by_text(log.convention(role, key))) if value else ("", "")


def _sd(role: str, key: str, log: Log, value: float) -> ConfigLine:
    """Return a sensor's noise: as a remark, because without the key replay finds the same."""
    said = next((convention_text(c) for c in log.provenance[role].conventions if c.key in SD_KEYS and not c.of), "")
    return (f"# {key} = {value:.3g}" if value > 0 else "", said)


def _no_offset(verdict: InterpretationResult | None) -> str:
    if verdict is None or not verdict.heading_sense_known:
        return "the log does not tell"
    return f"the fixes see {verdict.best.offset_deg:+.1f} deg, +-{verdict.offset_sd_deg:.1f}: too little to state"
