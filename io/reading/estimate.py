"""A track that a vehicle or another program computed, to be judged like those of the filters: a topic or a file."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError, UsageError, did_you_mean
from usbldr.filters.types import Trajectory
from usbldr.io.axes import named_ned
from usbldr.io.conventions.positions import gps
from usbldr.io.conventions.truth import distances_if_exchanged, find_truth_file, is_recording, read_truth_file
from usbldr.io.findings import Finding
from usbldr.io.geodesy import OriginKind
from usbldr.io.log import Log
from usbldr.io.messages.roles import find_topic, topic_named
from usbldr.io.reading.opening import Request, open_configured
from usbldr.io.reading.truth import only_positions, raw_positions
from usbldr.io.settings.sensor_sections import GpsSection, TruthSection

COVARIANCE = ("cov_ee_m2", "cov_en_m2", "cov_en_m2", "cov_nn_m2")


def read_estimate(log: Log, request: Request, name: str, frame: str | None = None) -> tuple[Log, Trajectory]:
    """Return the track of a topic of the log or of a file: east, north, and covariance and yaw if they are known.

    The log comes with it because its truth says whether its place on the map of this track is known, and with a finding
    about the frame, if there is one.

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
    if file is not None and is_recording(file):
        table, label, used, by_default = _of_topic(log, file, request, None, frame)
    elif file is None:
        if log.truth is not None and name.lstrip("/") == log.truth.source.lstrip("/"):
            raise UsageError(f"--estimate {name} is the truth itself; name another track or another --truth")
        table, label, used, by_default = _of_topic(log, log.path, request, name, frame)
    else:
        section = msgspec.convert({"frame": frame}, TruthSection)
        read = read_truth_file(file, "option", section, log.start_ns, log.origin)
        table, label, used = read.table, file.name, "" if read.on_log_plane else read.frame
        by_default = read.provenance.convention("frame").chosen_by == "default"
    table = table[np.isfinite(table["east_m"]) & np.isfinite(table["north_m"])]
    table = table.sort_values("time_ns", kind="stable").drop_duplicates("time_ns", keep="last")
    if table.empty:
        raise LogError(f"{name}: no position is left of the estimate")
    truth = log.truth
    if truth is not None and used:
        stated = log.origin is not None and log.origin.kind == OriginKind.MAP
        true_frame = log.convention("truth" if "truth" in log.provenance else "gps", "frame").value
        truth = replace(truth, place_unknown=(used == "latlon") != (true_frame == "latlon") and not stated)
    return replace(log, truth=truth), _trajectory(table, label, log.start_ns), used, by_default and bool(used)


def _of_topic(
    log: Log, path: Path, request: Request, name: str | None, frame: str | None
) -> tuple[pd.DataFrame, str, str, bool]:
    """Read a topic of a recording; without a name, its only one of positions."""
    if not path.exists():
        raise UsageError(f"--estimate {name}: a scenario has no topics; name a file")
    reader = open_configured(path, request if name else replace(request, configuration="none", joined=())).reader
    name = only_positions(path, reader.topics(), "--estimate") if name is None else name
    if find_topic(reader.topics(), name) is None:
        hint = did_you_mean(name, [topic.name for topic in reader.topics()], 3)
        raise LogError(f"estimate {name} is neither a file, here or beside the log, nor a topic{hint}", path=log.path)
    choice = topic_named(path, reader.topics(), "truth", name, "option")
    raw = raw_positions(reader, choice)
    try:
        made = gps(raw, msgspec.convert({"frame": frame}, GpsSection), log.origin)
    except SettingError as err:
        raise UsageError(f"--estimate: {err.text}") from err
    used = made.conventions[0]
    by_default = used.chosen_by == "default" and not named_ned(raw.frame_id)
    return made.table, choice.topic.name, str(used.value), by_default


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
