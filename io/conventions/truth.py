"""The reference track: a topic of the log or a file of its own, with its frame, its columns and its time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, SettingError, UsageError
from usbldr.filters.types import Array, Mask, Truth, Vector
from usbldr.filters.windows import columns_at
from usbldr.io.conventions.attitude import QUATERNION
from usbldr.io.conventions.grids import grid_to_geodetic
from usbldr.io.conventions.positions import heading_of_quaternion
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_plane
from usbldr.io.messages.configured import AT_1970, TIME_UNITS_NS, plain
from usbldr.io.messages.field_names import named_column
from usbldr.io.provenance import ChosenBy, Convention, Provenance
from usbldr.io.reader import Column
from usbldr.io.settings.sensor_sections import TruthSection
from usbldr.io.tables.cells import ParsedColumn, numbers, times
from usbldr.io.tables.csv_text import read_texts
from usbldr.io.tables.text_table import line_findings, listed
from usbldr.io.tables.time_columns import dated_columns, keys_since_1970

LEAST_POINTS = 10  # [points] within a track, by which its frame is checked
CLEARLY_BETTER = 2.0  # times: a frame whose points fit so much better is not chance
MORE = ("sd_east_m", "sd_north_m", "cov_en_m2", "heading_deg", *QUATERNION)

PLACES: Mapping[tuple[str, str], str | None] = {
    ("east_m", "north_m"): "ENU",
    ("lat_deg", "lon_deg"): "latlon",
    ("tx", "ty"): None,
    ("x_m", "y_m"): None,
    ("x", "y"): None,
}
"""Two columns that hold a position, as field_names calls them, and their frame; None: east and north, unless stated."""
VELOCITY = ("starboard_mps", "forward_mps")
FINDINGS = "findings"  # findings of a truth file, as an attribute of its table


def is_recording(place: Path) -> bool:
    """Tell whether a place is a recording of messages: MCAP, a bag, a rosbag2 folder or file."""
    formats = (".mcap", ".bag", ".db3")
    return (place.suffix in formats and place.is_file()) or (place.is_dir() and (place / "metadata.yaml").is_file())


def find_truth_file(name: str, log: Path, from_option: bool) -> Path | None:
    """Return the file of positions, or the recording: of an option from here, else from the folder of the log."""
    places = [Path(name)] if from_option else []
    places.append(log.resolve().parent / name)
    return next((place for place in places if place.is_file() or is_recording(place)), None)


def truth_from_table(
    table: pd.DataFrame, source: str, start_ns: int, section: TruthSection, kind: str
) -> tuple[Truth, list[Finding]]:
    """Return the truth of a table with time_ns, east_m, north_m and sd_m: in order of time, one row for each."""
    rows = table.iloc[section.skip_rows :]
    rows = rows[np.isfinite(rows["east_m"]) & np.isfinite(rows["north_m"])]
    rows = rows.sort_values("time_ns", kind="stable")
    repeated = rows.duplicated(subset="time_ns")
    findings: list[Finding] = list(table.attrs.get(FINDINGS, ()))
    if repeated.any():
        text = f"{source}: {repeated.sum()} truth rows have the time of an earlier one and are left out"
        findings.append(Finding("TRUTH-REPEATED", text, source))
        rows = rows[~repeated]
    if rows.empty:
        raise LogError(f"{source}: no truth row is left of {len(table)} (skip_rows = {section.skip_rows})")
    yaw_rad = None
    if "heading_deg" in rows and np.isfinite(rows["heading_deg"]).all():
        yaw_rad = np.unwrap(-np.radians(rows["heading_deg"].to_numpy(dtype=float)))
    velocity = rows[[*VELOCITY]].to_numpy(dtype=float) if set(VELOCITY) <= set(rows) else None
    truth = Truth(
        time_s=(rows["time_ns"].to_numpy() - start_ns) / 1e9 - section.latency_s,
        position_m=rows[["east_m", "north_m"]].to_numpy(dtype=float),
        sd_m=rows["sd_m"].to_numpy(dtype=float) if section.sd_m is None else np.full(len(rows), section.sd_m),
        heading_sd_rad=math.radians(section.heading_sd_deg),
        scale_sd=section.scale_sd,
        kind=kind,
        source=source,
        max_gap_s=section.max_gap_s,
        lever_m=section.lever_arm_m,
        yaw_rad=yaw_rad,
        velocity_mps=velocity if velocity is not None and np.isfinite(velocity).all() else None,
    )
    return truth, findings


def by_fixes(
    truth: Truth, provenance: Provenance, fixes: pd.DataFrame, start_ns: int
) -> tuple[Truth, Provenance, list[Finding]]:
    """Exchange east and north of a truth whose frame is not stated if the fixes (usbl) then fit clearly better.

    Only its shape counts: a constant shift between both is taken off. The truth remains unknown to filters.
    """
    frame = provenance.convention("frame")
    time_s: Vector = (fixes["time_ns"].to_numpy(dtype=np.int64) - start_ns) / 1e9
    fix_m = fixes[["east_m", "north_m"]].to_numpy(dtype=float)
    apart_m = distances_if_exchanged(time_s, fix_m, truth.time_s, truth.position_m)
    if frame.chosen_by != "default" or apart_m is None:
        return truth, provenance, []
    as_read_m, exchanged_m = apart_m
    other = "NED" if frame.value == "ENU" else "ENU"
    conventions = tuple(replace(c, value=other, chosen_by="data") if c is frame else c for c in provenance.conventions)
    text = (
        f"{truth.source}: read as {other}, because the fixes then fit to {exchanged_m:.2g} m (median) instead of "
        f"{as_read_m:.2g} m; state --truth-frame or frame under [truth] if that is wrong"
    )
    turned = replace(
        truth,
        position_m=truth.position_m[:, ::-1],
        yaw_rad=None if truth.yaw_rad is None else -math.pi / 2 - truth.yaw_rad,
        velocity_mps=None if truth.velocity_mps is None else truth.velocity_mps * [-1, 1],
    )
    return turned, replace(provenance, conventions=conventions), [Finding("TRUTH-FRAME", text, truth.source)]


def distances_if_exchanged(
    time_s: Vector, point_m: Array, track_time_s: Vector, track_m: Array
) -> tuple[float, float] | None:
    """Return the median distance of points from a track, as it is and with its east and north exchanged.

    None unless they fit clearly better then, or if too few points lie within the track. Only shapes count: a constant
    shift between both is taken off.
    """
    among: Mask = (time_s >= track_time_s[0]) & (time_s <= track_time_s[-1])
    if among.sum() < LEAST_POINTS:
        return None
    there_m = columns_at(time_s[among], track_time_s, track_m)
    apart_m = (point_m[among] - one for one in (there_m, there_m[:, ::-1]))
    as_read_m, exchanged_m = (float(np.median(np.hypot(*(one - np.median(one, axis=0)).T))) for one in apart_m)
    return (as_read_m, exchanged_m) if exchanged_m * CLEARLY_BETTER < as_read_m else None


class TruthFile(NamedTuple):
    """A file of positions: time_ns, east_m, north_m and sd_m of each row, and how it was read."""

    table: pd.DataFrame
    provenance: Provenance
    frame: str
    on_log_plane: bool  # a track of usbldr: its times and positions are of the log's own timeline and plane


def read_truth_file(
    file: Path, chosen_by: str, section: TruthSection, start_ns: int, origin: Origin | None
) -> TruthFile:
    """Return a file of positions, and its conventions.

    If the file has them, also cov_ee_m2, cov_en_m2, cov_nn_m2 and heading_deg. Skipped rows are not parsed; they are
    NaN. Raises LogError for a missing column, a broken number or an unknown plane; UsageError if the columns are
    unnamed.
    """
    read_table = read_texts(file, units_are_row=section.skip_rows > 0)  # the user counts a line of units
    texts = read_table.columns
    columns, frame, by_name = _columns(file, texts, section)
    row_count = len(texts[columns["x"]])
    rows = range(min(section.skip_rows, row_count), row_count)
    cells = {key: texts[name][rows.start :] for key, name in columns.items()}
    lines = read_table.lines[rows.start :]
    time_ns = _times(cells, columns, start_ns).checked(file, lines)
    by_commas = read_table.by_commas
    x, y = (numbers(cells[axis], columns[axis], by_commas).checked(file, lines) for axis in "xy")
    sd = numbers(cells["sd_m"], columns["sd_m"]).checked(file, lines) if "sd_m" in cells else np.full(len(x), np.nan)
    on_grid = [Convention("grid", section.grid, "configuration")] if section.grid else []
    if section.grid:
        try:
            x, y = grid_to_geodetic(section.grid, *((y, x) if frame == "NED" else (x, y)), file)
        except SettingError as err:
            raise UsageError(f"[truth] {err.text}", path=file) from err
        frame = "latlon"
    east, north = _on_plane(file, frame, x, y, origin)
    columns_by: ChosenBy = "column names" if section.columns is None else "configuration"
    frame_by: ChosenBy = columns_by if by_name else "default" if section.frame is None else "configuration"
    named = ", ".join(f"{key} = {name}" for key, name in columns.items())
    chosen = [Convention("frame", frame, frame_by), *on_grid, Convention("columns", named, columns_by)]
    chosen += [Convention("skip_rows", section.skip_rows, "configuration")] if section.skip_rows else []
    read = {"time_ns": time_ns, "east_m": east, "north_m": north, "sd_m": sd}
    more = {name: numbers(texts[name][rows.start :], name).checked(file, lines) for name in MORE if name in texts}
    read |= _covariance(more) | _heading(more, frame)
    skipped = {
        name: np.zeros(rows.start, np.int64) if name == "time_ns" else np.full(rows.start, np.nan) for name in read
    }
    table = pd.DataFrame({name: np.concatenate([skipped[name], values]) for name, values in read.items()})
    findings = line_findings(file, read_table)
    if by_name and section.frame not in (None, frame):
        text = f'{file.name}: frame = "{section.frame}" of the configuration is not used; its columns are {frame}'
        findings.append(Finding("KEY-UNUSED", text))
    table.attrs[FINDINGS] = tuple(findings)
    provenance = Provenance(file.name, "file", chosen_by, tuple(chosen), row_count, len(rows))
    return TruthFile(table, provenance, frame, columns.get("time_s") == "time_s")


def _covariance(more: Mapping[str, Column]) -> dict[str, Vector]:
    """Return the covariance of east and north that usbldr's own tracks have."""
    if not {"sd_east_m", "sd_north_m"} <= set(more):
        return {}
    en = more.get("cov_en_m2", np.zeros(len(more["sd_east_m"])))
    return {
        "cov_ee_m2": more["sd_east_m"] ** 2,
        "cov_en_m2": np.asarray(en, float),
        "cov_nn_m2": more["sd_north_m"] ** 2,
    }


