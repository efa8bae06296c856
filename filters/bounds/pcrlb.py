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

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.bounds.fisher import fisher_information
from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.types import Array

BATCH_SIZE = 16  # [truths] truths in one pass of ``local_bounds``: more would cost memory and save no time


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


def mean_absolute_error(cov: Array, row: int) -> float:
    """Return the mean |e| of Gaussian errors of one state with the covariances (K, n, n): sqrt(2/pi) mean sigma."""
    return math.sqrt(2 / math.pi) * float(np.sqrt(np.maximum(cov[:, row, row], 0.0)).mean())


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
