"""The simulator against closed forms, a fine numerical integration and the moments of its noise."""

import dataclasses
import math

import numpy as np
import pytest

from usbldr.filters.dives import motion
from usbldr.filters.noise import Gaussian
from usbldr.filters.scenarios import Accuracy, Leg, Outliers, Scenario, Timing
from usbldr.filters.simulation import simulate
from usbldr.io.scenario_library import find_scenario

PAPER, LAWNMOWER = find_scenario("paper"), find_scenario("lawnmower")

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
        usbl=dataclasses.replace(scenario.usbl, accuracy=Accuracy(0.0)),
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
    late = dataclasses.replace(exact, usbl=dataclasses.replace(exact.usbl, timing=Timing(latency_s=1.0, delay_s=2.5)))

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


def test_a_silence_takes_away_its_own_records_and_changes_no_other() -> None:
    silent = dataclasses.replace(
        PAPER,
        dvl=dataclasses.replace(PAPER.dvl, timing=Timing(silences_s=((10.0, 20.0), (990.0, 2000.0)))),
        usbl=dataclasses.replace(PAPER.usbl, timing=Timing(silences_s=((0.0, 5.0),))),
    )

    dive, whole = simulate(silent, 0), simulate(PAPER, 0)

    kept = np.r_[0:50, 100:4950]  # 5 Hz: the record at 20 s is heard again
    np.testing.assert_array_equal(dive.dvl.time_s, whole.dvl.time_s[kept])
    np.testing.assert_array_equal(dive.dvl.value, whole.dvl.value[kept])
    np.testing.assert_array_equal(dive.usbl.value, whole.usbl.value[5:])
    assert len(dive.truth.time_s) == 5001


def test_jitter_delays_the_stamp_with_the_vehicle_and_spread_delays_the_arrival_alone() -> None:
    exact = _without_noise(TURNING)
    late = dataclasses.replace(
        exact, usbl=dataclasses.replace(exact.usbl, timing=Timing(jitter_s=0.4, delay_s=0.5, delay_spread_s=1.5))
    )

    fixes = simulate(late, 0).usbl

    jitter_s, delay_s = fixes.time_s - np.arange(len(fixes.time_s)), fixes.received_s - fixes.time_s
    for drawn, low, high in ((jitter_s, 0.0, 0.4), (delay_s, 0.5, 2.0)):
        assert low - 1e-9 <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high + 1e-9
        np.testing.assert_allclose(drawn * 1000, np.round(drawn * 1000), atol=1e-6)  # whole milliseconds
    np.testing.assert_array_equal(fixes.value, motion(TURNING, fixes.time_s).position_m)


def test_noise_outliers_jitter_and_delay_leave_each_other_alone() -> None:
    still = dataclasses.replace(PAPER, legs=(Leg(1000.0, 0.0, 0.0),))  # jitter moves the vehicle nowhere
    all_at_once = dataclasses.replace(
        still,
        usbl=dataclasses.replace(
            PAPER.usbl,
            timing=Timing(jitter_s=0.3, delay_s=0.5, delay_spread_s=1.0),
            outliers=Outliers(0.1, 500.0, 600.0),
        ),
    )

    plain, rich = simulate(still, 4).usbl.value, simulate(all_at_once, 4).usbl.value[:1000]

    spared = np.hypot(*(rich - plain[: len(rich)]).T) < 400
    assert 0.85 < spared.mean() < 0.95
    np.testing.assert_array_equal(rich[spared], plain[: len(rich)][spared])


def test_the_lawnmower_turns_at_the_lane_ends_and_goes_up_the_field() -> None:
    t = np.arange(0.0, 900.5, 0.5)
    track = motion(LAWNMOWER, t)

    heading = np.degrees(-track.yaw_rad) % 360
    for lane in range(6):
        on_it = (t >= 155 * lane) & (t < 155 * lane + 125)
        np.testing.assert_allclose(heading[on_it], 280 if lane % 2 == 0 else 100)
    turning = track.turn_rate_radps != 0
    assert turning.sum() == 5 * 60
    np.testing.assert_allclose(np.abs(np.degrees(track.turn_rate_radps[turning])), 6)
    # lanes lie one turning circle apart: speed over turn rate is the radius
    across = np.array([math.sin(math.radians(10)), math.cos(math.radians(10))])  # to the right of heading 280
    steps = np.diff([(track.position_m[np.searchsorted(t, 155 * lane + 60)] @ across) for lane in range(6)])
    np.testing.assert_allclose(steps, 2 * 0.9 / math.radians(6), atol=1.5)


def test_the_lawnmower_is_slow_late_interrupted_and_struck() -> None:
    dive = simulate(LAWNMOWER, 0)

    np.testing.assert_allclose(np.median(np.diff(dive.dvl.time_s)), 0.5)
    np.testing.assert_allclose(np.median(np.diff(dive.compass.time_s)), 0.1)
    assert np.diff(dive.usbl.time_s).max() == pytest.approx(151.5, abs=1.5)
    assert np.diff(dive.dvl.time_s).max() == pytest.approx(40.5)
    delay_s = dive.usbl.received_s - dive.usbl.time_s
    assert 0.5 <= delay_s.min() < delay_s.max() <= 2.0
    error_m = np.hypot(*(dive.usbl.value - motion(LAWNMOWER, dive.usbl.time_s).position_m).T)
    assert 0.02 < (error_m > 5).mean() < 0.1
