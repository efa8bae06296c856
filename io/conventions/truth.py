"""The reference track: a topic of the log or a file of its own, with its frame, its columns and its time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.types import Truth, Vector
from usbldr.io.findings import Finding
from usbldr.io.formats.csv_sheets import plain
from usbldr.io.formats.csv_text import (
    ParsedColumn,
    column,
    cut_findings,
    nanoseconds,
    numbers,
    read_texts,
    row_findings,
    seconds,
)
from usbldr.io.geodesy import Origin, to_plane
from usbldr.io.provenance import ChosenBy, Convention, Provenance
from usbldr.io.settings.sensor_sections import TruthSection

FINDINGS = "findings"  # findings of a truth file, as an attribute of its table


def find_truth_file(name: str, log: Path, from_option: bool) -> Path | None:
    """Return the truth file of that name: of an option from here, else from the folder that holds the log."""
    places = [Path(name)] if from_option else []
    places.append(log.resolve().parent / name)
    return next((place for place in places if place.is_file()), None)


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
    truth = Truth(
        time_s=(rows["time_ns"].to_numpy() - start_ns) / 1e9,
        position_m=rows[["east_m", "north_m"]].to_numpy(dtype=float),
        sd_m=rows["sd_m"].to_numpy(dtype=float),
        kind=kind,
        source=source,
        max_gap_s=section.max_gap_s,
        lever_m=section.lever_arm_m,
    )
    return truth, findings


def read_truth_file(
    file: Path, chosen_by: str, section: TruthSection, start_ns: int, origin: Origin | None
) -> tuple[pd.DataFrame, Provenance]:
    """Return time_ns, east_m, north_m and sd_m of a truth file, and its conventions.

    Skipped rows are not parsed; they are NaN. Raises LogError for a missing column, a broken number or
    an unknown plane; UsageError if the columns are unnamed.
    """
    read_table = read_texts(file)
    texts = read_table.columns
    columns, frame = _columns(file, texts, section)
    row_count = len(texts[columns["x"]])
    rows = range(min(section.skip_rows, row_count), row_count)
    cells = {key: texts[name][rows.start :] for key, name in columns.items()}
    lines = read_table.lines[rows.start :]
    time_ns = _times(cells, columns, start_ns).checked(file, lines)
    x, y = (numbers(cells[axis], columns[axis]).checked(file, lines) for axis in "xy")
    sd = numbers(cells["sd_m"], columns["sd_m"]).checked(file, lines) if "sd_m" in cells else np.full(len(x), np.nan)
    east, north = _on_plane(file, frame, x, y, origin)
    columns_by: ChosenBy = "column names" if section.columns is None else "configuration"
    frame_by = columns_by if section.columns is None or section.frame else "default"
    named = ", ".join(f"{key} = {name}" for key, name in columns.items())
    chosen = [Convention("frame", frame, frame_by), Convention("columns", named, columns_by)]
    chosen += [Convention("skip_rows", section.skip_rows, "configuration")] if section.skip_rows else []
    read = {"time_ns": time_ns, "east_m": east, "north_m": north, "sd_m": sd}
    fill = {"time_ns": 0, "east_m": np.nan, "north_m": np.nan, "sd_m": np.nan}
    table = pd.DataFrame({name: np.insert(read[name], 0, [fill[name]] * rows.start) for name in read})
    findings = [*row_findings(file, read_table, read_table.left_out), *cut_findings(file, read_table)]
    if section.columns is None and section.frame not in (None, frame):
        text = f'{file.name}: frame = "{section.frame}" of the configuration is not used; its columns are {frame}'
        findings.append(Finding("KEY-UNUSED", text))
    table.attrs[FINDINGS] = tuple(findings)
    return table, Provenance(file.name, "file", chosen_by, tuple(chosen), row_count, len(rows))


def _columns(file: Path, texts: Mapping[str, Sequence[str]], section: TruthSection) -> tuple[dict[str, str], str]:
    if section.columns is not None:
        columns = {str(key): plain(name) for key, name in section.columns.items()}
        times = [key for key in columns if key.startswith("time")]
        if len(times) != 1 or "x" not in columns or "y" not in columns:
            raise UsageError("[truth] columns must name x, y and one of time_ns, time_unix_s, time_s", path=file)
        for name in columns.values():
            column(texts, name, file)
        return columns, section.frame or "ENU"
    own = {"time_ns": "time_ns"} | ({"sd_m": "sd_m"} if "sd_m" in texts else {})
    if "time_ns" in texts and {"east_m", "north_m"} <= set(texts):
        return own | {"x": "east_m", "y": "north_m"}, "ENU"
    if "time_ns" in texts and {"lat_deg", "lon_deg"} <= set(texts):
        return own | {"x": "lat_deg", "y": "lon_deg"}, "latlon"
    example = '{ time_unix_s = "...", x = "...", y = "..." }'
    raise UsageError(
        f"which columns hold time and position? State columns = {example} under [truth] "
        f"(its columns: {', '.join(texts)})",
        path=file,
    )


def _times(cells: Mapping[str, Sequence[str]], columns: Mapping[str, str], start_ns: int) -> ParsedColumn:
    if "time_ns" in columns:
        return nanoseconds(cells["time_ns"], columns["time_ns"])
    key = "time_unix_s" if "time_unix_s" in columns else "time_s"
    times = seconds(cells[key], columns[key])
    return times if key == "time_unix_s" else times._replace(values=times.values + start_ns)


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
