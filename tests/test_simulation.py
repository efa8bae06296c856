"""The simulator against closed forms, a fine numerical integration and the moments of its noise."""

import dataclasses
import math

import numpy as np
import pytest

from usbldr.filters.errors import UsageError
from usbldr.filters.noise import Gaussian, Mixture
from usbldr.filters.simulation import PAPER, Leg, Scenario, draw, motion, scenario_named, simulate

TURNING = dataclasses.replace(
    PAPER,
    legs=(Leg(100.0, 0.2, 1.5, 0.05), Leg(50.0, -0.3, 1.0), Leg(200.0, 0.1, 0.8, -0.2)),
    duration_s=350.0,
    east_m=12.0,
    north_m=-7.0,
)


def _without_noise(scenario: Scenario) -> Scenario:
    return dataclasses.replace(
        scenario,
        dvl=dataclasses.replace(scenario.dvl, sd_mps=0.0, scale_error=0.0),
        compass=dataclasses.replace(scenario.compass, sd_rad=0.0),
        usbl=dataclasses.replace(scenario.usbl, sd_m=0.0),
    )


def test_the_paper_ends_where_equation_1_leads_in_a_thousand_seconds() -> None:
    c, s = math.cos(math.radians(5)), math.sin(math.radians(5))

    truth = simulate(PAPER, 0).truth

    assert truth.time_s[-1] == 1000.0
    np.testing.assert_allclose(truth.position_m[0], [0, 0], atol=1e-12)
    np.testing.assert_allclose(truth.position_m[-1], [1000 * (c - s), 1000 * (s + c)], rtol=1e-13)


def test_the_paper_has_its_rates() -> None:
    dive = simulate(PAPER, 0)

    assert [len(r.time_s) for r in (dive.dvl, dive.compass, dive.usbl, dive.gps)] == [5001, 5001, 1001, 1001]
    np.testing.assert_array_equal(dive.dvl.time_s[:3], [0, 0.2, 0.4])


def test_gps_is_the_truth() -> None:
    dive = simulate(PAPER, 0)

    np.testing.assert_array_equal(dive.gps.value, dive.truth.position_m[::5])


def test_the_closed_form_of_turns_equals_a_fine_integration() -> None:
    t = np.linspace(0, 350, 350_001)
    track = motion(TURNING, t)
    u, v = track.velocity_mps.T
    V = np.column_stack(
        [u * np.cos(track.yaw_rad) - v * np.sin(track.yaw_rad), u * np.sin(track.yaw_rad) + v * np.cos(track.yaw_rad)]
    )

    steps = (V[1:] + V[:-1]) / 2 * 1e-3
    jumps = np.isin(np.arange(1, len(t)), [100_000, 150_000])  # the step into a new leg still belongs to the old one
    steps[jumps] = V[:-1][jumps] * 1e-3
    summed = np.array([12.0, -7.0]) + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    np.testing.assert_allclose(track.position_m, summed, atol=3e-4)
    turned = np.cumsum(track.turn_rate_radps[:-1] * 1e-3)
    np.testing.assert_allclose(track.yaw_rad[1:], math.radians(5) + turned, atol=1e-9)


def test_a_full_circle_comes_back_and_its_width_is_twice_speed_over_turn_rate() -> None:
    circle = dataclasses.replace(PAPER, legs=(Leg(100.0, 0.0, 2.0, 2 * math.pi / 100),), yaw_rad=0.0)

    start, halfway, end = motion(circle, np.array([0.0, 50.0, 100.0])).position_m

    np.testing.assert_allclose(end, start, atol=1e-12)
    # counter-clockwise from north: the circle lies to the west
    np.testing.assert_allclose(halfway - start, [-2 * 2.0 / (2 * math.pi / 100), 0], atol=1e-12)


def test_the_motion_reaches_back_before_the_start() -> None:
    c, s = math.cos(math.radians(5)), math.sin(math.radians(5))

    np.testing.assert_allclose(motion(PAPER, np.array([-2.0])).position_m, [[-2 * (c - s), -2 * (s + c)]])


def test_sensors_without_noise_tell_the_truth() -> None:
    dive = simulate(_without_noise(TURNING), 3)

    np.testing.assert_array_equal(dive.dvl.value, dive.truth.velocity_mps)
    np.testing.assert_array_equal(dive.compass.value[:, 0], dive.truth.yaw_rad)
    np.testing.assert_array_equal(dive.usbl.value, dive.truth.position_m[::5])


