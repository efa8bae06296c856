"""A Kalman filter of the position alone: dead reckoning moves it, and each USBL fix corrects it."""

import numpy as np

import usbldr

WALK_M = 0.1  # [m/√s] by which dead reckoning drifts, 1-sigma


def position_kf(timeline: usbldr.Timeline, anchor: object) -> usbldr.Trajectory:
    """Return the track of states x, y from the first fix."""
    time_s = timeline.time_s
    cos, sin = np.cos(timeline.dr_yaw_rad), np.sin(timeline.dr_yaw_rad)
    starboard, forward = timeline.dr_mps.T
    velocity_mps = np.column_stack([starboard * cos - forward * sin, starboard * sin + forward * cos])
    at = np.searchsorted(time_s, timeline.fix_time_s)  # the first epoch at or after each fix
    mean, cov = timeline.fix_m[0], timeline.fix_cov_m2[0]
    means, covs = [mean], [cov]
    for k, dt_s in enumerate(np.diff(time_s), start=1):
        mean = mean + dt_s * velocity_mps[k - 1]
        cov = cov + dt_s * WALK_M**2 * np.eye(2)
        for row in np.flatnonzero(at == k):
            gain = cov @ np.linalg.inv(cov + timeline.fix_cov_m2[row])
            mean = mean + gain @ (timeline.fix_m[row] - mean)
            cov = (np.eye(2) - gain) @ cov
        means.append(mean)
        covs.append(cov)
    return usbldr.Trajectory("position-kf", ("x", "y"), time_s, np.array(means), np.array(covs))


POSITION_KF = usbldr.Method(
    "position-kf",
    "Kalman filter of the position",
    make_track=position_kf,
    estimates=frozenset(),
    sensors=("dvl", "compass", "usbl"),
)
