"""Tracks in formats of other programs: TUM text (evo, trajectopy), .fnv (MB-System), GeoJSON and KML, and our own CSV.

East and north metres in, with seconds since the log's start; absolute Unix time and WGS84 degrees out.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pandas as pd

from usbldr.filters.errors import printable
from usbldr.filters.evaluation.consistency import sigmas
from usbldr.filters.frames import heading_deg
from usbldr.filters.models.calibration import estimated_errors
from usbldr.filters.types import Array, Indices, Trajectory, Truth, Vector
from usbldr.io.geodesy import Origin, to_geodetic

SECONDS_PER_HOUR = 3600.0  # fixed
MAP_STEP_S = 1.0  # a map shows no more than a point a second
ROWS = 10_000  # [rows] of a table turned to text at once: a megabyte or two

DECIMALS = {
    "s": 9,
    "m": 4,
    "m2": 9,
    "deg": 9,
    "heading_deg": 4,
    "roll_deg": 4,
    "pitch_deg": 4,
    "sd_heading_deg": 5,
    "mdeg": 7,
    "mps": 5,
    "scale": 7,
}
"""Digits written for a column, by its name or by the unit that ends it: 1 ns, 0.1 mm, 0.1 mm on the ground."""


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table with the digits that its units deserve; an unknown value is an empty cell."""
    write_pieces(path, (table.iloc[rows] for rows in _pieces(len(table))))


def write_pieces(path: Path, pieces: Iterable[pd.DataFrame]) -> None:
    """Write a table whose rows come in pieces, as `write_csv` does."""
    with path.open("w", encoding="utf-8", newline="") as out:
        for k, rows in enumerate(pieces):
            rounded(rows).to_csv(out, index=False, header=not k, lineterminator="\n")


def pieces_of(trajectory: Trajectory) -> Iterator[Trajectory]:
    """Yield the estimates of a track piece by piece: a table of all of a long dive would fill the memory."""
    time_s, mean, cov = trajectory.time_s, trajectory.mean, trajectory.cov
    for rows in _pieces(len(time_s)):
        yield replace(trajectory, time_s=time_s[rows], mean=mean[rows], cov=None if cov is None else cov[rows])


