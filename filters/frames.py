"""Angles and rotations in the plane: radians, counter-clockwise about up, as psi; headings are degrees clockwise."""

import math
from typing import TypeVar

import numpy as np

from usbldr.filters.types import Array, Vector

Angle = TypeVar("Angle", float, Array)
WGS84_M, WGS84_E2 = 6378137.0, 6.69437999014e-3  # fixed: semi-major axis and squared eccentricity


def wrapped(angle: Angle, half_turn: float = math.pi) -> Angle:
    """Return the angle within half a turn of 0: in radians, or in degrees with a half turn of 180."""
    return (angle + half_turn) % (2 * half_turn) - half_turn


def heading_deg(yaw_rad: Vector) -> Vector:
    """Return headings in degrees clockwise from north, 0 to 360, for yaw angles in radians: (n,) both."""
    return np.degrees(-yaw_rad) % 360.0


def rotation(angle_rad: float | Vector) -> Array:
    """Return the (2, 2) matrix, or (n, 2, 2), that turns a vector counter-clockwise: R(psi) (u, v) = (V_E, V_N)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([c, -s, s, c], axis=-1).reshape(*np.shape(c), 2, 2)


def rotated(angle_rad: float | Vector, vector: Array) -> Array:
    """Turn vectors, (n, 2) or one (2,), counter-clockwise by angles, (n,) or one: R(psi) (u, v) = (V_E, V_N)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    a, b = vector[..., 0], vector[..., 1]
    return np.stack([a * c - b * s, a * s + b * c], axis=-1)


def convergence_rad(origin_lat_deg: float, position_m: Array) -> Vector:
    """Return the yaw of true north on the plane that touches the earth at an origin, (n,), at east and north (n, 2).

    Meridians converge towards the poles: by about east / radius * tan(latitude). The plane holds the points of the
    ellipsoid along its own vertical, so true north is the projection of the axis of the earth, less its vertical part.
    """
    phi = math.radians(origin_lat_deg)
    w = math.sqrt(1 - WGS84_E2 * math.sin(phi) ** 2)
    across_m, along_m = WGS84_M / w, WGS84_M * (1 - WGS84_E2) / w**3  # radii of curvature, east-west and north-south
    up_east, up_north = position_m[..., 0] / across_m, position_m[..., 1] / along_m  # of the vertical at the point
    up = np.sqrt(np.maximum(1 - up_east**2 - up_north**2, 0.0))
    sin_lat = math.cos(phi) * up_north + math.sin(phi) * up
    return np.arctan2(sin_lat * up_east, math.cos(phi) - sin_lat * up_north)
