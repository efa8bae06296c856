"""The backward pass, against another library's, its bound, and what its sigmas promise."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as OtherKalmanFilter

from textbook import PRIOR, Drift, estimates, position_steps
from uncalibrated import dive_without_calibration
from usbldr.filters.bounds.pcrlb import bounds
from usbldr.filters.errors import UsageError
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.replay.methods import METHODS, FilterSettings
from usbldr.filters.replay.run import run
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario

PAPER = find_scenario("paper")

F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = (0.3, 0.2)
R = 0.8
NOISE = Gaussian().modes(np.array([[R]]))


def filtered(z: np.ndarray, rule=linearised, q: tuple[float, float] = Q) -> tuple[np.ndarray, np.ndarray]:
    """Return our filter's means (K, 2) and covariances (K, 2, 2)."""
    estimator = KalmanFilter(Drift(q), rule, moment_matched)
    reported = estimates(estimator, position_steps(z, NOISE), seed=None)
    return np.array([e.mean for e in reported]), np.array([e.cov for e in reported])


@pytest.mark.parametrize("rule", [linearised, cubature, unscented], ids=["ekf", "ckf", "ukf"])
def test_on_a_linear_model_the_whole_chain_is_the_smoother_of_another_library(rule) -> None:
    z = np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=80))
    other = OtherKalmanFilter(dim_x=2, dim_z=1)
    other.x, other.P = PRIOR.mean[:, None].copy(), PRIOR.cov.copy()
    other.F, other.H, other.Q, other.R = F, np.array([[1.0, 0.0]]), np.diag(Q), np.array([[R]])
    kept = []
    for k, value in enumerate(z):
        if k:
            other.predict()
        other.update(value)
        kept.append((other.x.copy(), other.P.copy()))
    want_mean, want_cov, _, _ = other.rts_smoother(*(np.array(part) for part in zip(*kept, strict=True)))

    mean, cov = smooth(*filtered(z, rule), np.ones(80), np.zeros((80, 2)), np.arange(80.0), Drift(Q), rule)

    np.testing.assert_allclose(mean, want_mean[:, :, 0], atol=1e-9)
    np.testing.assert_allclose(cov, want_cov, atol=1e-9)


@pytest.mark.parametrize("q", [(0.3, 0.2), (0.3, 0.0), (0.0, 0.0)], ids=["drifting", "constant velocity", "no noise"])
def test_on_a_linear_model_its_covariance_is_the_smoothers_bound(q: tuple[float, float]) -> None:
    """The bound adds up information from the future and knows no gain."""
    z = np.zeros(80)  # of which no covariance depends
    want = bounds(list(position_steps(z, NOISE)), Drift(q), np.zeros((80, 2)), PRIOR.cov)

    mean, cov = filtered(z, q=q)
    np.testing.assert_allclose(cov, want.filtered, rtol=1e-7, atol=1e-12)
    _, smoothed = smooth(mean, cov, np.ones(80), np.zeros((80, 2)), np.arange(80.0), Drift(q), linearised)

    np.testing.assert_allclose(smoothed, want.smoothed, rtol=1e-6, atol=1e-9)


def test_an_inflated_or_widened_prediction_counts_as_more_noise() -> None:
    z = np.random.default_rng(1).normal(size=12).cumsum()
    mean, cov = filtered(z)
    doubled, lost, none = np.ones(12), np.zeros((12, 2)), np.zeros((12, 2))
    doubled[6], lost[6] = 2.0, 1e12  # [m2] independent noise: the past says nothing of what comes after

    how = ((np.ones(12), none), (doubled, none), (np.ones(12), lost))
    whole, inflated, widened = (smooth(mean, cov, *of, np.arange(12.0), Drift(Q), linearised)[1] for of in how)

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


def test_only_what_is_near_a_gaussian_is_smoothed() -> None:
    log = dive_without_calibration(replace(PAPER, duration_s=5.0), 0)
    line = timeline(log)
    with pytest.raises(UsageError, match="pf is too far from a Gaussian"):
        run("pf", line, log.parameters, FilterSettings(smooth=True))
    assert METHODS["pf"].smoother_transform is None
