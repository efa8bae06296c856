"""Tracks and fixes of the field logs against their truth, as the collectors of the logs defined their errors.

East before north, metres. Truth rows outside a track, and fixes outside the truth, are left out.
"""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from survey.expected import Value
from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import Alignment, fit_rigid
from usbldr.filters.replay.dead_reckoning import displacement_m
from usbldr.filters.types import Array, Timeline, Truth, Vector
from usbldr.io.log import Log
from usbldr.io.read import Request, read_log

Measured = dict[str, Value]


def read_as(path: Path, stated: str) -> Log:
    """Read a log by the text of a configuration."""
    with TemporaryDirectory() as folder:
        configuration = Path(folder) / "usbldr.toml"
        configuration.write_text(stated, encoding="utf-8")
        return read_log(path, Request(configuration=str(configuration)))


def truth_of(log: Log) -> Truth:
    if log.truth is None:
        raise LogError(f"{log.path}: no truth to measure errors against")
    return log.truth


def at(truth: Truth, time_s: Vector) -> Array:
    """Return the truth at some times, (n, 2)."""
    return np.column_stack([np.interp(time_s, truth.time_s, column) for column in truth.position_m.T])


def euler(log: Log, longest_s: float = math.inf) -> tuple[Vector, Array]:
    """Return dead reckoning as the collectors did it: each DVL record holds until the next, but no longer than that.

    Times (n,) and positions (n, 2), from the origin.
    """
    dvl, compass = log.tables["dvl"], log.tables["compass"]
    dvl = dvl[dvl["valid"]]
    t = dvl["time_s"].to_numpy()
    heading = np.interp(t, compass["time_s"], np.unwrap(np.radians(compass["heading_deg"])))
    u, v = dvl["starboard_mps"].to_numpy(), dvl["forward_mps"].to_numpy()
    V = np.column_stack([u * np.cos(heading) + v * np.sin(heading), v * np.cos(heading) - u * np.sin(heading)])
    steps = V[:-1] * np.minimum(np.diff(t), longest_s)[:, None]
    return t, np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def reckoned(line: Timeline) -> tuple[Vector, Array]:
    """Return dead reckoning as usbldr does it."""
    return line.time_s, displacement_m(line)


def fitted(truth: Truth, track: tuple[Vector, Array]) -> tuple[Vector, Alignment]:
    """Return distances from every truth row once the track was turned and shifted onto all of them, and the fit."""
    there, moved = together(truth, track)
    found = fit_rigid(moved, there)
    return np.hypot(*(found.points(moved) - there).T), found


def anchored(truth: Truth, track: tuple[Vector, Array], clockwise_deg: float) -> Vector:
    """Return distances from every truth row where the track was turned and starts on the first."""
    there, moved = together(truth, track)
    turned = Alignment("rigid", -math.radians(clockwise_deg)).points(moved)
    return np.hypot(*(turned - turned[0] - there + there[0]).T)


def turn_deg(truth: Truth, track: tuple[Vector, Array]) -> float:
    """Return by how much a track that starts on the truth has to be turned clockwise to lie on it as well as it can."""
    there, moved = (points - points[0] for points in together(truth, track))
    across = np.sum(moved[:, 0] * there[:, 1] - moved[:, 1] * there[:, 0])
    return -math.degrees(math.atan2(across, np.sum(moved * there)))


def together(truth: Truth, track: tuple[Vector, Array]) -> tuple[Array, Array]:
    """Return the truth and the track at the times of the truth that the track spans, (n, 2) each."""
    time_s, position_m = track
    rows = (truth.time_s >= time_s[0]) & (truth.time_s <= time_s[-1])
    moved = [np.interp(truth.time_s[rows], time_s, column) for column in position_m.T]
    return truth.position_m[rows], np.column_stack(moved)


def clockwise_deg(found: Alignment) -> float:
    return float(np.degrees(-found.rotation_rad))


def path_m(position_m: Array) -> float:
    """Return the length of a track, (n, 2)."""
    return float(np.sum(np.hypot(*np.diff(position_m, axis=0).T)))


def fix_offsets(log: Log, rows: NDArray[np.bool_] | None = None) -> Array:
    """Return each fix less the truth at its own time, (n, 2): all fixes, or some rows of them."""
    usbl, truth = log.tables["usbl"], truth_of(log)
    t = usbl["time_s"].to_numpy()
    inside = (t >= truth.time_s[0]) & (t <= truth.time_s[-1])
    if rows is not None:
        inside &= rows
    return (usbl[["east_m", "north_m"]].to_numpy() - at(truth, t))[inside]


def fix_statistics(offset_m: Array) -> Measured:
    """Sum up what fixes are off by, (n, 2)."""
    off_m = np.hypot(*offset_m.T)
    east_m, north_m = (float(value) for value in np.median(offset_m, axis=0))
    many: Measured = {"more_than_5_m": int(np.sum(off_m > 5.0)), "median_east_m": east_m, "median_north_m": north_m}
    return statistics(off_m) | many


def statistics(off_m: Vector) -> Measured:
    """Sum up distances by the names of expected.json."""
    return {
        "n": len(off_m),
        "median_m": float(np.median(off_m)),
        "mean_m": float(np.mean(off_m)),
        "rms_m": float(np.sqrt(np.mean(off_m**2))),
        "p95_m": float(np.percentile(off_m, 95)),
        "max_m": float(np.max(off_m)),
        "end_m": float(off_m[-1]),
    }


def prefixed(name: str, numbers: Measured, way: str = "") -> Measured:
    """Return numbers as parts of a larger one."""
    return {f"{name}.{key}{way}": value for key, value in numbers.items()}