def _heading(more: Mapping[str, Column], frame: str) -> dict[str, Vector]:
    """Return headings in degrees: stated ones, or those of quaternions, unless all are the same."""
    if "heading_deg" in more:
        return {"heading_deg": np.asarray(more["heading_deg"], float)}
    if not set(QUATERNION) <= set(more):
        return {}
    quaternion = np.column_stack([np.asarray(more[name], float) for name in QUATERNION])
    heading = heading_of_quaternion(quaternion, frame)
    return {} if np.ptp(heading) == 0 else {"heading_deg": heading}


def _columns(file: Path, texts: Mapping[str, Sequence[str]], section: TruthSection) -> tuple[dict[str, str], str, bool]:
    """Return the columns by key, the frame, and whether the names of the columns state it."""
    if section.columns is not None:
        columns = {str(key): plain(name) for key, name in section.columns.items()}
        clocks = [key for key in columns if key in TIME_UNITS_NS]
        if len(clocks) != 1 or not ({"x", "y"} <= columns.keys() or {"lat_deg", "lon_deg"} <= columns.keys()):
            keys = ", ".join(TIME_UNITS_NS)
            raise UsageError(f"[truth] columns must name x and y, or lat_deg and lon_deg, and one of {keys}", path=file)
        if missing := [name for name in columns.values() if name not in texts]:
            raise LogError(f"has no column {missing[0]} (its columns: {listed(list(texts))})", path=file)
        if "lat_deg" in columns:
            return {**columns, "x": columns["lat_deg"], "y": columns["lon_deg"]}, "latlon", False
        return columns, section.frame or "ENU", False
    cells = {name: next(islice(texts[name], section.skip_rows, None), "") for name in texts}
    named = [column for column in map(named_column, texts) if column]
    clocks = dated_columns(cells, [column for column in named if column.rule.key == "time"])
    places = {column.rule.key: column.name for column in reversed(named) if column.factor == 1}
    places |= {name: name for name in texts}
    pair = next((keys for keys in PLACES if places.keys() >= {*keys}), None)
    if clocks and pair:
        clock = clocks[0]
        keys = [clock.name] if clock.name in TIME_UNITS_NS else keys_since_1970(cells[clock.name])
        key = next((key for key in keys if not clock.known or TIME_UNITS_NS[key] == clock.factor), "time_unix_s")
        columns = {key: clock.name, "x": places[pair[0]], "y": places[pair[1]]}
        columns |= {"sd_m": "sd_m"} if "sd_m" in texts else {}
        return columns, PLACES[pair] or section.frame or "ENU", PLACES[pair] is not None
    example = '{ time_unix_s = "...", x = "...", y = "..." }'
    raise UsageError(
        f"which columns hold time and position (it has {', '.join(texts)})? Call them time_unix_s, lat_deg and lon_deg "
        f"or x and y; of a truth, or state columns = {example} under [truth]",
        path=file,
    )


def _times(cells: Mapping[str, Sequence[str]], columns: Mapping[str, str], start_ns: int) -> ParsedColumn:
    key = next(key for key in TIME_UNITS_NS if key in columns)
    found = times(cells[key], columns[key], TIME_UNITS_NS[key], AT_1970.get(key, 0))
    return found._replace(values=found.values + start_ns) if key == "time_s" else found


def _on_plane(file: Path, frame: str, x: Vector, y: Vector, origin: Origin | None) -> tuple[Vector, Vector]:
    if frame == "latlon":
        if origin is None:
            raise LogError(
                "holds latitudes and longitudes, but the plane has no origin; "
                "state origin_lat_deg and origin_lon_deg under [map]",
                path=file,
            )
        return to_plane(origin, x, y)
    return (y, x) if frame == "NED" else (x, y)
