"""Moment transforms: mean and covariance of g(x) for Gaussian x, linearised, by cubature or unscented.

This is the only difference between ekf, ckf and ukf. A StateFunction is affine in all states but those it names as
``nonlinear``; sigma points in the other directions only repeat the affine part, so they are summed in closed form. With
the nonlinear states first in the Cholesky root the result equals that of all 2n points (test_sigma_points.py).

If the yaw is so uncertain that points are more than a quarter turn from the mean, sine and cosine at them no longer
represent the function: the covariance of the displacement is too small, and a vehicle without a compass would appear to
know its position. Each transform is then linearised, which overstates the effect of the yaw.

I. Arasaratnam and S. Haykin, "Cubature Kalman Filters", IEEE Trans. Automatic Control 54(6), 2009,
doi:10.1109/TAC.2009.2019800; S. Julier and J. Uhlmann, "Unscented filtering and nonlinear estimation", Proc. IEEE
92(3), 2004, doi:10.1109/JPROC.2003.823141.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from usbldr.filters.models.states import StateLayout
from usbldr.filters.types import Array

YAW = StateLayout().index("psi")  # in every layout
MAX_POINT_OFFSET_RAD = math.pi / 2  # of a point from the mean


class StateFunction(Protocol):
    """g: n states to k values, for N states at once."""

    @property
    def rows(self) -> slice | None:
        """The rows, if g only selects neighbouring states; None otherwise."""
        ...

    @property
    def nonlinear(self) -> tuple[int, ...]:
        """Rows of the states in which g is not affine if the others are constant."""
        ...

    @property
    def linear(self) -> tuple[int, ...]:
        """Rows of the other states that g depends on."""
        ...

    def predict(self, x: Array) -> Array:
        """Return g(x): (n, N) in, (k, N) out."""
        ...

    def jacobian(self, x: Array) -> Array:
        """Return dg/dx by the c states of ``nonlinear``, then the a of ``linear``: (k, c + a, N) or (k, c + a, 1)."""
        ...

    def residual(self, a: Array, b: Array) -> Array:
        """Return a - b, (k, N), with angles wrapped to half a turn."""
        ...


class Unwrapped:
    """The residual of a StateFunction whose values are no angles."""

    __slots__ = ()

    def residual(self, a: Array, b: Array) -> Array:
        """Return a - b, (k, N)."""
        return a - b


class TransformedMoments(NamedTuple):
    """Mean, covariance and covariance with the state of g(x)."""

    mean: Array  # (k, N)
    cov: Array  # (k, k, N)
    cross: Array  # (n, k, N) cov(x, g(x))


class MomentTransform(Protocol):
    """Return the moments of g(x) for x ~ N(m, P), of N Gaussians at once."""

    def __call__(self, g: StateFunction, m: Array, P: Array) -> TransformedMoments:
        """Return the moments of g(x) for x ~ N(m, P): (n, N) and (n, n, N) in."""
        ...


def linearised(g: StateFunction, m: Array, P: Array) -> TransformedMoments:
    """Take the first-order expansion at the mean (EKF)."""
    if g.rows is not None:
        return _pick(g.rows, m, P)
    return TransformedMoments(g.predict(m), *_linear_moments(P, g.nonlinear + g.linear, g.jacobian(m)))


@dataclass(frozen=True, slots=True)
class Unscented:
    """Symmetric sigma points at sqrt(n + kappa) sigma; the centre weighs kappa / (n + kappa)."""

    kappa: float | None = None  # None: 3 - n, Julier's choice for a Gaussian

    def scale(self, n: int) -> float:
        """Return n + kappa, the squared distance of the points from the mean."""
        return 3.0 if self.kappa is None else n + self.kappa

    def __call__(self, g: StateFunction, m: Array, P: Array) -> TransformedMoments:
        """Return the moments by weighted points."""
        if g.rows is not None:
            return _pick(g.rows, m, P)
        base = g.predict(m)
        if not g.nonlinear:
            return TransformedMoments(base, *_linear_moments(P, g.linear, g.jacobian(m)))
        scale = self.scale(len(m))
        if YAW not in g.nonlinear:
            return _by_points(g, m, P, base, scale)
        unknown_yaw = scale * P[YAW, YAW] > MAX_POINT_OFFSET_RAD**2
        if not unknown_yaw.any():
            return _by_points(g, m, P, base, scale)
        if unknown_yaw.all():
            return linearised(g, m, P)
        both = zip(linearised(g, m, P), _by_points(g, m, P, base, scale), strict=True)
        return TransformedMoments(*(np.where(unknown_yaw, linear, by_points) for linear, by_points in both))


def _by_points(g: StateFunction, m: Array, P: Array, base: Array, scale: float) -> TransformedMoments:
    """Return the moments by points at sqrt(scale) sigma about the mean m, with ``base`` = g(m)."""
    root, rest = _partial_root(P, g.nonlinear)
    step = math.sqrt(scale) * root  # (n, c, N)
    cov, cross = _linear_moments(rest, g.linear, g.jacobian(m)[:, len(g.nonlinear) :])
    shift = np.zeros_like(base)
    for j in range(len(g.nonlinear)):
        ahead = g.residual(g.predict(m + step[:, j]), base)
        behind = g.residual(g.predict(m - step[:, j]), base)
        shift += ahead + behind
        cov += (ahead[:, None] * ahead[None] + behind[:, None] * behind[None]) / (2 * scale)
        cross += step[:, j, None] * (ahead - behind)[None] / (2 * scale)
    shift /= 2 * scale
    return TransformedMoments(base + shift, cov - shift[:, None] * shift[None], cross)


cubature: MomentTransform = Unscented(kappa=0.0)
unscented: MomentTransform = Unscented()


def _pick(rows: slice, m: Array, P: Array) -> TransformedMoments:
    return TransformedMoments(m[rows], P[rows, rows], P[:, rows])


def _linear_moments(P: Array, columns: Sequence[int], J: Array) -> tuple[Array, Array]:
    """Return J P J' and P J' for a g that depends on these columns only: P (n, n, N), J (k, q, N)."""
    cross = np.zeros((len(P), len(J), P.shape[-1]))
    cov = np.zeros((len(J), len(J), P.shape[-1]))
    for q, column in enumerate(columns):
        cross += P[:, column, None] * J[None, :, q]
    for q, column in enumerate(columns):
        cov += cross[column, None, :] * J[:, None, q]
    return 0.5 * (cov + cov.swapaxes(0, 1)), cross


def _partial_root(P: Array, pivots: Sequence[int]) -> tuple[Array, Array]:
    """Return the Cholesky columns of the pivots, (n, c, N), and the rest of P; a zero pivot has a zero column."""
    columns: list[Array] = []
    rest = P
    for i in pivots:
        pivot = rest[i, i]
        positive = pivot > 0
        if positive.all():
            column = rest[:, i] * (1 / np.sqrt(pivot))
        else:
            column = rest[:, i] * np.where(positive, 1 / np.sqrt(np.where(positive, pivot, 1.0)), 0.0)
        rest = rest - column[:, None] * column[None]
        columns.append(column)
    return np.array(columns).swapaxes(0, 1), rest
