"""Measurement models z = h(x) + v of DVL, compass and position fixes, and one measurement of each.

Every model is a StateFunction (sigma_points.py): DVL and compass select states or are affine in them; a USBL fix is
the position at its own time of validity, usually before the epoch at which it is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.models.noise import Noise
from usbldr.filters.models.parameters import LeverArm
from usbldr.filters.models.sigma_points import StateFunction, Unwrapped
from usbldr.filters.models.states import StateLayout
from usbldr.filters.types import Array, Vector


class Measurement(NamedTuple):
    """k measured scalars with their model and noise; a fix has both axes, east and north."""

    z: Vector  # (k,)
    model: StateFunction
    noise: Noise
    sensor: str  # "dvl", "compass", "usbl", "gps"
    axis: str  # which scalar of the record, see types.Update
    row: int  # which record, see types.Update
    time_s: float  # time of validity
    bilinear: bool = False  # the model multiplies a state by a constant error that is a state, too
    held: tuple[int, ...] = ()  # rows of states of which the measurement says nothing

    def parts(self) -> "Sequence[Measurement]":
        """Return the parts that are used in sequence: each axis of a fix if their errors are independent, else all."""
        if len(self.z) == 1 or len(blocks := self.noise.blocks()) == 1:
            return (self,)
        assert isinstance(self.model, UsblFix)
        return [
            self._replace(
                z=self.z[scalars],
                model=replace(self.model, axes=self.model.axes[scalars]),
                noise=self.noise.block(scalars),
                axis=axis,
            )
            for axis, scalars in zip(("east", "north"), blocks, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class DirectState:
    """z = one state: psi for a compass, u or v for a DVL at the reference point."""

    row: int
    angle: bool = False
    nonlinear: tuple[int, ...] = ()

    @property
    def rows(self) -> slice:
        """Rows of the state."""
        return slice(self.row, self.row + 1)

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in the state."""
        return (self.row,)

    def predict(self, x: Array) -> Array:
        """Return the state, (1, N)."""
        return x[self.rows]

    def jacobian(self, x: Array) -> Array:
        """Return 1, (1, 1, 1)."""
        return np.ones((1, 1, 1))

    def residual(self, a: Array, b: Array) -> Array:
        """Return a - b, wrapped to half a turn for angles."""
        return wrapped(a - b) if self.angle else a - b


@dataclass(frozen=True, slots=True)
class BodyVelocity(Unwrapped):
    """One axis of a DVL: z = (1 + s) (u' cos a + v' sin a), a = d for starboard, d + 90 deg for forward.

    u' = u - forward r and v' = v + starboard r at a DVL off the reference point; s is its scale error, d the angle of
    its axes in the body. Through the water, the current (c_E, c_N) is missing: u' is less by c_E cos psi + c_N sin psi,
    v' by -c_E sin psi + c_N cos psi.
    """

    velocity_rows: tuple[int, int]  # u, v
    rate_row: int
    axis: int  # 0 starboard, 1 forward
    arm_m: tuple[float, float] = (0.0, 0.0)  # starboard, forward of the reference point
    scale_row: int | None = None
    mount_row: int | None = None
    psi_row: int = 0
    current_rows: tuple[int, ...] = ()  # c_E and c_N, or none
    rows: slice | None = None

    @property
    def nonlinear(self) -> tuple[int, ...]:
        """Nonlinear in yaw if the current is a state, and in scale and angle if they are."""
        psi = (self.psi_row,) if self.current_rows else ()
        return psi + tuple(row for row in (self.scale_row, self.mount_row) if row is not None)

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in velocity, turn rate and current."""
        return (*self.velocity_rows, self.rate_row, *self.current_rows)

    def predict(self, x: Array) -> Array:
        """Return the velocity that the DVL reads, m/s, (1, N)."""
        gain, along, across = self._gain_and_axis(x)
        u, v = self._velocity(x)
        return (gain * (along * u + across * v))[None]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by the states of ``nonlinear`` and ``linear``, (1, 3 to 8, N)."""
        gain, along, across = self._gain_and_axis(x)
        starboard, forward = self.arm_m
        by_state: list[Array | float] = [gain * along, gain * across, gain * (starboard * across - forward * along)]
        if self.scale_row is not None or self.mount_row is not None:
            u, v = self._velocity(x)
            by_angle = gain * (along * v - across * u)
            by_state[:0] = [by_angle] if self.mount_row is not None else []
            by_state[:0] = [along * u + across * v] if self.scale_row is not None else []
        if self.current_rows:
            c, s = np.cos(x[self.psi_row]), np.sin(x[self.psi_row])
            to_starboard, ahead = self._current(x)
            by_state[:0] = [gain * (across * to_starboard - along * ahead)]
            by_state += [gain * (across * s - along * c), -gain * (along * s + across * c)]
        J = np.empty((1, len(by_state), x.shape[1]))
        for column, derivative in enumerate(by_state):
            J[0, column] = derivative
        return J

    def _velocity(self, x: Array) -> tuple[Array, Array]:
        """Return u' and v', (N,) each."""
        (u, v), r = self.velocity_rows, x[self.rate_row]
        starboard, forward = self.arm_m
        to_starboard, ahead = self._current(x)
        return x[u] - forward * r - to_starboard, x[v] + starboard * r - ahead

    def _current(self, x: Array) -> tuple[Array, Array]:
        """Return the current to starboard and ahead, (N,) or (1,) each."""
        if not self.current_rows:
            return np.zeros(1), np.zeros(1)
        c, s = np.cos(x[self.psi_row]), np.sin(x[self.psi_row])
        east, north = x[list(self.current_rows)]
        return east * c + north * s, north * c - east * s

    def _gain_and_axis(self, x: Array) -> tuple[Array, Array, Array]:
        """Return 1 + s, cos a and sin a, (N,) or (1,) each."""
        gain = np.ones(1) if self.scale_row is None else 1 + x[self.scale_row]
        c, s = np.ones(1), np.zeros(1)
        if self.mount_row is not None:
            c, s = np.cos(x[self.mount_row]), np.sin(x[self.mount_row])
        return (gain, c, s) if self.axis == 0 else (gain, -s, c)


