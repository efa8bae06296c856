"""The motion model against closed forms and an integration."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usbldr.filters.estimators.gaussian_bank import predict, replicate
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.parameters import ProcessNoise
from usbldr.filters.models.sigma_points import cubature, linearised, unscented
from usbldr.filters.models.states import StateLayout

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
