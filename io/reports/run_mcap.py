"""track.mcap: a run as ROS messages of the usual types for players, alone or merged into a copy of the log.

All are stamped with their time of validity. Positions are east and north in the frame "map"; places are WGS84.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.evaluation.consistency import sigmas
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.types import Array, Vector
from usbldr.io.decoding.definitions import known_types
from usbldr.io.geodesy import to_geodetic
from usbldr.io.reports.estimate_text import in_unit, with_sigma
from usbldr.io.reports.report_json import fixes_table
from usbldr.io.reports.run import Run
from usbldr.io.reports.tracks import a_point_a_second
from usbldr.io.writers.ros_messages import POSE, Makers, RosMessage, nanoseconds

TRACK_MCAP = "track.mcap"
MAP, VEHICLE = "map", "base_link"  # frames
ODOMETRY, NAVSAT = "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix"
VECTOR, DIAGNOSTICS = "geometry_msgs/msg/Vector3Stamped", "diagnostic_msgs/msg/DiagnosticArray"
KNOWN_COVARIANCE, NO_COVARIANCE = 3, 0  # of NavSatFix
LEVELS: Mapping[str, int] = {"used": 0, "down-weighted": 1, "rejected": 2, "not used": 1}  # OK, WARN, ERROR


Stamped: TypeAlias = Iterator[tuple[int, RosMessage]]  # messages, made one by one, with their stamps since 1970 in ns
RunTopic: TypeAlias = tuple[str, str, Stamped]  # name, type


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


def run_topics(m: Makers, run: Run) -> list[RunTopic]:
    """Return the topics of a run: estimate, truth, fixes by what became of them, errors and sensor errors.

    Without a known origin of the map there are no latitudes and longitudes.
    """
    track, report = run.scored
    time_s, position_m, cov_m2 = track.time_s, track.position_m, track.position_cov_m2
    topics: list[RunTopic] = [("/usbldr/estimate", ODOMETRY, _odometry(m, run))]
    topics += _places(m, run, "/usbldr/estimate", time_s, position_m, cov_m2)
    if run.truth is not None:
        sd_m = run.truth.sd_m
        truth_cov_m2 = None if np.isnan(sd_m).all() else sd_m[:, None, None] ** 2 * np.eye(2)
        topics += _positions(m, run, "/usbldr/truth", run.truth.time_s, run.truth.position_m, truth_cov_m2)
    fixes = fixes_table(run.timeline, track)
    for outcome in dict.fromkeys(fixes["outcome"]):
        at = (fixes["outcome"] == outcome).to_numpy()
        name = f"/usbldr/fixes/{(outcome or 'all').replace('-', '_').replace(' ', '_')}"
        line = run.timeline
        topics += _positions(m, run, name, line.fix_time_s[at], line.fix_m[at], line.fix_cov_m2[at])
    if len(fixes):
        topics.append(("/usbldr/fixes/outcome", DIAGNOSTICS, _outcomes(m, run)))
    if report is not None:
        error_m = np.column_stack([report.error_m, report.horizontal_m])
        topics.append(("/usbldr/error", VECTOR, _vectors(m, run, report.time_s, error_m)))
    if cov_m2 is not None:
        sd_m = np.column_stack([sigmas(cov_m2), np.zeros(len(time_s))])
        topics.append(("/usbldr/sigma", VECTOR, _vectors(m, run, time_s, sd_m)))
    if estimated_errors(track):
        topics.append(("/usbldr/sensor_errors", DIAGNOSTICS, _sensor_errors(m, run)))
    return topics


def _positions(
    m: Makers, run: Run, topic: str, time_s: Vector, position_m: Array, cov_m2: Array | None
) -> list[RunTopic]:
    poses = _poses(m, run, time_s, position_m, cov_m2)
    return [(topic, POSE, poses), *_places(m, run, topic, time_s, position_m, cov_m2)]


def _places(m: Makers, run: Run, topic: str, time_s: Vector, position_m: Array, cov_m2: Array | None) -> list[RunTopic]:
    """Return the topic of the latitudes of a track; none if they are unknown."""
    if run.log.origin is None or run.log.map_unknown:
        return []
    return [(f"{topic}/place", NAVSAT, _navsats(m, run, time_s, position_m, cov_m2))]


def _odometry(m: Makers, run: Run) -> Stamped:
    """The pose in the map, the velocity in the axes of the vehicle: x forward, y port."""
    track = run.scored.trajectory
    zero, unknown = np.zeros(len(track.time_s)), np.full(len(track.time_s), np.nan)
    psi = unknown if (known := track.state("psi")) is None else known
    u, v = (zero if (known := track.state(name)) is None else known for name in ("u", "v"))
    covs = [None] * len(zero) if track.position_cov_m2 is None else track.position_cov_m2
    columns = (each.tolist() for each in (track.time_s, track.position_m, psi, u, v))
    for time_s, (east, north), yaw, starboard, forward, cov in zip(*columns, covs, strict=True):
        if not (math.isfinite(east) and math.isfinite(north)):
            continue
        stamp_ns, header = _header(m, run, time_s)
        velocity = m.make("geometry_msgs/msg/Twist", m.vector(forward, -starboard, 0.0), m.vector(0.0, 0.0, 0.0))
        twist = m.make("geometry_msgs/msg/TwistWithCovariance", velocity, np.zeros(36))
        yield stamp_ns, m.make(ODOMETRY, header, VEHICLE, m.pose(east, north, cov, yaw), twist)


def _header(m: Makers, run: Run, time_s: float) -> tuple[int, RosMessage]:
    stamp_ns = nanoseconds(run.log, time_s)
    return stamp_ns, m.header({"stamp_ns": stamp_ns}, MAP)


def _poses(m: Makers, run: Run, time_s: Vector, position_m: Array, cov_m2: Array | None) -> Stamped:
    for k, (east, north) in enumerate(position_m.tolist()):
        stamp_ns, header = _header(m, run, float(time_s[k]))
        yield stamp_ns, m.make(POSE, header, m.pose(east, north, None if cov_m2 is None else cov_m2[k]))


def _navsats(m: Makers, run: Run, time_s: Vector, position_m: Array, cov_m2: Array | None) -> Stamped:
    """Places at most once a second, as a map shows them."""
    assert run.log.origin is not None
    lat, lon = to_geodetic(run.log.origin, *position_m.T)
    for k in a_point_a_second(time_s).tolist():
        if not math.isfinite(lat[k]):
            continue
        stamp_ns, header = _header(m, run, float(time_s[k]))
        covariance, kind = np.zeros(9), NO_COVARIANCE
        if cov_m2 is not None and np.isfinite(cov_m2[k]).all():
            covariance[[0, 1, 3, 4]], kind = cov_m2[k].ravel(), KNOWN_COVARIANCE
        status = m.make("sensor_msgs/msg/NavSatStatus", 0, 0)
        yield stamp_ns, m.make(NAVSAT, header, status, float(lat[k]), float(lon[k]), 0.0, covariance, kind)


def _vectors(m: Makers, run: Run, time_s: Vector, values: Array) -> Stamped:
    for t, row in zip(time_s.tolist(), values.tolist(), strict=True):
        stamp_ns, header = _header(m, run, t)
        yield stamp_ns, m.make(VECTOR, header, m.vector(*row))


def _outcomes(m: Makers, run: Run) -> Stamped:
    """What became of each fix, with the numbers of fixes.csv."""
    for row in fixes_table(run.timeline, run.scored.trajectory).to_dict("records"):
        outcome = str(row["outcome"])
        numbers = {str(name): f"{value:.6g}" for name, value in row.items() if isinstance(value, int | float)}
        found = ("USBL fix", LEVELS.get(outcome, 0), outcome, str(row["why"]), numbers)
        yield _diagnostics(m, run, row["time_s"], [found])


def _sensor_errors(m: Makers, run: Run) -> Stamped:
    """The estimated sensor errors once a second."""
    track = run.scored.trajectory
    errors = [(error, *in_unit(error.unit)) for error in estimated_errors(track)]
    for k in a_point_a_second(track.time_s).tolist():
        found: list[tuple[str, int, str, str, dict[str, str]]] = []
        for error, factor, unit in errors:
            value, sd = factor * float(error.value[k]), factor * float(error.sd[k])
            numbers = {"value": f"{value:.6g}", "sd": f"{sd:.6g}", "unit": unit}
            found.append((error.title, 0, f"{with_sigma(value, sd)} {unit}", "", numbers))
        yield _diagnostics(m, run, float(track.time_s[k]), found)


def _diagnostics(
    m: Makers, run: Run, time_s: float, found: Sequence[tuple[str, int, str, str, Mapping[str, Any]]]
) -> tuple[int, RosMessage]:
    stamp_ns, header = _header(m, run, time_s)
    statuses: list[RosMessage] = []
    for name, level, text, why, numbers in found:
        values = [m.make("diagnostic_msgs/msg/KeyValue", key, value) for key, value in numbers.items()]
        said = f"{text}: {why}" if why else text
        statuses.append(m.make("diagnostic_msgs/msg/DiagnosticStatus", level, f"usbldr: {name}", said, "", values))
    return stamp_ns, m.make(DIAGNOSTICS, header, statuses)
