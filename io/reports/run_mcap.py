"""track.mcap: a run as MCAP for players, alone or merged into a copy of the log."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.definitions import known_types
from usbldr.io.reports.run import Run
from usbldr.io.reports.run_messages import run_topics
from usbldr.io.writers.ros_messages import Makers

TRACK_MCAP = "track.mcap"


def require_mergeable(log: Path) -> None:
    """Raise UsageError for a log into whose copy nothing can be merged."""
    if not (log.is_file() and log.suffix.lower() == ".mcap"):
        raise UsageError(f"--mcap merge copies an MCAP file, and {log} is none: usbldr export writes one")


def write_run_mcap(file: Path, run: Run, merge: bool = False) -> None:
    """Write the topics of a run; ``merge``: after a copy of every message of the log, an MCAP file.

    Raises LogError if the log cannot be copied.
    """
    store = known_types(2)
    makers = Makers(store)
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="usbldr")
        if merge:
            _copy(run.log.path, writer)
        for topic, type_name, stamped in run_topics(makers, run):
            definition, _ = store.generate_msgdef(type_name, ros_version=2)
            schema = writer.register_schema(type_name, "ros2msg", definition.encode())
            channel = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": ""})
            for stamp_ns, message in stamped:
                writer.add_message(channel, stamp_ns, bytes(store.serialize_cdr(message, type_name)), stamp_ns)
        writer.add_metadata("usbldr", {"track": run.label, "log": run.log.path.name, "sha256": run.log.sha256})
        writer.finish()


def _copy(log: Path, writer: Writer) -> None:
    schemas: dict[int, int] = {0: 0}  # 0: a channel without a schema
    channels: dict[int, int] = {}
    for schema, channel, message in _messages(log):
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            own, encoding = schemas[channel.schema_id], channel.message_encoding
            channels[channel.id] = writer.register_channel(channel.topic, encoding, own, channel.metadata)
        copied = channels[channel.id]
        writer.add_message(copied, message.log_time, message.data, message.publish_time, message.sequence)


def _messages(log: Path) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield the messages of a log; raise LogError if it cannot be read, but not for a fault of who writes the copy."""
    try:
        with log.open("rb") as stream:
            yield from NonSeekingReader(stream).iter_messages(log_time_order=False)
    except (McapError, struct.error, EOFError, zlib.error, ValueError, OSError) as err:
        why = err.strerror if isinstance(err, OSError) and err.strerror else err
        raise LogError(f"--mcap merge: the log cannot be copied ({why}); leave merge out", path=log) from err
