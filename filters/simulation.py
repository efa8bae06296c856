"""Simulated dives: a vehicle whose motion is known exactly, and what its sensors would have said.

The scenario ``paper`` is section 3.1 of Dou et al., "A USBL/DR underwater integrated positioning method based on the
cubature particle filter". Frames, units and signs are the package's; a sensor's scale, bias, misalignment and latency
are its errors: positive means that the sensor reads too much (too far counter-clockwise, too late).
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from usbldr.filters.assumptions import ProcessNoise, Start
from usbldr.filters.errors import UsageError
from usbldr.filters.noise import Gaussian, Mixture, NoiseFamily
from usbldr.filters.types import Array, Vector

SENSORS = ("dvl", "compass", "usbl", "gps")
"""Each draws from a generator of its own, spawned in this order: append, and the draws of the others stay."""


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch of constant body velocity and constant turn rate (counter-clockwise)."""

    duration_s: float
    starboard_mps: float
    forward_mps: float
    turn_rate_radps: float = 0.0


@dataclass(frozen=True, slots=True)
class Dvl:
    """(z_u, z_v) = (1 + s)(u cos d + v sin d, -u sin d + v cos d) + noise."""

    rate_hz: float
    sd_mps: float
    noise: NoiseFamily = Gaussian()
    scale_error: float = 0.0  # s
    misalignment_rad: float = 0.0  # d: angle of the DVL's axes in the body


@dataclass(frozen=True, slots=True)
class Compass:
    """z_psi = psi + b0 + noise."""

    rate_hz: float
    sd_rad: float
    noise: NoiseFamily = Gaussian()
    bias_rad: float = 0.0  # b0


@dataclass(frozen=True, slots=True)
class Usbl:
    """A fix stamped t_v tells where the vehicle was at t_v - latency; the vehicle hears of it after the delay."""

    rate_hz: float
    sd_m: float
    noise: NoiseFamily = Gaussian()
    latency_s: float = 0.0
    delay_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Gps:
    """The truth of the log: the position itself, with noise only where a scenario asks for it."""

    rate_hz: float
    sd_m: float = 0.0
    noise: NoiseFamily = Gaussian()


@dataclass(frozen=True, slots=True)
class Scenario:
    """A dive: how the vehicle moves, how its sensors err, and what a filter is told beforehand."""

    name: str
    about: str
    duration_s: float
    legs: tuple[Leg, ...]  # the first also reaches back before time 0, the last goes on
    dvl: Dvl
    compass: Compass
    usbl: Usbl
    gps: Gps
    yaw_rad: float = 0.0
    east_m: float = 0.0
    north_m: float = 0.0
    process: ProcessNoise = field(default_factory=ProcessNoise)  # told to the filter; the truth has none
    start: Start | None = None  # told to the filter


PAPER = Scenario(
    name="paper",
    about="section 3.1 of the paper: 1000 s straight on at 5 deg yaw, noise of eq. (23), DVL reads 1 % too much",
    duration_s=1000.0,
    legs=(Leg(1000.0, starboard_mps=1.0, forward_mps=1.0),),
    dvl=Dvl(rate_hz=5.0, sd_mps=0.02, noise=Mixture(), scale_error=0.01),
    compass=Compass(rate_hz=5.0, sd_rad=math.radians(0.1), noise=Mixture()),
    usbl=Usbl(rate_hz=1.0, sd_m=1.0, noise=Mixture()),
    gps=Gps(rate_hz=1.0),
    yaw_rad=math.radians(5.0),
    process=ProcessNoise(position_m=0.067, yaw_rad=2.2e-4, velocity_mps=2.2e-3, turn_rate_radps=2.2e-5),
    start=Start(0.0, 0.0, 0.01, sd_yaw_rad=math.radians(0.5), sd_mps=0.1, sd_radps=math.radians(0.01)),
)

SCENARIOS = {scenario.name: scenario for scenario in (PAPER,)}


def scenario_named(name: str) -> Scenario:
    """Return a scenario of SCENARIOS; raises UsageError that lists the names."""
    if name not in SCENARIOS:
        raise UsageError(f"there is no scenario {name!r} (scenarios: {', '.join(SCENARIOS)})")
    return SCENARIOS[name]


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

    t_v = _stamps(scenario, usbl.rate_hz)
    seen_m = motion(scenario, t_v - usbl.latency_s).position_m
    noise_m = draw(usbl.noise, usbl.sd_m**2 * np.eye(2), len(t_v), np.random.default_rng(chance["usbl"]))

    t_g = _stamps(scenario, gps.rate_hz)
    gps_m = motion(scenario, t_g).position_m
    gps_m = gps_m + draw(gps.noise, gps.sd_m**2 * np.eye(2), len(t_g), np.random.default_rng(chance["gps"]))
    return Simulated(
        truth,
        Records(t, t, seen_mps),
        Records(t_c, t_c, seen_rad + noise_rad),
        Records(t_v, t_v + usbl.delay_s, seen_m + noise_m),
        Records(t_g, t_g, gps_m),
    )


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
