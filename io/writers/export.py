"""Rewrite a log, or a time span of it, in canonical form, with the configuration that replays it alike.

Conventions, mounts and offsets of the original have been applied; a latency remains one, so that stamps, and with
them the epochs of a replay, do not change.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.models.calibration import AUTO
from usbldr.filters.models.noise import NoiseFamily
from usbldr.filters.models.parameters import LeverArm, ProcessNoise, SensorErrors
from usbldr.io.conventions.map_north import headings_on_plane
from usbldr.io.log import Log
from usbldr.io.messages.roles import ROLES
from usbldr.io.reading.inputs import refuse_inputs
from usbldr.io.settings.configuration import configuration_places
from usbldr.io.settings.toml_text import changed, noise_text, stated, toml_text
from usbldr.io.writers.write_log import (
    WRITTEN_BY,
    configuration_place,
    conventions_of,
    log_format_of,
    write_log_atomically,
    write_records,
)


def cut_log(log: Log, start_s: float, end_s: float) -> Log:
    """Return the records valid from start to end, seconds of the log, ends included; raise LogError if none is left.

    A known start is dropped if the beginning is cut off.
    """
    tables = {
        sensor: table[(table["time_s"] >= start_s) & (table["time_s"] <= end_s)].reset_index(drop=True)
        for sensor, table in log.tables.items()
    }
    tables = {sensor: table for sensor, table in tables.items() if len(table)}
    if not tables:
        raise LogError(f"{log.path}: no record is from --start {start_s:g} to --end {end_s:g} s")
    known = log.parameters if start_s <= 0 else replace(log.parameters, start=None)
    truth = log.truth
    if truth is not None:
        inside = (truth.time_s >= start_s) & (truth.time_s <= end_s)
        truth = truth.only(inside) if inside.any() else None
    return replace(log, tables=tables, parameters=known, truth=truth)


def export(
    log: Log, out: Path, force: bool = False, stated: str | None = None, read: Sequence[Path] = ()
) -> tuple[Log, Path]:
    """Write a log to ``out``, in the stated format or that of its name; ``read``: the files it was read from, if known.

    Return what was written, as tables, and the configuration's path. Raises UsageError as
    write_log_atomically does, and for a file that was read.
    """
    form = log_format_of(out, stated)
    _refuse_own(log, out, configuration_place(out, form), read)
    # headings count from the plane's north if the fixes are written on it; positions of a GPS stay latitudes
    written = _with_truth(headings_on_plane(log) if "usbl" in log.tables else log)
    tables, latencies = dict(written.tables), dict[str, float]()
    for role in ROLES:
        if latency_s := log.settings.section(role).latency_s:
            latencies[role] = latency_s
            if role in tables:
                tables[role] = tables[role].assign(time_s=tables[role]["time_s"] + latency_s)
    written = replace(written, tables=tables)
    configuration = _configuration(log, written, conventions_of(written, form, exported=True), latencies)

    def make(target: Path) -> None:
        write_records(written, target, form, {"exported from": log.path.name}, exported=True)

    return written, write_log_atomically(out, form, configuration, make, force)


def _refuse_own(log: Log, out: Path, place: Path, read: Sequence[Path]) -> None:
    """Raise UsageError if a file that was read would be overwritten, or get a new configuration."""
    simulated = log.format == "simulated"  # its path is only a name
    known = read if simulated else [log.path, *read, *([log.configuration] if log.configuration else [])]
    refuse_inputs(out, known)
    own = log.path.resolve()
    if not simulated and place.resolve() in configuration_places(own, own.is_dir()):
        raise UsageError(f"{out}: its configuration {place.name} would also apply to {log.path}; choose another name")
    refuse_inputs(place, known)


def _with_truth(log: Log) -> Log:
    """Give a truth that is not the log's GPS a table of its own."""
    if log.truth is None or ("truth" not in log.provenance and "gps" in log.tables):
        return log
    east, north = log.truth.position_m.T
    columns = {"time_s": log.truth.time_s, "received_s": log.truth.time_s, "east_m": east, "north_m": north}
    table = pd.DataFrame(columns | {"sd_m": log.truth.sd_m})
    return replace(log, tables=dict(log.tables) | {"truth": table})


def _configuration(
    log: Log, written: Log, conventions: Mapping[str, Mapping[str, str]], latencies: Mapping[str, float]
) -> str:
    known = log.parameters
    sections: dict[str, dict[str, str]] = {}
    if log.origin is not None:
        sections["map"] = {"origin_lat_deg": repr(log.origin.lat_deg), "origin_lon_deg": repr(log.origin.lon_deg)}
    sections["dvl"] = _of_sensor(known.dvl, "dvl", known.dvl_sd_scale) | _lever(known.dvl_lever_m)
    sections["compass"] = _of_sensor(known.compass, "compass", known.compass_sd_scale)
    sections["usbl"] = _of_sensor(known.usbl, "usbl", known.usbl_sd_scale) | _lever(known.usbl_lever_m)
    sections["gps"] = _of_sensor(known.gps, "gps") | _lever(known.gps_lever_m)
    sections["depth"] = {}
    for sensor, latency_s in latencies.items():
        sections[sensor] |= {"latency_s": repr(latency_s)}
    sections["truth"] = {"topic": '"none"'}
    if log.truth is not None:
        sections["truth"] = {"kind": f'"{log.truth.kind}"', "max_gap_s": repr(float(log.truth.max_gap_s))}
        sections["truth"] |= _lever(log.truth.lever_m) if any(log.truth.lever_m) else {}
        if "truth" in written.tables and "truth" not in conventions:
            sections["truth"] |= {"topic": '"/truth"'}
        if "truth" not in written.tables and (skipped := _skipped(log)):
            sections["truth"] |= {"skip_rows": str(skipped)}
    states = '"auto"' if known.calibrate == (AUTO,) else json.dumps(known.calibrate)
    sections["calibrate"] = {"states": states} | changed(known.errors, SensorErrors())
    sections["process"] = changed(known.process, ProcessNoise())
    if known.start is not None and not math.isnan(known.start.east_m):
        sections["start"] = stated(known.start)
    title = (
        f"{WRITTEN_BY} export {log.path.name}",
        "Mounts, offsets and signs of the original have been applied to the records.",
    )
    return toml_text(title, sections, conventions)


def _skipped(log: Log) -> int:
    if log.truth is None or "gps" not in log.tables:
        return 0
    first = (log.truth.time_s[0], *log.truth.position_m[0])
    same = (log.tables["gps"][["time_s", "east_m", "north_m"]].to_numpy(dtype=float) == first).all(axis=1)
    return int(same.argmax())


def _of_sensor(noise: NoiseFamily, sensor: str, sd_scale: float = 1.0) -> dict[str, str]:
    return {"noise": noise_text(noise, sensor)} | ({"sd_scale": repr(sd_scale)} if sd_scale != 1 else {})


def _lever(arm_m: LeverArm) -> dict[str, str]:
    return {"lever_arm_m": str(list(arm_m))}
