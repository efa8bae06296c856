"""Write a log as ROS 2 MCAP: cdr messages of the usual types, their definitions embedded, zstd chunks."""

from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from usbldr.io.decoding.definitions import known_types
from usbldr.io.log import Log
from usbldr.io.writers.ros_messages import Channel, messages


def write_mcap(log: Log, file: Path, remarks: Mapping[str, str], channels: Mapping[str, Channel]) -> None:
    """Write the sensors of the channels in order of arrival; ``remarks`` become its metadata."""
    store = known_types(2)
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
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
