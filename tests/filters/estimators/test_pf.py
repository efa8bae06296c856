"""The bootstrap particle filter against the Kalman filter that it must become."""

import math

import numpy as np

from textbook import Drift, end, exact_mixture, position_steps
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.pf import BootstrapParticleFilter
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.models.sigma_points import linearised

Q = (0.3, 0.1)
MOTION = Drift(Q)


def test_on_a_linear_model_it_tends_to_the_kalman_filter_as_one_over_root_n() -> None:
    z = np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=15))
    noise = Gaussian().modes(np.array([[0.8]]))
    want = end(KalmanFilter(MOTION, linearised, moment_matched), position_steps(z, noise))
    errors = {}
    for count, seeds in ((100, 60), (10_000, 10)):
        ends = [
            end(BootstrapParticleFilter(MOTION, count, start_seed=s), position_steps(z, noise), s) for s in range(seeds)
        ]
        errors[count] = math.sqrt(np.mean([np.sum((e.mean - want.mean) ** 2) for e in ends]))
    np.testing.assert_allclose(np.mean([e.mean for e in ends], axis=0), want.mean, atol=0.02)
    np.testing.assert_allclose(np.mean([e.cov for e in ends], axis=0), want.cov, rtol=0.05, atol=0.005)

    assert errors[10_000] < errors[100] / 5


def test_with_heavy_tails_it_tends_to_the_posterior_over_all_mode_histories() -> None:
    rng = np.random.default_rng(1)
    noise = Mixture(0.3, 60.0).modes(np.array([[0.2]]))
    z = np.cumsum(np.ones(8)) + rng.normal(size=8) * np.where(rng.random(8) < 0.3, 3.5, 0.45)
    mean, cov = exact_mixture(z, noise, np.array(Q))

    ends = [end(BootstrapParticleFilter(MOTION, 20_000, start_seed=s), position_steps(z, noise), s) for s in range(6)]

    np.testing.assert_allclose(np.mean([e.mean for e in ends], axis=0), mean, atol=0.02)
    np.testing.assert_allclose(np.mean([e.cov for e in ends], axis=0), cov, rtol=0.08, atol=0.01)
