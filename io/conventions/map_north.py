"""From true north where a vehicle or ship is to the north of the plane: the convergence of the meridians.

It is known if the positions are by latitude and longitude. A log with positions in a frame of its own has its headings
taken from the north of that frame.
"""

from dataclasses import replace

import numpy as np

from usbldr.filters.frames import convergence_rad, rotated
from usbldr.filters.types import Array, Vector
from usbldr.filters.windows import columns_at, integrated
from usbldr.io.conventions.implausible import TimedRecords
from usbldr.io.conventions.time_series import bracketing, unwrap
from usbldr.io.log import Log
from usbldr.io.messages.layouts import blocks

FEW_FIXES = 5  # the median of so many tolerates two outliers, as at the start of dead reckoning


def on_plane_north(offset_m: Array, place_m: Array, plane_lat_deg: float | None) -> Array:
    """Return offsets (n, 2) that count from true north at places (n, 2) or (2,) as east and north of the plane.

    Without the latitude of the plane's origin they count from its north already.
    """
    return offset_m if plane_lat_deg is None else rotated(convergence_rad(plane_lat_deg, place_m), offset_m)


def headings_on_plane(log: Log) -> Log:
    """Return the log with headings from the plane's north, if its positions are by latitude and longitude.

    The place of each heading is dead reckoned from the last fixes; 1 km of error turns a heading by 0.01 deg at 45 deg
    of latitude.
    """
    source = "usbl" if "usbl" in log.tables else "gps"
    if log.origin is None or not {"dvl", "compass", source} <= log.tables.keys() or not log.provenance[source].geodetic:
        return log
    table = log.tables["compass"]
    headings = TimedRecords.of("", table, ["heading_deg"])
    if not len(headings.values):
        return log
    known_s, moved_m = _displacement_m(log, headings)
    since_s, offset_m = _offsets_m(log, source, headings, known_s, moved_m)
    time_s, heading_deg = table["time_s"].to_numpy(dtype=float), table["heading_deg"].to_numpy(dtype=float, copy=True)
    for rows in blocks(len(table)):
        good, turned = headings.good[rows], heading_deg[rows]
        t = time_s[rows][good]
        place_m = columns_at(t, known_s, moved_m) + offset_m[np.searchsorted(since_s, t, side="right")]
        turned[good] = (turned[good] - np.degrees(convergence_rad(log.origin.lat_deg, place_m))) % 360.0
    provenance = dict(log.provenance) | {source: replace(log.provenance[source], geodetic=False)}
    tables = dict(log.tables) | {"compass": table.assign(heading_deg=heading_deg)}
    return replace(log, tables=tables, provenance=provenance)


def _offsets_m(log: Log, source: str, headings: TimedRecords, known_s: Vector, moved_m: Array) -> tuple[Vector, Array]:
    """Return times (k,) and what to add to displacements before and after each, east and north, (k + 1, 2)."""
    fixes, start = TimedRecords.of("", log.tables[source], ["east_m", "north_m"]), log.parameters.start
    if source == "gps" and start is not None:
        return np.empty(0), np.array([[start.east_m, start.north_m]])
    if not len(fixes.values):
        return np.empty(0), np.zeros((1, 2))
    near_s = headings.time_s[bracketing(headings.time_s, fixes.time_s)]
    offset_m = fixes.values - columns_at(fixes.time_s, near_s, columns_at(near_s, known_s, moved_m))
    count = min(FEW_FIXES, len(offset_m))
    medians_m: Array = np.median(np.lib.stride_tricks.sliding_window_view(offset_m, count, axis=0), axis=-1)
    if source == "gps":  # the truth may only give the start
        return np.empty(0), medians_m[:1]
    return fixes.time_s[count:], medians_m


def _displacement_m(log: Log, headings: TimedRecords) -> tuple[Vector, Array]:
    """Return times (n,) and the displacement dead-reckoned since the first DVL record, (n, 2)."""
    dvl = TimedRecords.of("", log.tables["dvl"], ["starboard_mps", "forward_mps"])
    if len(dvl.values) < 2:
        return np.zeros(1), np.zeros((1, 2))
    clockwise = unwrap(np.radians(headings.values[:, 0]), 2 * np.pi)
    V = rotated(-np.interp(dvl.time_s, headings.time_s, clockwise), dvl.values)
    return dvl.time_s[1:], integrated(dvl.time_s, V)[1:]