def _pieces(count: int) -> list[slice]:
    return [slice(first, first + ROWS) for first in range(0, max(count, 1), ROWS)]  # one of an empty table: its header


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the digits that its units deserve."""
    keys = {name: name if name in DECIMALS else name.rsplit("_", 1)[-1] for name in map(str, table)}
    return table.round({name: DECIMALS[key] for name, key in keys.items() if key in DECIMALS})


def track_table(trajectory: Trajectory, origin: Origin | None) -> pd.DataFrame:
    """Return the track as estimated, without any alignment, one row per epoch.

    The estimated sensor errors are the last columns, each with its sigma.
    """
    unknown = np.full(len(trajectory.time_s), np.nan)
    psi, cov = trajectory.state("psi"), trajectory.position_cov_m2
    u, v = trajectory.state("u"), trajectory.state("v")
    sd = np.full((len(unknown), 2), np.nan) if cov is None else sigmas(cov)
    lat, lon = (unknown, unknown) if origin is None else to_geodetic(origin, *trajectory.position_m.T)
    calibrated = {
        name: values
        for e in estimated_errors(trajectory)
        for name, values in ((e.name, e.value), (f"sd_{e.name}", e.sd))
    }
    return pd.DataFrame(
        {
            "time_s": trajectory.time_s,
            "east_m": trajectory.position_m[:, 0],
            "north_m": trajectory.position_m[:, 1],
            "sd_east_m": sd[:, 0],
            "sd_north_m": sd[:, 1],
            "cov_en_m2": unknown if cov is None else cov[:, 0, 1],
            "heading_deg": unknown if psi is None else heading_deg(psi),
            "starboard_mps": unknown if u is None else u,
            "forward_mps": unknown if v is None else v,
            "lat_deg": lat,
            "lon_deg": lon,
            **calibrated,
        }
    )


def track_content(trajectory: Trajectory) -> dict[str, Any]:
    """Return what report.json says of a track: epochs, states, whether it is smoothed, a digest."""
    digest = hashlib.sha256()
    for part in (trajectory.time_s, trajectory.mean, trajectory.cov):
        digest.update(b"" if part is None else np.ascontiguousarray(part, dtype="<f8").ravel().data)
    return {
        "epochs": len(trajectory.time_s),
        "states": trajectory.names,
        "smoothed": trajectory.smoothed,
        "sha256": digest.hexdigest(),
    }


def write_tum(
    path: Path,
    start_ns: int,
    time_s: Vector,
    position_m: Array,
    yaw_rad: Vector | None = None,
    depth_m: Vector | None = None,
) -> None:
    """Write `timestamp x y z qx qy qz qw`: Unix seconds to the nanosecond, x east, y north, z up, 0 if it is unknown.

    The quaternion rotates x to the bow, as in REP 103: yaw is 0 when the bow points east. Without a yaw it is 0 0 0 1.
    """
    half = np.zeros(len(time_s)) if yaw_rad is None else (yaw_rad + np.pi / 2) / 2
    stamps = [start_ns + round(t * 1e9) for t in time_s.tolist()]
    up_m = np.zeros(len(time_s)) if depth_m is None else -np.nan_to_num(depth_m)
    heights = [f"{z:.4f}" if z else "0" for z in up_m.tolist()]
    rows = zip(stamps, position_m.tolist(), heights, np.sin(half).tolist(), np.cos(half).tolist(), strict=True)
    with path.open("w", encoding="utf-8", newline="\n") as out:
        for ns, (east, north), up, qz, qw in rows:
            seconds, rest = divmod(ns, 1_000_000_000)
            out.write(f"{seconds}.{rest:09d} {east:.6f} {north:.6f} {up} 0 0 {qz:.9f} {qw:.9f}\n")


FNV_HEAD = (
    "## <yyyy mm dd hh mm ss.ssssss> <epoch seconds> <longitude (deg)> <latitude (deg)> <heading (deg)> "
    "<speed (km/hr)> <draft (m)> <roll (deg)> <pitch (deg)> <heave (m)> <portlon (deg)> <portlat (deg)> "
    "<stbdlon (deg)> <stbdlat (deg)>\n"
)


def write_fnv(path: Path, trajectory: Trajectory, origin: Origin, start_ns: int) -> None:
    """Write the track once a second as fast navigation of MB-System, columns tMXYHScRPr=X=Y+X+Y of mblist.

    Unknown are 0: depth, roll, pitch and heave; heading and speed of a track without them. The swath has no width.
    """
    shown = a_point_a_second(trajectory.time_s)
    place = np.array(_coordinates(trajectory.position_m[shown], origin)).reshape(-1, 2)
    zero = np.zeros(len(trajectory.time_s))
    psi, u, v = (zero if (known := trajectory.state(name)) is None else known for name in ("psi", "u", "v"))
    heading = zero if trajectory.state("psi") is None else heading_deg(psi)
    speed_kmph = SECONDS_PER_HOUR / 1000 * np.hypot(u, v)
    rows = zip(trajectory.time_s[shown].tolist(), place.tolist(), heading[shown], speed_kmph[shown], strict=True)
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(FNV_HEAD)
        for time_s, (lon, lat), degrees, kmph in rows:
            if not np.isfinite(lon):
                continue
            micros = (start_ns + round(time_s * 1e9)) // 1000
            moment = datetime(1970, 1, 1) + timedelta(microseconds=micros)
            out.write(
                f"{moment:%Y %m %d %H %M %S.%f}\t{micros // 1_000_000}.{micros % 1_000_000:06d}\t"
                f"{lon:.10f}\t{lat:.10f}\t{degrees:.3f}\t{kmph:.3f}\t0.0000\t0.000\t0.000\t0.0000"
                + f"\t{lon:.10f}\t{lat:.10f}" * 2
                + "\n"
            )


def write_geojson(path: Path, trajectory: Trajectory, truth: Truth | None, fixes: pd.DataFrame, origin: Origin) -> None:
    """Write the track, the truth (cut at its long gaps) and the fixes with their outcomes, as RFC 7946."""
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.writelines(geojson_pieces(_features(trajectory, truth, fixes, origin)))


def _features(
    trajectory: Trajectory, truth: Truth | None, fixes: pd.DataFrame, origin: Origin
) -> Iterator[dict[str, Any]]:
    line = _track_line(trajectory, origin)
    yield feature("LineString", line, {"name": trajectory.label, "role": "estimate"})
    if truth is not None:
        said = {"name": f"truth ({truth.kind})", "role": "truth", "source": truth.source}
        yield feature("MultiLineString", _truth_lines(truth, origin), said)
    places = _coordinates(fixes[["east_m", "north_m"]].to_numpy(), origin)
    for place, t, outcome in zip(places, fixes["time_s"].tolist(), fixes["outcome"].tolist(), strict=True):
        said = {"name": "USBL fix", "role": "fix", "time_s": round(t, 3), "outcome": outcome}
        yield feature("Point", place, said)


def feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    """Return a feature of RFC 7946."""
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def geojson_pieces(features: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield features as the text of a file of RFC 7946, one by one: those of a long dive would fill the memory."""
    yield '{"type": "FeatureCollection", "features": ['
    for k, one in enumerate(features):
        yield (", " if k else "") + json.dumps(one, allow_nan=False)
    yield "]}\n"


