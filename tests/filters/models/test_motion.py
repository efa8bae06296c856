"""The motion model against closed forms and an integration; in gaps of DVL and compass against simulated vehicles."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.estimators.gaussian_bank import predict, replicate
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.models.states import StateLayout
from usbldr.filters.models.usual_motion import (
    LONGEST_GAP_S,
    LONGEST_TURN_GAP_S,
    TURN_S,
    TurnHistory,
    UsualMotion,
    VelocityHistory,
)

QUIET = ProcessNoise(0.0, 0.0, 0.0, 0.0)


def moved(x: np.ndarray, seconds: float) -> np.ndarray:
    """Move a known state, which has no spread, so that every rule is exact."""
    bank = replicate(x, np.zeros((6, 6)), 1)
    return predict(bank, VehicleMotion(StateLayout(), QUIET), cubature, 0.0, seconds).mean[:, 0]


def test_yaw_turns_the_body_velocity_counter_clockwise() -> None:
    north = moved(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), 1.0)  # bow north, going forward
    west = moved(np.array([np.pi / 2, 0.0, 2.0, 0.0, 0.0, 0.0]), 1.0)  # bow west
    crab = moved(np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]), 1.0)  # bow north, going to starboard

    np.testing.assert_allclose(north[4:], [0.0, 2.0], atol=1e-15)
    np.testing.assert_allclose(west[4:], [-2.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(crab[4:], [3.0, 0.0], atol=1e-15)


def test_many_small_steps_follow_the_circle() -> None:
    y = np.array([0.3, 0.2, 1.5, 0.05, 0.0, 0.0])
    for _ in range(3000):
        y = moved(y, 0.02)
    t = np.linspace(0, 60, 600_001)
    psi = 0.3 + 0.05 * t
    mps = 0.2 * np.cos(psi) - 1.5 * np.sin(psi), 0.2 * np.sin(psi) + 1.5 * np.cos(psi)

    np.testing.assert_allclose(y[4:], [np.trapezoid(axis, t) for axis in mps], atol=1e-4)
    assert abs(y[0] - 3.3) < 1e-12


def test_process_noise_grows_with_the_time_that_passes() -> None:
    motion = VehicleMotion(StateLayout(), ProcessNoise(0.1, 0.2, 0.3, 0.4))

    np.testing.assert_allclose(motion.noise(1.0, 3.0), 2 * np.array([0.04, 0.09, 0.09, 0.16, 0.01, 0.01]))


def test_prediction_is_symmetric_to_the_last_bit_and_agrees_with_samples() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * np.array([0.1, 0.3, 0.3, 0.05, 1.0, 1.0])[:, None]
    m, P = np.array([0.5, 0.3, 1.2, 0.02, 5.0, -3.0]), root @ root.T
    motion = VehicleMotion(StateLayout(), QUIET)
    drawn = m[:, None] + np.linalg.cholesky(P) @ rng.normal(size=(6, 400_000))
    known = replicate(m, np.zeros((6, 6)), 400_000)._replace(mean=drawn)
    samples = predict(known, motion, linearised, 0.0, 1.0).mean

    for rule, bias in ((cubature, 0.01), (unscented, 0.01), (linearised, 0.05)):
        after = predict(replicate(m, P, 1), motion, rule, 0.0, 1.0)

        np.testing.assert_array_equal(after.cov, after.cov.swapaxes(0, 1))
        np.testing.assert_allclose(after.mean[:, 0], samples.mean(axis=1), atol=bias)
        np.testing.assert_allclose(after.cov[:, :, 0], np.cov(samples), atol=0.05)


def test_an_unknown_yaw_spreads_the_position_along_a_straight_path_too() -> None:
    """Against simulated vehicles at 1 m/s whose yaw walks at random by .17 rad in a second, 30 s (p = .9)."""
    layout = StateLayout()
    walk_radps, dt_s, steps = 0.17, 0.2, 150
    motion = VehicleMotion(layout, replace(QUIET, yaw_rad=walk_radps))
    mean, cov = np.zeros(6), np.zeros((6, 6))
    mean[layout.index("v")] = 1.0
    bank = replicate(mean, cov, 1)
    for k in range(steps):
        bank = predict(bank, motion, linearised, k * dt_s, (k + 1) * dt_s)

    turns = np.random.default_rng(2).normal(0.0, walk_radps * math.sqrt(dt_s), (steps, 20_000))
    forward_m = np.sum(np.cos(np.cumsum(turns, axis=0)), axis=0) * dt_s
    want_m = math.sqrt(np.mean((forward_m - steps * dt_s) ** 2))
    along = layout.index("y")  # yaw 0 moves v north
    assert math.sqrt(bank.cov[along, along, 0]) == pytest.approx(want_m, rel=0.05)


WALK_MPS = 0.05
MEAN, SD = np.array([0.1, 1.0]), np.array([0.1, 0.3])
TIME_S = 2 * SD**2 / WALK_MPS**2  # so that the velocity is WALK_MPS over short times
DT_S = 0.2


def velocities(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Draw a stationary Ornstein-Uhlenbeck velocity, (n, 2), by its exact transition."""
    left = np.exp(-DT_S / TIME_S)
    v = np.empty((round(seconds / DT_S), 2))
    v[0] = MEAN + SD * rng.normal(size=2)
    for k in range(1, len(v)):
        v[k] = MEAN + (v[k - 1] - MEAN) * left + SD * np.sqrt(1 - left**2) * rng.normal(size=2)
    return v


