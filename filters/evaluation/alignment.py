"""Moving a track onto the truth before it is scored, and the shift that is left: for evaluation only, and reported."""

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.evaluation.consistency import LEAST_VARIANCE_M2, nees
from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.frames import rotated, rotation
from usbldr.filters.types import Array, Vector

ALIGNMENTS: Mapping[str, str] = {
    "none": "none",
    "shift": "constant shift fitted to the truth",
    "first": "first epoch moved onto the first truth row",
    "rigid": "rotation and shift fitted to the truth",
    "body": "constant lever arm on the vehicle fitted to the truth",
}
LARGEST_SHARE = 0.5  # of the mean square error: a larger shift makes up most of it
UNEXPLAINED_SHARE = 0.5  # of the mean square motion: if errors have more, track and truth do not move together
DISPLACEMENT_S = 60.0  # [s] of that motion: long enough for a vehicle to go further than fixes scatter
EXPLAINED_SIGMAS = 3.0  # a shift within so many sigmas of the track itself is what the filter expects


class Alignment(NamedTuple):
    """What was done to a track: p -> R(rotation) (p + R(yaw) lever) + shift, east and north."""

    name: str = "none"  # of ALIGNMENTS
    rotation_rad: float = 0.0  # counter-clockwise about up
    shift_m: tuple[float, float] = (0.0, 0.0)
    lever_m: tuple[float, float] = (0.0, 0.0)  # starboard, forward: from the point of the track to that of the truth

    @property
    def matrix(self) -> Array:
        """The rotation, (2, 2)."""
        return rotation(self.rotation_rad)

    def points(self, position_m: Array, yaw_rad: Vector | None = None) -> Array:
        """Move points, (T, 2), of a vehicle at these yaws, (T,); without them there is no lever arm."""
        moved = position_m @ self.matrix.T + np.array(self.shift_m)
        if yaw_rad is None or not any(self.lever_m):
            return moved
        return moved + rotated(yaw_rad + self.rotation_rad, np.array(self.lever_m))

    def after(self, first: "Alignment") -> "Alignment":
        """Return this alignment of a track that the lever arm of another one has moved before."""
        starboard, forward = np.add(self.lever_m, first.lever_m).tolist()
        return self._replace(lever_m=(starboard, forward))

    def covariances(self, cov_m2: Array) -> Array:
        """Turn covariances, (T, 2, 2), with the track."""
        return self.matrix @ cov_m2 @ self.matrix.T

    @property
    def sentence(self) -> str:
        """Describe the alignment with its numbers."""
        text, lever_m = ALIGNMENTS[self.name], np.array(self.lever_m)
        arm = f"{lever_m[0]:+.3f} m starboard, {lever_m[1]:+.3f} m forward"
        if self.name == "body":
            return f"{text} ({arm})"
        stated = f"; moved to the point of the truth ({arm})" if lever_m.any() else ""
        if self.name == "none":
            return text + stated
        turned = f"turned {np.degrees(-self.rotation_rad):+.3f} deg clockwise, " if self.name == "rigid" else ""
        return f"{text} ({turned}shifted {self.shift_m[0]:+.3f} m east, {self.shift_m[1]:+.3f} m north){stated}"


def fit_alignment(
    name: str, first_m: Array, first_truth_m: Array, track_m: Array, truth_m: Array, yaw_rad: Vector | None
) -> Alignment:
    """Find the alignment of that name.

    ``first`` needs the track's first epoch and the first truth row, (2,) each, between which nothing is interpolated;
    ``shift`` and ``rigid`` the scored epochs and the truth at their times, (M, 2) each; ``body`` also the yaw there,
    (M,). Raises LogError for ``body`` on a track without yaw, UsageError for another name.
    """
    if name == "none":
        return Alignment()
    if name == "shift":
        return Alignment("shift", shift_m=_pair((truth_m - track_m).mean(axis=0)))
    if name == "first":
        return Alignment("first", shift_m=_pair(first_truth_m - first_m))
    if name == "rigid":
        return fit_rigid(track_m, truth_m)
    if name == "body":
        if yaw_rad is None:
            raise LogError(
                "--align body needs the heading of the track, which raw fixes lack; use --align none or first"
            )
        return Alignment("body", lever_m=_pair(rotated(-yaw_rad, truth_m - track_m).mean(axis=0)))
    raise UsageError(f"--align {name}: there is only {', '.join(ALIGNMENTS)}")


def fit_rigid(track_m: Array, truth_m: Array) -> Alignment:
    """Fit the rotation and shift that bring (M, 2) points closest to the truth, without scale.

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE Trans. PAMI
    13(4), 1991, doi:10.1109/34.88573; in the plane its rotation is one arctangent.
    """
    a, b = track_m - track_m.mean(axis=0), truth_m - truth_m.mean(axis=0)
    if not (np.any(a) and np.any(b)):
        raise LogError(
            f"--align rigid: the {len(a)} epochs to be scored are all at one place, so no rotation can be fitted; "
            "use --align none or first"
        )
    crossed = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    turn = Alignment("rigid", float(np.arctan2(crossed, np.sum(a * b))))
    return turn._replace(shift_m=_pair(truth_m.mean(axis=0) - turn.points(track_m.mean(axis=0))))


def _pair(point: Array) -> tuple[float, float]:
    return float(point[0]), float(point[1])


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
    A wrong map origin or a lever arm of the truth shifts the whole track, and says nothing about the filter. Mean
    square error = shift squared + mean square of the remaining error, so that the share of the shift lies between 0
    and 1.
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
