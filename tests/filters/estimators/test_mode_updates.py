"""What a Gaussian makes of noise with modes, against grids and the textbook."""

import math

import numpy as np
import pytest

from textbook import PRIOR, grid_posterior
from usbldr.filters.estimators.gaussian_bank import Projection, inverse_and_logdet, project, replicate, update
from usbldr.filters.estimators.mode_updates import Gate, collapse, mode_likelihoods, moment_matched
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr.filters.models.sensors import DirectState, Measurement, UsblFix
from usbldr.filters.models.sigma_points import cubature
from usbldr.filters.models.states import StateLayout


@pytest.mark.parametrize("family", [Gaussian(), Mixture(), Contamination(), StudentT()], ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("z", [0.3, 2.0, 6.0, -11.0])
def test_collapse_keeps_the_moments_of_the_grid_posterior(family, z: float) -> None:
    noise = family.modes(np.array([[0.7]]))
    bank = replicate(np.array([0.5]), np.array([[2.0]]), 1)
    seen = project(bank, Measurement(np.array([z]), DirectState(0), noise, "usbl", "east", 0, 0.0), cubature)

    after, log_l, rejected = collapse(bank, seen, noise)

    mean, variance, evidence = grid_posterior(0.5, 2.0, z, noise)
    assert after.mean[0, 0] == pytest.approx(mean, abs=1e-8)
    assert after.cov[0, 0, 0] == pytest.approx(variance, abs=1e-8)
    assert math.exp(log_l[0]) == pytest.approx(evidence, rel=1e-8)
    assert not rejected


def test_collapse_of_a_two_dimensional_fix_keeps_the_moments_of_the_mixture_of_updates() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    bank = replicate(rng.normal(size=6), root @ root.T, 1)
    noise = Mixture(0.4, 20.0).modes(np.array([[0.5, 0.2], [0.2, 0.9]]))
    reading = Measurement(np.array([2.0, -3.0]), UsblFix(StateLayout(), -0.4), noise, "usbl", "position", 0, 0.0)
    seen = project(bank, reading, cubature)

    after, *_ = collapse(bank, seen, noise)

    branches, weights = [], []
    for share, R in zip(noise.probabilities, noise.cov, strict=True):
        S = seen.cov[:, :, 0] + R
        K = seen.cross[:, :, 0] @ np.linalg.inv(S)
        e = seen.innovation[:, 0]
        branches.append((bank.mean[:, 0] + K @ e, bank.cov[:, :, 0] - K @ S @ K.T))
        weights.append(share * math.exp(-0.5 * e @ np.linalg.solve(S, e)) / math.sqrt(np.linalg.det(S)))
    p = np.array(weights) / sum(weights)
    mean = sum(w * m for w, (m, _) in zip(p, branches, strict=True))
    cov = sum(w * (P + np.outer(m - mean, m - mean)) for w, (m, P) in zip(p, branches, strict=True))
    np.testing.assert_allclose(after.mean[:, 0], mean, atol=1e-12)
    np.testing.assert_allclose(after.cov[:, :, 0], cov, atol=1e-12)
    np.testing.assert_array_equal(after.cov, after.cov.swapaxes(0, 1))


def test_per_scalar_and_joint_updates_agree_where_the_noise_is_gaussian_and_round() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    bank = replicate(rng.normal(size=6), root @ root.T, 1)
    R, z = 0.8 * np.eye(2), np.array([1.0, 2.0])
    joint = Measurement(z, UsblFix(StateLayout(), 0.0), Gaussian().modes(R), "usbl", "position", 0, 0.0)
    together, *_ = moment_matched(bank, project(bank, joint, cubature), joint.noise)
    apart = bank
    for axis in (0, 1):
        noise = Gaussian().modes(R[:1, :1])
        model = UsblFix(StateLayout(), 0.0, axes=(axis,))
        scalar = Measurement(z[axis : axis + 1], model, noise, "usbl", "east", 0, 0.0)
        apart, *_ = moment_matched(apart, project(apart, scalar, cubature), noise)

    np.testing.assert_allclose(apart.mean, together.mean, atol=1e-12)
    np.testing.assert_allclose(apart.cov, together.cov, atol=1e-12)


def test_a_thousand_updates_leave_covariances_symmetric_and_positive() -> None:
    """An asymmetric P in batched updates once grew into negative variances after some 400 s."""
    rng = np.random.default_rng(2)
    bank = replicate(np.zeros(6), np.diag([0.1, 1, 1, 0.1, 9, 9.0]), 8)
    noise = Mixture().modes(np.array([[0.5, 0.1], [0.1, 0.6]]))
    for k in range(1000):
        bank = bank._replace(cov=bank.cov + 1e-4 * np.eye(6)[:, :, None])
        z = rng.normal(size=2)
        reading = Measurement(z, UsblFix(StateLayout(), -0.1), noise, "usbl", "position", k, 0.0)
        bank, *_ = collapse(bank, project(bank, reading, cubature), noise)

    np.testing.assert_array_equal(bank.cov, bank.cov.swapaxes(0, 1))
    assert np.linalg.eigvalsh(np.moveaxis(bank.cov, -1, 0)).min() > 0


def test_small_inverses_agree_with_lapack() -> None:
    rng = np.random.default_rng(3)
    for k in (1, 2, 3):
        root = rng.normal(size=(4, 7, k, k))
        S = np.moveaxis(root @ root.swapaxes(-1, -2) + 0.1 * np.eye(k), 1, -1)
        inverse, logdet = inverse_and_logdet(S)
        for j in range(4):
            for i in range(7):
                np.testing.assert_allclose(inverse[j, :, :, i], np.linalg.inv(S[j, :, :, i]), rtol=1e-9)
                assert logdet[j, i] == pytest.approx(np.linalg.slogdet(S[j, :, :, i])[1], abs=1e-9)


def test_the_modes_likelihood_survives_a_hopeless_outlier() -> None:
    noise = Mixture().modes(np.array([[1.0]]))
    seen = Projection(np.array([[1e4]]), np.array([[[1.0]]]), np.array([[[1.0]]]))

    weighed = mode_likelihoods(seen, noise)

    assert np.isfinite(weighed.log_likelihood).all()
    np.testing.assert_allclose(weighed.probability.sum(axis=0), 1)


def test_a_gate_refuses_the_unlikely_and_uses_the_nominal_mode_alone() -> None:
    noise = Contamination(0.05, 10.0).modes(np.array([[1.0]]))
    bank = replicate(PRIOR.mean, PRIOR.cov, 1)
    far = Measurement(np.array([12.0]), DirectState(0), noise, "usbl", "east", 0, 0.0)
    near = far._replace(z=np.array([1.0]))
    gate = Gate(0.99)

    kept, _, refused = gate(bank, project(bank, far, cubature), noise)
    taken, *_ = gate(bank, project(bank, near, cubature), noise)

    assert refused
    assert kept is bank
    np.testing.assert_allclose(taken.mean, update(bank, project(bank, near, cubature), noise.cov[0, :, :, None]).mean)
