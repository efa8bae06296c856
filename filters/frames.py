"""Angles and rotations in the plane: radians, counter-clockwise about up, as psi."""

import math

import numpy as np

from usbldr.filters.types import Array, Vector


def wrapped(angle_rad: Array) -> Array:
    """Return the angle in_intervals half a turn of 0."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def rotation(angle_rad: float) -> Array:
    """Return the (2, 2) matrix that turns a vector counter-clockwise: R(psi) (u, v) = (V_E, V_N)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def rotated(angle_rad: Vector, vector: Array) -> Array:
    """Turn vectors, (n, 2) or one (2,), counter-clockwise by angles (n,): R(psi) (u, v) = (V_E, V_N)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    a, b = vector[..., 0], vector[..., 1]
    return np.stack([a * c - b * s, a * s + b * c], axis=-1)
