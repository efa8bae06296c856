"""A bank of N Gaussians in n states, and the operations of every filter on it: predict, project, update.

The particle index is last. N = 1 is a Kalman filter; covariances of 0 are a plain particle cloud. States are in metres,
radians and seconds (models/states.py). H, F, Q, R, S, K and P are the matrices of the Kalman filter.
"""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from usbldr.filters.models.motion import MotionModel, PositionIncrement
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import YAW, MomentTransform
from usbldr.filters.types import Array, Indices, Vector


class GaussianBank(NamedTuple):
    """N weighted Gaussians in n dimensions."""

    mean: Array  # (n, N)
    cov: Array  # (n, n, N), exactly symmetric
    log_weight: Vector  # (N,), normalised

    def take(self, ancestors: Indices) -> "GaussianBank":
        """Return the bank of these members with their weights."""
        return GaussianBank(self.mean[:, ancestors], self.cov[:, :, ancestors], self.log_weight[ancestors])

    def resampled_members(self, ancestors: Indices) -> "GaussianBank":
        """Return the bank after resampling: these members, equally weighted."""
        return self.take(ancestors)._replace(log_weight=equal_weights(len(ancestors)))


class Projection(NamedTuple):
    """A measurement of k scalars as each member of the bank predicts it."""

    innovation: Array  # (k, N) e = z - E[h(x)]
    cov: Array  # (k, k, N) H P H', without the measurement noise R
    cross: Array  # (n, k, N) P H'
    held: tuple[int, ...] = ()  # see Measurement
    relinearise: "Callable[[GaussianBank], Projection] | None" = None  # repeats the projection from another bank

    def take(self, ancestors: Indices) -> "Projection":
        """Return the projection of these members."""
        return self._replace(
            innovation=self.innovation[:, ancestors], cov=self.cov[:, :, ancestors], cross=self.cross[:, :, ancestors]
        )


def equal_weights(count: int) -> Vector:
    """Return log weights of 1 / N each."""
    return np.full(count, -np.log(count))


def replicate(mean: Vector, cov: Array, count: int) -> GaussianBank:
    """Return ``count`` copies of N(mean, cov), equally weighted: the paper's initial particles."""
    return GaussianBank(
        np.repeat(mean[:, None], count, axis=1), np.repeat(cov[:, :, None], count, axis=2), equal_weights(count)
    )


class PartialPrediction(NamedTuple):
    """The bank after one part of the motion, before the process noise."""

    bank: GaussianBank
    rows: slice  # states that the part changed
    cross: Array  # (n, k, N) covariance of all states before with the increment of those rows


def predict_parts(
    bank: GaussianBank, motion: MotionModel, rule: MomentTransform, t0_s: float, t1_s: float
) -> Iterator[PartialPrediction]:
    """Predict the bank part by part, each increment by the moment transform; yield the bank after each part."""
    for rows, increment in motion.parts(t0_s, t1_s):
        mean, cov, cross = rule(increment, bank.mean, bank.cov)  # of d(x): E d, cov(d, d), cov(x, d)
        m, P = bank.mean.copy(), bank.cov.copy()
        both = cross[rows]  # x' = x + d: P' = P + cov(x, d) + cov(d, x) + cov(d, d)
        growth = both + both.swapaxes(0, 1) + cov
        if isinstance(increment, PositionIncrement):
            growth += increment.variance_along(P[YAW, YAW], mean, growth)
        block = P[rows, rows] + growth
        m[rows] += mean
        P[rows] += cross.swapaxes(0, 1)
        P[:, rows] += cross
        P[rows, rows] = block
        bank = GaussianBank(m, P, bank.log_weight)
        yield PartialPrediction(bank, rows, cross)


