"""Write a log as ROS 2 MCAP: cdr messages of the usual types, their definitions embedded, zstd chunks.

Values keep all their digits. Log time is the time of arrival, the header's stamp the time of validity.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys.store import Typestore

from usbldr.io.definitions import known_types
from usbldr.io.log import Log

Row: TypeAlias = Mapping[str, Any]  # one record of a table, by the names of COLUMNS
Message: TypeAlias = Any  # rosbags makes the classes of messages at run time

@dataclass(frozen=True, slots=True)
class Channel:
    """How a sensor's table becomes messages, and what a configuration has to say of them."""

    topic: str
    type: str
    message: Callable[["Makers", Row], Message]
    conventions: Mapping[str, str]  # keys of the sensor's section


class Makers:
    """The classes of a typestore, and the parts that messages share."""

    def __init__(self, store: Typestore) -> None:
        self.types: Mapping[str, Any] = store.types

    def make(self, type_name: str, *fields: Any) -> Message:
        """Return a message with its fields in the order of the definition."""
        return self.types[type_name](*fields)

    def header(self, row: Row, frame: str) -> Message:
        """Return the header: time of validity and frame."""
        sec, nanosec = divmod(int(row["stamp_ns"]), 1_000_000_000)
        return self.make("std_msgs/msg/Header", self.make("builtin_interfaces/msg/Time", sec, nanosec), frame)

    def vector(self, x: float, y: float, z: float) -> Message:
        """Return a geometry_msgs/Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x, y, z)


def _dvl(m: Makers, row: Row) -> Message:
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


def _imu(m: Makers, row: Row) -> Message:
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


def _point(m: Makers, row: Row) -> Message:
    point = m.make("geometry_msgs/msg/Point", row["east_m"], row["north_m"], 0.0)
    return m.make("geometry_msgs/msg/PointStamped", m.header(row, "map"), point)


def _navsat(m: Makers, row: Row) -> Message:
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


CHANNELS: Mapping[str, Channel] = {
    "dvl": Channel("/dvl/data", "marine_acoustic_msgs/msg/Dvl", _dvl, {"topic": "/dvl/data", "axes": "FRD"}),
    "compass": Channel("/imu/data", "sensor_msgs/msg/Imu", _imu, {"topic": "/imu/data", "convention": "ENU"}),
    "usbl": Channel(
        "/usbl/fix",
        "geometry_msgs/msg/PointStamped",
        _point,
        {"topic": "/usbl/fix", "kind": "position", "frame": "ENU", "relative_to": "map"},
    ),
    "gps": Channel("/gps/fix", "sensor_msgs/msg/NavSatFix", _navsat, {"topic": "/gps/fix"}),
}
"""A sensor is one line."""


def write_mcap(log: Log, file: Path, remarks: Mapping[str, str]) -> None:
    """Write the sensors of CHANNELS that the log has, in order of arrival; ``remarks`` become the file's metadata."""
    store = known_types(2)
    makers = Makers(store)
    sensors = [sensor for sensor in CHANNELS if sensor in log.tables]
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="usbldr")
        ids: dict[str, int] = {}
        for sensor in sensors:
            channel = CHANNELS[sensor]
            definition, _ = store.generate_msgdef(channel.type, ros_version=2)
            schema = writer.register_schema(channel.type, "ros2msg", definition.encode())
            ids[sensor] = writer.register_channel(channel.topic, "cdr", schema, {"offered_qos_profiles": ""})
        for received_ns, sensor, row in sorted(_rows(log, sensors), key=lambda item: item[0]):
            channel = CHANNELS[sensor]
            data = bytes(store.serialize_cdr(channel.message(makers, row), channel.type))
            writer.add_message(ids[sensor], received_ns, data, received_ns)
        writer.add_metadata("usbldr", dict(remarks))
        writer.finish()


def _rows(log: Log, sensors: Iterable[str]) -> Iterable[tuple[int, str, Row]]:
    for sensor in sensors:
        for row in log.tables[sensor].to_dict("records"):
            stamp_ns, received_ns = nanoseconds(log, row["time_s"]), nanoseconds(log, row["received_s"])
            yield received_ns, sensor, {str(name): value for name, value in row.items()} | {"stamp_ns": stamp_ns}


def nanoseconds(log: Log, time_s: float) -> int:
    """Return absolute time, nanoseconds since 1970."""
    return log.start_ns + round(time_s * 1e9)
