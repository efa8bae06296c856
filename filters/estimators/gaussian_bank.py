"""A bank of N Gaussians, particles last, and what every filter does with one: predict it, hold a reading against it.

N = 1 is a Kalman filter; covariances of 0 are a plain particle cloud.
"""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.types import Array, Indices, Vector


class GaussianBank(NamedTuple):
    """N weighted Gaussians in n dimensions."""

    mean: Array  # (n, N)
    cov: Array  # (n, n, N), exactly symmetric
    log_weight: Vector  # (N,), normalised

    def take(self, ancestors: Indices) -> "GaussianBank":
        """Return the bank of these members, weights and all."""
        return GaussianBank(self.mean[:, ancestors], self.cov[:, :, ancestors], self.log_weight[ancestors])

    def resampled_members(self, ancestors: Indices) -> "GaussianBank":
        """Return what resampling leaves: these members, equally weighted."""
        return self.take(ancestors)._replace(log_weight=equal_weights(len(ancestors)))


class Projection(NamedTuple):
    """A measurement seen from each member of the bank."""

    innovation: Array  # (k, N) z - E h
    cov: Array  # (k, k, N) H P H', without the measurement's own noise
    cross: Array  # (n, k, N) P H'
    relinearise: "Callable[[GaussianBank], Projection] | None" = None  # holds it against another bank, see `about`

    def take(self, ancestors: Indices) -> "Projection":
        """Return the projection of these members."""
        return self._replace(
            innovation=self.innovation[:, ancestors],
            cov=self.cov[:, :, ancestors],
            cross=self.cross[:, :, ancestors],
        )


def equal_weights(count: int) -> Vector:
    """Return log weights of 1 / N each."""
    return np.full(count, -np.log(count))


def replicate(mean: Vector, cov: Array, count: int) -> GaussianBank:
    """Return ``count`` copies of N(mean, cov), equally weighted: the paper's initial particles."""
    return GaussianBank(
        np.repeat(mean[:, None], count, axis=1),
        np.repeat(cov[:, :, None], count, axis=2),
        equal_weights(count),
    )


class PartialPrediction(NamedTuple):
    """The bank after one part of the motion, before the process noise."""

    bank: GaussianBank
    rows: slice  # which states the part moved
    cross: Array  # (n, k, N) covariance of all states before with what those rows gained


def predict_parts(
    bank: GaussianBank, motion: MotionModel, rule: MomentTransform, t0_s: float, t1_s: float
) -> Iterator[PartialPrediction]:
    """Move the bank part by part: each part's increment by the rule."""
    for rows, increment in motion.parts(t0_s, t1_s):
        mean, cov, cross = rule(increment, bank.mean, bank.cov)
        m, P = bank.mean.copy(), bank.cov.copy()
        both = cross[rows]
        block = P[rows, rows] + (both + both.swapaxes(0, 1) + cov)
        m[rows] += mean
        P[rows] += cross.swapaxes(0, 1)
        P[:, rows] += cross
        P[rows, rows] = block
        bank = GaussianBank(m, P, bank.log_weight)
        yield PartialPrediction(bank, rows, cross)


def predict(bank: GaussianBank, motion: MotionModel, rule: MomentTransform, t0_s: float, t1_s: float) -> GaussianBank:
    """Move the bank from t0 to t1 and add the process noise."""
    if t1_s == t0_s:
        return bank
    *_, last = predict_parts(bank, motion, rule, t0_s, t1_s)
    P = last.bank.cov.copy()
    diagonal = np.arange(len(P))
    P[diagonal, diagonal] += motion.noise(t0_s, t1_s)[:, None]
    return last.bank._replace(cov=P)


def project(bank: GaussianBank, measurement: Measurement, rule: MomentTransform) -> Projection:
    """Hold a measurement against every member."""
    model = measurement.model
    mean, cov, cross = rule(model, bank.mean, bank.cov)
    relinearise = functools.partial(project, measurement=measurement, rule=rule) if measurement.bilinear else None
    return Projection(model.residual(measurement.z[:, None], mean), cov, cross, relinearise)


