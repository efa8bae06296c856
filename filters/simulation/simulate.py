"""Simulate a dive, the exact motion of a vehicle and the records of its sensors, or a survey of a transponder.

Frames, units and signs are the package's. scenario.py defines a dive, true_motion.py the motion.
Each kind of random error draws from a generator of its own, so that it does not change the draws of the others.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.frames import heading_deg, rotated, rotation
from usbldr.filters.models.noise import NoiseFamily, StudentT
from usbldr.filters.simulation.scenario import (
    Compass,
    CorrelatedError,
    Dvl,
    Intervals,
    Multipath,
    Outliers,
    Scenario,
    Sensor,
    SurveyScenario,
    Usbl,
)
from usbldr.filters.simulation.true_motion import TrueMotion, TrueTrack, leg_motion, random_walk_track
from usbldr.filters.types import Array, Vector
from usbldr.filters.usbl_survey.geometry import LATENCIES, ShipMotion, UsblSurvey, seen_from_head, ship_motion

RANDOM_STREAMS = ("dvl", "compass", "usbl", "gps", "dive")
"""Each has its own generator, spawned in this order: append new ones, so that the draws of the others do not change."""

ERROR_STREAMS = ("jitter", "delay", "outliers", "dropouts", "correlated", "multipath")
"""The same for the errors of a sensor besides its noise."""
Flags: TypeAlias = NDArray[np.bool_]  # (n,)


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


def draw_noise(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    """Return noise of ``count`` records, (count, k), for the nominal covariance R: (k, k), or (count, k, k).

    If the family is per scalar, each scalar draws its own mode, from the diagonal of R; else one for the record.
    """
    k = R.shape[-1]
    if family.per_scalar:
        axes = [slice(i, i + 1) for i in range(k)]
        return np.column_stack([_draw_records(family, R[..., axis, axis], count, rng) for axis in axes])
    return _draw_records(family, R, count, rng)


def _draw_records(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    if isinstance(family, StudentT):  # the distribution itself; its modes are for filters
        precision = rng.chisquare(family.dof, count) / family.dof
        cov = R / precision[:, None, None]
    elif R.ndim == 2:
        noise = family.modes(R)
        cov = noise.cov[rng.choice(len(noise.probabilities), size=count, p=noise.probabilities)]
    else:
        each = [family.modes(one) for one in R]
        mode = rng.choice(len(each[0].probabilities), size=count, p=each[0].probabilities)
        cov = np.stack([noise.cov[j] for noise, j in zip(each, mode, strict=True)])
    # a symmetric root by eigenvalues, because a sensor without noise has no Cholesky root
    value, vector = np.linalg.eigh(cov)
    root = vector * np.sqrt(np.clip(value, 0, None))[:, None, :]
    return np.einsum("nij,nj->ni", root, rng.standard_normal((count, R.shape[-1])))


def correlated_error(error: CorrelatedError, time_s: Vector, axes: int, rng: np.random.Generator) -> Array:
    """Return a stationary first-order Gauss-Markov process at the times, (n, axes), axes independent.

    c_k+1 = phi c_k + sd sqrt(1 - phi^2) N(0, 1), phi = exp(-dt/T): exact for any intervals.
    """
    phi = np.exp(-np.diff(time_s, prepend=time_s[:1]) / error.time_constant_s)
    drive = error.sd * rng.standard_normal((len(time_s), axes))
    drive[1:] *= np.sqrt(1 - phi[1:, None] ** 2)
    error_by_time, c = np.empty_like(drive), np.zeros(axes)
    for k, step in enumerate(drive):
        c = phi[k] * c + step
        error_by_time[k] = c
    return error_by_time


def outlier_errors(outliers: Outliers, count: int, axes: int, rng: np.random.Generator) -> Array:
    """Return what outliers add to the records, (count, axes): 0 for inliers, a random direction for outliers."""
    affected = rng.random(count) < outliers.share
    far = np.where(affected, rng.uniform(outliers.least, outliers.most, count), 0.0)
    return far[:, None] * _directions(count, axes, rng)


def multipath_errors(multipath: Multipath, time_s: Vector, duration_s: float, rng: np.random.Generator) -> Array:
    """Return what multipath adds to the fixes, (n, 2): the same vector for all in a cluster, plus scatter.

    Clusters are at the stated times and at random: a Poisson process with exponential durations.
    """
    clusters = list(multipath.clusters_s)
    begin_s = rng.exponential(multipath.every_s) if multipath.every_s else np.inf
    while begin_s < duration_s:
        clusters.append((begin_s, begin_s + rng.exponential(multipath.lasts_s)))
        begin_s += rng.exponential(multipath.every_s)
    n = len(time_s)
    affected, scatter = rng.random(n) < multipath.share, multipath.scatter_m * rng.standard_normal((n, 2))
    far_m = rng.uniform(multipath.least_m, multipath.most_m, len(clusters))
    direction = _directions(len(clusters), 2, rng)
    error_m = np.zeros((n, 2))
    for offset_m, cluster in zip(far_m[:, None] * direction, clusters, strict=True):
        here = affected & in_intervals((cluster,), time_s)
        error_m[here] = offset_m + scatter[here]
    return error_m


def in_intervals(intervals_s: Intervals, time_s: Vector) -> Flags:
    """Return whether each time, (n,), is in one of the intervals [from, to)."""
    inside = np.zeros(len(time_s), dtype=bool)
    for start_s, end_s in intervals_s:
        inside |= (time_s >= start_s) & (time_s < end_s)
    return inside


def _directions(count: int, axes: int, rng: np.random.Generator) -> Array:
    """Return unit vectors, (count, 2), in any direction of the plane, or signs, (count, 1)."""
    angle = rng.uniform(0, 2 * np.pi, count)
    both = np.column_stack([np.cos(angle), np.sin(angle)])
    return both if axes == 2 else np.where(angle < np.pi, 1.0, -1.0)[:, None]


def simulate_survey(scenario: SurveyScenario, seed: int) -> UsblSurvey:
    """Return the survey as its records hold it; time_s counts from the beginning of the course."""
    rng = np.random.default_rng(seed)
    late_s = scenario.true_values[LATENCIES]
    spare_s = 2.0 + float(np.abs(late_s).max())
    times_s = np.arange(spare_s, scenario.duration_s - spare_s, 1 / scenario.rate_hz)
    nothing = np.zeros(len(times_s))
    dense_s = np.arange(0.0, scenario.duration_s, 0.05)  # what is between is interpolated
    exact = _motion(scenario, dense_s, dense_s, np.zeros(2))
    true = UsblSurvey(times_s, nothing, np.zeros((len(times_s), 3)), nothing, exact)
    values = scenario.true_values.copy()
    values[LATENCIES] = 0.0
    seen = seen_from_head(true, values)
    range_m = np.linalg.norm(seen, axis=1)
    line = seen / range_m[:, None]
    range_m = range_m + scenario.range_sd_m * np.asarray(rng.standard_t(scenario.dof, len(line)))
    outlier = rng.random(len(line)) < scenario.outlier_share
    sd_deg = np.where(outlier, scenario.outlier_deg, scenario.angle_sd_deg)[:, None]
    line = line + np.radians(sd_deg) * np.asarray(rng.standard_t(scenario.dof, (len(line), 3)))
    line = line / np.linalg.norm(line, axis=1, keepdims=True)
    position_s = np.arange(0.0, scenario.duration_s, 1 / scenario.position_rate_hz)
    attitude_s = np.arange(0.0, scenario.duration_s, 1 / scenario.attitude_rate_hz)
    ship = _motion(scenario, position_s, attitude_s, late_s)
    recorded = ship_motion(
        position_s,
        ship.position_m + rng.normal(0, scenario.position_sd_m, ship.position_m.shape),
        attitude_s,
        ship.attitude_deg + rng.normal(0, scenario.attitude_sd_deg, ship.attitude_deg.shape),
    )
    return UsblSurvey(times_s, range_m, line, np.arctan2(line[:, 0], line[:, 1]), recorded)


def _motion(scenario: SurveyScenario, position_s: Vector, attitude_s: Vector, late_s: Vector) -> ShipMotion:
    """Return the ship's motion as exact records, (k,) and (m,), that attitude and position are late by, (2,)."""
    valid_s = attitude_s - late_s[0]
    pitch = scenario.pitch_deg * np.sin(2 * np.pi * valid_s / scenario.pitch_period_s)
    roll = scenario.roll_deg * np.sin(2 * np.pi * valid_s / scenario.roll_period_s)
    attitude = np.column_stack([heading_deg(leg_motion(scenario, valid_s).yaw_rad), pitch, roll])
    positions = leg_motion(scenario, position_s - late_s[1]).position_m
    return ship_motion(position_s, positions, attitude_s, attitude)
