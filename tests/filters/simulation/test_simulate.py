"""The simulator and its truth against closed forms, a fine integration, and the filters' own motion model."""

import dataclasses
import math

import numpy as np
import pytest

from turning import TURNING, over_ground
from usbldr.filters.frames import rotation
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import Gaussian
from usbldr.filters.models.states import StateLayout
from usbldr.filters.simulation.scenario import Accuracy, AcousticHead, Leg, RandomWalkMotion, Scenario, Timing
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.simulation.true_motion import leg_motion, random_walk_track
from usbldr.io.scenarios.shipped import find_scenario, scenario_names

PAPER, DRAWN, LAWNMOWER = map(find_scenario, ("paper", "paper-drawn", "lawnmower"))


def _with(scenario: Scenario, sensor: str, **errors) -> Scenario:
    return dataclasses.replace(scenario, **{sensor: dataclasses.replace(getattr(scenario, sensor), **errors)})


def _without_noise(scenario: Scenario) -> Scenario:
    exact = _with(_with(scenario, "compass", sd_rad=0.0), "usbl", accuracy=Accuracy(0.0))
    return _with(exact, "dvl", sd_mps=0.0, scale_error=0.0)


def test_the_paper_ends_where_equation_1_leads_in_a_thousand_seconds_and_reaches_back_before_its_start() -> None:
    c, s = math.cos(math.radians(5)), math.sin(math.radians(5))

    truth = simulate(PAPER, 0).truth

    assert truth.time_s[-1] == 1000.0
    np.testing.assert_allclose(truth.position_m[0], [0, 0], atol=1e-12)
    np.testing.assert_allclose(truth.position_m[-1], [1000 * (c - s), 1000 * (s + c)], rtol=1e-13)
    np.testing.assert_allclose(leg_motion(PAPER, np.array([-2.0])).position_m, [[-2 * (c - s), -2 * (s + c)]])


@pytest.mark.parametrize("scenario", [TURNING, DRAWN], ids=lambda one: one.name)
def test_sensors_without_noise_tell_the_truth(scenario: Scenario) -> None:
    dive = simulate(_without_noise(scenario), 3)

    np.testing.assert_array_equal(dive.dvl.value, dive.truth.velocity_mps * (1 + dive.scenario.dvl.scale_error))
    np.testing.assert_array_equal(dive.compass.value[:, 0], dive.truth.yaw_rad)
    np.testing.assert_array_equal(dive.usbl.value, dive.truth.position_m[::5])
    np.testing.assert_array_equal(dive.gps.value, dive.truth.position_m[::5])


@pytest.mark.parametrize(
    ("error", "seen"),
    [
        ({"scale_error": 0.01}, [1.01, 1.01]),
        ({"misalignment_rad": 0.1}, [math.cos(0.1) + math.sin(0.1), math.cos(0.1) - math.sin(0.1)]),
    ],
)
def test_a_dvl_of_positive_scale_reads_too_fast_and_one_turned_counter_clockwise_sees_surge_as_starboard(error, seen):
    """The paper's vehicle goes 1 m/s to starboard and 1 m/s ahead."""
    value = simulate(_with(_without_noise(PAPER), "dvl", **error), 0).dvl.value

    np.testing.assert_allclose(value, np.tile(seen, (5001, 1)))


def test_what_one_sensor_draws_does_not_hang_on_the_others() -> None:
    slow = _with(PAPER, "dvl", rate_hz=1.5, noise=Gaussian())

    np.testing.assert_array_equal(simulate(slow, 0).usbl.value, simulate(PAPER, 0).usbl.value)
    np.testing.assert_array_equal(simulate(slow, 0).compass.value, simulate(PAPER, 0).compass.value)


