"""Simulated dives: a vehicle whose motion is known exactly, and what its sensors would have said.

Frames, units and signs are the package's. What a dive is made of stands in scenario.py, how the vehicle moves in
true_motion.py, how sensors err at random in sensor_errors.py.
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
"""Each draws from a generator of its own, spawned in this order: append, and the draws of the others stay."""

ERROR_STREAMS = ("jitter", "delay", "outliers", "dropouts", "correlated", "multipath")
"""Likewise what a sensor draws beside its noise."""


class SensorRecords(NamedTuple):
    """What one sensor said."""

    time_s: Vector  # (n,) stamps, ascending
    received_s: Vector  # (n,)
    value: Array  # (n, k): starboard, forward in m/s; yaw in rad, not wrapped; east, north in m
    valid: Flags  # (n,) False: the sensor itself says that this is not what was asked for


class SimulatedDive(NamedTuple):
    """The truth at the rate of the DVL, and the native records of each sensor."""

    truth: TrueMotion
    dvl: SensorRecords
    compass: SensorRecords
    usbl: SensorRecords
    gps: SensorRecords
    fix_cov_m2: Array  # (F, 2, 2) what the USBL states of each fix, at the slant range and bearing that it had
    scenario: Scenario  # with what was drawn of it


def simulate(scenario: Scenario, seed: int) -> SimulatedDive:
    """Draw one dive; the same scenario and seed give the same bytes."""
    seeds = dict(zip(RANDOM_STREAMS, np.random.SeedSequence(seed).spawn(len(RANDOM_STREAMS)), strict=True))
    track: TrueTrack = partial(leg_motion, scenario)
    if scenario.drawn is not None:
        rng = np.random.default_rng(seeds["dive"])
        track, scenario = random_walk_track(scenario, scenario.drawn, rng), _with_drawn_errors(scenario, rng)
    dvl, compass, usbl, gps = scenario.dvl, scenario.compass, scenario.usbl, scenario.gps

    def usbl_noise(at_s: Vector) -> tuple[Array, Array]:
        seen = _line_of_sight(usbl, track(at_s))
        variances = usbl.accuracy.variances(seen, scenario.depth_m - usbl.head.depth_m)
        return variances[:, :, None] * np.eye(2), usbl.accuracy.axes(seen)

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
    heard_s = made["usbl"].time_s - usbl.timing.clock_offset_s - usbl.timing.latency_s
    told = usbl.accuracy if usbl.told_accuracy is None else usbl.told_accuracy
    stated_m2 = told.covariance(_line_of_sight(usbl, track(heard_s)), scenario.depth_m - usbl.head.depth_m)
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
    see: Callable[[Vector], Array],
    R: Array | Callable[[Vector], tuple[Array, Array]],
    seeds: np.random.SeedSequence,
    multipath: Multipath | None = None,
) -> SensorRecords:
    """Return a sensor's records: what it sees at each time, (n, k), and all that is added to it.

    R is the nominal covariance (k, k), or tells for each time the one along axes of its own, (n, k, k), and those axes.
    What is drawn of time is rounded to milliseconds, as a stamp in integer nanoseconds can say it.
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
        value = see(at_s) + np.einsum("nij,nj->ni", axes, draw_noise(sensor.noise, cov, n, of_noise))
    else:
        value = see(at_s) + draw_noise(sensor.noise, R, n, of_noise)
    k = value.shape[1]
    if sensor.correlated is not None:
        value = value + correlated_error(sensor.correlated, t, k, of["correlated"])
    if sensor.outliers is not None:
        value = value + outlier_errors(sensor.outliers, n, k, of["outliers"])
    if multipath is not None:
        value = value + multipath_errors(multipath, t, scenario.duration_s, of["multipath"])
    heard = (t <= scenario.duration_s + 1e-9) & ~in_intervals(timing.silences_s, t)
    heard &= of["dropouts"].random(n) >= timing.dropout_share
    valid = ~in_intervals(sensor.water_track_s, at_s) if isinstance(sensor, Dvl) else np.ones(n, dtype=bool)
    t, received_s = t + timing.clock_offset_s, received_s + timing.clock_offset_s
    return SensorRecords(t[heard], received_s[heard], value[heard], valid[heard])


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
    astray_rad = np.full(len(truth.time_s), usbl.misalignment_rad)
    if usbl.inverted:
        astray_rad += compass.bias_rad + _deviation(compass, truth.yaw_rad)
    head = np.array([usbl.head.east_m, usbl.head.north_m])
    return head + (1 + usbl.scale_error) * rotated(astray_rad, _line_of_sight(usbl, truth)) + usbl.bias_m


def _line_of_sight(usbl: Usbl, truth: TrueMotion) -> Array:
    """Return where the vehicle's end of the line of sight lies from the fixed one, east and north, (n, 2)."""
    return _at(truth, usbl.lever_m) - [usbl.head.east_m, usbl.head.north_m]


def _at(truth: TrueMotion, lever_m: tuple[float, float, float]) -> Array:
    """Return the position of a point of the vehicle, (n, 2)."""
    return truth.position_m + rotated(truth.yaw_rad, np.array(lever_m[:2]))


def _stamps(scenario: Scenario, rate_hz: float) -> Vector:
    return np.arange(math.floor(scenario.duration_s * rate_hz + 1e-9) + 1) / rate_hz
