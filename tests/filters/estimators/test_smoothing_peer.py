"""The smoother against another library's, and against the bound that no smoother can pass."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as OtherKalmanFilter

from textbook import PRIOR, Drift, estimates, position_steps
from usbldr.filters.bounds.pcrlb import bounds
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.rts_smoother import smooth
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.sigma_points import cubature, linearised, unscented

NOISE = Gaussian().modes(np.array([[0.8]]))
EPOCHS = 80


def readings() -> np.ndarray:
    return np.cumsum(np.random.default_rng(0).normal(1.0, 1.0, size=EPOCHS))


def filtered(motion: Drift) -> tuple[np.ndarray, np.ndarray]:
    """Return our filter's means (EPOCHS, 2) and covariances (EPOCHS, 2, 2)."""
    estimator = KalmanFilter(motion, linearised, moment_matched)
    reported = estimates(estimator, position_steps(readings(), NOISE), seed=None)
    return np.array([e.mean for e in reported]), np.array([e.cov for e in reported])


@pytest.mark.parametrize("rule", [linearised, cubature, unscented], ids=["ekf", "ckf", "ukf"])
def test_on_a_linear_model_the_whole_chain_is_the_smoother_of_another_library(rule) -> None:
    q = (0.05, 0.02)
    other = OtherKalmanFilter(dim_x=2, dim_z=1)
    other.x, other.P = PRIOR.mean[:, None].copy(), PRIOR.cov.copy()
    other.F, other.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    other.Q, other.R = np.diag(q), np.array([[0.8]])
    kept = []
    for k, value in enumerate(readings()):
        if k:
            other.predict()
        other.update(value)
        kept.append((other.x.copy(), other.P.copy()))
    want_mean, want_cov, _, _ = other.rts_smoother(*(np.array(part) for part in zip(*kept, strict=True)))

    mean, cov = smooth(
        *filtered(Drift(q)), np.ones(EPOCHS), np.zeros((EPOCHS, 2)), np.arange(float(EPOCHS)), Drift(q), rule
    )

    np.testing.assert_allclose(mean, want_mean[:, :, 0], atol=1e-9)
    np.testing.assert_allclose(cov, want_cov, atol=1e-9)


@pytest.mark.parametrize(
    "q", [(0.05, 0.02), (0.05, 0.0), (0.0, 0.0)], ids=["drifting", "constant velocity", "no noise"]
)
def test_on_a_linear_model_its_covariance_is_the_smoothers_bound(q: tuple[float, float]) -> None:
    """The bound adds up information from the future and knows no gain."""
    steps = list(position_steps(readings(), NOISE))
    want = bounds(steps, Drift(q), np.zeros((EPOCHS, 2)), PRIOR.cov)

    mean, cov = filtered(Drift(q))
    np.testing.assert_allclose(cov, want.filtered, rtol=1e-7, atol=1e-12)
    _, smoothed = smooth(
        mean, cov, np.ones(EPOCHS), np.zeros((EPOCHS, 2)), np.arange(float(EPOCHS)), Drift(q), linearised
    )

    np.testing.assert_allclose(smoothed, want.smoothed, rtol=1e-6, atol=1e-9)