def history_of(v: np.ndarray) -> VelocityHistory:
    return VelocityHistory.of(np.linspace(0.0, (len(v) - 1) * DT_S, len(v)), v)


def in_gap(history: VelocityHistory, time_s: float) -> UsualMotion:
    usual = history.in_gap(time_s, WALK_MPS)
    assert usual is not None
    return usual


def test_a_long_past_tells_mean_spread_and_time_constant() -> None:
    v = velocities(np.random.default_rng(0), 40_000)

    usual = in_gap(history_of(v), 40_010.0)

    np.testing.assert_allclose(usual.mean, MEAN, atol=0.02)
    sd = np.hypot(SD, np.sqrt(0.2) * np.array(MEAN))  # one vehicle of five lies still
    np.testing.assert_allclose(usual.sd, sd, rtol=0.1)
    np.testing.assert_allclose(usual.time_s, TIME_S * (sd / SD) ** 2, rtol=0.2)


def test_a_short_past_leaves_the_speed_wide_open() -> None:
    usual = in_gap(history_of(np.tile([0.0, 1.2], (50, 1))), 20.0)

    assert (usual.sd > 0.3).all()


def test_nothing_relaxes_while_records_come_before_the_first_or_without_a_walk() -> None:
    history = VelocityHistory()
    assert history.in_gap(0.0, WALK_MPS) is None
    history.add(5.0, MEAN)
    assert history.in_gap(4.0, WALK_MPS) is None
    assert history.in_gap(5.0 + LONGEST_GAP_S, WALK_MPS) is None
    assert history.in_gap(9.0, 0.0) is None
    assert history.in_gap(9.0, WALK_MPS) is not None


def test_only_the_past_counts() -> None:
    v = velocities(np.random.default_rng(1), 100)
    history = history_of(v)
    before = in_gap(history, 110.0)

    for time_s in (115.0, 116.0):
        history.add(time_s, np.array([3.0, -3.0]))

    np.testing.assert_array_equal(in_gap(history, 110.0), before)
    assert in_gap(history, 120.0).mean[0] > before.mean[0]


def test_a_late_record_is_put_in_its_place() -> None:
    v = velocities(np.random.default_rng(2), 20)
    late = VelocityHistory()
    for k in (*range(40), *range(50, 100), *range(40, 50)):
        late.add(k * DT_S, v[k])

    for time_s in (9.0, 12.0, 25.0):
        got, want = late.in_gap(time_s, WALK_MPS), history_of(v).in_gap(time_s, WALK_MPS)
        assert (got is None) == (want is None) == (time_s < 20)
        if got is not None and want is not None:
            np.testing.assert_allclose(np.array(got), np.array(want), rtol=1e-12)


