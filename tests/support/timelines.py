"""Timelines of which tests know every number."""

from dataclasses import replace
from typing import Any

import numpy as np

from usbldr.filters.types import Array, Timeline, Vector

HZ = 5


def five_hz(
    dvl_mps: Array,
    yaw_rad: Vector,
    fix_s: Vector,
    fix_m: Array,
    *,
    dvl_sd_mps: float = 0.02,
    yaw_sd_rad: float = 0.01,
    fix_sd_m: float = 1.0,
    **more: Any,
) -> Timeline:
    """Return a timeline with a record of DVL and compass at every epoch, and no GPS unless in more fields."""
    K = len(yaw_rad)
    one = np.ones(K, dtype=np.intp)
    line = Timeline(
        start_ns=0, time_s=np.arange(K) / HZ, slow=np.arange(0, K, HZ),
        dvl_mps=dvl_mps, dvl_count=one, dvl_sd_mps=np.full(K, dvl_sd_mps),
        yaw_rad=yaw_rad, yaw_count=one, yaw_sd_rad=np.full(K, yaw_sd_rad), dr_mps=dvl_mps, dr_yaw_rad=yaw_rad,
        fix_time_s=fix_s, fix_received_s=fix_s, fix_m=fix_m,
        fix_cov_m2=np.tile(fix_sd_m**2 * np.eye(2), (len(fix_s), 1, 1)),
        gps_time_s=np.empty(0), gps_m=np.empty((0, 2)),
    )  # fmt: skip
    return replace(line, **more)
