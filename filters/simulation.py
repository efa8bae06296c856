"""Simulated dives: a vehicle whose motion is known exactly, and what its sensors would have said.

Frames, units and signs are the package's. The dives themselves stand in scenarios.py.
"""

import math
from typing import NamedTuple

import numpy as np

from usbldr.filters.noise import NoiseFamily
from usbldr.filters.scenarios import Leg, Outliers, Scenario, Silences, Usbl
from usbldr.filters.types import Array, Vector

SENSORS = ("dvl", "compass", "usbl", "gps")
"""Each draws from a generator of its own, spawned in this order: append, and the draws of the others stay."""


class Motion(NamedTuple):
    """The vehicle at n instants."""

    time_s: Vector  # (n,)
    position_m: Array  # (n, 2) east, north
    yaw_rad: Vector  # (n,) not wrapped
    velocity_mps: Array  # (n, 2) starboard, forward
    turn_rate_radps: Vector  # (n,)


class Records(NamedTuple):
    """What one sensor said."""

    time_s: Vector  # (n,) stamps, ascending
    received_s: Vector  # (n,)
    value: Array  # (n, k): starboard, forward in m/s; yaw in rad, not wrapped; east, north in m


class Simulated(NamedTuple):
    """The truth at the rate of the DVL, and the native records of each sensor."""

    truth: Motion
    dvl: Records
    compass: Records
    usbl: Records
    gps: Records


def simulate(scenario: Scenario, seed: int) -> Simulated:
    """Draw one dive; the same scenario and seed give the same bytes."""
    chance = dict(zip(SENSORS, np.random.SeedSequence(seed).spawn(len(SENSORS)), strict=True))
    dvl, compass, usbl, gps = scenario.dvl, scenario.compass, scenario.usbl, scenario.gps

    t = _stamps(scenario, dvl.rate_hz)
    truth = motion(scenario, t)
    seen_mps = (1 + dvl.scale_error) * truth.velocity_mps @ rotation(dvl.misalignment_rad)
    seen_mps = seen_mps + draw(dvl.noise, dvl.sd_mps**2 * np.eye(2), len(t), np.random.default_rng(chance["dvl"]))

    t_c = _stamps(scenario, compass.rate_hz)
    seen_rad = motion(scenario, t_c).yaw_rad[:, None] + compass.bias_rad
    noise_rad = draw(compass.noise, np.array([[compass.sd_rad**2]]), len(t_c), np.random.default_rng(chance["compass"]))

    t_g = _stamps(scenario, gps.rate_hz)
    gps_m = motion(scenario, t_g).position_m
    gps_m = gps_m + draw(gps.noise, gps.sd_m**2 * np.eye(2), len(t_g), np.random.default_rng(chance["gps"]))
    return Simulated(
        truth,
        _but(dvl.silences_s, Records(t, t, seen_mps)),
        _but(compass.silences_s, Records(t_c, t_c, seen_rad + noise_rad)),
        _but(usbl.silences_s, _fixes(scenario, usbl, chance["usbl"])),
        Records(t_g, t_g, gps_m),
    )


def _fixes(scenario: Scenario, usbl: Usbl, chance: np.random.SeedSequence) -> Records:
    """Return the USBL's records. Noise, jitter, delay and outliers draw apart, so that each leaves the others alone.

    What is drawn of time is rounded to milliseconds, as a stamp in integer nanoseconds can say it.
    """
    of_jitter, of_delay, of_outliers = map(np.random.default_rng, chance.spawn(3))
    t = _stamps(scenario, usbl.rate_hz)
    n = len(t)
    noise_m = draw(usbl.noise, usbl.sd_m**2 * np.eye(2), n, np.random.default_rng(chance))
    t = t + np.round(usbl.jitter_s * of_jitter.random(n), 3)
    received_s = t + usbl.delay_s + np.round(usbl.delay_spread_s * of_delay.random(n), 3)
    seen_m = motion(scenario, t - usbl.latency_s).position_m + noise_m
    if usbl.outliers is not None:
        seen_m = seen_m + _gross_errors(usbl.outliers, n, of_outliers)
    inside = t <= scenario.duration_s
    return Records(t[inside], received_s[inside], seen_m[inside])


