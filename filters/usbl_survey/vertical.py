"""The vertical of a dive's fixes against the vehicle's depth: tilt of the head, scale of its ranges, offset of depths.

A head whose bow is pitched up by p and whose starboard side is rolled down by r measures a vehicle at starboard s and
forward f too deep by p f - r s; ranges whose true length is c times the measured one make it too deep by d (1 / c - 1).
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector
from usbldr.filters.usbl_survey.calibration import DOF, PRIOR_SD, long_run

NAMES = ("roll_deg", "pitch_deg", "scale", "offset_m")  # of the parameters, in this order
OFFSET_SD_M = 5.0  # of the depth of the head below the surface, and of the pressure of the air, before the fit
LEAST = 40  # fixes with a vertical and a depth, ten for each parameter
ROUNDS = 20  # of reweighting: it converges in ten
UNCHANGED = 0.5  # of the sigma before: the dive has said nothing


class VerticalFit(NamedTuple):
    """What the vertical of fixes says of their head; each (4,) by NAMES."""

    value: Vector
    sd: Vector
    prior_sd: Vector
    noise_m: float  # 1-sigma of the vertical of a fix
    fixes: int

    @property
    def settled(self) -> list[bool]:
        """Whether the dive has told each."""
        return (self.sd < UNCHANGED * self.prior_sd).tolist()


def vertical_fit(drop_m: Vector, depth_m: Vector, along_m: Array) -> VerticalFit | None:
    """Fit how deep fixes lie below the head (n,) to the depths of the vehicle below it, with Student-t errors.

    ``along_m`` (n, 2) is where they lie along starboard and forward of the head. None if too few are known.
    """
    there = np.isfinite(drop_m) & np.isfinite(depth_m) & np.isfinite(along_m).all(axis=1)
    if int(there.sum()) < LEAST:
        return None
    starboard, forward = along_m[there].T
    H = np.column_stack([-np.radians(starboard), np.radians(forward), -depth_m[there], np.ones(len(forward))])
    y = drop_m[there] - depth_m[there]
    prior_sd = np.array([PRIOR_SD[0], PRIOR_SD[1], PRIOR_SD[3], OFFSET_SD_M])
    value: Vector = np.zeros(4)
    weight, sd_m = np.ones(len(y)), 1.0
    for _ in range(ROUNDS):
        residual = y - H @ value
        scale = np.median(np.abs(residual)) / 0.6745 if np.all(weight == 1) else sd_m
        z = residual / max(float(scale), 1e-6)
        weight = (DOF + 1) / (DOF + z**2)
        sd_m = max(float(np.sqrt(np.mean(weight * residual**2))), 1e-4)
        information = (H * weight[:, None]).T @ H / sd_m**2 + np.diag(prior_sd**-2)
        value = np.asarray(np.linalg.solve(information, H.T @ (weight * y) / sd_m**2), dtype=np.float64)
    z = (y - H @ value) / sd_m
    slope = float(np.mean((DOF + 1) * (DOF - z**2) / (DOF + z**2) ** 2))
    prior = np.diag(prior_sd**-2)
    bread = np.linalg.inv(slope * H.T @ H / sd_m**2 + prior)
    scores = H * ((DOF + 1) * z / (DOF + z**2) / sd_m)[:, None]
    cov = bread @ (long_run(scores) + prior) @ bread
    value[2] = 1.0 + value[2]
    return VerticalFit(value, np.sqrt(np.diag(cov)), prior_sd, sd_m, len(y))
