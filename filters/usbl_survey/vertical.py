"""The vertical of a dive's fixes against the vehicle's depth: tilt of the head, scale of its ranges, offset of depths.

A head whose bow is pitched up by p and whose starboard side is rolled down by r measures a vehicle at starboard s and
forward f too deep by p f - r s; ranges whose true length is c times the measured one make it too deep by d (1 / c - 1).
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector
from usbldr.filters.usbl_survey.calibration import DOF, PRIOR_SD, long_run
from usbldr.filters.usbl_survey.verdict import UNCHANGED

NAMES = ("roll_deg", "pitch_deg", "scale", "offset_m")  # of the parameters, in this order
OFFSET_SD_M = 5.0  # of the depth of the head below the surface, and of the pressure of the air, before the fit
LEAST = 40  # fixes with a vertical and a depth, ten for each parameter
MIRRORED_FACTOR = 2.0  # [-] by judgement: how much nearer fixes are to the depth mirrored; not near the head's depth
ROUNDS = 20  # of reweighting: it converges in ten


class VerticalFit(NamedTuple):
    """What the vertical of fixes says of their head; each (4,) by NAMES."""

    value: Vector
    sd: Vector
    prior_sd: Vector
    noise_m: float  # 1-sigma of the vertical of a fix, median
    fixes: int
    mirrored: bool  # the fixes lie as far above the head as the vehicle lies below it

    @property
    def settled(self) -> list[bool]:
        """Whether the dive settles each."""
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
    prior_sd = np.array([*PRIOR_SD[[0, 1, 3]], OFFSET_SD_M])
    value: Vector = np.zeros(4)
    reach_m = np.hypot(starboard, forward)
    weight, sd_m = np.ones(len(y)), np.full(len(y), max(float(np.median(np.abs(y - np.median(y)))) / 0.6745, 1e-4))
    for _ in range(ROUNDS):
        information = (H * (weight / sd_m**2)[:, None]).T @ H + np.diag(prior_sd**-2)
        value = np.asarray(np.linalg.solve(information, H.T @ (weight / sd_m**2 * y)), dtype=np.float64)
        residual = y - H @ value
        sd_m = _noise_m(np.sqrt(weight) * residual, reach_m)
        weight = (DOF + 1) / (DOF + (residual / sd_m) ** 2)
    z = (y - H @ value) / sd_m
    G = H / sd_m[:, None]
    slope = float(np.mean((DOF + 1) * (DOF - z**2) / (DOF + z**2) ** 2))
    prior = np.diag(prior_sd**-2)
    bread = np.linalg.inv(slope * G.T @ G + prior)
    scores = G * ((DOF + 1) * z / (DOF + z**2))[:, None]
    pulls = long_run(scores), scores.T @ scores  # neighbours that differ by chance do not make the fit surer
    sd = np.sqrt(np.max([np.diag(bread @ (pull + prior) @ bread) for pull in pulls], axis=0))
    value[2] = 1.0 + value[2]
    above, below = (np.median(np.abs(drop_m[there] + sign * depth_m[there])) for sign in (1, -1))
    return VerticalFit(value, sd, prior_sd, float(np.median(sd_m)), len(y), bool(MIRRORED_FACTOR * above < below))


def _noise_m(residual_m: Vector, reach_m: Vector) -> Vector:
    """Return the 1-sigma of each vertical, (n,): a constant, and a part that grows with the distance as an angle's."""
    columns = np.column_stack([np.ones(len(reach_m)), reach_m**2])
    for used in ([0, 1], [0], [1]):
        variance = np.linalg.lstsq(columns[:, used], residual_m**2, rcond=None)[0]
        if (variance >= 0).all():
            return np.sqrt(np.maximum(columns[:, used] @ variance, 1e-8))
    return np.full(len(reach_m), 1e-4)