def predict(bank: GaussianBank, motion: MotionModel, rule: MomentTransform, t0_s: float, t1_s: float) -> GaussianBank:
    """Return the bank predicted from t0_s to t1_s: m- = f(m), P- = F P F' + Q."""
    if t1_s == t0_s:
        return bank
    *_, last = predict_parts(bank, motion, rule, t0_s, t1_s)
    P = last.bank.cov.copy()
    diagonal = np.arange(len(P))
    P[diagonal, diagonal] += motion.noise(t0_s, t1_s)[:, None]
    return last.bank._replace(cov=P)


def project(bank: GaussianBank, measurement: Measurement, rule: MomentTransform) -> Projection:
    """Return innovation, H P H' and P H' of a measurement for every member."""
    model = measurement.model
    mean, cov, cross = rule(model, bank.mean, bank.cov)
    relinearise = functools.partial(project, measurement=measurement, rule=rule) if measurement.bilinear else None
    return Projection(model.residual(measurement.z[:, None], mean), cov, cross, measurement.held, relinearise)


def relinearised(bank: GaussianBank, after: GaussianBank, projection: Projection) -> Projection | None:
    """Return the projection relinearised at the updated mean; None if the measurement is not bilinear.

    A sensor that multiplies a state by its own constant error, as a DVL does by its scale, has a Jacobian that depends
    on the state. If each covariance update used the Jacobian at the predicted mean, the next measurement would use a
    different one, and the difference would count as information on the error: innovations that are correlated in time,
    as they are if the process noise does not match the vehicle, then shift a constant that is not observable. So the
    covariance update uses the Jacobian at the updated mean (G. Huang, A. Mourikis and S. Roumeliotis,
    "Observability-based rules for designing consistent EKF SLAM estimators", Int. J. Robotics Research 29(5), 2010,
    doi:10.1177/0278364909353640, on why Jacobians must be consistent).
    """
    if projection.relinearise is None:
        return None
    return projection.relinearise(bank._replace(mean=after.mean))._replace(innovation=projection.innovation)


def update(bank: GaussianBank, projection: Projection, R: Array) -> GaussianBank:
    """Update each member with its own measurement noise: R (k, k, N) or (k, k, 1)."""
    after = _updated(bank, projection, R)
    again = relinearised(bank, after, projection)
    return after if again is None else after._replace(cov=_updated(bank, again, R).cov)


def _updated(bank: GaussianBank, projection: Projection, R: Array) -> GaussianBank:
    inverse, _ = inverse_and_logdet(projection.cov + R)  # S^-1, S = H P H' + R; K = P H' S^-1: m + K e, P - K S K'
    return apply_gain(bank, projection, np.einsum("kln,ln->kn", inverse, projection.innovation), inverse)


def apply_gain(bank: GaussianBank, projection: Projection, g: Array, G: Array) -> GaussianBank:
    """Return mean + cross g and cov - cross G cross' but for what is held, with the covariance exactly symmetric.

    cross (n, k, N) is P H'. g (k, N) is the score of the predictive likelihood and G (k, k, N) its negative curvature;
    for a Gaussian g = S^-1 e and G = S^-1, the Kalman update. An asymmetry by rounding would grow until a variance
    turns negative.

    A compass with a deviation corrects heading and turn rate alone: mean and covariance of the others are held (S.
    Schmidt, "Application of state-space methods to navigation problems", Advances in Control Systems 3, 1966,
    doi:10.1016/B978-1-4831-6716-9.50011-4). The deviation multiplies the turn rate that the compass shows. Turns that
    are not as the motion model assumes would count as information on the deviation, and so on the position.
    """
    cross, held = projection.cross, list(projection.held)
    if len(g) == 1:
        c = cross[:, 0]
        moved, loss = c * g, (c[:, None] * c[None]) * G[0, 0]
    else:
        loss = np.einsum("aln,bln->abn", np.einsum("akn,kln->aln", cross, G), cross)
        moved, loss = np.einsum("akn,kn->an", cross, g), 0.5 * (loss + loss.swapaxes(0, 1))
    if held:
        moved[held], loss[np.ix_(held, held)] = 0.0, 0.0
    return GaussianBank(bank.mean + moved, bank.cov - loss, bank.log_weight)


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
