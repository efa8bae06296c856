"""Where a sensor was at given times, by a smoothed run: position, depth, attitude, and the radius that holds 95 %.

Between two epochs the position follows the cubic through both positions with both velocities, and the covariance goes
from one to the other. Nothing is extrapolated.
"""

import json
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.frames import rotated
from usbldr.filters.models.parameters import LeverArm
from usbldr.filters.types import Array, Mask, Vector
from usbldr.filters.usbl_survey.geometry import attitude_matrix
from usbldr.io.geodesy import Origin, OriginKind, to_geodetic
from usbldr.io.reader import Nanoseconds
from usbldr.io.reports.run_directory import REPORT

SHARE = 0.95  # fixed: of the positions that the radius holds
ANGLES = np.radians(np.arange(0.5, 90))  # of a quarter circle, for the integral of the radius
ROUNDS = 40  # of bisection: far below a millimetre
STEEPEST_RAY = np.cos(np.radians(80.0))  # [-] of a footprint: nearer to the horizon no bottom is flat enough
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])  # fixed: of a footprint, starboard and forward
OUTSIDE, BEFORE, OUTAGE = "outside the run", "before the first fix", "in an outage of the {}"


class SmoothedRun(NamedTuple):
    """What a run directory holds of its track."""

    folder: Path
    start_ns: int
    origin: Origin | None
    epochs: pd.DataFrame  # track and pose, by time_s
    first_fix_s: float
    outages: tuple[tuple[str, float, float], ...]  # sensor, from, to
    log: Path


def read_smoothed_run(folder: Path) -> SmoothedRun:
    """Read a run directory; raise LogError if it is none, UsageError with the command to repeat an unsmoothed one."""
    try:
        report: Any = json.loads((folder / REPORT).read_text(encoding="utf-8"))
        smoothed, start_ns = report["track"]["smoothed"], int(report["time_base"]["start_ns"])
        (track,) = folder.glob("track_*hz.csv")
        log = Path(report["request"].get("log", report["log"]["name"]))  # a run in Python has no request
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise LogError(f"{folder} is not a run directory of a filter: usbldr replay LOG --smooth -o {folder}") from err
    if not smoothed:
        words = [word for word in report["provenance"]["command"] if word != "--force"]
        again = shlex.join([*(words or ("usbldr", "replay", str(log))), "--smooth", "--force"])
        raise UsageError(f"{folder} is not smoothed, so later fixes are not used: repeat it by {again}")
    pose = folder / track.name.replace("track", "pose")
    if not pose.is_file():
        raise LogError(f"{folder} holds no {pose.name}: its track has no heading, or an older version wrote it")
    epochs = pd.read_csv(track).merge(pd.read_csv(pose), on="time_s", validate="one_to_one")
    fixes = pd.read_csv(folder / "fixes.csv")
    used = fixes.loc[fixes["outcome"] == "used", "time_s"]
    place = report["origin"]
    origin = None
    if place is not None and not report.get("place_unknown"):  # only a run with a truth says it
        origin = Origin(place["lat_deg"], place["lon_deg"], OriginKind.MAP)
    first_fix_s = float(used.min()) if len(used) else float("inf")
    outages = tuple((one["sensor"], one["start_s"], one["end_s"]) for one in report["outages"])
    return SmoothedRun(folder, start_ns, origin, epochs, first_fix_s, outages, log)


