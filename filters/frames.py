"""Angles and rotations in the plane: radians, counter-clockwise about up, as psi; headings are degrees clockwise."""

import math
from typing import TypeVar

import numpy as np

from usbldr.filters.types import Array, Vector

Angle = TypeVar("Angle", float, Array)


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
