"""The constant shift of a track against the truth, apart from what remains of the errors.

A wrong map origin or a lever arm of the truth shifts the whole track, and says nothing about the filter. Mean square
error = shift squared + mean square of the remaining error, so that the share of the shift lies between 0 and 1.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from usbldr.filters.evaluation.consistency import LEAST_VARIANCE_M2, nees
from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.types import Array, Vector

LARGEST_SHARE = 0.5  # of the mean square error: a larger shift makes up most of it
UNEXPLAINED_SHARE = 0.5  # of the mean square motion: if errors have more, track and truth do not move together
DISPLACEMENT_S = 60.0  # [s] of that motion: long enough for a vehicle to go further than fixes scatter
EXPLAINED_SIGMAS = 3.0  # a shift within so many sigmas of the track itself is what the filter expects


class ConstantShift(NamedTuple):
    """The mean error as a vector, and the errors after it is subtracted."""

    length_m: Annotated[float, Metric("shift_m", "Length of the mean error as a vector.", "lower")]
    share: Annotated[float, Metric("shift_share", "Share of that shift in the mean square error.")]
    mean_m: Annotated[float, Metric("unshifted_mean_m", "Mean horizontal error without the shift.", "lower")]
    rmse_m: Annotated[float, Metric("unshifted_rmse_m", "RMS horizontal error without the shift.", "lower")]
    nees: Annotated[float | None, Metric("unshifted_nees", "Mean NEES without the shift.")]
    sigmas: Annotated[float, Metric("shift_sigmas", "Length of the shift over the sigma of the track.")]

    @property
    def dominates(self) -> bool:
        """Whether the shift is most of the mean square error, and larger than the track's sigma explains."""
        return self.share > LARGEST_SHARE and self.sigmas > EXPLAINED_SIGMAS


def constant_shift(error_m: Array, cov_m2: Array | None) -> ConstantShift:
    """Split errors (M, 2) with their covariances (M, 2, 2), if known, into a shift and what remains.

    Without covariances the sigma of the track is the RMS of what remains.
    """
    shift_m: Vector = error_m.mean(axis=0)
    remaining_m = error_m - shift_m
    length_m = math.hypot(float(shift_m[0]), float(shift_m[1]))
    off_m: Vector = np.hypot(*remaining_m.T)
    rest_m2 = float(np.mean(off_m**2))
    share = length_m**2 / max(length_m**2 + rest_m2, LEAST_VARIANCE_M2)
    variance_m2, remaining_nees = rest_m2, None
    if cov_m2 is not None and (known := np.isfinite(cov_m2).all(axis=(1, 2))).any():
        remaining_nees = float(nees(remaining_m[known], cov_m2[known]).mean())
        variance_m2 = float(np.trace(cov_m2[known], axis1=1, axis2=2).mean())
    sigmas = length_m / math.sqrt(max(variance_m2, LEAST_VARIANCE_M2))
    return ConstantShift(length_m, share, float(off_m.mean()), math.sqrt(rest_m2), remaining_nees, sigmas)


def moves_otherwise(shift: ConstantShift, time_s: Vector, error_m: Array, truth_m: Array) -> bool:
    """Return whether errors change as much as the truth (M, 2) moves within a minute, and beyond the sigmas.

    Drift of the track and slow errors do not count. Without sigmas return False.
    """
    later = np.searchsorted(time_s, time_s + DISPLACEMENT_S)
    first = np.flatnonzero(later < len(time_s))
    first = first[time_s[later[first]] - time_s[first] < 2 * DISPLACEMENT_S]
    moved_m2, changed_m2 = (float(np.sum((p[later[first]] - p[first]) ** 2)) for p in (truth_m, error_m))
    beyond = shift.nees is not None and shift.nees > 2 * EXPLAINED_SIGMAS**2
    return beyond and changed_m2 > UNEXPLAINED_SHARE * moved_m2
