"""The truth of simulated dives: closed forms, a fine integration, and the filters' own motion model."""

import dataclasses
import math

import numpy as np

from turning import TURNING, over_ground
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.states import StateLayout
from usbldr.filters.simulation.scenario import Leg, RandomWalkMotion
from usbldr.filters.simulation.simulate import simulate
from usbldr.filters.simulation.true_motion import leg_motion, random_walk_track
from usbldr.io.scenarios.shipped import find_scenario

PAPER, DRAWN, LAWNMOWER = map(find_scenario, ("paper", "paper-drawn", "lawnmower"))


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


def test_the_motion_reaches_back_before_the_start() -> None:
    c, s = math.cos(math.radians(5)), math.sin(math.radians(5))

    np.testing.assert_allclose(leg_motion(PAPER, np.array([-2.0])).position_m, [[-2 * (c - s), -2 * (s + c)]])


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


def test_a_current_carries_the_vehicle_along_and_shows_in_its_velocity_over_ground_alone() -> None:
    carried = dataclasses.replace(TURNING, current_mps=(0.3, -0.2))
    t = np.linspace(-5, 350, 711)

    still, moved = leg_motion(TURNING, t), leg_motion(carried, t)

    np.testing.assert_allclose(moved.position_m - still.position_m, t[:, None] * [0.3, -0.2], atol=1e-12)
    np.testing.assert_array_equal(moved.water_mps, still.velocity_mps)
    np.testing.assert_array_equal(moved.yaw_rad, still.yaw_rad)


def test_velocity_over_ground_is_the_derivative_of_the_track_in_a_current_and_in_turns() -> None:
    carried = dataclasses.replace(TURNING, current_mps=(0.3, -0.2))
    t, h = np.linspace(1, 349, 800), 1e-4
    t = t[np.all(np.abs(t[:, None] - [100, 150]) > 0.01, axis=1)]

    slope = (leg_motion(carried, t + h).position_m - leg_motion(carried, t - h).position_m) / (2 * h)

    track = leg_motion(carried, t)
    np.testing.assert_allclose(over_ground(track.yaw_rad, track.velocity_mps), slope, atol=1e-7)


def test_a_vehicle_heading_north_in_an_eastward_current_sways_to_starboard() -> None:
    legs = (Leg(1000.0, 0.0, 1.2),)
    north = dataclasses.replace(PAPER, legs=legs, yaw_rad=0.0, current_mps=(0.3, 0.0), duration_s=10.0)

    np.testing.assert_allclose(leg_motion(north, np.array([7.0])).velocity_mps, [[0.3, 1.2]])


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
    short = dataclasses.replace(DRAWN, duration_s=1.0, dvl=dataclasses.replace(DRAWN.dvl, sd_mps=0.0))
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


def test_every_sensor_of_a_drawn_dive_sees_the_same_track() -> None:
    compass = dataclasses.replace(DRAWN.compass, sd_rad=0.0)
    usbl = dataclasses.replace(DRAWN.usbl, accuracy=dataclasses.replace(DRAWN.usbl.accuracy, sd_m=0.0))
    dive = simulate(dataclasses.replace(DRAWN, compass=compass, usbl=usbl), 3)

    np.testing.assert_array_equal(dive.compass.value[:, 0], dive.truth.yaw_rad)
    np.testing.assert_array_equal(dive.usbl.value, dive.truth.position_m[::5])
    np.testing.assert_array_equal(dive.gps.value, dive.truth.position_m[::5])
