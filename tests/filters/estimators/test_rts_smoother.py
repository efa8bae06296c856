"""The backward pass, against solving for the whole dive at once and against what its sigmas promise."""

from dataclasses import replace

import numpy as np
import pytest

from textbook import PRIOR, Drift, estimates, position_steps
from uncalibrated import dive_without_calibration
from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import collapse, moment_matched
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.run import run
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

PAPER = find_scenario("paper")

F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = np.array([0.3, 0.2])
R = 0.8


def filtered(z: np.ndarray, rule=linearised) -> tuple[np.ndarray, np.ndarray]:
    estimator = KalmanFilter(Drift(tuple(Q)), rule, moment_matched)
    reported = estimates(estimator, position_steps(z, Gaussian().modes(np.array([[R]]))), seed=None)
    return np.array([e.mean for e in reported]), np.array([e.cov for e in reported])


def solved_at_once(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The normal equations of prior, motions and measurements over all epochs."""
    n, K = 2, len(z)
    information, right = np.zeros((n * K, n * K)), np.zeros(n * K)
    P0 = np.linalg.inv(PRIOR.cov)
    information[:n, :n] += P0
    right[:n] += P0 @ PRIOR.mean
    for k in range(K):
        information[n * k, n * k] += 1 / R
        right[n * k] += z[k] / R
        if k:
            both = slice(n * (k - 1), n * k + n)
            A = np.hstack([-F, np.eye(n)])
            information[both, both] += A.T @ np.diag(1 / Q) @ A
    cov = np.linalg.inv(information)
    mean = cov @ right
    return mean.reshape(K, n), np.array([cov[n * k : n * k + n, n * k : n * k + n] for k in range(K)])


@pytest.mark.parametrize("rule", [linearised, cubature, unscented])
def test_on_a_linear_dive_the_pass_solves_the_normal_equations(rule) -> None:
    z = np.random.default_rng(0).normal(size=40).cumsum()
    mean, cov = filtered(z, rule)

    none, seconds = np.zeros((40, 2)), np.arange(40.0)
    smoothed_mean, smoothed_cov = smooth(mean, cov, np.ones(40), none, seconds, Drift(tuple(Q)), rule)

    want_mean, want_cov = solved_at_once(z)
    np.testing.assert_allclose(smoothed_mean, want_mean, atol=1e-9)
    np.testing.assert_allclose(smoothed_cov, want_cov, atol=1e-9)


def test_an_inflated_or_widened_prediction_counts_as_more_noise() -> None:
    z = np.random.default_rng(1).normal(size=12).cumsum()
    mean, cov = filtered(z)
    doubled, lost, none = np.ones(12), np.zeros((12, 2)), np.zeros((12, 2))
    doubled[6], lost[6] = 2.0, 1e12  # [m2] independent noise: the past says nothing of what comes after

    how = ((np.ones(12), none), (doubled, none), (np.ones(12), lost))
    whole, inflated, widened = (smooth(mean, cov, *of, np.arange(12.0), Drift(tuple(Q)), linearised)[1] for of in how)

    np.testing.assert_allclose(widened[5], cov[5], rtol=1e-6)
    np.testing.assert_array_equal(widened[6:], whole[6:])
    assert whole[5, 0, 0] < inflated[5, 0, 0] < cov[5, 0, 0]


def test_a_state_that_is_known_exactly_stays_known() -> None:
    """Velocity without variance or noise: the position alone is smoothed, as by solving for it alone."""
    still = Drift((0.3, 0.0))
    mean = np.array([[0.0, 1.0], [1.2, 1.0], [1.9, 1.0]])
    cov = np.zeros((3, 2, 2))
    cov[:, 0, 0] = 0.5, 0.4, 0.3

    smoothed_mean, smoothed_cov = smooth(mean, cov, np.ones(3), np.zeros((3, 2)), np.arange(3.0), still, cubature)

    gain = 0.4 / (0.4 + 0.3)
    assert smoothed_mean[1, 0] == pytest.approx(1.2 + gain * (1.9 - 2.2))
    assert smoothed_cov[1, 0, 0] == pytest.approx(0.4 + gain**2 * (0.3 - 0.7))
    np.testing.assert_array_equal(smoothed_mean[:, 1], 1.0)
    assert not smoothed_cov[:, 1].any()


@pytest.mark.parametrize("name", ["ekf", "ckf", "adf", "cpf", "pf-wekf"])
def test_smoothing_leaves_the_last_epoch_and_narrows_the_others(name: str) -> None:
    log = dive_without_calibration(replace(PAPER, duration_s=60.0), 3)
    line = timeline(log)
    assumed = replace(log.parameters, calibrate=("scale", "misalignment"))
    plain, smoothed = (run(name, line, assumed, FilterSettings(particles=20, smooth=on)) for on in (False, True))

    assert (plain.label, smoothed.label) == (name, f"{name} smoothed")
    np.testing.assert_array_equal(smoothed.mean[-1], plain.mean[-1])
    assert smoothed.cov is not None
    assert plain.cov is not None
    spread = np.einsum("kii->ki", plain.cov)
    narrowed = np.einsum("kii->ki", smoothed.cov)
    if name != "cpf":  # whose covariance is that of a mixture, which the pass takes for one Gaussian
        assert (narrowed <= spread * (1 + 1e-6)).all()
    assert narrowed[:200, 4:6].mean() < 0.8 * spread[:200, 4:6].mean()
    np.testing.assert_array_equal(smoothed.cov[:-1], smoothed.cov[:-1].swapaxes(1, 2))


def test_the_sigmas_of_smoothed_dives_are_right() -> None:
    """Dives drawn from the filter's own model: the mean NEES over 150 of them is 2, within 4 of its sigmas."""
    rng = np.random.default_rng(5)
    q, r, total, count = np.array([0.2, 0.1]), Gaussian().modes(np.array([[0.7]])), 0.0, 150
    for _ in range(count):
        x = PRIOR.mean + np.linalg.cholesky(PRIOR.cov) @ rng.normal(size=2)
        track, z = [], []
        for k in range(25):
            if k:
                x = F @ x + np.sqrt(q) * rng.normal(size=2)
            track.append(x)
            z.append(x[0] + np.sqrt(0.7) * rng.normal())
        estimator = KalmanFilter(Drift(tuple(q)), cubature, collapse)
        belief, estimates = estimator.start(PRIOR), []
        for step in position_steps(np.array(z), r):
            belief = estimator.step(belief, step, lambda: np.random.default_rng(0))
            estimates.append(estimator.estimate(belief))
        mean, cov = (np.array([getattr(e, part) for e in estimates]) for part in ("mean", "cov"))
        mean, cov = smooth(mean, cov, np.ones(25), np.zeros((25, 2)), np.arange(25.0), Drift(tuple(q)), cubature)
        e = track[10] - mean[10]
        total += float(e @ np.linalg.solve(cov[10], e))

    assert abs(total / count - 2) < 4 * 2 / np.sqrt(count)


def test_only_what_is_near_a_gaussian_is_smoothed() -> None:
    log = dive_without_calibration(replace(PAPER, duration_s=5.0), 0)
    line = timeline(log)
    with pytest.raises(UsageError, match="pf is too far from a Gaussian"):
        run("pf", line, log.parameters, FilterSettings(smooth=True))
    assert METHODS["pf"].smoother_transform is None
