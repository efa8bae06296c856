"""The particle filters, also as the paper may be read otherwise, against exact posteriors and the Kalman filter."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from paper.cpf_gaussian import GaussianParticleFilter
from paper.cpf_literal import LiteralParticleFilter
from textbook import PRIOR, Drift, beliefs, end, exact_mixture, position_steps
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.pf import BootstrapParticleFilter
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.estimators.resampling import effective_size, normalised, systematic
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.models.sensors import DirectState, Measurement
from usbldr.filters.models.sigma_points import cubature, linearised

Q = (0.3, 0.1)
MOTION = Drift(Q)
THIRTY = CubatureParticleFilter(MOTION, cubature, 30)


@pytest.mark.parametrize(
    ("form", "count", "rounding"), [(CubatureParticleFilter, 7, 1e-12), (GaussianParticleFilter, 25, 1e-9)]
)
def test_with_one_noise_mode_it_is_the_kalman_filter(form, count: int, rounding: float) -> None:
    """The Gaussian form's proposal is then the posterior, and whitened draws carry no sampling error."""
    z = np.random.default_rng(0).normal(size=20)
    noise = Gaussian().modes(np.array([[0.8]]))

    got = end(form(MOTION, cubature, count), position_steps(z, noise))
    want = end(KalmanFilter(MOTION, cubature, moment_matched), position_steps(z, noise))

    np.testing.assert_allclose(got.mean, want.mean, atol=rounding)
    np.testing.assert_allclose(got.cov, want.cov, atol=rounding)
    assert got.ess == pytest.approx(count)


def test_it_tends_to_the_exact_posterior_over_all_mode_histories() -> None:
    """2^10 histories are enumerated; the particle filter's error must shrink as 1 / sqrt(N)."""
    rng = np.random.default_rng(1)
    noise = Mixture(0.3, 60.0).modes(np.array([[0.2]]))
    z = np.cumsum(np.ones(10)) + rng.normal(size=10) * np.where(rng.random(10) < 0.3, 3.5, 0.45)
    want_mean, want_cov = exact_mixture(z, noise, np.array(Q))
    errors = {}
    for count, seeds in ((20, 60), (2000, 6)):
        estimator = CubatureParticleFilter(MOTION, cubature, count)
        ends = [end(estimator, position_steps(z, noise), seed) for seed in range(seeds)]
        errors[count] = math.sqrt(np.mean([np.sum((end.mean - want_mean) ** 2) for end in ends]))
        np.testing.assert_allclose(np.mean([end.mean for end in ends], axis=0), want_mean, atol=0.03)
        np.testing.assert_allclose(np.mean([end.cov for end in ends], axis=0), want_cov, rtol=0.12, atol=0.01)

    assert errors[2000] < errors[20] / 5


