"""A curved dive in any conventions, with faults that the test puts there."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from commands import findings
from recordings import SECOND, T0, Row, fix, point, twist, write_mcap, yaw

LAT, LON = 45.0, 7.0
FLIPPED = {"HEADING-CONVENTION", "MAP-FRAME", "DVL-AXES"}
CONVENTIONS = {*FLIPPED, "CONVENTION-UNDECIDED", "CONVENTION-CONTRADICTED", "CONVENTION-UNOBSERVABLE"}
M_PER_DEG = 111_132.0  # of latitude at 45 degrees, WGS84, to 0.1 %


def curved_dive(
    *,
    dvl: str = "FLU",
    imu: str = "ENU",
    usbl: str = "ENU",
    mount_deg: float = 0.0,
    gravity: float = 0.0,
    gps: bool = False,
    late_s: float = 0.0,
    straight: bool = False,
    gross: tuple[int, ...] = (),
    seconds: int = 300,
) -> list[Row]:
    """Some minutes of surge and sway around curves, stated in the conventions that are asked for.

    ``mount_deg``: heading of the DVL's x axis minus heading of the bow; ``late_s``: stamps of fixes minus true time.
    """
    rng = np.random.default_rng(1)
    t = np.arange(0, seconds, 0.02)
    heading = np.radians(np.full(len(t), 40.0)) if straight else 0.02 * t + 0.9 * np.sin(t / 31)
    forward, starboard = 1 + 0.3 * np.sin(t / 17), 0.4 * np.sin(t / 41) + 0.2
    east = np.cumsum(forward * np.sin(heading) + starboard * np.cos(heading)) * 0.02
    north = np.cumsum(forward * np.cos(heading) - starboard * np.sin(heading)) * 0.02
    rows: list[Row] = []
    mount = np.radians(mount_deg)
    for k in range(0, len(t), 25):
        ns = T0 + round(t[k] * SECOND)
        x = forward[k] * np.cos(mount) + starboard[k] * np.sin(mount)
        to_starboard = -forward[k] * np.sin(mount) + starboard[k] * np.cos(mount)
        rows.append(twist(ns, x, to_starboard if dvl == "FRD" else -to_starboard))
        degrees = float(np.degrees(heading[k]))
        row = yaw(ns, degrees if imu == "NED" else 90.0 - degrees)
        rows.append((*row[:3], dict(row[3]) | {"linear_acceleration.z": gravity}))
    for k in range(500, len(t) - 500, 50):
        e, n = np.array([east[k], north[k]]) + rng.normal(0, 0.3, 2)
        e += 12.0 if (k - 500) // 50 in gross else 0.0
        ns = T0 + round((t[k] + late_s) * SECOND)
        rows.append(point(ns, n, e, delay_s=0.8) if usbl == "NED" else point(ns, e, n, delay_s=0.8))
        if gps:
            lon = LON + e / (M_PER_DEG * np.cos(np.radians(LAT)))
            rows.append(fix(T0 + round(t[k] * SECOND), LAT + n / M_PER_DEG, lon))
    return sorted(rows, key=lambda row: row[0])


def in_radians(rows: list[Row], times: float = 1.0) -> list[Row]:
    """Return the dive with plain headings clockwise from north, in radians times a number, in place of the Imu."""
    reported: list[Row] = []
    for ns, topic, kind, values in rows:
        if topic == "/imu":
            angle = 2 * np.arctan2(values["orientation.z"], values["orientation.w"])
            heading = times * float(np.mod(np.pi / 2 - angle, 2 * np.pi))
            reported.append((ns, "/heading", "std_msgs/msg/Float64", {"data": heading}))
        else:
            reported.append((ns, topic, kind, values))
    return reported


def written(folder: Path, rows: Iterable[Row] | None = None, toml: str = "", **dive: Any) -> Path:
    """Write dive.mcap of the rows, or of a curved dive, and usbldr.toml beside it."""
    folder.mkdir(exist_ok=True)
    (folder / "usbldr.toml").write_text(toml, encoding="utf-8")
    return write_mcap(folder / "dive.mcap", curved_dive(**dive) if rows is None else rows)


def stating(log: Path, toml: str) -> str:
    """Return the file of a configuration beside the log."""
    file = log.parent / "stated.toml"
    file.write_text(toml, encoding="utf-8")
    return str(file)


def cured_by(log: Path, toml: str) -> Mapping[str, Mapping[str, Any]]:
    """Return code -> finding of the doctor with a configuration."""
    return findings(log, "--config", stating(log, toml))


def changed(rows: Iterable[Row], topic: str, **values: Any) -> list[Row]:
    """Set fields of a topic's messages; "__" in a name is a dot, and a function makes a value of those of a message."""
    return [
        (*row[:3], dict(row[3]) | {path.replace("__", "."): of(row[3], value) for path, value in values.items()})
        if row[1] == topic
        else row
        for row in rows
    ]


def of(values: Mapping[str, Any], value: Any) -> Any:
    return value(values) if callable(value) else value