def test_a_silence_takes_away_its_own_records_and_changes_no_other() -> None:
    silent = _with(PAPER, "dvl", timing=Timing(silences_s=((10.0, 20.0), (990.0, 2000.0))))
    silent = _with(silent, "usbl", timing=Timing(silences_s=((0.0, 5.0),)))

    dive, whole = simulate(silent, 0), simulate(PAPER, 0)

    kept = np.r_[0:50, 100:4950]  # 5 Hz: the record at 20 s is there again
    np.testing.assert_array_equal(dive.dvl.time_s, whole.dvl.time_s[kept])
    np.testing.assert_array_equal(dive.dvl.value, whole.dvl.value[kept])
    np.testing.assert_array_equal(dive.usbl.value, whole.usbl.value[5:])
    assert len(dive.truth.time_s) == 5001


def test_jitter_delays_the_stamp_with_the_vehicle_and_spread_delays_the_arrival_alone() -> None:
    timing = Timing(jitter_s=0.4, delay_s=0.5, delay_spread_s=1.5)

    fixes = simulate(_with(_without_noise(TURNING), "usbl", timing=timing), 0).usbl

    jitter_s, delay_s = fixes.time_s - np.arange(len(fixes.time_s)), fixes.received_s - fixes.time_s
    for drawn, low, high in ((jitter_s, 0.0, 0.4), (delay_s, 0.5, 2.0)):
        assert low - 1e-9 <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high + 1e-9
        np.testing.assert_allclose(drawn * 1000, np.round(drawn * 1000), atol=1e-6)  # whole milliseconds
    np.testing.assert_array_equal(fixes.value, leg_motion(TURNING, fixes.time_s).position_m)


def test_the_lawnmower_is_slow_late_interrupted_and_struck() -> None:
    dive = simulate(LAWNMOWER, 0)

    np.testing.assert_allclose(np.median(np.diff(dive.dvl.time_s)), 0.5)
    np.testing.assert_allclose(np.median(np.diff(dive.compass.time_s)), 0.1)
    assert np.diff(dive.usbl.time_s).max() == pytest.approx(151.5, abs=1.5)
    assert np.diff(dive.dvl.time_s).max() == pytest.approx(40.5)
    delay_s = dive.usbl.received_s - dive.usbl.time_s
    assert 0.5 <= delay_s.min() < delay_s.max() <= 2.0
    error_m = np.hypot(*(dive.usbl.value - leg_motion(LAWNMOWER, dive.usbl.time_s).position_m).T)
    assert 0.02 < (error_m > 5).mean() < 0.1


@pytest.mark.parametrize(
    ("sensor", "bias", "added"),
    [
        ("dvl", {"bias_mps": (0.03, -0.04)}, [0.03, -0.04]),
        ("compass", {"bias_rad": 0.02}, [0.02]),
        ("usbl", {"bias_m": (0.5, -0.25)}, [0.5, -0.25]),
        ("gps", {"bias_m": (0.5, -0.25)}, [0.5, -0.25]),
    ],
)
def test_a_positive_bias_is_in_every_record_of_its_sensor_and_in_no_other(sensor, bias, added):
    plain, biased = simulate(TURNING, 2), simulate(_with(TURNING, sensor, **bias), 2)

    for name in ("dvl", "compass", "usbl", "gps"):
        difference = getattr(biased, name).value - getattr(plain, name).value
        np.testing.assert_allclose(difference, np.broadcast_to(added if name == sensor else 0.0, difference.shape))


def test_a_levered_dvl_sees_the_derivative_of_its_own_track() -> None:
    lever = (0.7, -2.0, 0.0)
    exact = _without_noise(TURNING)
    as_antenna = simulate(_with(_with(exact, "gps", rate_hz=1000.0), "gps", lever_m=lever), 0).gps
    dive = simulate(_with(exact, "dvl", lever_m=lever), 0)

    k = np.array([50, 200, 600, 1000])  # seconds times 5, none at a corner
    slope = (as_antenna.value[200 * k + 1] - as_antenna.value[200 * k - 1]) / 0.002
    np.testing.assert_allclose(over_ground(dive.truth.yaw_rad[k], dive.dvl.value[k]), slope, atol=1e-5)