def relinearised(bank: GaussianBank, after: GaussianBank, seen: Projection) -> Projection | None:
    """Return the measurement as the bank sees it from the mean after it; None where that is as before.

    A sensor that multiplies a state by its own constant error, as a DVL does by its scale, ties the two by a slope that
    depends on the state. Had the covariance the slope of the old mean, the next reading, which has that of the new one,
    would find the difference to be news of the error: innovations that are alike in time, as they are wherever the
    process noise is not the vehicle's own, then push a constant that nothing tells. So the covariance takes the slope
    of the new mean (G. Huang, A. Mourikis and S. Roumeliotis, "Observability-based rules for designing consistent EKF
    SLAM estimators", Int. J. Robotics Research 29(5), 2010, doi:10.1177/0278364909353640, on why one slope must serve).
    """
    if seen.relinearise is None:
        return None
    return seen.relinearise(bank._replace(mean=after.mean))._replace(innovation=seen.innovation)


def update(bank: GaussianBank, seen: Projection, R: Array) -> GaussianBank:
    """Update each member with its own measurement noise: R (k, k, N) or (k, k, 1)."""
    after = _updated(bank, seen, R)
    relinearised_seen = relinearised(bank, after, seen)
    return after if relinearised_seen is None else after._replace(cov=_updated(bank, relinearised_seen, R).cov)


def _updated(bank: GaussianBank, seen: Projection, R: Array) -> GaussianBank:
    inverse, _ = inverse_and_logdet(seen.cov + R)
    return apply_gain(bank, seen.cross, np.einsum("kln,ln->kn", inverse, seen.innovation), inverse)


def apply_gain(bank: GaussianBank, cross: Array, g: Array, G: Array) -> GaussianBank:
    """Return mean + cross g and cov - cross G cross', symmetric to the last bit.

    cross (n, k, N); g (k, N) is the score of the predictive likelihood, G (k, k, N) its negative curvature. Rounding
    that leaves a covariance asymmetric grows until a variance turns negative, hence the care.
    """
    if len(g) == 1:
        c = cross[:, 0]
        return GaussianBank(bank.mean + c * g, bank.cov - (c[:, None] * c[None]) * G[0, 0], bank.log_weight)
    loss = np.einsum("akn,kln,bln->abn", cross, G, cross, optimize=["einsum_path", (0, 1), (0, 1)])
    mean = bank.mean + np.einsum("akn,kn->an", cross, g)
    return GaussianBank(mean, bank.cov - 0.5 * (loss + loss.swapaxes(0, 1)), bank.log_weight)


def mixture_moments(bank: GaussianBank) -> tuple[Vector, Array]:
    """Return the mean, (n,), and covariance, (n, n), of the weighted mixture: eqs. (21) and (22) with weights."""
    w = np.exp(bank.log_weight)
    mean = bank.mean @ w
    spread = bank.mean - mean[:, None]
    return mean, bank.cov @ w + (spread * w) @ spread.T


def inverse_and_logdet(S: Array) -> tuple[Array, Array]:
    """Invert small symmetric matrices: S (..., k, k, N) to inverse (..., k, k, N) and log determinant (..., N)."""
    k = S.shape[-2]
    if k == 1:
        return 1 / S, np.log(S[..., 0, 0, :])
    if k == 2:
        a, b, d = S[..., 0, 0, :], S[..., 0, 1, :], S[..., 1, 1, :]
        det = a * d - b * b
        adjugate = np.stack([np.stack([d, -b], axis=-2), np.stack([-b, a], axis=-2)], axis=-3)
        return adjugate / det[..., None, None, :], np.log(det)
    stacked = np.moveaxis(S, -1, -3)  # (..., N, k, k) as numpy.linalg wants it
    inverse = np.linalg.inv(stacked).astype(np.float64, copy=False)
    logdet = np.linalg.slogdet(stacked).logabsdet.astype(np.float64, copy=False)
    return np.moveaxis(inverse, -3, -1), logdet


def log_density(x: Array, mean: Array, cov: Array) -> Vector:
    """Return log N(x; mean, cov) without its constant: x (n, N), mean (n, 1), cov (n, n)."""
    root = np.linalg.cholesky(cov)
    normals = np.linalg.solve(root, x - mean)
    return -0.5 * np.sum(normals**2, axis=0) - np.log(np.diag(root)).sum()
