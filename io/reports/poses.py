"""The vehicle's pose at the epochs of a track beside its position: depth, altitude, tilt, and its heading's sigma."""

import numpy as np
import pandas as pd

from usbldr.filters.types import Array, Trajectory, Vector
from usbldr.io.log import Log

MAX_GAP_S = 3.0  # [s] across which depth, roll and pitch are interpolated


def pose_table(log: Log, trajectory: Trajectory) -> pd.DataFrame | None:
    """Return depth, altitude, roll, pitch, and the heading's covariance with the position; None without a heading.

    The altitude is that of the vehicle's reference point above the bottom: what the DVL measured, less its arm up.

    Unknown values are NaN. Headings are clockwise, the covariances with east and north in metres times degrees.
    """
    psi = trajectory.names.index("psi") if "psi" in trajectory.names else None
    if psi is None or trajectory.cov is None:
        return None
    x, y = trajectory.names.index("x"), trajectory.names.index("y")
    time_s = trajectory.time_s
    return pd.DataFrame(
        {
            "time_s": time_s,
            "depth_m": column_at(time_s, log.tables.get("depth"), "depth_m"),
            "altitude_m": column_at(time_s, log.altitude, "altitude_m") - log.parameters.dvl_lever_m[2],
            "roll_deg": column_at(time_s, log.attitude, "roll_deg"),
            "pitch_deg": column_at(time_s, log.attitude, "pitch_deg"),
            "sd_heading_deg": np.degrees(np.sqrt(trajectory.cov[:, psi, psi])),
            "cov_east_heading_mdeg": -np.degrees(trajectory.cov[:, x, psi]),
            "cov_north_heading_mdeg": -np.degrees(trajectory.cov[:, y, psi]),
        }
    )


def column_at(time_s: Vector, table: pd.DataFrame | None, column: str) -> Vector:
    """Return a column of a table at the times, (n,); NaN outside of its records and inside long gaps."""
    if table is None or not len(table):
        return np.full(len(time_s), np.nan)
    known_s = table["time_s"].to_numpy(dtype=float)
    values: Array = table[column].to_numpy(dtype=float)
    found = np.interp(time_s, known_s, values, left=np.nan, right=np.nan)
    after = np.minimum(np.searchsorted(known_s, time_s), len(known_s) - 1)
    before = np.maximum(np.searchsorted(known_s, time_s, side="right") - 1, 0)
    return np.where(known_s[after] - known_s[before] > MAX_GAP_S, np.nan, found)
