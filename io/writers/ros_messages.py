"""A log as ROS messages of the usual types, for every file format that holds them.

Values keep all their digits. Log time is the time of arrival, the header's stamp the time of validity.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np
from rosbags.typesys.store import Typestore

from usbldr.filters.types import Array
from usbldr.io.conventions.dvl_depth import SURFACE_PA, WATER_PA_PER_M
from usbldr.io.log import Log

TableRow: TypeAlias = Mapping[str, Any]  # one record of a table, by the names of COLUMNS
RosMessage: TypeAlias = Any  # rosbags makes the classes of messages at run time


@dataclass(frozen=True, slots=True)
class Channel:
    """How a sensor's table becomes messages, and the configuration that reads them."""

    topic: str
    type: str
    message: Callable[["Makers", TableRow], RosMessage]
    conventions: Mapping[str, str] = field(default_factory=dict[str, str])  # keys of the sensor's section


class Makers:
    """The classes of a typestore, and the parts that messages share."""

    def __init__(self, store: Typestore) -> None:
        self.types: Mapping[str, Any] = store.types
        self._sequenced = "seq" in dict(store.fielddefs["std_msgs/msg/Header"][1])  # ROS 1

    def make(self, type_name: str, *fields: Any) -> RosMessage:
        """Return a message with its fields in the order of the definition."""
        return self.types[type_name](*fields)

    def header(self, row: TableRow, frame: str) -> RosMessage:
        """Return the header: time of validity and frame."""
        sec, nanosec = divmod(int(row["stamp_ns"]), 1_000_000_000)
        sequence = (0,) if self._sequenced else ()
        stamp = self.make("builtin_interfaces/msg/Time", sec, nanosec)
        return self.make("std_msgs/msg/Header", *sequence, stamp, frame)

    def vector(self, x: float, y: float, z: float) -> RosMessage:
        """Return a geometry_msgs/Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x, y, z)

    def pose(self, east_m: float, north_m: float, cov_m2: Array | None, psi: float = math.nan) -> RosMessage:
        """Return a geometry_msgs/PoseWithCovariance, that of east and north; REP 103: yaw is 0 if the bow points east.

        A covariance (2, 2) or a yaw that is unknown is 0.
        """
        covariance = np.zeros(36)
        if cov_m2 is not None and np.isfinite(cov_m2).all():
            covariance[[0, 1, 6, 7]] = cov_m2.ravel()
        half = 0.0 if math.isnan(psi) else (psi + math.pi / 2) / 2
        turned = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(half), math.cos(half))
        pose = self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", east_m, north_m, 0.0), turned)
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance)


def _dvl(m: Makers, row: TableRow) -> RosMessage:
    """The message's own axes: x forward, y starboard, z down."""
    x, y, z = row["forward_mps"], row["starboard_mps"], -row["up_mps"]
    variance = row["sd_mps"] ** 2
    nothing = np.zeros(4, dtype=np.float32)
    return m.make(
        "marine_acoustic_msgs/msg/Dvl",
        m.header(row, "dvl_link"),
        1,  # bottom track
        0,  # one piston for each beam
        m.vector(x, y, z),
        np.full(9, -1.0) if math.isnan(variance) else np.diag(np.full(3, variance)).ravel(),
        math.nan,  # altitude
        math.atan2(y, x),
        math.hypot(x, y),
        4 if row["valid"] else 0,
        1500.0,
        False,  # no beam ranges
        False,  # no beam velocities
        [m.vector(0.0, 0.0, 0.0)] * 4,
        np.zeros(4),
        nothing,
        nothing,
        nothing,
        nothing,
    )


def _imu(m: Makers, row: TableRow) -> RosMessage:
    """REP 103: the yaw of the quaternion is counter-clockwise from east, so 90 degrees minus the heading."""
    half = math.radians(90.0 - row["heading_deg"]) / 2
    variance = math.radians(row["sd_deg"]) ** 2
    unknown = np.full(9, -1.0)  # REP 145: no such data
    return m.make(
        "sensor_msgs/msg/Imu",
        m.header(row, "imu_link"),
        m.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(half), math.cos(half)),
        np.zeros(9) if math.isnan(variance) else np.diag(np.full(3, variance)).ravel(),
        m.vector(0.0, 0.0, 0.0),
        unknown,
        m.vector(0.0, 0.0, 0.0),
        unknown,
    )


def _point(m: Makers, row: TableRow) -> RosMessage:
    point = m.make("geometry_msgs/msg/Point", row["east_m"], row["north_m"], 0.0)
    return m.make("geometry_msgs/msg/PointStamped", m.header(row, "map"), point)


def _navsat(m: Makers, row: TableRow) -> RosMessage:
    known = not math.isnan(row["sd_m"])
    return m.make(
        "sensor_msgs/msg/NavSatFix",
        m.header(row, "gps_antenna"),
        m.make("sensor_msgs/msg/NavSatStatus", 0, 1),  # a fix, by GPS
        row["lat_deg"],
        row["lon_deg"],
        0.0,  # altitude
        np.diag(np.full(3, row["sd_m"] ** 2)).ravel() if known else np.zeros(9),
        2 if known else 0,  # covariance: diagonal known, or unknown
    )


