"""Velocities of a DVL and lever arms turned level by roll and pitch, if the log has an attitude.

A DVL measures along its own axes, and some correct for roll and pitch themselves. The change of depth shows which.
The filters place a lever arm in the horizontal plane by the heading alone; here a fix moves by what the tilt changes.
"""

from dataclasses import replace

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.models.parameters import LeverArm
from usbldr.filters.types import Array, Vector
from usbldr.filters.windows import integrated
from usbldr.io.conventions.attitude import along_level_axes
from usbldr.io.conventions.compass import VERTICAL
from usbldr.io.conventions.converted import ConvertedTable
from usbldr.io.conventions.time_series import time_series
from usbldr.io.conventions.usbl_head import rotated_clockwise
from usbldr.io.provenance import ChosenBy, Convention

VELOCITY = ["starboard_mps", "forward_mps", "up_mps"]
LONGEST_GAP_S = 3.0  # across which attitudes are interpolated, and vertical velocities integrated
STRETCH_S = 10.0  # over which the change of depth is compared: waves last less, dives longer
LEAST_SD_M = 0.01  # of a change of depth: the resolution of a pressure sensor
MIN_LOG_ODDS = 3.0  # log 20, as for every sensor error that is taken from a log


def level_velocities(
    dvl: ConvertedTable, compass: ConvertedTable | None, depth: ConvertedTable | None, stated: bool | None
) -> ConvertedTable:
    """Return a DVL's table with velocities along level axes, if so stated, or if the change of depth then fits better.

    Raises SettingError if they are to be levelled, but the compass has no attitude.
    """
    if compass is None or compass.attitude is None:
        if stated:
            raise SettingError("[dvl] level: no record of the compass holds an attitude (a quaternion)")
        return dvl
    time_ns = dvl.table["time_ns"].to_numpy(dtype=np.int64)
    vertical = time_series(compass.attitude, "compass", VERTICAL).at(time_ns, LONGEST_GAP_S)
    velocity = dvl.table[VELOCITY].to_numpy(dtype=float)
    level = along_level_axes(velocity, vertical)
    chosen_by: ChosenBy = "configuration"
    note = ""
    if stated is None:
        if depth is None:
            return dvl
        ups = np.column_stack([velocity[:, 2], level[:, 2]])
        ups[~dvl.table["valid"].to_numpy(dtype=bool)] = np.nan
        log_odds = _log_odds(time_ns, ups, time_series(depth, "depth", ["depth_m"]).at(time_ns)[:, 0])
        stated, chosen_by, note = log_odds > MIN_LOG_ODDS, "data", f"depth, log odds {log_odds:.3g}"
    if not stated:
        return dvl
    known = np.isfinite(level).all(axis=1, keepdims=True)
    table = dvl.table.assign(**dict(zip(VELOCITY, np.where(known, level, velocity).T, strict=True)))
    how = Convention("level", "roll and pitch of the compass", chosen_by, note=note)
    return replace(dvl, table=table, conventions=(*dvl.conventions, how))


def level_lever_arm(fixes: ConvertedTable, compass: ConvertedTable | None, lever_m: LeverArm) -> ConvertedTable:
    """Return fixes, moved so that their lever arm, as stated for an upright vehicle, holds if it is tilted."""
    if not any(lever_m) or compass is None or compass.attitude is None:
        return fixes
    time_ns = fixes.table["time_ns"].to_numpy(dtype=np.int64)
    vertical = time_series(compass.attitude, "compass", VERTICAL).at(time_ns, LONGEST_GAP_S)
    heading_deg = time_series(compass, "compass", ["heading_deg"]).at(time_ns, LONGEST_GAP_S)[:, 0]
    arm_m = np.tile(lever_m, (len(time_ns), 1))
    tilted_m = rotated_clockwise((along_level_axes(arm_m, vertical) - arm_m)[:, :2], heading_deg)
    tilted_m = np.where(np.isfinite(tilted_m), tilted_m, 0.0)
    east_m, north_m = (fixes.table[["east_m", "north_m"]].to_numpy(dtype=float) - tilted_m).T
    how = Convention("lever_arm", "roll and pitch of the compass", "records")
    table = fixes.table.assign(east_m=east_m, north_m=north_m)
    return replace(fixes, table=table, conventions=(*fixes.conventions, how))


def _log_odds(time_ns: Vector, ups_mps: Array, depth_m: Vector) -> float:
    """Return how much better the second of two vertical velocities (n, 2) explains the change of depth.

    It is the log ratio of their likelihoods over stretches, with normal errors of unknown size.
    """
    known = np.isfinite(ups_mps).all(axis=1) & np.isfinite(depth_m)
    order = np.argsort(time_ns[known], kind="stable")
    t, ups, z = (time_ns[known][order] - time_ns[0]) / 1e9, ups_mps[known][order], depth_m[known][order]
    if len(t) < 2:
        return 0.0
    risen = integrated(t, ups)
    broken = np.concatenate([[0], np.cumsum(np.diff(t) > LONGEST_GAP_S)])
    ends = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], STRETCH_S)))
    whole = np.diff(broken[ends]) == 0
    errors = (np.diff(risen[ends], axis=0) + np.diff(z[ends])[:, None])[whole]
    as_recorded, level = np.sum(errors**2 + LEAST_SD_M**2, axis=0)
    return len(errors) / 2 * float(np.log(as_recorded / level)) if len(errors) else 0.0
