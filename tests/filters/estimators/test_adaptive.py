"""Adaptive factors: nothing while innovations are as predicted, a quick return after a jump; the two-stage filter."""

import functools
import math

import numpy as np
import pytest

from textbook import Drift, estimates, position_steps
from usbldr.filters.estimators.adaptive import MAX_FACTOR, CovarianceMatching, FadingFactor, InflationFactor, Innovation
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.pf_wekf import TwoStageFilter
from usbldr.filters.estimators.protocol import Estimate, Prior, Step
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, Noise, NoiseFamily
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sensors import DirectState, Measurement, UsblFix
from usbldr.filters.models.sigma_points import linearised, unscented
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
def test_the_table_pairs_ukf_and_ekf_with_their_factors(name, rule, factor):
    motion = VehicleMotion(StateLayout(), ProcessNoise())

    build = METHODS[name].build
    assert build is not None
    assert build(motion, FilterSettings()) == KalmanFilter(motion, rule, moment_matched, factor)


MOVING = VehicleMotion(StateLayout(), ProcessNoise(0.02, 1e-3, 1e-3, 1e-4))
SURE = Prior(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3, 1e-4, 1.0, 1.0]) ** 2)
GROSS = Contamination(0.05, 20.0)


def northbound(offset_m: np.ndarray, family: NoiseFamily, seed: int = 0, sd_m: float = 1.0) -> list[Step]:
    """Return a fix per second of a vehicle that goes north at 1 m/s; ``offset_m`` (K,) is added to its east."""
    rng = np.random.default_rng(seed)
    model, noise, steps = UsblFix(StateLayout(), 0.0), family.modes(sd_m**2 * np.eye(2)), list[Step]()
    for k, off in enumerate(offset_m):
        z = np.array([off, k]) + sd_m * rng.normal(size=2)
        fix = Measurement(z, model, noise, "usbl", "position", k, float(k))
        steps.append(Step(k, float(max(k - 1, 0)), float(k), (fix,)))
    return steps


run_drawing = functools.partial(estimates, prior=SURE)


def test_noise_of_one_mode_leaves_a_plain_ekf() -> None:
    """There is nothing to weigh, so the second stage takes every fix with its own R."""
    steps = northbound(np.zeros(40), Gaussian(per_scalar=False))

    two_stage = run_drawing(TwoStageFilter(MOVING), steps)
    plain = run_drawing(KalmanFilter(MOVING, linearised, moment_matched), steps)

    for a, b in zip(two_stage, plain, strict=True):
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)
        np.testing.assert_allclose(a.cov, b.cov, atol=1e-9)


def test_a_fix_that_disagrees_with_the_local_track_is_rejected_and_the_next_is_not() -> None:
    offset_m = 15.0 * (np.arange(30) == 20)

    estimates = run_drawing(TwoStageFilter(MOVING), northbound(offset_m, GROSS))

    assert [k for k, e in enumerate(estimates) if e.updates[0].outcome == "rejected"] == [20]
    assert abs(estimates[20].mean[4]) < 1.0


def test_the_candidates_and_not_the_ekf_decide_about_a_fix() -> None:
    """An EKF that is sure of a wrong place, 30 m off, doubts every fix; the fixes agree with each other."""
    wrong = Prior(SURE.mean + np.array([0, 0, 0, 0, 30.0, 0]), SURE.cov)
    steps = northbound(np.zeros(60), GROSS)

    estimates = run_drawing(TwoStageFilter(MOVING), steps, prior=wrong)
    plain = run_drawing(KalmanFilter(MOVING, linearised, moment_matched), steps, prior=wrong)

    assert not any(e.updates[0].outcome == "rejected" for e in estimates)
    assert abs(estimates[30].mean[4]) < 0.5 * abs(plain[30].mean[4])


def test_a_lasting_displacement_is_doubted_first_and_then_believed() -> None:
    offset_m = 15.0 * (np.arange(80) >= 40)

    estimates = run_drawing(TwoStageFilter(MOVING), northbound(offset_m, GROSS))
    fates = [e.updates[0].outcome for e in estimates]

    assert fates[40:43] == ["rejected"] * 3
    assert "rejected" not in fates[55:]


def test_candidates_are_the_mean_of_the_fixes_carried_by_dead_reckoning() -> None:
    """With Gaussian noise and next to no drift the posterior is N(mean, R / n) in closed form."""
    estimator = TwoStageFilter(MOVING, particles=20_000, drift_per_distance=0.0)
    steps = northbound(np.zeros(9), Gaussian(per_scalar=False), seed=5)
    belief = estimator.start(SURE)
    for step in steps:
        belief = estimator.step(belief, step, lambda: np.random.default_rng(0))
    now_s = 8.0
    carried = np.array([step.measurements[0].z + np.array([0.0, now_s - k]) for k, step in enumerate(steps)])

    cloud = estimator._candidates(belief.past, now_s, belief.dead_reckoned_m, np.random.default_rng(1))  # pyright: ignore
    w = np.exp(cloud.log_weight)
    mean = cloud.mean @ w
    sd = np.sqrt((cloud.mean - mean[:, None]) ** 2 @ w)

    np.testing.assert_allclose(mean, carried.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(sd, 1 / math.sqrt(9), rtol=0.08)


def test_the_same_seed_gives_the_same_bits_and_another_one_does_not() -> None:
    steps = northbound(np.zeros(20), GROSS)

    first, again, other = (run_drawing(TwoStageFilter(MOVING), steps, seed=seed)[-1] for seed in (1, 1, 2))

    np.testing.assert_array_equal(first.mean, again.mean)
    assert np.any(first.mean != other.mean)
    assert first.ess < 100


def test_a_fix_that_no_local_track_precedes_is_taken_as_by_an_ekf() -> None:
    """After two silent minutes the old fixes are no longer local."""
    late = [step._replace(t0_s=step.t0_s + 120.0, t1_s=step.t1_s + 120.0) for step in northbound(np.zeros(1), GROSS)]
    steps = [*northbound(np.zeros(10), GROSS), late[0]._replace(epoch=10, t0_s=9.0)]

    two_stage = run_drawing(TwoStageFilter(MOVING), steps)

    assert two_stage[-1].updates[0].outcome != "rejected"
    assert two_stage[-1].ess == two_stage[-2].ess < 100  # no candidates were drawn anew
