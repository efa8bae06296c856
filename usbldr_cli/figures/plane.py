"""The plane in pictures: east and north at one scale, or, for a straight track, along and across it at two scales."""

import math
from dataclasses import dataclass

import numpy as np

from usbldr.filters.types import Array
from usbldr_cli.figures.style import Axes

STRAIGHT = 0.05  # width over length of a track: a narrower one would be a single line at one scale
CIRCLE = np.linspace(0, 2 * math.pi, 37)  # [rad] corners of an ellipse
USUAL = (1.0, 99.0)  # [%] of the points that set the scale of axes: a few wrong ones do not


@dataclass(frozen=True, slots=True)
class Plane:
    """How positions are drawn: as they are, or turned so that a straight track lies along the first axis."""

    origin_m: Array  # (2,)
    turn: Array | None = None  # (2, 2); None: east and north

    def points(self, position_m: Array) -> Array:
        """Return positions, east and north (n, 2), as they are drawn."""
        return position_m if self.turn is None else (position_m - self.origin_m) @ self.turn.T

    @property
    def text(self) -> str:
        """What the title of the panel says of it."""
        if self.turn is None:
            return ""
        bearing_deg = math.degrees(math.atan2(self.turn[0, 0], self.turn[0, 1])) % 360
        return f"turned: {bearing_deg:03.0f} deg points right, across at a larger scale"


EAST_NORTH = Plane(np.zeros(2))


def plane_of(track_m: Array) -> Plane:
    """Return how a track (n, 2) is drawn: turned if it is narrower than STRAIGHT times its length."""
    known = track_m[np.isfinite(track_m).all(axis=1)]
    middle = known.mean(axis=0)
    along = np.linalg.svd(known - middle, full_matrices=False)[2][0] if len(known) > 2 else np.array([1.0, 0.0])
    if (known[-1] - known[0]) @ along < 0:
        along = -along
    turn = np.array([along, [-along[1], along[0]]])
    length, width = np.ptp((known - middle) @ turn.T, axis=0)
    return Plane(known[0], turn) if width < STRAIGHT * length else Plane(middle)


def frame_plane(axes: Axes, plane: Plane, points_m: Array, margin: float) -> None:
    """Label the axes and frame the points: in a square at one scale, or each axis by itself."""
    drawn = plane.points(points_m)
    if plane.turn is None:
        plane_axes(axes)
        frame_square(axes, drawn, margin)
        return
    low, high = np.percentile(drawn, USUAL, axis=0)
    reach = max(1.6 * float(np.abs([low[1], high[1]]).max()), 1.0)
    edge = margin * float(np.ptp(drawn[:, 0]))
    axes.set_xlim(drawn[:, 0].min() - edge, drawn[:, 0].max() + edge)
    axes.set_ylim(-reach, reach)
    axes.set_xlabel("along the track [m]")
    axes.set_ylabel("across it, to the left [m]")


def usual_box(points_m: Array) -> Array:
    """Return two corners (2, 2) between which all points (n, 2) but a few lie; none of none."""
    return np.percentile(points_m, USUAL, axis=0) if len(points_m) else points_m


def plane_axes(axes: Axes) -> None:
    """Label the axes of a plane, on which metres are as long east as north."""
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.ticklabel_format(useOffset=False)


def frame_square(axes: Axes, points_m: Array, margin: float) -> None:
    """Frame the points in a square."""
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    half = max(float(np.max(np.ptp(points_m, axis=0))) / 2, 0.5) * (1 + margin)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def sigma_ellipses(center_m: Array, cov_m2: Array, sigmas: float) -> Array:
    """Return the outlines of confidence ellipses, (n, corners, 2), for centres (n, 2) and covariances (n, 2, 2)."""
    variance, vectors = np.linalg.eigh(cov_m2)
    axes_m = vectors * np.sqrt(np.maximum(variance, 0))[:, None, :]
    circle = np.stack([np.cos(CIRCLE), np.sin(CIRCLE)])
    return center_m[:, None, :] + sigmas * np.einsum("nij,jk->nki", axes_m, circle)
