"""Errors of heading and velocity, if the truth has these: a SLAM pose, odometry, a TUM file."""

from typing import Annotated, NamedTuple

import numpy as np

from usbldr.filters.evaluation.metrics import Metric, rms
from usbldr.filters.frames import wrapped
from usbldr.filters.types import Mask, Trajectory, Truth, Vector


class HeadingErrors(NamedTuple):
    """Errors of the estimated heading, clockwise."""

    bias_deg: Annotated[float, Metric("bias_heading_deg", "Signed mean of the heading error, clockwise.")]
    rmse_deg: Annotated[float, Metric("rmse_heading_deg", "Root mean square of the heading error.", "lower")]
    max_abs_deg: Annotated[float, Metric("max_abs_heading_deg", "Largest absolute heading error.", "lower")]


class VelocityErrors(NamedTuple):
    """Errors of the estimated velocity along the axes of the vehicle."""

    bias_starboard_mps: Annotated[float, Metric("bias_starboard_mps", "Signed mean error of the starboard velocity.")]
    rmse_starboard_mps: Annotated[
        float, Metric("rmse_starboard_mps", "Root mean square error of the starboard velocity.", "lower")
    ]
    bias_forward_mps: Annotated[float, Metric("bias_forward_mps", "Signed mean error of the forward velocity.")]
    rmse_forward_mps: Annotated[
        float, Metric("rmse_forward_mps", "Root mean square error of the forward velocity.", "lower")
    ]


def heading_errors(track: Trajectory, scored: Mask, truth: Truth, rotation_rad: float) -> HeadingErrors | None:
    """Return the statistics at the scored epochs of a track that an alignment has turned; None if one has no yaw."""
    yaw_rad = track.state("psi")
    if yaw_rad is None or truth.yaw_rad is None:
        return None
    true_rad = np.interp(track.time_s[scored], truth.time_s, truth.yaw_rad)
    error_deg = -np.degrees(wrapped(yaw_rad[scored] + rotation_rad - true_rad))
    return HeadingErrors(float(error_deg.mean()), rms(error_deg), float(np.abs(error_deg).max()))


def velocity_errors(track: Trajectory, scored: Mask, truth: Truth) -> VelocityErrors | None:
    """Return the statistics at the scored epochs; None if the track or the truth has no velocity."""
    u_mps, v_mps = track.state("u"), track.state("v")
    if u_mps is None or v_mps is None or truth.velocity_mps is None:
        return None
    time_s = track.time_s[scored]
    starboard: Vector = u_mps[scored] - np.interp(time_s, truth.time_s, truth.velocity_mps[:, 0])
    forward: Vector = v_mps[scored] - np.interp(time_s, truth.time_s, truth.velocity_mps[:, 1])
    return VelocityErrors(float(starboard.mean()), rms(starboard), float(forward.mean()), rms(forward))