def _known_validity(m: Makers, row: TableRow) -> RosMessage:
    """The DVL message with a flag of validity, so that zero velocity stays valid."""
    return m.make(
        "dvl_msgs/msg/DVL",
        m.header(row, "dvl_link"),
        0.0,  # since the last report, unknown
        m.vector(row["forward_mps"], row["starboard_mps"], -row["up_mps"]),
        row["sd_mps"],
        np.zeros(0),  # no covariance
        math.nan,  # altitude
        [],  # no beams
        bool(row["valid"]),
        0,
        0,  # no other times than the header's
        0,
        "json_v3.1",
    )


def _fix(m: Makers, row: TableRow) -> RosMessage:
    """A position and its covariance in the plane; one sd means a circular covariance."""
    variance = row.get("sd_m", math.nan) ** 2
    ee, en, nn = (row.get(f"cov_{axes}_m2", usual) for axes, usual in (("ee", variance), ("en", 0.0), ("nn", variance)))
    pose = m.pose(row["east_m"], row["north_m"], np.array([[ee, en], [en, nn]]))
    return m.make(POSE, m.header(row, "map"), pose)


def _pressure(m: Makers, row: TableRow) -> RosMessage:
    """The pressure in sea water, by the density and the surface that a reader takes by default."""
    pressure_pa = SURFACE_PA + row["depth_m"] * WATER_PA_PER_M
    return m.make("sensor_msgs/msg/FluidPressure", m.header(row, "pressure_link"), pressure_pa, 0.0)


ON_PLANE = {"kind": "position", "frame": "ENU", "relative_to": "map"}
CHANNELS: Mapping[str, Channel] = {
    "dvl": Channel("/dvl/data", "marine_acoustic_msgs/msg/Dvl", _dvl, {"axes": "FRD"}),
    "compass": Channel("/imu/data", "sensor_msgs/msg/Imu", _imu, {"convention": "ENU"}),
    "usbl": Channel("/usbl/fix", "geometry_msgs/msg/PointStamped", _point, ON_PLANE),
    "gps": Channel("/gps/fix", "sensor_msgs/msg/NavSatFix", _navsat),
}
"""A sensor is one line."""

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
EXPORTED: Mapping[str, Channel] = {
    "dvl": Channel("/dvl/data", "dvl_msgs/msg/DVL", _known_validity, {"axes": "FRD", "sd_mps": "message"}),
    "compass": Channel("/imu/data", "sensor_msgs/msg/Imu", _imu, {"convention": "ENU", "sd_deg": "message"}),
    "usbl": Channel("/usbl/fix", POSE, _fix, {**ON_PLANE, "sd_m": "message"}),
    "gps": CHANNELS["gps"],
    "depth": Channel("/depth", "sensor_msgs/msg/FluidPressure", _pressure, {"unit": "Pa"}),
    "truth": Channel("/truth", POSE, _fix, {"frame": "ENU"}),
}
"""As CHANNELS, with messages that carry every canonical value: the sigma and the validity of each record."""

LOCAL_GPS = Channel("/gps/fix", POSE, _fix, {"frame": "ENU"})
"""For a local plane without a known origin."""


def channels_of(log: Log, exported: bool) -> Mapping[str, Channel]:
    """Return how each sensor of the log becomes messages; ``exported``: messages that carry every canonical value.

    Fixes with their own covariance always carry it.
    """
    chosen, fixes, gps = dict(EXPORTED if exported else CHANNELS), log.tables.get("usbl"), log.tables.get("gps")
    if exported and gps is not None and not gps["lat_deg"].notna().all():
        chosen["gps"] = LOCAL_GPS
    if fixes is not None and any(fixes[name].nunique() > 1 for name in ("cov_ee_m2", "cov_en_m2", "cov_nn_m2")):
        chosen["usbl"] = EXPORTED["usbl"]
    return {sensor: channel for sensor, channel in chosen.items() if sensor in log.tables}


def messages(log: Log, channels: Mapping[str, Channel], store: Typestore) -> list[tuple[int, str, RosMessage]]:
    """Return the log's records as messages in order of arrival: log time in ns, sensor and message."""
    makers = Makers(store)
    made: list[tuple[int, str, RosMessage]] = []
    for sensor, channel in channels.items():
        rows: list[dict[str, Any]] = log.tables[sensor].to_dict("records")  # pyright: ignore
        for row in rows:
            row["stamp_ns"] = nanoseconds(log, row["time_s"])
            made.append((nanoseconds(log, row["received_s"]), sensor, channel.message(makers, row)))
    return sorted(made, key=itemgetter(0))


def nanoseconds(log: Log, time_s: float) -> int:
    """Return absolute time, nanoseconds since 1970."""
    return log.start_ns + round(time_s * 1e9)
