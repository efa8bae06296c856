"""The true motion of a simulated vehicle: legs in closed form, or a random walk from the filters' motion model.

Frames, units and signs are the package's. A current carries the vehicle along: its legs are velocities through the
water, its track and its velocity are over ground.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.simulation.scenario import Leg, RandomWalkMotion, Scenario, SurveyScenario
from usbldr.filters.types import Array, Vector


class TrueMotion(NamedTuple):
    """The vehicle at n instants."""

    time_s: Vector  # (n,)
    position_m: Array  # (n, 2) east, north
    yaw_rad: Vector  # (n,) not wrapped
    velocity_mps: Array  # (n, 2) starboard, forward, over ground
    turn_rate_radps: Vector  # (n,)
    water_mps: Array  # (n, 2) starboard, forward, through the water


TrueTrack: TypeAlias = Callable[[Vector], TrueMotion]
"""From instants, (n,), to the truth there."""


def leg_motion(scenario: Scenario | SurveyScenario, time_s: Vector) -> TrueMotion:
    """Return the truth at any instants, (n,), from the closed form of each leg, not by summing steps.

    Over t seconds at a constant turn rate r the chord is R(psi + r t/2) (u, v) t sinc(r t/2), with sinc(a) = sin a / a.
    """
    begins_s, yaw_rad, corner_m = [0.0], [scenario.yaw_rad], [np.array([scenario.east_m, scenario.north_m])]
    for leg in scenario.legs[:-1]:
        corner_m.append(corner_m[-1] + _chord(leg, yaw_rad[-1], np.array([leg.duration_s]))[0])
        yaw_rad.append(yaw_rad[-1] + leg.turn_rate_radps * leg.duration_s)
        begins_s.append(begins_s[-1] + leg.duration_s)

    n = len(time_s)
    t = np.array(time_s, dtype=float)
    position_m, yaw, through, rate = np.empty((n, 2)), np.empty(n), np.empty((n, 2)), np.empty(n)
    of_leg = np.clip(np.searchsorted(begins_s, t, side="right") - 1, 0, None)
    for i, leg in enumerate(scenario.legs):
        here = of_leg == i
        since_s = t[here] - begins_s[i]
        position_m[here] = corner_m[i] + _chord(leg, yaw_rad[i], since_s)
        yaw[here] = yaw_rad[i] + leg.turn_rate_radps * since_s
        through[here] = (leg.starboard_mps, leg.forward_mps)
        rate[here] = leg.turn_rate_radps
    current = np.array(scenario.current_mps)
    return TrueMotion(t, position_m + t[:, None] * current, yaw, through + rotated(-yaw, current), rate, through)


def random_walk_track(scenario: Scenario, drawn: RandomWalkMotion, rng: np.random.Generator) -> TrueTrack:
    """Draw the start about the first leg's motion, then a random walk by the filters' motion model.

    Each step is half the turn, the displacement, half the turn, then the process noise, as in motion.py; between two
    steps velocity and turn rate are constant. The sigmas are those that the filters assume.
    """
    assert scenario.start is not None, "a drawn dive has a start to be drawn about"
    start, process, leg, T = scenario.start, scenario.process, scenario.legs[0], drawn.step_s
    steps = math.ceil(scenario.duration_s / T)
    noise = rng.standard_normal((steps + 1, 6))
    noise[0] *= [start.sd_yaw_rad, start.sd_mps, start.sd_mps, start.sd_radps, start.sd_m, start.sd_m]
    walk = [process.yaw_rad, process.velocity_mps, process.velocity_mps, process.turn_rate_radps]
    noise[1:] *= np.array([*walk, process.position_m, process.position_m]) * math.sqrt(T)
    of_leg = leg.starboard_mps, leg.forward_mps, leg.turn_rate_radps
    noise[0] += [scenario.yaw_rad, *of_leg, scenario.east_m, scenario.north_m]
    rate = np.cumsum(noise[:, 3])
    velocity = np.cumsum(noise[:, 1:3], axis=0)
    yaw = np.cumsum(noise[:, 0] + T * np.r_[0.0, rate[:-1]])
    moves = T * rotated(yaw[:-1] + rate[:-1] * T / 2, velocity[:-1])
    position = np.cumsum(noise[:, 4:6] + np.vstack([np.zeros((1, 2)), moves]), axis=0)

    def at(time_s: Vector) -> TrueMotion:
        t = np.array(time_s, dtype=float)
        k = np.clip(np.floor(t / T + 1e-9).astype(int), 0, steps)
        h = t - k * T
        moved = h[:, None] * rotated(yaw[k] + rate[k] * h / 2, velocity[k])
        return TrueMotion(t, position[k] + moved, yaw[k] + rate[k] * h, velocity[k], rate[k], velocity[k])

    return at


def _chord(leg: Leg, yaw_rad: float, t: Vector) -> Array:
    half_turn = leg.turn_rate_radps * t / 2
    length = t * np.sinc(half_turn / np.pi)
    return length[:, None] * rotated(yaw_rad + half_turn, np.array([leg.starboard_mps, leg.forward_mps]))
