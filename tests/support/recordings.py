"""ROS 1 bags and rosbag2 folders that tests write by hand, with rosbags' own writers as the scribes."""

from collections.abc import Iterable
from functools import reduce
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from dives import Row, message

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)


def write_bag(file: Path, rows: Iterable[Row], compression: str = "none", chunk_size: int = 1 << 20) -> Path:
    """Write messages in the order given."""
    writer = Writer1(file)
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk_size
    with writer:
        connections = {}
        for log_ns, topic, type_name, values in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=ROS1)
            data = ROS1.serialize_ros1(message(type_name, values, ROS1), type_name)
            writer.write(connections[topic], log_ns, data)
    return file


def write_rosbag2(folder: Path, rows: Iterable[Row], storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    """Write messages in the order given, into one part."""
    with Writer2(folder, version=8, storage_plugin=storage) as writer:
        connections = {}
        for log_ns, topic, type_name, values in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=ROS2)
            writer.write(connections[topic], log_ns, ROS2.serialize_cdr(message(type_name, values), type_name))
    return folder


def sentence(body: str) -> str:
    """Close a sentence with the checksum that NMEA 0183 defines: all its characters, exclusive or."""
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"
