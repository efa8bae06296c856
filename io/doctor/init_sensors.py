"""The lines of DVL, compass and USBL in a drafted configuration: conventions, sensor errors, noise.

A sensor error for which the log has evidence is proposed as a comment, except the rotation of DVL and heading, and a
clock that is far off: replay would find it again, and calibration is better than an estimate from one dive.
"""

from importlib.util import find_spec
from typing import TypeAlias

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.identification.identification import Identification
from usbldr.filters.identification.linearisation import COMPASS_CLOCK, DVL_CLOCK, LEVER
from usbldr.io.conventions.compass import LARGER_CIRCLES
from usbldr.io.conventions.timestamps import LOG_TIME
from usbldr.io.doctor.cross_check import FIXED_ADVICE, heading_offset
from usbldr.io.doctor.doctor import Examination
from usbldr.io.doctor.gross_errors import unit_or_scale_key
from usbldr.io.doctor.interpretations import InterpretationResult, recorded_value
from usbldr.io.doctor.sensor_errors import log_odds_text, stated_lever_m, stated_scale
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log
from usbldr.io.messages.field_names import utm_code
from usbldr.io.provenance import chosen_by_text, convention_text
from usbldr.io.settings.toml_text import inline

ConfigLine: TypeAlias = tuple[str, str]  # a key and its value, and where the value comes from
SD_KEYS = ("sd_mps", "sd_deg", "sd_m", "sd_rel", "covariance")
MEASURE_IT = "starboard, forward, up: measure it on the vehicle"


def dvl_lines(examination: Examination, log: Log) -> list[ConfigLine]:
    """Return the lines of [dvl] after its topic."""
    _, result, found = examination.sensor_check
    velocity_ratio = next((d.worst for d in examination.findings if d.code == "DVL-UNIT"), None)
    key, key_value = unit_or_scale_key(log, velocity_ratio) if velocity_ratio is not None else ("", "")
    unit = recorded_line(log, "dvl", "unit")
    if key == "unit":
        unit = (f"unit = {key_value}", "CHECK: estimated from the distances between fixes")
    lines = [_convention(log, result, "dvl", "axes"), unit, _mount(log, result, found)]
    if velocity_ratio is not None and key != "unit":
        why = f"CHECK: velocities are {velocity_ratio:.3g} times those between fixes"
        lines.append((f"{key} = {key_value}" if key else "# unit = ?", why))
    elif found and (scale := found.estimates.get("dvl_scale")):
        why = f"fitted to the fixes, ±{scale.sd:.3f} ({log_odds_text(found, 'scale')}); calibrate it before use"
        lines.append((f"# scale_error = {stated_scale(log, scale.value):.3f}", why))
    else:
        lines.append(("scale_error = 0.0", _no_evidence(found, "scale")))
    timeline = examination.timeline
    lines.append(_sd("dvl", "sd_mps", log, 0.0 if timeline is None else float(np.median(timeline.dvl_sd_mps))))
    if found and (ahead := found.estimates.get("dvl_lever_forward_m")):
        starboard = found.estimates["dvl_lever_starboard_m"]
        sigmas = f"±{starboard.sd:.2f}, ±{ahead.sd:.2f} against the transponder ({log_odds_text(found, LEVER)})"
        lines.append((f"# lever_arm_m = {stated_lever_m(found)}", f"{sigmas}; {MEASURE_IT}"))
    else:
        lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", f"{MEASURE_IT}; {_no_evidence(found, LEVER)}"))
    lines += _clock(examination, DVL_CLOCK, "dvl", log.settings.dvl.latency_s)
    return [line for line in lines if line[0]]


def _clock(examination: Examination, key: str, sensor: str, stated_s: float) -> list[ConfigLine]:
    """Return the line of a sensor's clock: a comment, unless it is further off than replay corrects."""
    found, code = examination.sensor_check.identification, f"{sensor.upper()}-CLOCK"
    late_s = next((one.worst for one in examination.findings if one.code == code and one.worst), 0.0)
    if abs(late_s) >= THRESHOLDS.min_clock_offset_s:
        return [(f"latency_s = {stated_s + late_s:.1f}", "CHECK: by the fixes, against the other sensors")]
    if found is None or (clock := found.estimates.get(f"{sensor}_clock_s")) is None:
        return []
    why = f"fitted to the other sensors, ±{clock.sd:.2f} ({log_odds_text(found, key)})"
    return [(f"# latency_s = {stated_s + clock.value:.2f}", why)]