@pytest.mark.parametrize("sensor", ["usbl", "gps"])
def test_a_lever_arm_to_starboard_shows_south_of_a_vehicle_that_heads_east(sensor: str) -> None:
    east = dataclasses.replace(_without_noise(PAPER), legs=(Leg(1000.0, 0.0, 1.0),), yaw_rad=-math.pi / 2)

    seen = getattr(simulate(_with(east, sensor, lever_m=(0.5, 2.0, 3.0)), 0), sensor).value

    np.testing.assert_allclose(seen - simulate(east, 0).gps.value, np.tile([2.0, -0.5], (1001, 1)), atol=1e-9)


def test_deviation_is_a_sine_and_a_cosine_of_the_heading() -> None:
    round_about = dataclasses.replace(_without_noise(PAPER), legs=(Leg(1000.0, 0.0, 1.0, 2 * math.pi / 1000),))
    A, B = math.radians(2.0), math.radians(1.0)  # heading h reads h + A sin h + B cos h

    iron = _with(round_about, "compass", deviation_rad=(A, -B))
    seen, true = -simulate(iron, 0).compass.value[:, 0], -simulate(round_about, 0).compass.value[:, 0]

    np.testing.assert_allclose(seen - true, A * np.sin(true) + B * np.cos(true), atol=1e-12)
    assert (seen - true).max() == pytest.approx(math.hypot(A, B), rel=1e-4)


def test_a_usbl_that_reads_ranges_too_long_shows_the_vehicle_further_from_its_head() -> None:
    exact = _with(_without_noise(TURNING), "usbl", head=AcousticHead(40.0, 30.0, 0.0))

    long = simulate(_with(exact, "usbl", scale_error=0.01), 0).usbl.value - [40.0, 30.0]

    np.testing.assert_allclose(long, 1.01 * (simulate(exact, 0).gps.value - [40.0, 30.0]))


def test_a_usbl_that_is_misaligned_turns_its_fixes_counter_clockwise_about_its_head() -> None:
    east = dataclasses.replace(_without_noise(PAPER), legs=(Leg(1000.0, 0.0, 0.0),), east_m=100.0)

    turned = simulate(_with(east, "usbl", misalignment_rad=0.1), 0).usbl.value

    np.testing.assert_allclose(turned, np.tile([100 * math.cos(0.1), 100 * math.sin(0.1)], (1001, 1)))


def test_the_compass_error_of_the_boat_turns_the_fixes_of_an_inverted_usbl_about_the_beacon() -> None:
    """Boat = beacon - R(seen yaw) what was measured in the boat's frame, worked out here by hand."""
    exact = _with(_without_noise(TURNING), "usbl", head=AcousticHead(40.0, 30.0, 1.0), lever_m=(0.2, -2.5, 0.0))
    boat = _with(_with(exact, "usbl", inverted=True), "compass", bias_rad=0.05, deviation_rad=(0.02, 0.01))

    dive = simulate(boat, 0)

    true, seen = dive.truth.yaw_rad[::5], dive.compass.value[::5, 0]
    for k in range(0, 351, 25):
        at_head = dive.truth.position_m[5 * k] + rotation(true[k]) @ [0.2, -2.5]
        measured = rotation(true[k]).T @ (np.array([40.0, 30.0]) - at_head)
        np.testing.assert_allclose(dive.usbl.value[k], [40.0, 30.0] - rotation(seen[k]) @ measured, atol=1e-9)
    upright = simulate(_with(exact, "compass", bias_rad=0.05), 0)
    np.testing.assert_allclose(upright.usbl.value, simulate(exact, 0).usbl.value)


@pytest.mark.parametrize("sensor", ["dvl", "compass", "usbl", "gps"])
def test_a_clock_that_is_ahead_stamps_and_delivers_later_what_it_saw_in_time(sensor: str) -> None:
    plain = getattr(simulate(TURNING, 1), sensor)

    ahead = getattr(simulate(_with(TURNING, sensor, timing=Timing(clock_offset_s=0.35)), 1), sensor)

    np.testing.assert_allclose(ahead.time_s - plain.time_s, 0.35)
    np.testing.assert_allclose(ahead.received_s - plain.received_s, 0.35)
    np.testing.assert_array_equal(ahead.value, plain.value)


