"""Small models that several tests hold the filters against, written the textbook way."""

import functools
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from usbldr.filters.estimators.protocol import Estimate, Prior, Step
from usbldr.filters.models.noise import Noise
from usbldr.filters.models.sensors import DirectState, Measurement


class Drift:
    """Linear motion of (position, velocity): position += velocity dt, both with random walks."""

    rows = None
    nonlinear = ()
    linear = (1,)

    def __init__(self, q: tuple[float, float], dt: float = 1.0) -> None:
        self.q, self.dt = np.array(q), dt

    def predict(self, x):
        return x[1:2] * self.dt

    def jacobian(self, x):
        return np.full((1, 1, 1), self.dt)

    def residual(self, a, b):
        return a - b

    def parts(self, t0_s: float, t1_s: float) -> Iterator:
        yield slice(0, 1), self

    def noise(self, t0_s: float, t1_s: float):
        return self.q * (t1_s - t0_s)


def position_steps(z: np.ndarray, noise: Noise) -> Iterator[Step]:
    """Yield one measured position per second, the first without motion."""
    for k, value in enumerate(z):
        reading = Measurement(np.array([value]), DirectState(0), noise, "usbl", "east", k, float(k))
        yield Step(k, float(max(k - 1, 0)), float(k), (reading,))


PRIOR = Prior(np.array([0.0, 1.0]), np.array([[4.0, 0.3], [0.3, 1.0]]))


def beliefs(estimator: Any, steps: Iterable[Step], prior: Prior = PRIOR, seed: int | None = 0) -> Iterator[Any]:
    """Yield the belief after each step; without a seed no filter may draw."""

    def generator(epoch: int) -> np.random.Generator:
        assert seed is not None, "this filter leaves nothing to chance"
        return np.random.default_rng((seed, epoch))

    belief = estimator.start(prior)
    for step in steps:
        belief = estimator.step(belief, step, functools.partial(generator, step.epoch))
        yield belief


def estimates(estimator: Any, steps: Iterable[Step], prior: Prior = PRIOR, seed: int | None = 0) -> list[Estimate]:
    return [estimator.estimate(belief) for belief in beliefs(estimator, steps, prior, seed)]


def end(estimator: Any, steps: Iterable[Step], seed: int | None = 0, prior: Prior = PRIOR) -> Estimate:
    return estimates(estimator, steps, prior, seed)[-1]


def exact_mixture(z: np.ndarray, noise: Noise, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of p(x_T | z): every one of the J^T mode histories through its own Kalman filter."""
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    H = np.array([[1.0, 0.0]])
    branches = [(0.0, PRIOR.mean, PRIOR.cov)]
    for k, value in enumerate(z):
        grown = []
        for log_w, m, P in branches:
            if k:
                m, P = F @ m, F @ P @ F.T + np.diag(q)
            for share, R in zip(noise.probabilities, noise.cov, strict=True):
                S = H @ P @ H.T + R
                e = value - H @ m
                K = P @ H.T / S
                log_l = np.log(share) - 0.5 * float(e @ e / S[0, 0]) - 0.5 * np.log(2 * np.pi * S[0, 0])
                grown.append((log_w + log_l, m + K @ e, P - K @ S @ K.T))
        branches = grown
    log_w = np.array([b[0] for b in branches])
    w = np.exp(log_w - log_w.max())
    w /= w.sum()
    means = np.array([b[1] for b in branches])
    mean = w @ means
    spread = means - mean
    cov = np.einsum("i,ijk->jk", w, np.array([b[2] for b in branches])) + np.einsum("i,ij,ik->jk", w, spread, spread)
    return mean, cov


def grid_posterior(m: float, P: float, z: float, noise: Noise) -> tuple[float, float, float]:
    """Brute force on a line: mean and variance of p(x | z) and p(z)."""
    x = np.linspace(m - 14 * math.sqrt(P), m + 14 * math.sqrt(P), 400_001)
    density = np.exp(-0.5 * (x - m) ** 2 / P) / math.sqrt(2 * math.pi * P)
    likelihood = sum(
        share * np.exp(-0.5 * (z - x) ** 2 / R[0, 0]) / math.sqrt(2 * math.pi * R[0, 0])
        for share, R in zip(noise.probabilities, noise.cov, strict=True)
    )
    joint = density * likelihood
    evidence = float(np.trapezoid(joint, x))
    mean = float(np.trapezoid(x * joint, x)) / evidence
    return mean, float(np.trapezoid((x - mean) ** 2 * joint, x)) / evidence, evidence


def radii_m(lat_deg: float) -> tuple[float, float]:
    """Return the radii of WGS 84 along the meridian and across it, the radius of its parallel over cos(latitude)."""
    a, e2 = 6378137.0, 0.00669437999014
    w = math.sqrt(1 - e2 * math.sin(math.radians(lat_deg)) ** 2)
    return a * (1 - e2) / w**3, a / w


def log_density(x: np.ndarray, cov: np.ndarray) -> float:
    """Return the logarithm of a normal density of mean 0."""
    return -0.5 * float(np.linalg.slogdet(2 * np.pi * cov)[1] + x @ np.linalg.solve(cov, x))


def utm_m(lat_deg: float, lon_deg: float, zone: int) -> tuple[float, float]:
    """Return easting and northing by Krueger's series (Karney 2011, doi:10.1007/s00190-011-0445-3)."""
    f = 1 / 298.257223563
    n = f / (2 - f)
    e = 2 * math.sqrt(n) / (1 + n)
    phi, lam = math.radians(lat_deg), math.radians(lon_deg - (6 * zone - 183))
    t = math.sinh(math.atanh(math.sin(phi)) - e * math.atanh(e * math.sin(phi)))
    xi, eta = math.atan2(t, math.cos(lam)), math.asinh(math.sin(lam) / math.hypot(t, math.cos(lam)))
    alpha = (n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16, 13 * n**2 / 48 - 3 * n**3 / 5, 61 * n**3 / 240)
    east = eta + sum(a * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, a in enumerate(alpha, 1))
    north = xi + sum(a * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, a in enumerate(alpha, 1))
    radius_m = 0.9996 * 6_378_137.0 / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    return 500_000.0 + radius_m * east, radius_m * north
