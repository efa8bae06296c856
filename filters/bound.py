"""The posterior Cramer-Rao bound: how small the error covariance of any filter, and of any smoother, can be.

For a truth that obeys x' = f(x) + w, w ~ N(0, Q), and readings with additive noise of Fisher information I, Tichavsky's
recursion for the information J of a filter reads, with F and H the Jacobians at the truth and E over truths,

    J' = Q^-1 - Q^-1 E[F] (J + E[F' Q^-1 F])^-1 E[F]' Q^-1 + sum E[H' I H].

It is used here in the equal form (docs/bounds.md) that lets states be constant or known, so that Q and the prior may be
singular:

    J' = (Q + E[F] (J + M)^-1 E[F]')^-1 + sum E[H' I H],    M = E[(F - E[F])' Q^-1 (F - E[F])],

and the smoother adds to J what the future tells, by the same formula run backwards. Units are those of the states.

P. Tichavsky, C. Muravchik and A. Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE
Trans. Signal Processing 46(5), 1998, doi:10.1109/78.668800.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.filter import Step
from usbldr.filters.fisher import fisher_information
from usbldr.filters.motion import MotionModel
from usbldr.filters.rules import linearised
from usbldr.filters.sensors import Measurement
from usbldr.filters.types import Array


class Bounds(NamedTuple):
    """The least error covariance at each of K epochs."""

    filtered: Array  # (K, n, n) from the measurements up to the epoch
    smoothed: Array  # (K, n, n) from all measurements


class Link(NamedTuple):
    """What the motion from one epoch to the next says about both."""

    F: Array  # (n, n) mean Jacobian
    Q: Array  # (n, n) process noise
    M: Array  # (n, n) information that the spread of the Jacobians over truths carries: 0 for a linear motion


def bounds(steps: Sequence[Step], motion: MotionModel, truth: Array, prior_cov: Array) -> Bounds:
    """Return the bounds for K steps: what is measured when, and with which noise, but not the values.

    ``truth`` holds the true states at the end of each step: (K, n), or (K, n, T) for T draws from the prior and the
    motion, over which expectations are taken. ``prior_cov`` (n, n) belongs to the start of the first step, at which the
    truth is taken to be that of its end. Raises UsageError where the bound does not exist: noise without variance, or
    truths that differ where the motion bends but has no process noise.
    """
    states = np.atleast_3d(truth)
    cov = prior_cov
    links: list[Link] = []
    told: list[Array] = []  # information that each epoch's measurements bring, (n, n)
    filtered: list[Array] = []
    for k, (step, x) in enumerate(zip(steps, states, strict=True)):
        link = _link(motion, states[max(k - 1, 0)], step)
        told.append(sum((_information(measurement, x) for measurement in step.measurements), np.zeros_like(cov)))
        cov = parallel(link.F @ parallel(cov, link.M) @ link.F.T + link.Q, told[-1])
        links.append(link)
        filtered.append(cov)
    future = np.zeros_like(cov)  # information that later epochs bring
    smoothed: list[Array] = []
    for cov, link, news in zip(reversed(filtered), reversed(links), reversed(told), strict=True):
        smoothed.append(parallel(cov, future))
        future = link.F.T @ parallel(future + news, link.Q) @ link.F + link.M
    return Bounds(np.array(filtered), np.array(smoothed[::-1]))


def mean_absolute_error(cov: Array, row: int) -> float:
    """Return the mean |e| of Gaussian errors of one state with the covariances (K, n, n): sqrt(2/pi) mean sigma."""
    return math.sqrt(2 / math.pi) * float(np.sqrt(np.maximum(cov[:, row, row], 0.0)).mean())


def parallel(A: Array, B: Array) -> Array:
    """Return (A^-1 + B)^-1 for symmetric A, B without negative eigenvalues, (n, n), even where A is singular."""
    if not B.any():
        return A
    result = np.linalg.solve(np.eye(len(A)) + A @ B, A)
    return 0.5 * (result + result.T)


def _link(motion: MotionModel, x: Array, step: Step) -> Link:
    """Return the link from the truths x, (n, T), over a step; time may stand still."""
    if step.t1_s == step.t0_s:
        return Link(np.eye(len(x)), np.zeros((len(x), len(x))), np.zeros((len(x), len(x))))
    F = _jacobians(motion, x, step.t0_s, step.t1_s)
    q = motion.noise(step.t0_s, step.t1_s)
    mean = F.mean(axis=2)
    # equal numbers have a mean that may differ in the last bit, which no noise would forgive
    spread = np.where(np.ptp(F, axis=2, keepdims=True) > 0, F - mean[:, :, None], 0.0)
    bent = spread.any(axis=(1, 2))
    if not q[bent].all():
        raise UsageError("there is no bound over several truths without process noise where the motion is not linear")
    weighted = (spread[bent] / np.sqrt(q[bent])[:, None, None]).transpose(1, 0, 2).reshape(len(x), -1)
    return Link(mean, np.diag(q), weighted @ weighted.T / x.shape[1])


def _jacobians(motion: MotionModel, x: Array, t0_s: float, t1_s: float) -> Array:
    """Return the Jacobian of the whole motion at each of the states x, (n, T): (n, n, T)."""
    F = _identity(x)
    for rows, increment in motion.parts(t0_s, t1_s):
        gained = np.einsum("akt,abt->kbt", linearised(increment, x, _identity(x)).cross, F)
        moved = x.copy()
        moved[rows] += increment.predict(x)
        F[rows] += gained
        x = moved
    return F


def _information(measurement: Measurement, x: Array) -> Array:
    """Return E[H' I H] over the states x, (n, T): (n, n)."""
    H = linearised(measurement.model, x, _identity(x)).cross  # H', (n, k, T)
    root = np.linalg.cholesky(fisher_information(measurement.noise))
    weighted = np.einsum("akt,kl->alt", H, root).reshape(len(x), -1)
    return weighted @ weighted.T / x.shape[1]


def _identity(x: Array) -> Array:
    """Return a covariance of 1, (n, n, T), of which a rule's P J' is J'."""
    return np.repeat(np.eye(len(x))[:, :, None], x.shape[1], axis=2)
