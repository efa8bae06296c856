"""The other two readings of the paper's particle filter: one Gaussian proposal, and the letter."""

import math

import numpy as np
import pytest

from paper.cpf_gaussian import GaussianParticleFilter, whitened
from paper.cpf_literal import LiteralParticleFilter
from textbook import PRIOR, Drift, end, grid_posterior, position_steps
from usbldr.filters.estimators.gaussian_bank import replicate
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.protocol import Prior, Step
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.models.sensors import DirectState, Measurement
from usbldr.filters.models.sigma_points import cubature

MOTION = Drift((0.3, 0.1))


def test_whitened_draws_have_the_moments_of_a_standard_normal_exactly() -> None:
    draws = whitened(np.random.default_rng(0).normal(size=(6, 40)))
    np.testing.assert_allclose(draws.mean(axis=1), 0, atol=1e-14)
    np.testing.assert_allclose(draws @ draws.T / 40, np.eye(6), atol=1e-12)


def test_with_gaussian_noise_on_a_linear_model_the_gaussian_form_is_the_kalman_filter() -> None:
    """Its proposal is then the posterior, all weights are equal, and whitened draws carry no sampling error."""
    z = np.random.default_rng(1).normal(size=20)
    noise = Gaussian().modes(np.array([[0.8]]))

    got = end(GaussianParticleFilter(MOTION, cubature, 25), position_steps(z, noise))
    want = end(KalmanFilter(MOTION, cubature, moment_matched), position_steps(z, noise))

    np.testing.assert_allclose(got.mean, want.mean, atol=1e-9)
    np.testing.assert_allclose(got.cov, want.cov, atol=1e-9)
    assert got.ess == pytest.approx(25)


@pytest.mark.parametrize("z", [0.5, 4.0, -9.0])
def test_the_gaussian_form_tends_to_the_grid_posterior_of_one_heavy_tailed_reading(z: float) -> None:
    noise = Mixture(0.3, 30.0).modes(np.array([[0.7]]))
    reading = Measurement(np.array([z]), DirectState(0), noise, "usbl", "east", 0, 0.0)
    prior = Prior(np.array([0.5]), np.array([[2.0]]))

    got = end(GaussianParticleFilter(MOTION, cubature, 200_000), [Step(0, 0.0, 0.0, (reading,))], prior=prior)

    mean, variance, _ = grid_posterior(0.5, 2.0, z, noise)
    assert got.mean[0] == pytest.approx(mean, abs=0.02)
    assert got.cov[0, 0] == pytest.approx(variance, rel=0.03)


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


def test_the_prior_of_every_form_is_the_prior() -> None:
    for estimator in (GaussianParticleFilter(MOTION, cubature, 30), LiteralParticleFilter(MOTION, cubature, 30)):
        bank = estimator.start(PRIOR).bank
        np.testing.assert_array_equal(bank.mean, replicate(PRIOR.mean, PRIOR.cov, bank.mean.shape[1]).mean)
