"""The adaptive factors: nothing while the innovations are as predicted, a quick return after a jump."""

import math

import numpy as np
import pytest

from textbook import Drift, estimates, position_steps
from usbldr.filters.estimators.adaptive import MAX_FACTOR, CovarianceMatching, FadingFactor, InflationFactor, Innovation
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.protocol import Estimate, Step
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Noise
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sensors import DirectState, Measurement
from usbldr.filters.models.sigma_points import MomentTransform, linearised, unscented
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.methods import METHODS, FilterSettings

QUIET = (1e-4, 1e-6)
ONE = Gaussian().modes(np.eye(1))
FACTORS = pytest.mark.parametrize("factor", [FadingFactor(), CovarianceMatching()], ids=["afukf", "aekf"])


def run(factor: InflationFactor | None, steps: list[Step]) -> list[Estimate]:
    return estimates(KalmanFilter(Drift(QUIET), unscented, moment_matched, factor), steps, seed=None)


def noisy(z: np.ndarray, noise: Noise = ONE, seed: int = 0) -> list[Step]:
    return list(position_steps(z + np.random.default_rng(seed).normal(size=len(z)), noise))


def epochs_until_back(estimates: list[Estimate], truth: np.ndarray, jump: int) -> int:
    error = np.abs([e.mean[0] - z for e, z in zip(estimates, truth, strict=True)])
    return int(np.argmax(error[jump:] < 3.0))


@FACTORS
def test_innovations_as_predicted_leave_the_plain_filter(factor: InflationFactor) -> None:
    steps = noisy(np.arange(120.0), seed=3)

    adapted, plain = run(factor, steps), run(None, steps)

    assert [e.inflation for e in adapted] == [1.0] * 120
    for a, b in zip(adapted, plain, strict=True):
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_array_equal(a.cov, b.cov)


@FACTORS
def test_chance_alone_seldom_inflates(factor: InflationFactor) -> None:
    """Half of a window beyond its 90th percentile is a case for one window in 600, and 4000 are looked at."""
    inflated = sum(e.inflation > 1 for seed in range(20) for e in run(factor, noisy(np.arange(200.0), seed=100 + seed)))

    assert inflated <= 5


@FACTORS
def test_a_jump_that_no_model_knows_is_followed_sooner_and_uses_the_evidence_up(factor: InflationFactor) -> None:
    truth = np.arange(160.0) + 25.0 * (np.arange(160) >= 80)
    steps = noisy(truth)

    adapted, plain = run(factor, steps), run(None, steps)

    assert epochs_until_back(adapted, truth, 80) <= factor.window
    assert epochs_until_back(plain, truth, 80) > 2 * factor.window
    assert max(e.inflation for e in adapted[:80]) == 1.0
    assert max(e.inflation for e in adapted[80:]) > 10
    assert np.all(np.diff(np.flatnonzero([e.inflation > 1 for e in adapted])) >= factor.window)


@FACTORS
def test_lone_gross_errors_are_not_taken_for_a_jump(factor: InflationFactor) -> None:
    z = np.arange(120.0) + 60.0 * (np.arange(120) % 6 == 5)
    noise = Contamination(0.15, 30.0).modes(np.eye(1))

    adapted = run(factor, noisy(z, noise))

    assert [e.inflation for e in adapted] == [1.0] * 120


def test_the_fading_factor_brings_the_distance_to_the_99th_percentile_of_chi_square() -> None:
    """6.635 and 9.210 for one and two degrees of freedom, from a printed table."""
    for k, limit in ((1, 6.635), (2, 9.210)):
        one = Innovation(np.full(k, 8.0), 0.5 * np.eye(k), Gaussian().modes(2.0 * np.eye(k)))

        factor = FadingFactor()([one] * 5)

        assert k * 64.0 / (factor * 0.5 + 2.0) == pytest.approx(limit, rel=0.01)


def test_the_matching_factor_explains_the_mean_square_of_a_normal_sample() -> None:
    """Innovations of variance 50 at R = 2 and H P H' = 0.5 ask for the factor (50 - 2) / 0.5 = 96."""
    e = np.random.default_rng(0).normal(scale=math.sqrt(50.0), size=(20_001, 1))

    factor = CovarianceMatching(window=20_001)(
        [Innovation(row, 0.5 * np.eye(1), Gaussian().modes(2.0 * np.eye(1))) for row in e]
    )

    assert factor == pytest.approx(96.0, rel=0.08)


@FACTORS
def test_no_factor_is_beyond_all_reason(factor: InflationFactor) -> None:
    far = Innovation(np.array([1e6]), 1e-3 * np.eye(1), ONE)

    assert factor([far] * factor.window) == MAX_FACTOR


@FACTORS
def test_speed_and_heading_are_not_listened_to(factor: InflationFactor) -> None:
    z = np.arange(40.0) + 25.0 * (np.arange(40) >= 20)
    readings = [(Measurement(np.array([v]), DirectState(0), ONE, "dvl", "forward", k, k),) for k, v in enumerate(z)]
    steps = [Step(k, float(max(k - 1, 0)), float(k), reading) for k, reading in enumerate(readings)]

    assert {e.inflation for e in run(factor, steps)} == {1.0}


@pytest.mark.parametrize(
    ("name", "rule", "factor"), [("afukf", unscented, FadingFactor()), ("aekf", linearised, CovarianceMatching())]
)
def test_the_table_pairs_ukf_and_ekf_with_their_factors(
    name: str, rule: MomentTransform, factor: InflationFactor
) -> None:
    motion = VehicleMotion(StateLayout(), ProcessNoise())

    build = METHODS[name].build
    assert build is not None
    assert build(motion, FilterSettings()) == KalmanFilter(motion, rule, moment_matched, factor)
