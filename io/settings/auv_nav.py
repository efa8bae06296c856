"""vehicle.yaml and mission.yaml of oplab's auv_nav as the content of a usbldr.toml.

Their keys: docs/file_format_definitions.md of github.com/ocean-perception/oplab_pipeline. Surge, sway and heave are
metres forward, starboard and down, yaw is clockwise. A time offset is added to stamps, but subtracted from ROS's. The
yaw of the INS is added to headings by some of its parsers and has no effect in others, so it is not converted.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

from usbldr.filters.errors import UsageError
from usbldr.io.settings.plain_yaml import plain_yaml
from usbldr.io.settings.validation import read_text


class Parts(NamedTuple):
    """Where auv_nav states a sensor, and the keys of usbldr for it; "" if there is none."""

    mission: str
    vehicle: str
    yaw: str
    sd: str


VEHICLE, MISSION = "vehicle.yaml", "mission.yaml"
SENSORS: Mapping[str, Parts] = {
    "dvl": Parts("velocity", "dvl", "mount_deg", "sd_mps"),
    "compass": Parts("orientation", "ins", "", "sd_deg"),
    "usbl": Parts("usbl", "usbl", "", "sd_m"),
    "gps": Parts("", "gps", "", ""),
    "depth": Parts("depth", "depth", "", ""),
}
ARM = (("sway_m", 1.0), ("surge_m", 1.0), ("heave_m", -1.0))  # starboard, forward, up
WITH_ARM = ("dvl", "usbl", "gps")
NO_MATTER = {"version", "format", "filepath", "filename", "origin", "field_id"}  # files, which the command line names
UTC = ("utc", "UTC", 0)


def is_auv_nav(file: Path) -> bool:
    """Return whether a configuration is one of the two files, by its name."""
    return file.name in (VEHICLE, MISSION)


def auv_nav_content(file: Path) -> tuple[dict[str, object], str]:
    """Return the content of a configuration by the two files of this folder, and what has no key in it."""
    of_vehicle, of_mission = file.with_name(VEHICLE), file.with_name(MISSION)
    vehicle, mission = _tables(of_vehicle), _tables(of_mission)
    origin, place = _numbers(vehicle, "origin", of_vehicle), _section(mission, "origin", of_mission)
    content: dict[str, object] = {"schema": 1}
    if place:
        content["map"] = {f"origin_{key[:3]}_deg": place.get(key) for key in ("latitude", "longitude")}
    used, left_out = {"origin"}, list[str]()
    for sensor, parts in SENSORS.items():
        stated = _section(mission, parts.mission, of_mission)
        node = str(stated.get("origin", parts.vehicle))
        mounted, keys = _numbers(vehicle, node, of_vehicle), dict[str, object]()
        if sensor in WITH_ARM and mounted:
            arm = [(mounted.pop(key, 0.0) - origin.get(key, 0.0)) * sign + 0.0 for key, sign in ARM]  # no -0.0
            keys["lever_arm_m"] = [round(length_m, 6) for length_m in arm]
        if parts.yaw and "yaw_deg" in mounted:
            keys[parts.yaw] = mounted.pop("yaw_deg")
        without = dict(ARM) if sensor == "compass" else {}  # a heading has no place
        left_out += [f"{node} {key}" for key, value in mounted.items() if value and key not in without]
        used |= {node, parts.mission}
        if keys := keys | _mission_keys(stated, parts, of_mission, left_out):
            content[sensor] = keys
    left_out += [key for key in (*vehicle, *mission) if key not in used | NO_MATTER]
    return content, ", ".join(left_out)


def _mission_keys(stated: dict[str, Any], parts: Parts, file: Path, left_out: list[str]) -> dict[str, object]:
    """Return the keys of a sensor by its section of mission.yaml; add the others to those that are left out."""
    rest = {key: value for key, value in stated.items() if key not in NO_MATTER}
    keys: dict[str, object] = {}
    ros = stated.get("format") == "rosbag"
    if topic := rest.pop("topic", None):
        keys["topic"] = topic
    if offset_s := _number(rest.pop("timeoffset", 0), f"{parts.mission} timeoffset", file):
        keys["latency_s"] = offset_s if ros else -offset_s
    for key in ("id", "label"):
        if parts.mission == "usbl" and (target := rest.pop(key, None)) is not None:
            keys["target"] = target
    if parts.sd and not rest.get("std_factor") and (sd := rest.pop("std_offset", 0)):
        keys[parts.sd] = sd
    if rest.get("timezone") in UTC:
        del rest["timezone"]
    left_out += [f"{parts.mission} {key}" for key, value in rest.items() if value]
    return keys


def _tables(file: Path) -> dict[str, Any]:
    """Return the tables of a file, none if it is missing; raise UsageError if it is not YAML of tables."""
    if not file.is_file():
        return {}
    try:
        found = plain_yaml(read_text(file))
    except ValueError as err:
        raise UsageError(f"{file}: is not valid YAML ({err})") from err
    if not isinstance(found, dict):
        raise UsageError(f"{file}: is no {file.name} of auv_nav: it has no sections")
    return cast("dict[str, Any]", found)


def _section(tables: Mapping[str, Any], name: str, file: Path) -> dict[str, Any]:
    found: Any = tables.get(name) or {}
    if not isinstance(found, dict):
        raise UsageError(f"{file}: {name} is no section with keys, as auv_nav has it")
    return cast("dict[str, Any]", found)


def _numbers(tables: Mapping[str, Any], name: str, file: Path) -> dict[str, float]:
    return {key: _number(value, f"{name} {key}", file) for key, value in _section(tables, name, file).items()}


def _number(value: object, what: str, file: Path) -> float:
    """Return a number; raise UsageError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{file}: {what} is {value!r}, not a number")
    return float(value)