@dataclass(frozen=True, slots=True)
class ScaledVelocity(Unwrapped):
    """z = (1 + s) u or v: `BodyVelocity` with a scale error alone and the DVL at the reference point."""

    scale_row: int
    velocity_row: int
    rows: slice | None = None

    @property
    def nonlinear(self) -> tuple[int, ...]:
        """Nonlinear in the scale."""
        return (self.scale_row,)

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in the velocity."""
        return (self.velocity_row,)

    def predict(self, x: Array) -> Array:
        """Return the velocity that the DVL reads, m/s, (1, N)."""
        return ((1 + x[self.scale_row]) * x[self.velocity_row])[None]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by scale and velocity, (1, 2, N)."""
        return np.array([[x[self.velocity_row], 1 + x[self.scale_row]]])


@dataclass(frozen=True, slots=True)
class DeviatingCompass:
    """z = psi + b0 + b_s sin psi + b_c cos psi: a constant bias, and the deviation by magnetic parts of the vehicle."""

    psi_row: int
    bias_rows: tuple[int, ...] = ()  # b0, or none
    deviation_rows: tuple[int, ...] = ()  # b_s and b_c, or none
    rows: slice | None = None

    @property
    def nonlinear(self) -> tuple[int, ...]:
        """Nonlinear in psi if there is a deviation."""
        return (self.psi_row,) if self.deviation_rows else ()

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in the errors, and in psi if there is no deviation."""
        psi = () if self.deviation_rows else (self.psi_row,)
        return psi + self.bias_rows + self.deviation_rows

    def predict(self, x: Array) -> Array:
        """Return the yaw that the compass reads, rad, (1, N)."""
        yaw = x[self.psi_row] + x[list(self.bias_rows)].sum(axis=0)
        if self.deviation_rows:
            b_s, b_c = x[list(self.deviation_rows)]
            yaw = yaw + b_s * np.sin(x[self.psi_row]) + b_c * np.cos(x[self.psi_row])
        return yaw[None]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by psi, b0, b_s and b_c, as far as they are states, (1, 1 to 4, N)."""
        by_state: list[Array] = [np.ones_like(x[self.psi_row])] * (1 + len(self.bias_rows))
        if self.deviation_rows:
            c, s = np.cos(x[self.psi_row]), np.sin(x[self.psi_row])
            b_s, b_c = x[list(self.deviation_rows)]
            by_state = [1 + b_s * c - b_c * s, *by_state[1:], s, c]
        return np.array([by_state])

    def residual(self, a: Array, b: Array) -> Array:
        """Return a - b, wrapped to half a turn."""
        return wrapped(a - b)


