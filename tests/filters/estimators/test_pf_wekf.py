"""The two-stage filter: what the last fixes say decides what the EKF makes of the next one."""

import math

import numpy as np

from textbook import estimates
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.pf_wekf import TwoStageFilter
from usbldr.filters.estimators.protocol import Estimate, Prior, Step
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Contamination, Gaussian, NoiseFamily
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sensors import Measurement, UsblFix
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import StateLayout

MOTION = VehicleMotion(StateLayout(), ProcessNoise(0.02, 1e-3, 1e-3, 1e-4))
PRIOR = Prior(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.diag([1e-3, 1e-3, 1e-3, 1e-4, 1.0, 1.0]) ** 2)
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


def run(estimator, steps: list[Step], prior: Prior = PRIOR, seed: int = 0) -> list[Estimate]:
    return estimates(estimator, steps, prior, seed)


def test_noise_of_one_mode_leaves_a_plain_ekf() -> None:
    """There is nothing to weigh, so the second stage takes every fix with its own R."""
    steps = northbound(np.zeros(40), Gaussian(per_scalar=False))

    two_stage = run(TwoStageFilter(MOTION), steps)
    plain = run(KalmanFilter(MOTION, linearised, moment_matched), steps)

    for a, b in zip(two_stage, plain, strict=True):
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)
        np.testing.assert_allclose(a.cov, b.cov, atol=1e-9)


def test_a_fix_that_disagrees_with_the_local_track_is_rejected_and_the_next_is_not() -> None:
    offset_m = 15.0 * (np.arange(30) == 20)

    estimates = run(TwoStageFilter(MOTION), northbound(offset_m, GROSS))

    assert [k for k, e in enumerate(estimates) if e.updates[0].outcome == "rejected"] == [20]
    assert abs(estimates[20].mean[4]) < 1.0


def test_the_candidates_and_not_the_ekf_decide_about_a_fix() -> None:
    """An EKF that is sure of a wrong place, 30 m off, doubts every fix; the fixes agree with each other."""
    wrong = Prior(PRIOR.mean + np.array([0, 0, 0, 0, 30.0, 0]), PRIOR.cov)
    steps = northbound(np.zeros(60), GROSS)

    estimates = run(TwoStageFilter(MOTION), steps, wrong)
    plain = run(KalmanFilter(MOTION, linearised, moment_matched), steps, wrong)

    assert not any(e.updates[0].outcome == "rejected" for e in estimates)
    assert abs(estimates[30].mean[4]) < 0.5 * abs(plain[30].mean[4])


def test_a_lasting_displacement_is_doubted_first_and_then_believed() -> None:
    offset_m = 15.0 * (np.arange(80) >= 40)

    estimates = run(TwoStageFilter(MOTION), northbound(offset_m, GROSS))
    fates = [e.updates[0].outcome for e in estimates]

    assert fates[40:43] == ["rejected"] * 3
    assert "rejected" not in fates[55:]


def test_candidates_are_the_mean_of_the_fixes_carried_by_dead_reckoning() -> None:
    """With Gaussian noise and next to no drift the posterior is N(mean, R / n) in closed form."""
    estimator = TwoStageFilter(MOTION, particles=20_000, drift_per_distance=0.0)
    steps = northbound(np.zeros(9), Gaussian(per_scalar=False), seed=5)
    belief = estimator.start(PRIOR)
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

    first, again, other = (run(TwoStageFilter(MOTION), steps, seed=seed)[-1] for seed in (1, 1, 2))

    np.testing.assert_array_equal(first.mean, again.mean)
    assert np.any(first.mean != other.mean)
    assert first.ess < 100


def test_a_fix_that_no_local_track_precedes_is_taken_as_by_an_ekf() -> None:
    """After two silent minutes the old fixes are no longer local."""
    late = [step._replace(t0_s=step.t0_s + 120.0, t1_s=step.t1_s + 120.0) for step in northbound(np.zeros(1), GROSS)]
    steps = [*northbound(np.zeros(10), GROSS), late[0]._replace(epoch=10, t0_s=9.0)]

    two_stage = run(TwoStageFilter(MOTION), steps)

    assert two_stage[-1].updates[0].outcome != "rejected"
    assert two_stage[-1].ess == two_stage[-2].ess < 100  # no candidates were drawn anew