@pytest.mark.parametrize("sensor", ["dvl", "compass"])
def test_a_latency_shows_what_the_vehicle_did_earlier(sensor: str) -> None:
    exact = _without_noise(TURNING)
    late = getattr(simulate(_with(exact, sensor, timing=Timing(latency_s=0.4)), 0), sensor)

    np.testing.assert_allclose(late.value[2:], getattr(simulate(exact, 0), sensor).value[:-2], atol=1e-12)


def test_without_bottom_lock_the_dvl_sees_the_water_and_says_so() -> None:
    legs = (Leg(1000.0, 0.0, 1.2),)
    carried = dataclasses.replace(_without_noise(PAPER), legs=legs, yaw_rad=0.0, current_mps=(0.3, -0.2))

    dvl = simulate(_with(carried, "dvl", water_track_s=((100.0, 130.0),)), 0).dvl

    lost = (dvl.time_s >= 100) & (dvl.time_s < 130)
    np.testing.assert_array_equal(dvl.valid, ~lost)
    np.testing.assert_allclose(dvl.value[lost], np.tile([0.0, 1.2], (150, 1)))
    np.testing.assert_allclose(dvl.value[~lost], np.tile([0.3, 1.0], (4851, 1)))


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_repeats_itself_by_its_seed(name: str) -> None:
    first, again, other = (simulate(find_scenario(name), seed) for seed in (1, 1, 2))

    for sensor in ("dvl", "compass", "usbl", "gps"):
        for a, b in zip(getattr(first, sensor), getattr(again, sensor), strict=True):
            assert a.tobytes() == b.tobytes()
    for sensor in ("dvl", "compass", "usbl"):
        assert getattr(first, sensor).value.tobytes() != getattr(other, sensor).value.tobytes()


def test_the_closed_form_of_turns_equals_a_fine_integration() -> None:
    t = np.linspace(0, 350, 350_001)
    track = leg_motion(TURNING, t)
    V = over_ground(track.yaw_rad, track.velocity_mps)

    steps = (V[1:] + V[:-1]) / 2 * 1e-3
    jumps = np.isin(np.arange(1, len(t)), [100_000, 150_000])  # the step into a new leg still belongs to the old one
    steps[jumps] = V[:-1][jumps] * 1e-3
    summed = np.array([12.0, -7.0]) + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    np.testing.assert_allclose(track.position_m, summed, atol=3e-4)
    turned = np.cumsum(track.turn_rate_radps[:-1] * 1e-3)
    np.testing.assert_allclose(track.yaw_rad[1:], math.radians(5) + turned, atol=1e-9)


def test_a_full_circle_comes_back_and_its_width_is_twice_speed_over_turn_rate() -> None:
    circle = dataclasses.replace(PAPER, legs=(Leg(100.0, 0.0, 2.0, 2 * math.pi / 100),), yaw_rad=0.0)

    start, halfway, end = leg_motion(circle, np.array([0.0, 50.0, 100.0])).position_m

    np.testing.assert_allclose(end, start, atol=1e-12)
    # counter-clockwise from north: the circle lies to the west
    np.testing.assert_allclose(halfway - start, [-2 * 2.0 / (2 * math.pi / 100), 0], atol=1e-12)


def test_the_lawnmower_turns_at_the_lane_ends_and_goes_up_the_field() -> None:
    t = np.arange(0.0, 900.5, 0.5)
    track = leg_motion(LAWNMOWER, t)

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


def test_a_current_carries_the_vehicle_along_and_shows_in_its_velocity_over_ground_its_derivative_alone() -> None:
    carried = dataclasses.replace(TURNING, current_mps=(0.3, -0.2))
    t = np.linspace(-5, 350, 711)

    still, moved = leg_motion(TURNING, t), leg_motion(carried, t)

    np.testing.assert_allclose(moved.position_m - still.position_m, t[:, None] * [0.3, -0.2], atol=1e-12)
    np.testing.assert_array_equal(moved.water_mps, still.velocity_mps)
    np.testing.assert_array_equal(moved.yaw_rad, still.yaw_rad)
    h, inside = 1e-4, (t > 0) & np.all(np.abs(t[:, None] - [100, 150]) > 0.01, axis=1)  # no corner
    slope = (leg_motion(carried, t + h).position_m - leg_motion(carried, t - h).position_m) / (2 * h)
    np.testing.assert_allclose(over_ground(moved.yaw_rad, moved.velocity_mps)[inside], slope[inside], atol=1e-7)


