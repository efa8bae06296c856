"""Moving a track onto the truth before it is scored: for evaluation only, and reported beside every number."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.frames import rotated, rotation
from usbldr.filters.types import Array, Vector

ALIGNMENTS: Mapping[str, str] = {
    "none": "none",
    "shift": "constant shift fitted to the truth",
    "first": "first epoch moved onto the first truth row",
    "rigid": "rotation and shift fitted to the truth",
    "body": "constant lever arm on the vehicle fitted to the truth",
}


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
