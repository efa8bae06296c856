"""What each sensor would read in a given state, and one reading of it.

Every model is a Function (rules.py): DVL and compass pick states or are affine; a USBL fix is a point of the track at
its own time of validity, a little before the epoch at which it is used.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.assumptions import LeverArm
from usbldr.filters.layout import Layout
from usbldr.filters.noise import Noise
from usbldr.filters.rules import Function
from usbldr.filters.types import Array, Vector


class Measurement(NamedTuple):
    """A reading of k scalars with the model and the noise that explain it."""

    z: Vector  # (k,)
    model: Function
    noise: Noise
    sensor: str  # "dvl", "compass", "usbl"
    axis: str  # which scalar of the record, see types.Update
    row: int  # which record, see types.Update
    time_s: float  # time of validity


@dataclass(frozen=True, slots=True)
class State:
    """One state read directly: the compass reads psi, a DVL at the reference point u and v."""

    row: int
    angle: bool = False
    curved: tuple[int, ...] = ()

    @property
    def rows(self) -> slice:
        """Pick the state."""
        return slice(self.row, self.row + 1)

    @property
    def affine(self) -> tuple[int, ...]:
        """Read the state."""
        return (self.row,)

    def predict(self, x: Array) -> Array:
        """Return the state, (1, N)."""
        return x[self.rows]

    def jacobian(self, x: Array) -> Array:
        """Return 1, (1, 1, 1)."""
        return np.ones((1, 1, 1))

    def residual(self, a: Array, b: Array) -> Array:
        """Return the difference, of angles the shorter way round."""
        return wrapped(a - b) if self.angle else a - b


@dataclass(frozen=True, slots=True)
class LeveredVelocity:
    """u or v of a DVL away from the reference point: the turn rate adds to it, (u, v) + r (-forward, starboard)."""

    velocity_row: int
    rate_row: int
    arm_m: float  # -forward for u, +starboard for v
    rows: slice | None = None
    curved: tuple[int, ...] = ()

    @property
    def affine(self) -> tuple[int, ...]:
        """Read the velocity and the turn rate."""
        return (self.velocity_row, self.rate_row)

    def predict(self, x: Array) -> Array:
        """Return the velocity at the DVL, (1, N)."""
        return x[self.velocity_row, None] + self.arm_m * x[self.rate_row, None]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by velocity and turn rate, (1, 2, 1)."""
        return np.array([[[1.0], [self.arm_m]]])

    def residual(self, a: Array, b: Array) -> Array:
        """Return the difference."""
        return a - b


@dataclass(frozen=True, slots=True)
class UsblFix:
    """East and north (or one of them) of the transponder at ``offset_s`` from the epoch, usually a little before it.

    h = (x, y) + offset (V_E, V_N) + lever arm, with V at the heading psi + r offset/2 and the arm at psi + r offset.
    """

    layout: Layout
    offset_s: float
    lever_m: LeverArm = (0.0, 0.0, 0.0)
    axes: tuple[int, ...] = (0, 1)  # 0 east, 1 north

    @property
    def rows(self) -> slice | None:
        """Pick x and y where the fix is of the epoch itself and the transponder at the reference point."""
        if self.offset_s or any(self.lever_m[:2]):
            return None
        first = self.layout.index("x") + self.axes[0]
        return slice(first, first + len(self.axes))

    @property
    def curved(self) -> tuple[int, ...]:
        """Bend with psi and r."""
        return self.layout.rows("psi", "r")

    @property
    def affine(self) -> tuple[int, ...]:
        """Read velocity and position."""
        return self.layout.rows("u", "v", "x", "y")

    def predict(self, x: Array) -> Array:
        """Return the transponder's east and north, (k, N)."""
        psi, r, u, v, east, north = (x[i] for i in self.curved + self.affine)
        t = self.offset_s
        c, s = np.cos(psi + r * t / 2), np.sin(psi + r * t / 2)
        C, S = np.cos(psi + r * t), np.sin(psi + r * t)
        starboard, forward, _ = self.lever_m
        both = (
            east + (u * c - v * s) * t + starboard * C - forward * S,
            north + (u * s + v * c) * t + starboard * S + forward * C,
        )
        return np.stack([both[axis] for axis in self.axes])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by psi, r, u, v, x, y, (k, 6, N)."""
        psi, r, u, v, _, _ = (x[i] for i in self.curved + self.affine)
        t = self.offset_s
        c, s = np.cos(psi + r * t / 2), np.sin(psi + r * t / 2)
        C, S = np.cos(psi + r * t), np.sin(psi + r * t)
        starboard, forward, _ = self.lever_m
        move_e, move_n = -(u * s + v * c) * t, (u * c - v * s) * t  # by the heading of the move
        arm_e, arm_n = -starboard * S - forward * C, starboard * C - forward * S  # by the heading of the arm
        one, zero = np.ones_like(psi), np.zeros_like(psi)
        both = (
            np.stack([move_e + arm_e, move_e * t / 2 + arm_e * t, c * t, -s * t, one, zero]),
            np.stack([move_n + arm_n, move_n * t / 2 + arm_n * t, s * t, c * t, zero, one]),
        )
        return np.stack([both[axis] for axis in self.axes])

    def residual(self, a: Array, b: Array) -> Array:
        """Return the difference."""
        return a - b


def compass(layout: Layout) -> Function:
    """Return the model of a compass that reads psi."""
    return State(layout.index("psi"), angle=True)


def dvl(layout: Layout, lever_m: LeverArm) -> tuple[Function, Function]:
    """Return the models of a DVL's starboard and forward velocity."""
    u, v, r = layout.rows("u", "v", "r")
    starboard_m, forward_m, _ = lever_m
    if not starboard_m and not forward_m:
        return State(u), State(v)
    return LeveredVelocity(u, r, -forward_m), LeveredVelocity(v, r, starboard_m)


def wrapped(angle_rad: Array) -> Array:
    """Return the angle within half a turn of 0."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
