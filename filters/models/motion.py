"""The motion of the vehicle between two epochs: eq. (4) of the paper, corrected, in three parts.

psi += r dt/2; x += (u cos psi - v sin psi) dt, y += (u sin psi + v cos psi) dt; psi += r dt/2. The two half turns are
linear and exact; only the displacement is nonlinear, and only in psi. u, v and r are random walks; in a gap of the DVL
u and v relax to their usual values, in one of the compass r (usual_motion.py). Of the calibration states the correlated
error of the USBL decays, c *= exp(-dt/T) with noise c0^2 (1 - exp(-2 dt/T)), a heading bias and the current are random
walks, and the others are constant. Each part is the *increment* of a few rows, so that a moment transform handles those
rows alone.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from usbldr.filters.models.parameters import ProcessNoise, SensorErrors
from usbldr.filters.models.sigma_points import StateFunction, Unwrapped
from usbldr.filters.models.states import StateLayout
from usbldr.filters.models.usual_motion import TurnHistory, UsualMotion, VelocityHistory
from usbldr.filters.types import Array, Vector

UNKNOWN_YAW_RAD = 0.35  # [rad] below this sigma of the yaw, an error along the path is a quarter of that across it
NO_LENGTH_M2 = 1e-30  # [m^2] a displacement of 1e-15 m has no direction


class MotionModel(Protocol):
    """x(t1_s) = f(x(t0_s)) + w for n states, f as a sequence of increments."""

    def parts(self, t0_s: float, t1_s: float) -> Iterator[tuple[slice, StateFunction]]:
        """Yield the rows that change and their increment, in order."""
        ...

    def noise(self, t0_s: float, t1_s: float) -> Vector:
        """Return the variances added after the last part, (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class YawIncrement(Unwrapped):
    """psi += r dt; psi is never wrapped inside a filter."""

    rate_row: int
    dt_s: float
    rows: slice | None = None
    nonlinear: tuple[int, ...] = ()

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in the turn rate."""
        return (self.rate_row,)

    def predict(self, x: Array) -> Array:
        """Return the change of yaw, rad, (1, N)."""
        return x[self.rate_row, None] * self.dt_s

    def jacobian(self, x: Array) -> Array:
        """Return dt, (1, 1, 1)."""
        return np.full((1, 1, 1), self.dt_s)


@dataclass(frozen=True, slots=True)
class PositionIncrement(Unwrapped):
    """Displacement east and north by the body velocity: eq. (1) times dt."""

    nonlinear: tuple[int, ...]  # row of psi
    linear: tuple[int, ...]  # rows of u, v
    dt_s: float
    rows: slice | None = None

    def predict(self, x: Array) -> Array:
        """Return the displacement east and north, m, (2, N)."""
        psi, u, v = x[self.nonlinear[0]], x[self.linear[0]], x[self.linear[1]]
        c, s = np.cos(psi) * self.dt_s, np.sin(psi) * self.dt_s
        return np.array([u * c - v * s, u * s + v * c])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by psi, u, v, (2, 3, N)."""
        psi, u, v = x[self.nonlinear[0]], x[self.linear[0]], x[self.linear[1]]
        c, s = np.cos(psi) * self.dt_s, np.sin(psi) * self.dt_s
        return np.array([[-u * s - v * c, c, -s], [u * c - v * s, s, c]])

    def variance_along(self, yaw_variance: Vector, displacement_m: Array, growth: Array) -> Array:
        """Return the covariance along the displacement that an unknown yaw causes, m^2, (2, 2, N).

        To first order, an error of the yaw moves the vehicle across its path only. What it loses along it, 1 - cos psi
        of each step, has the same sign in all steps, so it adds up, which no moment transform of a single step shows.
        It grows by p / (2 + p) times what the step adds across, ``growth`` (2, 2, N), p the variance of the yaw; for a
        yaw that walks at random this is the mean square error along a straight prediction up to p = 1.5 (within 5 %,
        tests/filters/models/test_motion.py).
        """
        east, north = displacement_m
        across = north**2 * growth[0, 0] - 2 * east * north * growth[0, 1] + east**2 * growth[1, 1]
        share = np.where(yaw_variance > UNKNOWN_YAW_RAD**2, yaw_variance / (2 + yaw_variance), 0.0)
        along = share * np.maximum(across, 0.0) / np.maximum(east**2 + north**2, NO_LENGTH_M2) ** 2
        return along * (displacement_m[:, None] * displacement_m[None])


@dataclass(frozen=True, slots=True)
class GaussMarkovIncrement(Unwrapped):
    """c = mean + factor (c - mean), for k neighbouring rows: a first-order Gauss-Markov process without its noise."""

    linear: tuple[int, ...]
    factor: Vector  # (k,)
    mean: Vector  # (k,)
    rows: slice | None = None
    nonlinear: tuple[int, ...] = ()

    def predict(self, x: Array) -> Array:
        """Return the decay (factor - 1) (c - mean), (k, N)."""
        return (self.factor - 1)[:, None] * (x[list(self.linear)] - self.mean[:, None])

    def jacobian(self, x: Array) -> Array:
        """Return factor - 1 on the diagonal, (k, k, 1)."""
        return np.diag(self.factor - 1)[:, :, None]


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """The paper's motion for any layout that starts with psi, u, v, r, x, y."""

    layout: StateLayout
    process: ProcessNoise
    errors: SensorErrors = SensorErrors()
    history: VelocityHistory = field(default_factory=VelocityHistory)  # of the DVL
    turns: TurnHistory = field(default_factory=TurnHistory)  # of the compass

    def parts(self, t0_s: float, t1_s: float) -> Iterator[tuple[slice, StateFunction]]:
        """Yield half the turn, the displacement, half the turn; then the decay of velocity, turn rate, USBL's error."""
        dt_s = t1_s - t0_s
        psi, u, v, r, x, y = self.layout.rows("psi", "u", "v", "r", "x", "y")
        half_turn = (slice(psi, psi + 1), YawIncrement(r, dt_s / 2))
        yield half_turn
        yield slice(x, y + 1), PositionIncrement((psi,), (u, v), dt_s)
        yield half_turn
        for rows, usual in self.relaxing(t0_s):
            yield slice(rows[0], rows[-1] + 1), GaussMarkovIncrement(rows, usual.remaining(dt_s), usual.mean)
        if bias := self.layout.existing("usbl_bias_east", "usbl_bias_north"):
            factor = np.full(2, math.exp(-dt_s / self.errors.usbl_bias_s))
            yield slice(bias[0], bias[-1] + 1), GaussMarkovIncrement(bias, factor, np.zeros(2))

    def relaxing(self, t0_s: float) -> Iterator[tuple[tuple[int, ...], UsualMotion]]:
        """Yield the rows that relax to their usual values from a time on: of the velocity, of the turn rate."""
        if usual := self.history.in_gap(t0_s, self.process.velocity_mps):
            yield self.layout.rows("u", "v"), usual
        if usual := self.turns.in_gap(t0_s, self.process.turn_rate_radps):
            yield self.layout.rows("r"), usual

    def walk_variance_per_s(self) -> Vector:
        """Return the variance that the random walk of each state gains in a second, (n,)."""
        q, errors = self.process, self.errors
        position_m = q.position_m if self.layout.existing("dvl_scale") else math.hypot(q.position_m, q.uncalibrated_m)
        per_second = {"psi": q.yaw_rad, "u": q.velocity_mps, "v": q.velocity_mps, "r": q.turn_rate_radps}
        per_second |= {"x": position_m, "y": position_m, "heading_bias": errors.heading_walk_rad}
        per_second |= {"current_east": errors.current_walk_mps, "current_north": errors.current_walk_mps}
        return np.array([per_second.get(name, 0.0) ** 2 for name in self.layout.names])

    def noise(self, t0_s: float, t1_s: float) -> Vector:
        """Return the variances that the random walks and the Gauss-Markov processes add over the step, (n,)."""
        errors, dt_s = self.errors, t1_s - t0_s
        variance = self.walk_variance_per_s() * dt_s
        for rows, usual in self.relaxing(t0_s):
            variance[list(rows)] = usual.added_variance(dt_s)
        bias = list(self.layout.existing("usbl_bias_east", "usbl_bias_north"))
        variance[bias] = -math.expm1(-2 * dt_s / errors.usbl_bias_s) * errors.usbl_bias_m**2
        return variance