def located(
    run: SmoothedRun,
    time_ns: Nanoseconds,
    lever_m: LeverArm = (0.0, 0.0, 0.0),
    opening_deg: tuple[float, float] | None = None,
) -> pd.DataFrame:
    """Return where a sensor was at Unix times (n,), with the arm starboard, forward, up of the vehicle to it.

    Columns: time_ns, lat_deg, lon_deg, east_m, north_m, depth_m, altitude_m (of the sensor above the bottom),
    heading_deg, roll_deg, pitch_deg, sd_east_m, sd_north_m, cov_en_m2, radius95_m; with the opening angles across and
    along of a camera that looks down, footprint_across_m, footprint_along_m and footprint, a polygon of WKT in degrees
    (longitude first); last note. Outside of the run all but the time and the note are unknown.
    """
    table = run.epochs
    known_s = table["time_s"].to_numpy(dtype=float)
    time_s = (np.asarray(time_ns, dtype=np.int64) - run.start_ns) / 1e9
    inside = (time_s >= known_s[0]) & (time_s <= known_s[-1])

    def between(column: str) -> Vector:  # a column that an older version did not write is unknown
        values: Vector = table[column].to_numpy(dtype=float) if column in table else np.full(len(known_s), np.nan)
        return np.interp(time_s, known_s, values)

    heading_rad: Vector = np.unwrap(np.radians(table["heading_deg"].to_numpy(dtype=float)))
    heading_deg = np.degrees(np.interp(time_s, known_s, heading_rad))
    position = _cubic(table, heading_rad, np.clip(time_s, known_s[0], known_s[-1]))
    roll, pitch = between("roll_deg"), between("pitch_deg")
    tilted = attitude_matrix(heading_deg, np.nan_to_num(pitch), np.nan_to_num(roll))
    arm = np.einsum("nij,j->ni", tilted, np.array(lever_m))
    cov = _covariance(between, arm)
    east, north = (position + arm[:, :2]).T
    lat, lon = (np.full(len(time_s), np.nan),) * 2 if run.origin is None else to_geodetic(run.origin, east, north)
    columns = {
        "lat_deg": lat,
        "lon_deg": lon,
        "east_m": east,
        "north_m": north,
        "depth_m": between("depth_m") - arm[:, 2],
        "altitude_m": between("altitude_m") + arm[:, 2],
        "heading_deg": heading_deg % 360,
        "roll_deg": roll,
        "pitch_deg": pitch,
        "sd_east_m": np.sqrt(cov[:, 0, 0]),
        "sd_north_m": np.sqrt(cov[:, 1, 1]),
        "cov_en_m2": cov[:, 0, 1],
        "radius95_m": radius(cov),
    }
    made = pd.DataFrame({name: np.where(inside, values, np.nan) for name, values in columns.items()})
    made.insert(0, "time_ns", np.asarray(time_ns, dtype=np.int64))
    if opening_deg is not None:
        made = made.assign(**_footprints(run.origin, made, tilted, opening_deg))
    return made.assign(note=_notes(run, time_s, inside))


def _footprints(
    origin: Origin | None, made: pd.DataFrame, attitude: Array, opening_deg: tuple[float, float]
) -> dict[str, Vector | list[str]]:
    """Return width, length and corners of what a camera along the vehicle's down axis sees of a flat bottom."""
    half = np.tan(np.radians(opening_deg) / 2)
    rays = np.einsum("nij,kj->nki", attitude, np.column_stack([CORNERS * half, -np.ones(len(CORNERS))]))
    lowest = np.max(rays[:, :, 2] / np.linalg.norm(rays, axis=2), axis=1)
    altitude_m = made["altitude_m"].to_numpy(dtype=float)
    seen = (lowest < -STEEPEST_RAY) & (altitude_m > 0)
    reach_m = np.where(seen, altitude_m, np.nan)[:, None, None] * rays[:, :, :2] / -rays[:, :, 2:]
    sides_m = np.linalg.norm(np.diff(reach_m, axis=1), axis=2)
    polygons = [""] * len(made)
    if origin is not None:
        corners_m = made[["east_m", "north_m"]].to_numpy(dtype=float)[:, None] + reach_m
        lat, lon = to_geodetic(origin, corners_m[..., 0].ravel(), corners_m[..., 1].ravel())
        places = np.stack([lon, lat], axis=1).reshape(*corners_m.shape)
        for row in np.flatnonzero(seen & np.isfinite(corners_m).all(axis=(1, 2))):
            polygons[row] = f"POLYGON (({', '.join(f'{x:.9f} {y:.9f}' for x, y in places[row].tolist())}))"
    across, along = sides_m[:, [0, 2]].mean(axis=1), sides_m[:, [1, 3]].mean(axis=1)
    return {"footprint_across_m": across, "footprint_along_m": along, "footprint": polygons}