def _mount(log: Log, result: InterpretationResult | None, found: Identification | None) -> ConfigLine:
    if result is None or not result.heading_sense_known:
        return "mount_deg = 0.0", "not observable"
    apart = _names_differ(log, result)
    offset_deg, sd_deg, significant = heading_offset(result, None if apart else found)  # of the log as its names say
    if significant:
        why = f"CHECK: fitted to the fixes, ±{max(sd_deg, 0.1):.1f}; or a heading bias (bias_deg)"
        why += "; only with the axes, convention and frame that fit the fixes better" * apart
        return f"{'# ' * apart}mount_deg = {wrapped(offset_deg, 180.0):.1f}", why
    return (
        "mount_deg = 0.0",
        f"fitted to the fixes: {offset_deg:+.1f} deg, ±{sd_deg:.1f}; replay estimates so small an angle",
    )


def _no_evidence(found: Identification | None, key: str) -> str:
    return f"no evidence for another ({log_odds_text(found, key)})" if found else "not observable"


def compass_lines(examination: Examination, log: Log) -> list[ConfigLine]:
    """Return the lines of [compass] after its topic."""
    _, result, found = examination.sensor_check
    unit = recorded_line(log, "compass", "unit")
    if any(one.code == "HEADING-RADIANS" for one in examination.findings):
        unit = ('unit = "rad"', "by the fixes, instead of deg")
    elif recorded_value(log, "compass", "unit") in LARGER_CIRCLES:
        unit = (unit[0], "CHECK: by the fixes; in degrees most of its values are beyond a whole turn")
    bias = ("bias_deg = 0.0", "the log does not distinguish it from mount_deg")
    lines = [_convention(log, result, "compass", "convention"), unit, bias]
    lines += _deviation(found) + _clock(examination, COMPASS_CLOCK, "compass", log.settings.compass.latency_s)
    declination = log.convention("compass", "declination_deg")
    if declination.value:
        lines.append(('declination_deg = "auto"', convention_text(declination)))
    else:
        lines.append(("# declination_deg = 0.0", "needed if the heading is magnetic; unknown from the log"))
    lines.append(_sd("compass", "sd_deg", log, float(np.nanmedian(log.tables["compass"]["sd_deg"]))))
    topic = log.provenance["compass"].topic
    offset = [d for d in examination.findings if d.code == "CLOCK-OFFSET" and d.topic == topic]
    if offset and offset[0].worst is not None and all(not entry.startswith("latency_s") for entry, _ in lines):
        headless = log.convention("compass", "time").value == LOG_TIME
        why = "as the DVL's delay" + (": it has no stamps" if headless else "; only if both have the same delay")
        lines.append((f"{'' if headless else '# '}latency_s = {-offset[0].worst:.3f}", why))
    return [line for line in lines if line[0]]


def _deviation(found: Identification | None) -> list[ConfigLine]:
    names = ("deviation_sin_deg", "deviation_cos_deg")
    if found is None or not set(names) <= set(found.estimates):
        return []
    odds, estimates = log_odds_text(found, "deviation"), [found.estimates[name] for name in names]
    return [(f"# {one.name} = {one.value:z.2f}", f"fitted to the fixes, ±{one.sd:.2f} ({odds})") for one in estimates]