def _states(scenario, seed: int) -> np.ndarray:
    """Return psi, u, v, r, x, y at the DVL's stamps, (6, K)."""
    truth = simulate(scenario, seed).truth
    return np.vstack([truth.yaw_rad, truth.velocity_mps.T, truth.turn_rate_radps, truth.position_m.T])


def test_a_drawn_dive_is_the_filters_motion_with_its_own_process_noise_and_nothing_else() -> None:
    model = VehicleMotion(StateLayout(), dataclasses.replace(DRAWN.process, uncalibrated_m=0.0))
    noises = []
    for seed in range(4):
        x = _states(DRAWN, seed)
        predicted = x[:, :-1].copy()
        for rows, increment in model.parts(0.0, 0.2):
            predicted[rows] += increment.predict(predicted)
        noises.append((x[:, 1:] - predicted) / np.sqrt(model.noise(0.0, 0.2))[:, None])
    noise = np.hstack(noises)

    count = noise.shape[1]
    np.testing.assert_allclose(noise.mean(axis=1), 0, atol=4 / math.sqrt(count))
    np.testing.assert_allclose(noise @ noise.T / count, np.eye(6), atol=4 * math.sqrt(2 / count))
    following = (noise[:, 1:] * noise[:, :-1]).mean(axis=1)
    np.testing.assert_allclose(following, 0, atol=4 / math.sqrt(count))


def test_a_drawn_dive_starts_within_the_sigmas_that_the_filters_are_told() -> None:
    short = dataclasses.replace(DRAWN, duration_s=1.0)
    starts = np.array([_states(short, seed)[:, 0] for seed in range(1000)])
    reported = DRAWN.start

    sd = [reported.sd_yaw_rad, reported.sd_mps, reported.sd_mps, reported.sd_radps, reported.sd_m, reported.sd_m]
    off = starts.mean(axis=0) - [math.radians(5), 1, 1, 0, 0, 0]
    np.testing.assert_allclose(off / sd, 0, atol=4 / math.sqrt(1000))
    np.testing.assert_allclose(starts.std(axis=0) / sd, 1, atol=4 / math.sqrt(2000))


def test_the_scale_of_a_drawn_dive_has_its_sigma_and_shows_in_its_dvl() -> None:
    short = _with(dataclasses.replace(DRAWN, duration_s=1.0), "dvl", sd_mps=0.0)
    dives = [simulate(short, seed) for seed in range(1000)]

    scale = np.array([dive.scenario.dvl.scale_error for dive in dives])
    seen = np.array([dive.dvl.value[3] / dive.truth.velocity_mps[3] for dive in dives])

    assert abs(scale.std() / 0.01 - 1) < 4 / math.sqrt(2000)
    assert abs(scale.mean()) < 4 * 0.01 / math.sqrt(1000)
    np.testing.assert_allclose(seen, 1 + scale[:, None] * np.ones(2))


def test_between_two_steps_a_drawn_vehicle_moves_as_the_step_began() -> None:
    rng = np.random.default_rng(0)
    fast = dataclasses.replace(DRAWN, legs=(Leg(1.0, 0.3, 1.0, 0.5),), duration_s=2.0)
    track = random_walk_track(fast, RandomWalkMotion(step_s=0.2), rng)

    at, later = track(np.array([0.4])), track(np.array([0.5]))

    r = at.turn_rate_radps
    moved = 0.1 * over_ground(at.yaw_rad + r * 0.05, at.velocity_mps)
    np.testing.assert_allclose(later.position_m - at.position_m, moved, atol=1e-12)
    np.testing.assert_allclose(later.yaw_rad - at.yaw_rad, r * 0.1, atol=1e-12)