def test_over_short_times_it_is_the_random_walk_and_over_long_ones_its_variance_stays() -> None:
    usual = UsualMotion(MEAN, SD, TIME_S)

    np.testing.assert_allclose(usual.added_variance(0.01), 0.01 * WALK_MPS**2, rtol=0.01)
    np.testing.assert_allclose(usual.added_variance(1e4), SD**2)
    np.testing.assert_allclose(usual.remaining(1e4), 0.0, atol=1e-12)
    twice = usual.remaining(7.0) ** 2 * usual.added_variance(7.0) + usual.added_variance(7.0)
    np.testing.assert_allclose(twice, usual.added_variance(14.0))  # two steps are one


def test_a_motion_through_a_gap_has_the_moments_of_an_integrated_ornstein_uhlenbeck_process() -> None:
    """Var x(t) = s^2 T^2 (2 t/T - 3 + 4 exp(-t/T) - exp(-2 t/T)) for a known velocity at the start."""
    history, gap_s = history_of(velocities(np.random.default_rng(3), 2000)), 60.0
    motion = VehicleMotion(StateLayout(), ProcessNoise(0.0, 0.0, WALK_MPS, 0.0), history=history)
    start, begins_s = np.array([0.0, 0.5, 0.2, 0.0, 0.0, 0.0]), 2010.0
    bank = replicate(start, np.zeros((6, 6)), 1)

    for k in range(round(gap_s / DT_S)):
        bank = predict(bank, motion, linearised, begins_s + k * DT_S, begins_s + (k + 1) * DT_S)

    mean, sd, T = in_gap(history, begins_s)
    a = np.exp(-gap_s / T)
    np.testing.assert_allclose(bank.mean[1:3, 0], mean + (start[1:3] - mean) * a, rtol=1e-9)
    np.testing.assert_allclose(bank.mean[4:, 0], mean * gap_s + (start[1:3] - mean) * T * (1 - a), rtol=0.01)
    np.testing.assert_allclose(bank.cov[[1, 2], [1, 2], 0], sd**2 * (1 - a**2), rtol=1e-9)
    closed = sd**2 * T**2 * (2 * gap_s / T - 3 + 4 * a - a**2)
    np.testing.assert_allclose(bank.cov[[4, 5], [4, 5], 0], closed, rtol=0.02)


def test_the_displacement_through_gaps_of_a_minute_is_as_uncertain_as_said() -> None:
    nees: list[float] = []
    for seed in range(60):
        v = velocities(np.random.default_rng(seed), 1060)
        history, first = history_of(v[:5000]), 5000
        motion = VehicleMotion(StateLayout(), ProcessNoise(0.0, 0.0, WALK_MPS, 0.0), history=history)
        bank = replicate(np.array([0.0, *v[first], 0.0, 0.0, 0.0]), np.zeros((6, 6)), 1)
        for k in range(1, 60):  # a second each
            bank = predict(bank, motion, linearised, 1003.0 + k, 1004.0 + k)
        moved = v[first : first + 295].sum(axis=0) * DT_S
        e, P = bank.mean[4:, 0] - moved, bank.cov[4:, 4:, 0]
        nees.append(float(e @ np.linalg.solve(P, e)))

    # at most 2, whose 99.9 % interval for 120 degrees of freedom is 1.2 to 2.9: the vehicle might have stopped
    assert 0.6 < np.mean(nees) < 2.8


def test_a_vehicle_that_stops_for_five_minutes_without_records_is_within_four_sigma() -> None:
    ahead = np.array([0.0, MEAN[1]])
    history = history_of(velocities(np.random.default_rng(1), 1000) - MEAN + ahead)
    motion = VehicleMotion(StateLayout(), ProcessNoise(0.0, 0.0, WALK_MPS, 0.0), history=history)
    bank = replicate(np.array([0.0, *ahead, 0.0, 0.0, 0.0]), np.zeros((6, 6)), 1)
    for k in range(300):
        bank = predict(bank, motion, linearised, 1003.0 + k, 1004.0 + k)

    nees = bank.mean[4:, 0] @ np.linalg.solve(bank.cov[4:, 4:, 0], bank.mean[4:, 0])
    assert nees < 4.0**2