def _gross_errors(outliers: Outliers, count: int, rng: np.random.Generator) -> Array:
    """Return what outliers add to the positions, (count, 2): nothing to most."""
    struck = rng.random(count) < outliers.share
    far_m = np.where(struck, rng.uniform(outliers.least_m, outliers.most_m, count), 0.0)
    direction = rng.uniform(0, 2 * np.pi, count)
    return far_m[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])


def _but(silences_s: Silences, records: Records) -> Records:
    """Leave out the records stamped in a silence."""
    t = records.time_s
    heard = np.ones(len(t), dtype=bool)
    for start_s, end_s in silences_s:
        heard &= (t < start_s) | (t >= end_s)
    return Records(*(column[heard] for column in records))


def motion(scenario: Scenario, time_s: Vector) -> Motion:
    """Return the truth at any instants, (n,), from the closed form of each leg, not by summing steps.

    Over t seconds at a constant turn rate r the chord is R(psi + r t/2) (u, v) t sinc(r t/2), with sinc(a) = sin a / a.
    """
    begins_s, yaw_rad, corner_m = [0.0], [scenario.yaw_rad], [np.array([scenario.east_m, scenario.north_m])]
    for leg in scenario.legs[:-1]:
        corner_m.append(corner_m[-1] + _chord(leg, yaw_rad[-1], np.array([leg.duration_s]))[0])
        yaw_rad.append(yaw_rad[-1] + leg.turn_rate_radps * leg.duration_s)
        begins_s.append(begins_s[-1] + leg.duration_s)

    n = len(time_s)
    found = Motion(np.array(time_s, dtype=float), np.empty((n, 2)), np.empty(n), np.empty((n, 2)), np.empty(n))
    of_leg = np.clip(np.searchsorted(begins_s, found.time_s, side="right") - 1, 0, None)
    for i, leg in enumerate(scenario.legs):
        here = of_leg == i
        t = found.time_s[here] - begins_s[i]
        found.position_m[here] = corner_m[i] + _chord(leg, yaw_rad[i], t)
        found.yaw_rad[here] = yaw_rad[i] + leg.turn_rate_radps * t
        found.velocity_mps[here] = (leg.starboard_mps, leg.forward_mps)
        found.turn_rate_radps[here] = leg.turn_rate_radps
    return found


def rotation(angle_rad: float) -> Array:
    """Return the (2, 2) matrix that turns a vector counter-clockwise: R(psi) (u, v) = (V_E, V_N)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def draw(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    """Return noise of ``count`` records, (count, k), for the nominal covariance R (k, k).

    Each scalar draws its own mode, from the diagonal of R, where the family says so; else a record draws one for all.
    """
    k = len(R)
    if family.per_scalar:
        return np.column_stack([_draw_records(family, R[i : i + 1, i : i + 1], count, rng) for i in range(k)])
    return _draw_records(family, R, count, rng)


def _draw_records(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    noise = family.modes(R)
    mode = rng.choice(len(noise.shares), size=count, p=noise.shares)
    # a symmetric root by eigenvalues, because a sensor without noise has no Cholesky root
    value, vector = np.linalg.eigh(noise.cov)
    root = vector * np.sqrt(np.clip(value, 0, None))[:, None, :]
    return np.einsum("nij,nj->ni", root[mode], rng.standard_normal((count, len(R))))


def _chord(leg: Leg, yaw_rad: float, t: Vector) -> Array:
    half_turn = leg.turn_rate_radps * t / 2
    length = t * np.sinc(half_turn / np.pi)
    c, s = np.cos(yaw_rad + half_turn), np.sin(yaw_rad + half_turn)
    u, v = leg.starboard_mps, leg.forward_mps
    return length[:, None] * np.column_stack([u * c - v * s, u * s + v * c])


def _stamps(scenario: Scenario, rate_hz: float) -> Vector:
    return np.arange(math.floor(scenario.duration_s * rate_hz + 1e-9) + 1) / rate_hz
