"""From true north where a vehicle or ship is to the north of the plane: the convergence of the meridians.

It is known if the positions are by latitude and longitude. A log with positions in a frame of its own has its headings
taken from the north of that frame.
"""

from dataclasses import replace

import numpy as np

from usbldr.filters.frames import convergence_rad, rotated
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.implausible import Records
from usbldr.io.log import Log

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
    if log.origin is None or source not in log.tables or not log.provenance[source].geodetic:
        return log
    if not {"dvl", "compass"} <= log.tables.keys():
        return log
    table = log.tables["compass"]
    headings = Records.of("", table, ["heading_deg"])
    if not len(headings.rows):
        return log
    turn_rad = convergence_rad(log.origin.lat_deg, _places_m(log, source, headings))
    heading_deg = table["heading_deg"].to_numpy(dtype=float, copy=True)
    heading_deg[headings.rows] = (headings.values[:, 0] - np.degrees(turn_rad)) % 360.0
    provenance = dict(log.provenance) | {source: replace(log.provenance[source], geodetic=False)}
    tables = dict(log.tables) | {"compass": table.assign(heading_deg=heading_deg)}
    return replace(log, tables=tables, provenance=provenance)


def _places_m(log: Log, source: str, headings: Records) -> Array:
    """Return where the vehicle was at the time of each heading, east and north, (n, 2)."""
    fixes, time_s = Records.of("", log.tables[source], ["east_m", "north_m"]), headings.time_s
    moved = _displacement_m(log, headings)
    start = log.parameters.start
    if source == "gps" and start is not None:
        return moved + np.array([start.east_m, start.north_m])
    if not len(fixes.rows):
        return moved
    offset_m = fixes.values - _interpolated(fixes.time_s, time_s, moved)
    count = min(FEW_FIXES, len(offset_m))
    medians_m: Array = np.median(np.lib.stride_tricks.sliding_window_view(offset_m, count, axis=0), axis=-1)
    if source == "gps":  # the truth may only give the start
        return moved + medians_m[0]
    return moved + medians_m[np.maximum(np.searchsorted(fixes.time_s, time_s, side="right") - count, 0)]


def _displacement_m(log: Log, headings: Records) -> Array:
    """Return the dead-reckoned displacement since the first DVL record at the time of each heading, (n, 2)."""
    dvl = Records.of("", log.tables["dvl"], ["starboard_mps", "forward_mps"])
    if len(dvl.rows) < 2:
        return np.zeros((len(headings.rows), 2))
    yaw: Vector = -np.unwrap(np.radians(headings.values[:, 0]))
    V = rotated(np.interp(dvl.time_s, headings.time_s, yaw), dvl.values)
    moved = np.cumsum((V[1:] + V[:-1]) / 2 * np.diff(dvl.time_s)[:, None], axis=0)
    return _interpolated(headings.time_s, dvl.time_s[1:], moved)


def _interpolated(time_s: Vector, known_s: Vector, values: Array) -> Array:
    """Return values (n, k) of known times at other times, (m, k)."""
    columns: list[Vector] = list(values.T)
    return np.column_stack([np.interp(time_s, known_s, column) for column in columns])