def _cubic(table: pd.DataFrame, heading_rad: Vector, time_s: Vector) -> Array:
    """Return positions (n, 2) on the cubic through the epochs around them, with their velocities (Hermite)."""
    known_s = table["time_s"].to_numpy(dtype=float)
    at = np.clip(np.searchsorted(known_s, time_s, side="right") - 1, 0, len(known_s) - 2)
    h = np.diff(known_s)[at, None]
    s = (time_s - known_s[at])[:, None] / h
    position: Array = table[["east_m", "north_m"]].to_numpy(dtype=float)
    velocity = rotated(-heading_rad, table[["starboard_mps", "forward_mps"]].to_numpy(dtype=float))
    first = (1 + 2 * s) * (1 - s) ** 2 * position[at] + s * (1 - s) ** 2 * h * velocity[at]
    return first + s**2 * (3 - 2 * s) * position[at + 1] + s**2 * (s - 1) * h * velocity[at + 1]


def _covariance(between: Any, arm_m: Array) -> Array:
    """Return the covariance of the sensor's east and north, (n, 2, 2): a heading error turns the arm."""
    per_deg = np.radians(np.column_stack([arm_m[:, 1], -arm_m[:, 0]]))  # clockwise
    cross = np.column_stack([between("cov_east_heading_mdeg"), between("cov_north_heading_mdeg")])
    own = np.empty((len(arm_m), 2, 2))
    own[:, 0, 0], own[:, 1, 1] = between("sd_east_m") ** 2, between("sd_north_m") ** 2
    own[:, 0, 1] = own[:, 1, 0] = between("cov_en_m2")
    mixed = np.einsum("ni,nj->nij", cross, per_deg)
    turned = np.einsum("n,ni,nj->nij", between("sd_heading_deg") ** 2, per_deg, per_deg)
    return own + mixed + np.swapaxes(mixed, 1, 2) + turned


def radius(cov_m2: Array) -> Vector:
    """Return the radius around the estimate that holds the true position with SHARE, (n,), of covariances (n, 2, 2).

    A normal error is a random length along (a cos t, b sin t), t uniform and a, b the sigmas along the ellipse, so it
    lies within R with the mean over t of 1 - exp(-R^2 / 2 / (a^2 cos^2 t + b^2 sin^2 t)).
    """
    variance = np.maximum(np.linalg.eigvalsh(np.where(np.isfinite(cov_m2), cov_m2, 0.0)), 1e-12)
    spread = variance[:, :1] * np.cos(ANGLES) ** 2 + variance[:, 1:] * np.sin(ANGLES) ** 2
    low, high = np.zeros(len(variance)), 3 * np.sqrt(variance[:, 1])
    for _ in range(ROUNDS):
        middle = (low + high) / 2
        short = np.mean(1 - np.exp(-(middle[:, None] ** 2) / spread / 2), axis=1) < SHARE
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(np.isfinite(cov_m2).all(axis=(1, 2)), high, np.nan)


def _notes(run: SmoothedRun, time_s: Vector, inside: Mask) -> list[str]:
    """Return what to know of each time: nothing, outside the run, before the first fix, in which outages."""
    notes: list[list[str]] = [[] for _ in time_s]
    for sensor, first_s, last_s in run.outages:
        for row in np.flatnonzero((time_s > first_s) & (time_s < last_s)):
            notes[row].append(OUTAGE.format(sensor.upper() if sensor != "compass" else sensor))
    for row in np.flatnonzero(time_s < run.first_fix_s):
        notes[row].insert(0, BEFORE)
    return ["; ".join(one) if here else OUTSIDE for one, here in zip(notes, inside, strict=True)]