@pytest.mark.parametrize("time_s", [0.0, 1.0, 2.9])
def test_with_records_the_motion_is_the_random_walk_that_it_is_without_a_history(time_s: float) -> None:
    with_history = VehicleMotion(StateLayout(), ProcessNoise(), history=VelocityHistory.of(np.zeros(1), MEAN[None]))
    without = VehicleMotion(StateLayout(), ProcessNoise())

    np.testing.assert_array_equal(with_history.noise(time_s, time_s + 1), without.noise(time_s, time_s + 1))
    assert len(list(with_history.parts(time_s, time_s + 1))) == len(list(without.parts(time_s, time_s + 1))) == 3


def turning(rng: np.random.Generator, seconds: float, sd_radps: float) -> tuple[np.ndarray, np.ndarray]:
    """Draw times and yaw of a vehicle whose turn rate is constant for TURN_S, then another."""
    t = np.arange(0, seconds, DT_S)
    rate = rng.normal(0, sd_radps, round(seconds / TURN_S) + 1)[(t // TURN_S).astype(int)]
    return t, np.cumsum(rate) * DT_S


def test_yaw_spreads_in_a_gap_as_the_vehicle_turned_before() -> None:
    """A turn rate that is drawn every TURN_S spreads yaw by sd^2 TURN_S in a second."""
    t, yaw = turning(np.random.default_rng(5), 20_000, 0.05)
    motion = VehicleMotion(StateLayout(), ProcessNoise(0.0, 0.0, 0.0, 0.1), turns=TurnHistory.of(t, yaw))
    bank = replicate(np.zeros(6), np.zeros((6, 6)), 1)
    gap_s, step_s = 300.0, 0.2

    for k in range(round(gap_s / step_s)):
        bank = predict(bank, motion, linearised, 20_002.0 + k * step_s, 20_002.0 + (k + 1) * step_s)

    # mean rates over windows that begin anywhere have two thirds of the variance
    assert bank.cov[0, 0, 0] == pytest.approx(2 / 3 * 0.05**2 * TURN_S * gap_s, rel=0.15)


def test_a_vehicle_that_circles_goes_on_circling() -> None:
    t = np.arange(0, 20_000, 0.2)
    usual = TurnHistory.of(t, (0.03 * t).astype(np.float64)).in_gap(20_010.0, 0.1)

    assert usual.mean == pytest.approx(0.03, rel=0.01)
    assert usual.sd < 0.03


@pytest.mark.parametrize("interval_s", [0.2, 1.0, 5.0])
def test_headings_one_by_one_give_the_same_history_and_slow_ones_are_no_gap(interval_s: float) -> None:
    rng = np.random.default_rng(6)
    t = np.linspace(1, 199, 199) * interval_s
    yaw = np.cumsum(rng.normal(0, 0.3, len(t)))
    at_once, one_by_one, late = TurnHistory.of(t, yaw), TurnHistory(), TurnHistory()
    for k in range(len(t)):
        one_by_one.add(t[k], (yaw[k] - yaw[0] + np.pi) % (2 * np.pi) - np.pi)  # a compass does not count turns
    for k in (*range(50), *range(60, len(t)), *range(50, 60)):
        late.add(t[k], yaw[k])

    for time_s in (t[70] + 0.9 * interval_s, t[-1] + max(2.1 * interval_s, LONGEST_TURN_GAP_S + 0.1)):
        found = [history.in_gap(time_s, 0.1) for history in (at_once, one_by_one, late)]
        if time_s < t[-1]:
            assert found == [None] * 3
            continue
        for usual in found:
            np.testing.assert_allclose(np.array(usual), np.array(found[0]), rtol=1e-9)
    assert TurnHistory().in_gap(5.0, 0.1) is None
    assert at_once.in_gap(1e5, 0.0) is None
