"""Recordings that tests write by hand: MCAP, ROS 1 bags, rosbag2 folders, CSV folders and sentences of NMEA 0183.

The writers are those of mcap and rosbags, which owe nothing to usbldr.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from usbldr.io.decoding.definitions import KNOWN, SHIPPED

SECOND = 1_000_000_000
T0 = 1_600_000_000 * SECOND  # 2020-09-13T12:26:40Z

HEADER = "std_msgs/Header header\n"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)


def define(definitions: Mapping[str, str], ros_1: bool = False, shipped: str = "") -> None:
    """Make further types known: name -> definition; ``shipped``: beginnings of those that test_definitions checks."""
    for name in KNOWN:
        if name.startswith(tuple(shipped.split())):
            ROS2.register(dict(SHIPPED.layouts(name)[0]))
    for name, text in definitions.items():
        for store in (ROS1, ROS2) if ros_1 else (ROS2,):
            store.register(get_types_from_msg(text, name))


def fields(*lines: str) -> str:
    """Return a definition from "type name name ..."."""
    return "".join(f"{kind} {name}\n" for line in lines for kind, *names in [line.split()] for name in names)


OLD_DVL = HEADER + fields("float64 time", "geometry_msgs/Vector3 velocity", "float64 fom", "bool velocity_valid")
define({"old_dvl_msgs/msg/DVL": OLD_DVL}, shipped="dvl_msgs marine_acoustic_msgs")

Row = tuple[int, str, str, Mapping[str, Any]]  # log time, topic, type, values by field path


Schema = tuple[str, str, bytes]  # name, encoding and text of a definition
FLOAT64: Schema = ("std_msgs/msg/Float64", "ros2msg", b"float64 data")


def stamp(time_ns: int) -> Any:
    return ROS2.types["builtin_interfaces/msg/Time"](*divmod(time_ns, SECOND))


def message(type_name: str, values: Mapping[str, Any], store: Typestore = ROS2) -> Any:
    """Make a message of zeros and empty texts, but for the values, named by field path; "header.stamp" in ns."""
    made = _zeros(type_name, store)
    for path, value in values.items():
        *parents, last = path.split(".")
        owner = made
        for name in parents:
            owner = getattr(owner, name)
        owner_value = stamp(value) if last == "stamp" else value
        setattr(owner, last, owner_value)
    return made


def _zeros(type_name: str, store: Typestore) -> Any:
    fields = []
    descriptions: list[tuple[str, Any]] = list(store.fielddefs[type_name][1])
    for _, (kind, what) in descriptions:
        if kind is Nodetype.NAME:
            fields.append(_zeros(str(what), store))
        elif kind is Nodetype.BASE:
            fields.append({"string": "", "bool": False, "float64": 0.0, "float32": 0.0}.get(str(what[0]), 0))
        elif what[0][0] is Nodetype.NAME:
            fields.append([_zeros(str(what[0][1]), store) for _ in range(what[1])])
        else:
            (_, (base, _)), count = what  # an array of numbers
            fields.append(np.zeros(count if kind is Nodetype.ARRAY else 0, dtype=str(base)))
    return store.types[type_name](*fields)


def record(topic: str, kind: str, values: Mapping[str, Any], after_s: float = 0.0) -> Row:
    """A message of T0 and some seconds, which its header, if it has one, is stamped with."""
    time_ns = T0 + round(after_s * SECOND)
    header = {"header.stamp": time_ns} if "header" in dict(ROS2.fielddefs[kind][1]) else {}
    return time_ns, topic, kind, header | dict(values)


def write_mcap(
    file: Path,
    rows: Iterable[Row],
    compression: CompressionType = CompressionType.ZSTD,
    chunked: bool = True,
    chunk_size: int = 1 << 20,
    summary: bool = True,
    data_checksum: bool = False,
) -> Path:
    with file.open("wb") as stream:
        writer = Writer(
            stream, chunk_size, compression, use_chunking=chunked, enable_data_crcs=data_checksum,
            index_types=IndexType.ALL if summary else IndexType.NONE, use_statistics=summary,
            use_summary_offsets=summary, repeat_channels=summary, repeat_schemas=summary,
        )  # fmt: skip
        writer.start(profile="ros2", library="by hand")
        channels: dict[tuple[str, str], int] = {}
        for log_ns, topic, type_name, values in rows:
            if (topic, type_name) not in channels:
                text, _ = ROS2.generate_msgdef(type_name, ros_version=2)
                schema = writer.register_schema(type_name, "ros2msg", text.encode())
                channels[topic, type_name] = writer.register_channel(topic, "cdr", schema)
            data = bytes(ROS2.serialize_cdr(message(type_name, values), type_name))
            writer.add_message(channels[topic, type_name], log_ns, data, log_ns)
        writer.finish()
    return file


def decoded(file: Path) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, log time and message of an MCAP file, by the definitions in the file alone."""
    store = get_typestore(Stores.EMPTY)
    with file.open("rb") as stream:
        for schema, channel, written in make_reader(stream, validate_crcs=True).iter_messages():
            if schema.name not in store.types:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            yield channel.topic, written.log_time, store.deserialize_cdr(written.data, schema.name)


