"""A dive of three legs that turn to either side, without any other fault than those of `paper`."""

import dataclasses

import numpy as np

from usbldr.filters.simulation.scenario import Leg
from usbldr.filters.types import Array, Vector
from usbldr.io.scenarios.shipped import find_scenario

TURNING = dataclasses.replace(
    find_scenario("paper"),
    legs=(Leg(100.0, 0.2, 1.5, 0.05), Leg(50.0, -0.3, 1.0), Leg(200.0, 0.1, 0.8, -0.2)),
    duration_s=350.0,
    east_m=12.0,
    north_m=-7.0,
)


def over_ground(yaw_rad: Vector, velocity_mps: Array) -> Array:
    """Return east and north of velocities to starboard and forward, (K, 2)."""
    (u, v), c, s = velocity_mps.T, np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([u * c - v * s, u * s + v * c])