def write_kml(
    path: Path, name: str, trajectory: Trajectory, truth: Truth | None, origin: Origin, depth_m: Vector | None = None
) -> None:
    """Write the track and the truth as lines on the water, KML 2.2; the track at its depth (K,), if it is known."""
    deep = depth_m is not None and bool(np.isfinite(depth_m).any())
    track = [_track_line(trajectory, origin, depth_m if deep else None)]
    lines = [(trajectory.label, "ffb27200", track)]  # colours are alpha, blue, green, red
    if truth is not None:
        lines.append((f"truth ({truth.kind})", "ff000000", _truth_lines(truth, origin)))
    placemarks = "".join(
        f"<Placemark><name>{escape(printable(label))}</name><Style><LineStyle><color>{colour}</color><width>2</width>"
        "</LineStyle></Style><MultiGeometry>"
        f"{''.join(kml_shape('LineString', line) for line in parts)}</MultiGeometry></Placemark>\n"
        for label, colour, parts in lines
    )
    path.write_text(kml_text(name, placemarks), encoding="utf-8")


def kml_text(name: str, placemarks: str) -> str:
    """Return placemarks as a file of KML 2.2."""
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
    return f"{head}<name>{escape(printable(name))}</name>\n{placemarks}</Document></kml>\n"


def kml_shape(kind: str, line: list[list[float]]) -> str:
    """Return a LineString or a Point; heights, if any, count from the sea, and not from its floor."""
    mode = "<altitudeMode>absolute</altitudeMode>" if len(line[0]) > 2 else ""
    places = " ".join(",".join(map(str, place)) for place in line)
    return f"<{kind}>{mode}<coordinates>{places}</coordinates></{kind}>"


def _track_line(trajectory: Trajectory, origin: Origin, depth_m: Vector | None = None) -> list[list[float]]:
    """Return longitude, latitude and, with a depth (K,), height of a point a second; a depth not known is 0."""
    shown = np.flatnonzero(np.isfinite(trajectory.position_m).all(axis=1))
    shown = shown[a_point_a_second(trajectory.time_s[shown])]
    line = _coordinates(trajectory.position_m[shown], origin)
    if depth_m is not None:
        heights = (0.0 - np.nan_to_num(depth_m[shown])).round(DECIMALS["m"]).tolist()
        line = [[*place, up] for place, up in zip(line, heights, strict=True)]
    return line if len(line) > 1 else line * 2  # a line has two ends


def _truth_lines(truth: Truth, origin: Origin) -> list[list[list[float]]]:
    cuts = np.flatnonzero(np.diff(truth.time_s) > truth.max_gap_s) + 1
    lines: list[list[list[float]]] = []
    for part in np.split(np.arange(len(truth.time_s)), cuts):
        shown = part[a_point_a_second(truth.time_s[part])]
        if len(shown) > 1:
            lines.append(_coordinates(truth.position_m[shown], origin))
    return lines


def a_point_a_second(time_s: Vector) -> Indices:
    """Return the indices of the first point of each second, and of the last of all."""
    if not len(time_s):
        return np.empty(0, dtype=np.intp)
    _, first = np.unique(np.floor(time_s / MAP_STEP_S), return_index=True)
    return np.union1d(first, [len(time_s) - 1])


def _coordinates(position_m: Array, origin: Origin) -> list[list[float]]:
    lat, lon = to_geodetic(origin, *position_m.T)
    return np.column_stack([lon, lat]).round(DECIMALS["deg"]).tolist()