def write_payloads(file: Path, topic: str, encoding: str, schema: Schema, payloads: Iterable[bytes]) -> Path:
    """Write one channel of an MCAP file, byte for byte, a message a second."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_channel(topic, encoding, writer.register_schema(*schema))
        for k, data in enumerate(payloads):
            writer.add_message(number, T0 + k * SECOND, data, T0 + k * SECOND)
        writer.finish()
    return file


def write_bag(file: Path, rows: Iterable[Row], compression: str = "none", chunk_size: int = 1 << 20) -> Path:
    writer = Writer1(file)
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk_size
    with writer:
        connections = {}
        for log_ns, topic, type_name, values in rows:
            if (topic, type_name) not in connections:
                connections[topic, type_name] = writer.add_connection(topic, type_name, typestore=ROS1)
            data = ROS1.serialize_ros1(message(type_name, values, ROS1), type_name)
            writer.write(connections[topic, type_name], log_ns, data)
    return file


def write_rosbag2(
    folder: Path,
    rows: Iterable[Row],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    packed: CompressionMode | None = None,
    store: Typestore = ROS2,
) -> Path:
    """Write messages in the order given, into one part."""
    writer = Writer2(folder, version=9 if packed else 8, storage_plugin=storage)
    if packed:
        writer.set_compression(packed, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for log_ns, topic, type_name, values in rows:
            if (topic, type_name) not in connections:
                connections[topic, type_name] = writer.add_connection(topic, type_name, typestore=store)
            data = store.serialize_cdr(message(type_name, values, store), type_name)
            writer.write(connections[topic, type_name], log_ns, data)
    return folder


def execute(file: Path, *statements: str) -> None:
    with closing(sqlite3.connect(file)) as database, database:
        for statement in statements:
            database.execute(statement)


TWIST, IMU, POINT = "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Imu", "geometry_msgs/msg/PointStamped"
FIX, HEADING, PRESSURE = "sensor_msgs/msg/NavSatFix", "std_msgs/msg/Float64", "sensor_msgs/msg/FluidPressure"
TWIST_COVARIANCE, POSE = "geometry_msgs/msg/TwistWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE, ODOMETRY = "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"
MARINE, DVL = "marine_acoustic_msgs/msg/Dvl", "dvl_msgs/msg/DVL"


def twist(time_ns: int, x: float, y: float, z: float = 0.0, topic: str = "/dvl") -> Row:
    values = {"header.stamp": time_ns, "twist.linear.x": x, "twist.linear.y": y, "twist.linear.z": z}
    return time_ns, topic, TWIST, values


def yaw(time_ns: int, yaw_deg: float, topic: str = "/imu") -> Row:
    """An Imu turned by yaw_deg about its z axis."""
    return time_ns, topic, IMU, {"header.stamp": time_ns} | turned("orientation", yaw_deg)


def turned(prefix: str, yaw_deg: float) -> dict[str, float]:
    """Return the fields of a quaternion that turns about z."""
    half = np.radians(yaw_deg) / 2
    return {f"{prefix}.z": float(np.sin(half)), f"{prefix}.w": float(np.cos(half))}


def point(time_ns: int, x: float, y: float, z: float = 0.0, delay_s: float = 0.0, topic: str = "/usbl") -> Row:
    values = {"header.stamp": time_ns, "point.x": x, "point.y": y, "point.z": z}
    return time_ns + round(delay_s * SECOND), topic, POINT, values


def fix(time_ns: int, lat: float, lon: float, status: int = 0, topic: str = "/gps/fix") -> Row:
    values = {"header.stamp": time_ns, "latitude": lat, "longitude": lon, "status.status": status}
    return time_ns, topic, FIX, values


def pressure(time_ns: int, pascals: float) -> Row:
    return time_ns, "/pressure", PRESSURE, {"header.stamp": time_ns, "fluid_pressure": pascals}


def short_dive() -> list[Row]:
    """Ten seconds straight ahead: one record of DVL, compass and USBL each second, heading east by REP 103."""
    rows: list[Row] = []
    for k in range(11):
        t = T0 + k * SECOND
        rows += [twist(t, 1.0, 0.5), yaw(t, 0.0), point(t, float(k), 0.0)]
    return rows


def write_csv(folder: Path, **files: str) -> Path:
    """Write texts as CSV files, their lines stripped of indentation."""
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        lines = [line.strip() for line in text.strip().splitlines()]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def saved(file: Path, *parts: str | bytes | bytearray) -> Path:
    """Write texts or bytes, one behind the other."""
    file.write_bytes(b"".join(part.encode() if isinstance(part, str) else part for part in parts))
    return file


def saved_lines(file: Path, lines: Iterable[str]) -> Path:
    return saved(file, *(f"{line}\n" for line in lines))


def sentence(body: str) -> str:
    """Close a sentence with the checksum that NMEA 0183 defines: all its characters, exclusive or."""
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"
