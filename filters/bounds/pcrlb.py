"""The posterior Cramer-Rao bound: how small the error covariance of any filter, and of any smoother, can be.

For a truth that obeys x' = f(x) + w, w ~ N(0, Q), and readings with additive noise of Fisher information I, Tichavsky's
recursion for the information J of a filter reads, with F and H the Jacobians at the truth and E over truths,

    J' = Q^-1 - Q^-1 E[F] (J + E[F' Q^-1 F])^-1 E[F]' Q^-1 + sum E[H' I H].

It is used here in the equal form (docs/studies/bounds.md) that lets states be constant or known, so that Q and the
prior may be singular:

    J' = (Q + E[F] (J + M)^-1 E[F]')^-1 + sum E[H' I H],    M = E[(F - E[F])' Q^-1 (F - E[F])],

and the smoother adds the information of later measurements to J, by the same formula backwards. Units are those of the
states.

P. Tichavsky, C. Muravchik and A. Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE
Trans. Signal Processing 46(5), 1998, doi:10.1109/78.668800.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.noise import Noise
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.types import Array, Vector

BATCH_SIZE = 16  # [truths] truths in one pass of ``local_bounds``: more would cost memory and save no time
GRID_SPACING = 0.1  # in t; the information is then good to 1e-6 (tests/filters/bounds/test_fisher.py)
GRID_SIGMAS = 9.0  # of the widest mode


class Bounds(NamedTuple):
    """The least error covariance at each of K epochs."""

    filtered: Array  # (K, n, n) from the measurements up to the epoch
    smoothed: Array  # (K, n, n) from all measurements


class TransitionTerms(NamedTuple):
    """The transition from one epoch to the next, for B recursions side by side."""

    F: Array  # (B, n, n) Jacobian
    Q: Array  # (n, n) process noise
    M: Array  # (n, n) information that the spread of the Jacobians over truths carries: 0 for a linear motion


def bounds(steps: Sequence[Step], motion: MotionModel, truth: Array, prior_cov: Array) -> Bounds:
    """Return the bounds for K steps: what is measured when, and with which noise, but not the values.

    ``truth`` holds the true states at the end of each step: (K, n), or (K, n, T) for T draws from the prior and the
    motion, over which expectations are taken. ``prior_cov`` (n, n) belongs to the start of the first step, at which the
    truth is taken to be that of its end. Raises UsageError if the bound does not exist: noise without variance, or
    different truths with nonlinear motion but no process noise.
    """
    return _recursion(steps, motion, np.atleast_3d(truth), prior_cov, together=True)


def local_bounds(steps: Sequence[Step], motion: MotionModel, truth: Array, prior_cov: Array) -> Bounds:
    """Return the mean over the truths, (K, n, T), of the bounds that each has alone.

    This lies above ``bounds`` of all of them together and is no proven bound of a mean error over truths, but it is
    what a good filter reaches if its errors are small against the nonlinearity of the model (docs/studies/bounds.md).
    """
    total = Bounds(np.zeros((len(truth), *prior_cov.shape)), np.zeros((len(truth), *prior_cov.shape)))
    for first in range(0, truth.shape[2], BATCH_SIZE):
        some = truth[:, :, first : first + BATCH_SIZE]
        batch = _recursion(steps, motion, some, prior_cov, together=False)
        share = some.shape[2] / truth.shape[2]
        total = Bounds(total.filtered + share * batch.filtered, total.smoothed + share * batch.smoothed)
    return total


def parallel_sum(A: Array, B: Array) -> Array:
    """Return (A^-1 + B)^-1 for symmetric A, B without negative eigenvalues, (..., n, n), even if A is singular."""
    if not B.any():
        return A
    result = np.linalg.solve(np.eye(A.shape[-1]) + A @ B, A)
    return 0.5 * (result + result.swapaxes(-1, -2))


def _recursion(steps: Sequence[Step], motion: MotionModel, truth: Array, prior_cov: Array, together: bool) -> Bounds:
    """Run one recursion over expectations, or one for each truth and return their mean."""
    cov = prior_cov[None]
    links: list[TransitionTerms] = []
    measured: list[Array] = []  # information that each epoch's measurements bring, (B, n, n)
    filtered: list[Array] = []
    for k, (step, x) in enumerate(zip(steps, truth, strict=True)):
        link = _link(motion, truth[max(k - 1, 0)], step, together)
        measured.append(_information(step, x, together))
        cov = parallel_sum(link.F @ parallel_sum(cov, link.M) @ link.F.swapaxes(1, 2) + link.Q, measured[-1])
        links.append(link)
        filtered.append(cov)
    future = np.zeros_like(cov)  # information that later epochs bring
    smoothed: list[Array] = []
    for cov, link, news in zip(reversed(filtered), reversed(links), reversed(measured), strict=True):
        smoothed.append(parallel_sum(cov, future).mean(axis=0))
        future = link.F.swapaxes(1, 2) @ parallel_sum(future + news, link.Q) @ link.F + link.M
    return Bounds(np.array([cov.mean(axis=0) for cov in filtered]), np.array(smoothed[::-1]))


def _link(motion: MotionModel, x: Array, step: Step, together: bool) -> TransitionTerms:
    """Return the link from the truths x, (n, T), over a step; the step may have no duration."""
    n, count = x.shape
    nothing = np.zeros((n, n))
    if step.t1_s == step.t0_s:
        return TransitionTerms(np.eye(n)[None], nothing, nothing)
    F = _jacobians(motion, x, step.t0_s, step.t1_s)
    q = motion.noise(step.t0_s, step.t1_s)
    if not together or count == 1:
        return TransitionTerms(F, np.diag(q), nothing)
    mean = F.mean(axis=0)
    # equal numbers have a mean that may differ in the last bit, which would need process noise
    spread = np.where(np.ptp(F, axis=0) > 0, F - mean, 0.0)
    nonlinear = spread.any(axis=(0, 2))
    if not q[nonlinear].all():
        raise UsageError(
            "no bound over several truths exists if a nonlinear motion has no process noise: set it above 0"
        )
    weighted = (spread[:, nonlinear] / np.sqrt(q[nonlinear])[:, None]).reshape(-1, n)
    return TransitionTerms(mean[None], np.diag(q), weighted.T @ weighted / count)


def _jacobians(motion: MotionModel, x: Array, t0_s: float, t1_s: float) -> Array:
    """Return the Jacobian of the whole motion at each of the states x, (n, T): (T, n, n)."""
    unit = _unit(x)
    F = np.moveaxis(unit, 2, 0).copy()
    for rows, increment in motion.parts(t0_s, t1_s):
        gained = np.moveaxis(linearised(increment, x, unit).cross, (0, 2), (2, 0)) @ F
        moved = x.copy()
        moved[rows] += increment.predict(x)
        F[:, rows] += gained
        x = moved
    return F


def _information(step: Step, x: Array, together: bool) -> Array:
    """Return the sum of H' I H over the measurements, its mean over the states x, (n, T), or each: (B, n, n)."""
    unit = _unit(x)
    total = np.zeros((x.shape[1], len(x), len(x)))
    for part in (part for measurement in step.measurements for part in measurement.parts()):
        H = np.moveaxis(linearised(part.model, x, unit).cross, (0, 2), (2, 0))  # (T, k, n)
        total += H.swapaxes(1, 2) @ fisher_information(part.noise) @ H
    return total.mean(axis=0, keepdims=True) if together else total