@dataclass(frozen=True, slots=True)
class UsblFix(Unwrapped):
    """East and north (or one of them) of the transponder at ``offset_s`` from the epoch, usually before it.

    h = (x, y) + t (V_E, V_N) + lever arm + c, with V at the yaw psi + r t/2 and the lever arm at psi + r t. A stamp
    that is late by tau gives t = offset - tau; c is the correlated error. Both are 0 if they are not states.
    """

    layout: StateLayout
    offset_s: float
    lever_m: LeverArm = (0.0, 0.0, 0.0)
    axes: tuple[int, ...] = (0, 1)  # fixed: 0 east, 1 north

    @property
    def rows(self) -> slice | None:
        """Rows of x and y if the fix is valid at the epoch and the transponder at the reference point; else None."""
        if self.offset_s or any(self.lever_m[:2]) or self.layout.existing("usbl_latency", "usbl_bias_east"):
            return None
        first = self.layout.index("x") + self.axes[0]
        return slice(first, first + len(self.axes))

    @property
    def nonlinear(self) -> tuple[int, ...]:
        """Nonlinear in psi, r and the latency."""
        return self.layout.rows("psi", "r") + self.layout.existing("usbl_latency")

    @property
    def linear(self) -> tuple[int, ...]:
        """Linear in velocity, position and the correlated error."""
        return self.layout.rows("u", "v", "x", "y") + self.layout.existing("usbl_bias_east", "usbl_bias_north")

    def predict(self, x: Array) -> Array:
        """Return the transponder's east and north, m, (k, N)."""
        psi, u, v, r, east, north = x[:6]
        t = self.offset_s - self.layout.value(x, "usbl_latency")
        c, s = np.cos(psi + r * t / 2), np.sin(psi + r * t / 2)
        C, S = np.cos(psi + r * t), np.sin(psi + r * t)
        starboard, forward, _ = self.lever_m
        both = (
            east + (u * c - v * s) * t + starboard * C - forward * S + self.layout.value(x, "usbl_bias_east"),
            north + (u * s + v * c) * t + starboard * S + forward * C + self.layout.value(x, "usbl_bias_north"),
        )
        return np.array([both[axis] for axis in self.axes])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives by the states of ``nonlinear`` and ``linear``, (k, 6 to 9, N)."""
        psi, u, v, r, _, _ = x[:6]
        t = self.offset_s - self.layout.value(x, "usbl_latency")
        c, s = np.cos(psi + r * t / 2), np.sin(psi + r * t / 2)
        C, S = np.cos(psi + r * t), np.sin(psi + r * t)
        starboard, forward, _ = self.lever_m
        V = (u * c - v * s, u * s + v * c)
        arm = (starboard * C - forward * S, starboard * S + forward * C)
        one, zero = np.ones_like(psi), np.zeros_like(psi)
        both: list[list[Array]] = []
        for axis in (0, 1):
            turned_V = (-V[1], V[0])[axis] * t  # derivative of the displacement by yaw
            turned_arm = (-arm[1], arm[0])[axis]  # derivative of the lever arm by yaw
            by_state = [turned_V + turned_arm, turned_V * t / 2 + turned_arm * t]
            if self.layout.existing("usbl_latency"):
                by_state.append(-(V[axis] + turned_V * r / 2 + turned_arm * r))
            by_state += [(c, s)[axis] * t, (-s, c)[axis] * t, *((one, zero), (zero, one))[axis]]
            if self.layout.existing("usbl_bias_east"):
                by_state += ((one, zero), (zero, one))[axis]
            both.append(by_state)
        return np.array([both[axis] for axis in self.axes])


def compass_model(layout: StateLayout) -> StateFunction:
    """Return the model of a compass with the errors that are states."""
    psi, bias = layout.index("psi"), layout.existing("heading_bias")
    deviation = layout.existing("deviation_sin", "deviation_cos")
    if not bias and not deviation:
        return DirectState(psi, angle=True)
    return DeviatingCompass(psi, bias, deviation)


def dvl_models(layout: StateLayout, lever_m: LeverArm) -> tuple[StateFunction, StateFunction]:
    """Return the models of a DVL's starboard and forward velocity."""
    u, v, r = layout.rows("u", "v", "r")
    scale, mount = (next(iter(layout.existing(name)), None) for name in ("dvl_scale", "dvl_mount"))
    arm_m, current = lever_m[:2], layout.existing("current_east", "current_north")
    if not any(arm_m) and mount is None and not current:
        if scale is None:
            return DirectState(u), DirectState(v)
        return ScaledVelocity(scale, u), ScaledVelocity(scale, v)
    psi = layout.index("psi")
    starboard, forward = (BodyVelocity((u, v), r, axis, arm_m, scale, mount, psi, current) for axis in (0, 1))
    return starboard, forward
