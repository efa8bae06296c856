"""Write a log as ROS messages of the usual types: MCAP, and by rosbags a ROS 1 bag (bz2) or a rosbag2 folder."""

import errno
import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys.store import Typestore

from usbldr.io.decoding.definitions import known_types
from usbldr.io.log import Log
from usbldr.io.writers.ros_messages import Channel, messages


def write_mcap(log: Log, file: Path, remarks: Mapping[str, str], channels: Mapping[str, Channel]) -> None:
    """Write the sensors of the channels in order of arrival, definitions embedded; ``remarks`` become its metadata."""
    store = known_types(2)
    with file.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="usbldr")
        ids: dict[str, int] = {}
        for sensor, channel in channels.items():
            definition, _ = store.generate_msgdef(channel.type, ros_version=2)
            schema = writer.register_schema(channel.type, "ros2msg", definition.encode())
            ids[sensor] = writer.register_channel(channel.topic, "cdr", schema, {"offered_qos_profiles": ""})
        for received_ns, sensor, message in messages(log, channels, store):
            data = bytes(store.serialize_cdr(message, channels[sensor].type))
            writer.add_message(ids[sensor], received_ns, data, received_ns)
        writer.add_metadata("usbldr", dict(remarks))
        writer.finish()


def write_bag(log: Log, file: Path, channels: Mapping[str, Channel]) -> None:
    """Write the sensors of the channels in order of arrival."""
    store = known_types(1)
    writer = BagWriter(file)
    writer.set_compression(BagWriter.CompressionFormat.BZ2)
    with writer:
        _write(writer, store.serialize_ros1, log, channels, store)


def write_rosbag2(log: Log, folder: Path, channels: Mapping[str, Channel]) -> None:
    """Make the folder with its metadata.yaml and one .db3 file of the same name; raise OSError for a full disk."""
    store = known_types(2)
    try:
        with Rosbag2Writer(folder, version=8) as writer:
            _write(writer, store.serialize_cdr, log, channels, store)
    except sqlite3.OperationalError as err:  # SQLite's "database or disk is full"
        raise OSError(errno.ENOSPC, str(err)) from err


def _write(
    writer: Any, serialize: Callable[[Any, str], Any], log: Log, channels: Mapping[str, Channel], store: Typestore
) -> None:
    connections = {
        sensor: writer.add_connection(one.topic, one.type, typestore=store) for sensor, one in channels.items()
    }
    for received_ns, sensor, message in messages(log, channels, store):
        writer.write(connections[sensor], received_ns, serialize(message, channels[sensor].type))