@pytest.mark.parametrize("move_steps", [1, 2])
def test_the_move_leaves_the_posterior_over_modes_unchanged(move_steps: int) -> None:
    """Particles drawn from the enumerated posterior of the last steps' modes still have it after the move."""
    noise = Mixture(0.4, 30.0).modes(np.array([[0.3]]))
    z = np.array([0.2, 3.5, 1.0, 6.0])
    read = [Measurement(z[[k]], DirectState(0), noise, "usbl", "east", 0, float(k // 2)) for k in range(4)]
    steps = [Step(k, 0.0, float(k), tuple(read[2 * k : 2 * k + 2])) for k in (0, 1)]
    count = 40_000
    estimator = CubatureParticleFilter(MOTION, cubature, count, resample_below=0.0, move_steps=2)

    histories = list(itertools.product((0, 1), repeat=4))
    weights, means, stories = [], [], []
    for modes in histories:
        log_w, story = 0.0, []
        m, P = PRIOR.mean.copy(), PRIOR.cov.copy()
        F = np.array([[1.0, 1.0], [0.0, 1.0]])
        for k in (0, 1):
            if k:
                m, P = F @ m, F @ P @ F.T + np.diag(Q)
            start, log_l = None, 0.0
            for i in (0, 1):
                e = z[2 * k + i] - m[0]
                densities = [
                    share * math.exp(-0.5 * e * e / (P[0, 0] + R[0, 0])) / math.sqrt(2 * math.pi * (P[0, 0] + R[0, 0]))
                    for share, R in zip(noise.probabilities, noise.cov, strict=True)
                ]
                mode = modes[2 * k + i]
                log_w += math.log(densities[mode])
                log_l += math.log(sum(densities))
                S = P[0, 0] + noise.cov[mode][0, 0]
                gain = P[:, 0] / S
                m, P = m + gain * e, P - np.outer(gain, gain) * S
            story.append((start, log_l, m.copy(), P.copy()))
        weights.append(math.exp(log_w))
        means.append(m)
        stories.append(story)
    posterior = np.array(weights) / sum(weights)

    rng = np.random.default_rng(2)
    drawn = rng.choice(len(histories), size=count, p=posterior)
    *_, belief = beliefs(estimator, steps)
    bank = belief.bank._replace(
        mean=np.stack([means[i] for i in range(16)], axis=1)[:, drawn],
        cov=np.stack([stories[i][1][3] for i in range(16)], axis=2)[:, :, drawn],
        log_weight=np.full(count, -math.log(count)),
    )
    after_first = belief.past[1].start._replace(
        mean=np.stack([stories[i][0][2] for i in range(16)], axis=1)[:, drawn],
        cov=np.stack([stories[i][0][3] for i in range(16)], axis=2)[:, :, drawn],
    )
    past = (
        belief.past[0]._replace(log_likelihood=np.array([s[0][1] for s in stories])[drawn]),
        belief.past[1]._replace(start=after_first, log_likelihood=np.array([s[1][1] for s in stories])[drawn]),
    )[-move_steps:]

    moved, _, acceptance = estimator._move(bank, past, rng)

    assert 0.3 < acceptance < 0.999
    # a history is recognised by the mean that it ends in
    nearest = np.argmin(np.abs(moved.mean[:, :, None] - np.stack(means, axis=1)[:, None]).sum(axis=0), axis=1)
    share = np.bincount(nearest, minlength=16) / count
    assert 0.5 * np.abs(share - posterior).sum() < 0.015
    assert np.mean(nearest != drawn) > 0.2  # it did move


def test_a_belief_is_a_value_that_can_be_run_from_again() -> None:
    z = np.random.default_rng(4).normal(size=12)
    steps = list(position_steps(z, Mixture().modes(np.eye(1))))
    *_, belief = beliefs(THIRTY, steps[:6])
    kept = belief.bank.mean.copy()
    ends = []
    for _ in range(2):
        state = belief
        for step in steps[6:]:
            state = THIRTY.step(state, step, lambda k=step.epoch: np.random.default_rng((0, k)))
        ends.append(state.bank.mean)

    np.testing.assert_array_equal(*ends)
    np.testing.assert_array_equal(belief.bank.mean, kept)


def test_resampling_resets_the_weights_and_reports_the_least_effective_size_and_without_moves_no_acceptance() -> None:
    z = np.random.default_rng(5).normal(size=40) * 3
    steps = list(position_steps(z, Mixture(0.5, 100.0).modes(np.eye(1) * 0.05)))
    estimator = CubatureParticleFilter(MOTION, cubature, 50)

    fallen = [belief for belief in beliefs(estimator, steps) if belief.ess < 25]
    unmoved = beliefs(replace(estimator, move_steps=0), steps)

    assert fallen
    for belief in fallen:
        np.testing.assert_allclose(np.exp(belief.bank.log_weight), 1 / 50)
        assert 0 < belief.acceptance <= 1
    assert all(math.isnan(belief.acceptance) for belief in unmoved)


def test_on_a_linear_model_a_bootstrap_filter_tends_to_the_kalman_filter_as_one_over_root_n() -> None:
    z = np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=15))
    noise = Gaussian().modes(np.array([[0.8]]))
    want = end(KalmanFilter(MOTION, linearised, moment_matched), position_steps(z, noise))
    errors = {}
    for count, seeds in ((100, 60), (10_000, 10)):
        filters = [BootstrapParticleFilter(MOTION, count, start_seed=seed) for seed in range(seeds)]
        ends = [end(one, position_steps(z, noise), seed) for seed, one in enumerate(filters)]
        errors[count] = math.sqrt(np.mean([np.sum((e.mean - want.mean) ** 2) for e in ends]))
    np.testing.assert_allclose(np.mean([e.mean for e in ends], axis=0), want.mean, atol=0.02)
    np.testing.assert_allclose(np.mean([e.cov for e in ends], axis=0), want.cov, rtol=0.05, atol=0.005)

    assert errors[10_000] < errors[100] / 5


def test_each_particle_is_drawn_its_share_give_or_take_one_and_on_average_exactly() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        weights = rng.dirichlet(np.ones(50))
        counts = np.bincount(systematic(weights, rng), minlength=50)
        assert np.all(np.abs(counts - 50 * weights) < 1)

    rng, weights = np.random.default_rng(1), np.array([0.05, 0.15, 0.3, 0.5])
    counts = sum(np.bincount(systematic(weights, rng), minlength=4) for _ in range(20_000)) / 20_000
    np.testing.assert_allclose(counts, 4 * weights, atol=0.02)
    assert set(systematic(np.array([0.0, 1.0, 0.0]), np.random.default_rng(2))) == {1}


def test_effective_size_runs_from_one_to_n_also_of_weights_too_small_for_a_float() -> None:
    assert effective_size(np.full(7, -np.log(7))) == pytest.approx(7)
    assert effective_size(normalised(np.array([0.0, -800.0, -900.0]))) == pytest.approx(1)
    assert np.exp(normalised(np.array([-5000.0, -5001.0]))).sum() == pytest.approx(1)


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
