"""Simulate a dive: the exact motion of a vehicle and the records of its sensors.

Frames, units and signs are the package's. scenario.py defines a dive, true_motion.py the motion,
sensor_errors.py the random errors.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import rotated, rotation
from usbldr.filters.simulation.scenario import Compass, Dvl, Multipath, Scenario, Sensor, Usbl
from usbldr.filters.simulation.sensor_errors import (
    Flags,
    correlated_error,
    draw_noise,
    in_intervals,
    multipath_errors,
    outlier_errors,
)
from usbldr.filters.simulation.true_motion import TrueMotion, TrueTrack, leg_motion, random_walk_track
from usbldr.filters.types import Array, Vector

RANDOM_STREAMS = ("dvl", "compass", "usbl", "gps", "dive")
"""Each has its own generator, spawned in this order: append new ones, so that the draws of the others do not change."""

ERROR_STREAMS = ("jitter", "delay", "outliers", "dropouts", "correlated", "multipath")
"""The same for the errors of a sensor besides its noise."""


class SensorRecords(NamedTuple):
    """The n records of one sensor, of k scalars."""

    time_s: Vector  # (n,) stamps, ascending
    received_s: Vector  # (n,)
    value: Array  # (n, k): starboard, forward in m/s; yaw in rad, not wrapped; east, north in m
    valid: Flags  # (n,) False: flagged invalid by the sensor


class SimulatedDive(NamedTuple):
    """The truth at the rate of the DVL, and the native records of each sensor."""

    truth: TrueMotion
    dvl: SensorRecords
    compass: SensorRecords
    usbl: SensorRecords
    gps: SensorRecords
    fix_cov_m2: Array  # (F, 2, 2) stated by the USBL, at the slant range and bearing of each fix
    scenario: Scenario  # with its drawn errors


def simulate(scenario: Scenario, seed: int) -> SimulatedDive:
    """Draw one dive; the same scenario and seed give the same bytes."""
    seeds = dict(zip(RANDOM_STREAMS, np.random.SeedSequence(seed).spawn(len(RANDOM_STREAMS)), strict=True))
    track: TrueTrack = partial(leg_motion, scenario)
    if scenario.drawn is not None:
        rng = np.random.default_rng(seeds["dive"])
        track, scenario = random_walk_track(scenario, scenario.drawn, rng), _with_drawn_errors(scenario, rng)
    dvl, compass, usbl, gps = scenario.dvl, scenario.compass, scenario.usbl, scenario.gps

    def usbl_noise(at_s: Vector) -> tuple[Array, Array]:
        line_m = _line_of_sight(usbl, track(at_s))
        variances = usbl.accuracy.variances(line_m, scenario.depth_m - usbl.head.depth_m)
        return variances[:, :, None] * np.eye(2), usbl.accuracy.axes(line_m)

    made = {
        "dvl": _records(scenario, dvl, lambda t: _velocities(dvl, track(t)), dvl.sd_mps**2 * np.eye(2), seeds["dvl"]),
        "compass": _records(
            scenario, compass, lambda t: _yaws(compass, track(t)), compass.sd_rad**2 * np.eye(1), seeds["compass"]
        ),
        "usbl": _records(
            scenario, usbl, lambda t: _fixes(usbl, compass, track(t)), usbl_noise, seeds["usbl"], usbl.multipath
        ),
        "gps": _records(
            scenario, gps, lambda t: _at(track(t), gps.lever_m) + gps.bias_m, gps.sd_m**2 * np.eye(2), seeds["gps"]
        ),
    }
    valid_s = made["usbl"].time_s - usbl.timing.clock_offset_s - usbl.timing.latency_s
    accuracy = usbl.accuracy if usbl.assumed_accuracy is None else usbl.assumed_accuracy
    stated_m2 = accuracy.covariance(_line_of_sight(usbl, track(valid_s)), scenario.depth_m - usbl.head.depth_m)
    return SimulatedDive(track(_stamps(scenario, dvl.rate_hz)), **made, fix_cov_m2=stated_m2, scenario=scenario)


def _with_drawn_errors(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    assert scenario.drawn is not None
    scale, angle = rng.standard_normal(2) * [scenario.drawn.dvl_scale_sd, scenario.drawn.dvl_misalignment_sd_rad]
    dvl = scenario.dvl
    return replace(
        scenario,
        dvl=replace(
            dvl, scale_error=dvl.scale_error + float(scale), misalignment_rad=dvl.misalignment_rad + float(angle)
        ),
    )


def _records(
    scenario: Scenario,
    sensor: Sensor,
    measure: Callable[[Vector], Array],
    R: Array | Callable[[Vector], tuple[Array, Array]],
    seeds: np.random.SeedSequence,
    multipath: Multipath | None = None,
) -> SensorRecords:
    """Return the records of a sensor: its error-free values at each time, (n, k), plus all its errors.

    R is the nominal covariance (k, k), or a function from times to covariances along own axes, (n, k, k), and those
    axes. Drawn times are rounded to milliseconds, which a stamp in integer nanoseconds represents exactly.
    """
    of = dict(zip(ERROR_STREAMS, map(np.random.default_rng, seeds.spawn(len(ERROR_STREAMS))), strict=True))
    timing = sensor.timing
    t = _stamps(scenario, sensor.rate_hz)
    n = len(t)
    t = t + np.round(timing.jitter_s * of["jitter"].random(n), 3)
    received_s = t + timing.delay_s + np.round(timing.delay_spread_s * of["delay"].random(n), 3)
    at_s = t - timing.latency_s
    of_noise = np.random.default_rng(seeds)
    if callable(R):
        cov, axes = R(at_s)
        value = measure(at_s) + np.einsum("nij,nj->ni", axes, draw_noise(sensor.noise, cov, n, of_noise))
    else:
        value = measure(at_s) + draw_noise(sensor.noise, R, n, of_noise)
    k = value.shape[1]
    if sensor.correlated is not None:
        value = value + correlated_error(sensor.correlated, t, k, of["correlated"])
    if sensor.outliers is not None:
        value = value + outlier_errors(sensor.outliers, n, k, of["outliers"])
    if multipath is not None:
        value = value + multipath_errors(multipath, t, scenario.duration_s, of["multipath"])
    present = (t <= scenario.duration_s + 1e-9) & ~in_intervals(timing.silences_s, t)
    present &= of["dropouts"].random(n) >= timing.dropout_share
    valid = ~in_intervals(sensor.water_track_s, at_s) if isinstance(sensor, Dvl) else np.ones(n, dtype=bool)
    t, received_s = t + timing.clock_offset_s, received_s + timing.clock_offset_s
    return SensorRecords(t[present], received_s[present], value[present], valid[present])


def _velocities(dvl: Dvl, truth: TrueMotion) -> Array:
    starboard_m, forward_m, _ = dvl.lever_m
    bottom = ~in_intervals(dvl.water_track_s, truth.time_s)[:, None]
    over = np.where(bottom, truth.velocity_mps, truth.water_mps)
    at_dvl = over + truth.turn_rate_radps[:, None] * np.array([-forward_m, starboard_m])
    return (1 + dvl.scale_error) * at_dvl @ rotation(dvl.misalignment_rad) + dvl.bias_mps


def _yaws(compass: Compass, truth: TrueMotion) -> Array:
    return (truth.yaw_rad + compass.bias_rad + _deviation(compass, truth.yaw_rad))[:, None]


def _deviation(compass: Compass, yaw_rad: Vector) -> Vector:
    b_s, b_c = compass.deviation_rad
    return b_s * np.sin(yaw_rad) + b_c * np.cos(yaw_rad)


def _fixes(usbl: Usbl, compass: Compass, truth: TrueMotion) -> Array:
    rotation_rad = np.full(len(truth.time_s), usbl.misalignment_rad)
    if usbl.inverted:
        rotation_rad += compass.bias_rad + _deviation(compass, truth.yaw_rad)
    head = np.array([usbl.head.east_m, usbl.head.north_m])
    return head + (1 + usbl.scale_error) * rotated(rotation_rad, _line_of_sight(usbl, truth)) + usbl.bias_m


def _line_of_sight(usbl: Usbl, truth: TrueMotion) -> Array:
    """Return the line of sight from the fixed end to that on the vehicle, east and north, (n, 2)."""
    return _at(truth, usbl.lever_m) - [usbl.head.east_m, usbl.head.north_m]


def _at(truth: TrueMotion, lever_m: tuple[float, float, float]) -> Array:
    """Return the position of a point of the vehicle, (n, 2)."""
    return truth.position_m + rotated(truth.yaw_rad, np.array(lever_m[:2]))


def _stamps(scenario: Scenario, rate_hz: float) -> Vector:
    return np.arange(math.floor(scenario.duration_s * rate_hz + 1e-9) + 1) / rate_hz
