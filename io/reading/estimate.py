"""A track that a vehicle or another program computed, to be judged like those of the filters: a topic or a file."""

from dataclasses import replace

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError, UsageError, did_you_mean
from usbldr.filters.types import Trajectory
from usbldr.io.conventions.truth import distances_if_exchanged
from usbldr.io.findings import Finding
from usbldr.io.geodesy import OriginKind
from usbldr.io.log import Log
from usbldr.io.messages.roles import find_topic, topic_named
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.reading.position_files import Positions, find_truth_file, positions_of, read_positions
from usbldr.io.settings.sensor_sections import TruthSection

COVARIANCE = ("cov_ee_m2", "cov_en_m2", "cov_en_m2", "cov_nn_m2")


def read_estimate(log: Log, request: Request, name: str, frame: str | None = None) -> tuple[Log, Trajectory]:
    """Return the track of a topic of the log or of a file: east, north, and covariance and yaw if they are known.

    The log comes with it because its truth says whether its place on the map of this track is known, and its findings
    are also those of the track.

    A file is TUM text, usbldr's own track, or CSV with usbldr's names. ``frame`` is ENU, NED or latlon (None: by type
    and frame_id, else the one of ENU and NED that the truth fits clearly better, else ENU). Times are seconds of the
    log. Raises LogError for what cannot be read, UsageError for a frame that does not fit.
    """
    placed, track, used, by_default = _read(log, request, name, frame)
    truth = log.truth
    if truth is None or not by_default:
        return placed, track
    apart_m = distances_if_exchanged(truth.time_s, truth.position_m, track.time_s, track.position_m)
    if apart_m is None:
        return placed, track
    other = {"ENU": "NED", "NED": "ENU"}[used]
    text = (
        f"{track.label}: read as {other}, because the truth then fits to {apart_m[1]:.2g} m (median) instead of "
        f"{apart_m[0]:.2g} m; state --frame if that is wrong"
    )
    placed, track, _, _ = _read(log, request, name, other)
    return replace(placed, findings=(*placed.findings, Finding("ESTIMATE-FRAME", text, track.label))), track


def _read(log: Log, request: Request, name: str, frame: str | None) -> tuple[Log, Trajectory, str, bool]:
    """Return the log and the track, its frame, and whether only the default chose between ENU and NED."""
    file = find_truth_file(name, log.path, from_option=True)
    section = msgspec.convert({"frame": frame}, TruthSection)
    try:
        if file is None:
            read = _of_topic(log, request, name, section)
        else:
            read = read_positions(file, ("--estimate", "option"), request, section, log.start_ns, log.origin)
    except SettingError as err:
        raise UsageError(f"--estimate: {err.text}") from err
    used = "" if read.on_log_plane else str(read.provenance.convention("frame").value)
    truth = log.truth
    if truth is not None and used:
        stated = log.origin is not None and log.origin.kind == OriginKind.MAP
        true_frame = log.convention("truth" if "truth" in log.provenance else "gps", "frame").value
        truth = replace(truth, place_unknown=(used == "latlon") != (true_frame == "latlon") and not stated)
    track = _trajectory(read.table, read.provenance.topic, log.start_ns)
    placed = replace(log, truth=truth, findings=(*log.findings, *read.findings))
    return placed, track, used, read.by_default and bool(used)


def _of_topic(log: Log, request: Request, name: str, section: TruthSection) -> Positions:
    """Read a topic of the log."""
    if log.truth is not None and name.lstrip("/") == log.truth.source.lstrip("/"):
        raise UsageError(f"--estimate {name} is the truth itself; name another track or another --truth")
    if not log.path.exists():
        raise UsageError(f"--estimate {name}: a scenario has no topics; name a file")
    reader = open_configured(log.path, request).reader
    if find_topic(reader.topics(), name) is None:
        hint = did_you_mean(name, [topic.name for topic in reader.topics()], 3)
        raise LogError(f"estimate {name} is neither a file, here or beside the log, nor a topic{hint}", path=log.path)
    choice = topic_named(log.path, reader.topics(), "truth", name, "option")
    return positions_of(reader, choice, section, log.origin)


def _trajectory(table: pd.DataFrame, label: str, start_ns: int) -> Trajectory:
    time_s = (table["time_ns"].to_numpy() - start_ns) / 1e9
    names, columns = ("x", "y"), [table["east_m"].to_numpy(float), table["north_m"].to_numpy(float)]
    if "heading_deg" in table and np.isfinite(table["heading_deg"]).all():
        names = ("psi", *names)
        columns.insert(0, np.unwrap(-np.radians(table["heading_deg"].to_numpy(float))))
    cov = None
    if set(COVARIANCE) <= set(table) and np.isfinite(table["cov_ee_m2"]).any():
        cov = np.full((len(table), len(names), len(names)), np.nan)
        cov[:, -2:, -2:] = table[list(COVARIANCE)].to_numpy(float).reshape(-1, 2, 2)
    return Trajectory(label, names, time_s, np.column_stack(columns), cov)