def usbl_lines(examination: Examination, log: Log) -> list[ConfigLine]:
    """Return the lines of [usbl] after its topic."""
    _, result, found = examination.sensor_check
    lines = [recorded_line(log, "usbl", "kind"), *grid_lines(log, "usbl")]
    if recorded_value(log, "usbl", "frame"):
        lines.append(_convention(log, result, "usbl", "frame"))
        lines.append(recorded_line(log, "usbl", "relative_to"))
        if lines[-1][0] and log.convention("usbl", "relative_to").value != "head":
            lines.append(("# head = { lat_deg = 0.0, lon_deg = 0.0, depth_m = 0.0 }", "if fixes count from a head"))
    elif (ship := ships_gps(examination)) and log.settings.usbl.head is None:
        gyros = examination.alternatives.get("compass", ())
        head = {"topic": ship} | ({"heading_topic": gyros[0]} if len(gyros) == 1 else {})
        lines.append((f"# head = {inline(head)}", "if this ship carries the head: its errors are then found, too"))
    stated_m = float(np.sqrt(np.median(log.tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].mean(axis=1))))
    lines.append(_sd("usbl", "sd_m", log, stated_m))
    if found:
        why = "scatter of the fixes over their stated sd, outliers and slower errors not included"
        lines.append((f"# sd_scale = {found.parameters.usbl_sd_scale:.2g}", why))
    if found and (latency := found.estimates.get("usbl_latency_s")):
        fitted = f"fitted to dead reckoning, ±{latency.sd:.2f} ({log_odds_text(found, 'latency')})"
        why = f"{fitted}; only if the clocks of DVL and compass are right"
        lines.append((f"# latency_s = {log.settings.usbl.latency_s + latency.value:.2f}", why))
    else:
        lines.append(("latency_s = 0.0", _no_evidence(found, "latency")))
    lines.append(("lever_arm_m = [0.0, 0.0, 0.0]", MEASURE_IT))
    lines.append(('noise = { kind = "contamination" }', "default: 5 % of the fixes are off by 10 m"))
    return [line for line in lines if line[0]]


def ships_gps(examination: Examination) -> str:
    """Return the topic of a GPS that moves unlike the vehicle, "" if none does."""
    of_gps = (one for one in examination.findings if one.code == "TRUTH-MOTION")
    log = examination.log
    return next((one.topic for one in of_gps if log and one.topic == log.topic_of("gps")), "")


def grid_lines(log: Log, role: str) -> list[ConfigLine]:
    """Return the line that asks for the grid of a sensor's eastings and northings, if they are some."""
    topic = log.provenance[role].topic
    found = [finding for finding in log.findings if finding.topic == topic]
    if all(finding.code != "GRID-UNKNOWN" for finding in found):
        return []
    codes = (utm_code(finding.text) for finding in found if finding.code == "COLUMNS-BY-NAME")
    if code := next(filter(None, codes), ""):
        why = "CHECK: by the names of its columns, or a line before them"
        return [(f'{"" if find_spec("pyproj") else "# "}grid = "{code}"', why)]
    return [('# grid = "EPSG:?"', "CHECK: state the code of the grid: EPSG:32631 is UTM zone 31 north")]


def _convention(log: Log, result: InterpretationResult | None, role: str, key: str) -> ConfigLine:
    """Return a convention as it should be: as it was read, unless another fits the fixes better."""
    value, who = recorded_value(log, role, key), chosen_by_text(log.convention(role, key))
    if result is None or not value:
        line, why = recorded_line(log, role, key)
        return (f"# {line}", f"{why}, not checked") if why == "default" else (line, why)
    best = getattr(result.best, key)
    if best != value and _names_differ(log, result):
        return f'# {key} = "{value}"', f"CHECK: {who}, but {best} fits the fixes better; {FIXED_ADVICE}"
    fitting = sorted({str(getattr(one, key)) for one in result.plausible})
    if best == value and who == "default" and len(fitting) > 1:  # stated, it would look like knowledge
        return (
            f'# {key} = "{value}"',
            f"CHECK: only the default, and the log fits {' and '.join(fitting)} alike; state it",
        )
    return f'{key} = "{best}"', who if best == value else f"by the fixes, instead of {value} ({who})"


def _names_differ(log: Log, result: InterpretationResult) -> bool:
    """Return whether names of columns fix a convention that fits worse: then the best ones can only be comments."""
    return any(
        log.convention(role, key).chosen_by == "column names" and recorded_value(log, role, key) != best
        for role, key, best in result.best.conventions
    )


def recorded_line(log: Log, role: str, key: str) -> ConfigLine:
    """Return a convention as the records were read, empty if each has its own, or names of columns state the unit."""
    value = recorded_value(log, role, key)
    if key == "unit" and value and log.convention(role, key).chosen_by == "column names":
        return "", ""  # stated, it would come before the units of the names
    return (f'{key} = "{value}"', chosen_by_text(log.convention(role, key))) if value else ("", "")


def _sd(role: str, key: str, log: Log, value: float) -> ConfigLine:
    """Return a sensor's noise as a comment: without the key, replay uses the same."""
    why = next((convention_text(c) for c in log.provenance[role].conventions if c.key in SD_KEYS and not c.of), "")
    return (f"# {key} = {value:.3g}" if value > 0 else "", why)
