"""The other two readings of the paper's particle filter: one Gaussian proposal, and the letter."""

import math

import numpy as np
import pytest

from paper.cpf_gaussian import GaussianParticleFilter
from paper.cpf_literal import LiteralParticleFilter
from textbook import PRIOR, Drift, end, position_steps
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.models.sigma_points import cubature

MOTION = Drift((0.3, 0.1))


def test_with_gaussian_noise_on_a_linear_model_the_gaussian_form_is_the_kalman_filter() -> None:
    """Its proposal is then the posterior, all weights are equal, and whitened draws carry no sampling error."""
    z = np.random.default_rng(1).normal(size=20)
    noise = Gaussian().modes(np.array([[0.8]]))

    got = end(GaussianParticleFilter(MOTION, cubature, 25), position_steps(z, noise))
    want = end(KalmanFilter(MOTION, cubature, moment_matched), position_steps(z, noise))

    np.testing.assert_allclose(got.mean, want.mean, atol=1e-9)
    np.testing.assert_allclose(got.cov, want.cov, atol=1e-9)
    assert got.ess == pytest.approx(25)


def test_with_process_noise_to_spare_the_literal_form_tends_to_the_kalman_filter() -> None:
    z = np.cumsum(np.random.default_rng(2).normal(1.0, 1.0, size=8))
    noise = Gaussian().modes(np.array([[0.8]]))
    loud = Drift((1.0, 0.6))
    want = end(KalmanFilter(loud, cubature, moment_matched), position_steps(z, noise))
    ends = [end(LiteralParticleFilter(loud, cubature, 5000), position_steps(z, noise), seed) for seed in range(10)]

    np.testing.assert_allclose(np.mean([e.mean for e in ends], axis=0), want.mean, atol=0.05)
    np.testing.assert_allclose(np.mean([e.cov for e in ends], axis=0), want.cov, rtol=0.15, atol=0.02)


def test_the_literal_form_loses_its_particles_where_process_noise_is_small() -> None:
    z = np.arange(60.0)
    noise = Mixture().modes(np.array([[0.8]]))
    estimator = LiteralParticleFilter(Drift((1e-6, 1e-8)), cubature, 100)
    belief, least = estimator.start(PRIOR), []
    for step in position_steps(z, noise):
        belief = estimator.step(belief, step, lambda k=step.epoch: np.random.default_rng((0, k)))
        least.append(belief.ess)

    assert np.mean(least) < 10
    assert math.isfinite(estimator.estimate(belief).mean[0])