def test_a_positive_scale_error_reads_too_fast() -> None:
    exact = _without_noise(PAPER)
    fast = dataclasses.replace(exact, dvl=dataclasses.replace(exact.dvl, scale_error=0.01))

    np.testing.assert_allclose(simulate(fast, 0).dvl.value, 1.01)


def test_a_dvl_turned_counter_clockwise_sees_surge_as_starboard_velocity() -> None:
    exact = dataclasses.replace(_without_noise(PAPER), legs=(Leg(1000.0, 0.0, 1.0),))
    turned = dataclasses.replace(exact, dvl=dataclasses.replace(exact.dvl, misalignment_rad=0.1))

    np.testing.assert_allclose(simulate(turned, 0).dvl.value[0], [math.sin(0.1), math.cos(0.1)])


def test_a_compass_bias_adds_to_the_yaw() -> None:
    exact = _without_noise(PAPER)
    biased = dataclasses.replace(exact, compass=dataclasses.replace(exact.compass, bias_rad=0.02))

    np.testing.assert_allclose(simulate(biased, 0).compass.value, math.radians(5) + 0.02)


def test_a_late_stamp_shows_where_the_vehicle_was_earlier_and_a_delay_only_moves_the_arrival() -> None:
    exact = _without_noise(TURNING)
    late = dataclasses.replace(exact, usbl=dataclasses.replace(exact.usbl, latency_s=1.0, delay_s=2.5))

    fixes = simulate(late, 0).usbl

    np.testing.assert_allclose(fixes.value[1:], simulate(exact, 0).usbl.value[:-1], atol=1e-12)
    np.testing.assert_allclose(fixes.received_s - fixes.time_s, 2.5)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not() -> None:
    first, again, other = simulate(PAPER, 7), simulate(PAPER, 7), simulate(PAPER, 8)

    for sensor in ("dvl", "compass", "usbl"):
        assert getattr(first, sensor).value.tobytes() == getattr(again, sensor).value.tobytes()
        assert not np.any(getattr(first, sensor).value == getattr(other, sensor).value)


def test_what_one_sensor_draws_does_not_hang_on_the_others() -> None:
    slow = dataclasses.replace(PAPER, dvl=dataclasses.replace(PAPER.dvl, rate_hz=1.5, noise=Gaussian()))

    np.testing.assert_array_equal(simulate(slow, 0).usbl.value, simulate(PAPER, 0).usbl.value)
    np.testing.assert_array_equal(simulate(slow, 0).compass.value, simulate(PAPER, 0).compass.value)


def test_the_noise_of_equation_23_has_its_variance_and_its_tails() -> None:
    R = np.diag([4.0, 0.25])

    e = draw(Mixture(), R, 200_000, np.random.default_rng(0)) / np.sqrt(np.diag(R))

    # 0.7 * 1 + 0.3 * 10; beyond 3 sigma: 0.7 * 0.0027 + 0.3 * P(|N| > 3 / sqrt 10); standard errors .017 and .0007
    np.testing.assert_allclose((e**2).mean(axis=0), 3.7, atol=0.08)
    np.testing.assert_allclose((np.abs(e) > 3).mean(axis=0), 0.7 * 0.0027 + 0.3 * 0.34278, atol=0.003)


@pytest.mark.parametrize(("per_scalar", "expected"), [(True, 0.0), (False, 0.21 * 81)])
def test_scalars_share_their_mode_only_where_the_record_draws_it(per_scalar: bool, expected: float) -> None:
    e = draw(Mixture(per_scalar=per_scalar), np.eye(2), 200_000, np.random.default_rng(1))

    # two scalars of one mode: cov(e1^2, e2^2) = variance of the mode's own variance = 0.7 * 0.3 * (10 - 1)^2
    assert np.cov((e**2).T)[0, 1] == pytest.approx(expected, abs=1.0)


def test_noise_of_a_record_keeps_its_covariance_between_axes() -> None:
    R = np.array([[4.0, 1.5], [1.5, 1.0]])

    e = draw(Gaussian(per_scalar=False), R, 200_000, np.random.default_rng(2))

    np.testing.assert_allclose(np.cov(e.T), R, atol=0.05)


def test_an_unknown_scenario_is_answered_with_the_names() -> None:
    with pytest.raises(UsageError, match=r"no scenario 'lake' \(scenarios: paper\)"):
        scenario_named("lake")