def _unit(x: Array) -> Array:
    """Return a covariance of 1 for the states x, (n, T), of which a rule's P J' is J': (n, n, T)."""
    return np.repeat(np.eye(len(x))[:, :, None], x.shape[1], axis=2)


def fisher_information(noise: Noise) -> Array:
    """Return the Fisher information of one measurement of k scalars, (k, k), in one over its units squared.

    For noise of density p about a prediction it is the integral of p'p'/p: 1/R for N(0, R), and 0.529/R for each scalar
    of eq. (23) (0.589/R if both axes of a fix share their mode). The integrals are sums over a grid of points
    c sinh(t), evenly spaced in t: fine where the narrowest mode bends the density and as far out as the widest reaches.
    For smooth integrands that fall off like these the error of such a sum vanishes exponentially with the spacing:
    L. Trefethen and J. Weideman, "The exponentially convergent trapezoidal rule", SIAM Review 56(3), 2014,
    doi:10.1137/130932132. The work grows as 150^k, so k is 1 or 2. Raises UsageError for noise without variance.
    """
    nominal: Array = noise.cov[0]
    try:
        root = np.linalg.cholesky(nominal)
    except np.linalg.LinAlgError as err:
        raise UsageError("no bound exists if a sensor has no noise: set its sigmas above 0") from err
    unroot = np.linalg.inv(root).astype(np.float64, copy=False)
    whitened = unroot @ noise.cov @ unroot.T
    # a mixture of multiples of R is the same for each R once whitened; rounding makes it so to the bit
    information = _whitened_information(_rounded(noise.probabilities), _rounded(whitened), whitened.shape)
    return unroot.T @ information @ unroot


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.11e}") for value in values.ravel().tolist())


@functools.lru_cache(maxsize=4096)
def _whitened_information(shares: tuple[float, ...], flat: tuple[float, ...], shape: tuple[int, ...]) -> Array:
    """Return the information of modes given as numbers, so that equal ones are computed once."""
    modes = np.array(flat).reshape(shape)
    widest = modes[np.argmax(np.trace(modes, axis1=1, axis2=2))]
    axes: Array = np.linalg.eigh(widest).eigenvectors  # turned so that a lengthy mode lies along the grid
    R: Array = axes.T @ modes @ axes
    inverse, logdet = np.linalg.inv(R), np.linalg.slogdet(R).logabsdet
    narrow = np.sqrt(1 / np.einsum("jkk->jk", inverse).max(axis=0))
    wide = np.sqrt(np.einsum("jkk->jk", R).max(axis=0))
    points, weights = _grid(narrow, wide)
    scores = np.einsum("jkl,ml->jkm", inverse, points)  # minus the gradient of each mode's log density
    log_p = np.log(shares)[:, None] - 0.5 * (logdet[:, None] + np.einsum("jkm,mk->jm", scores, points))
    top = log_p.max(axis=0)
    p = np.exp(log_p - top)
    total = p.sum(axis=0)
    score = np.einsum("jm,jkm->km", p / total, scores)
    density = np.exp(top) * total * (2 * np.pi) ** (-len(axes) / 2)
    return axes @ ((score * (density * weights)) @ score.T) @ axes.T


def _grid(narrow: Vector, wide: Vector) -> tuple[Array, Vector]:
    """Return the product grid of each axis' points c sinh(t), (m, k), and their weights, (m,)."""
    values: list[Vector] = []
    steps: list[Vector] = []
    for c, reach in zip(narrow, GRID_SIGMAS * wide, strict=True):
        count = int(np.ceil(np.arcsinh(reach / c) / GRID_SPACING))
        t = GRID_SPACING * np.arange(-count, count + 1)
        values.append(c * np.sinh(t))
        steps.append(GRID_SPACING * c * np.cosh(t))
    points = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, len(values))
    return points, np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, len(steps)).prod(axis=1)
