"""A simulated survey: a ship moves around a transponder that lies still, and its USBL has known errors."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import heading_deg
from usbldr.filters.simulation.scenario import Leg
from usbldr.filters.simulation.true_motion import leg_motion
from usbldr.filters.types import Vector
from usbldr.filters.usbl_survey.geometry import NAMES, ShipMotion, UsblSurvey, seen_from_head, ship_motion


class Swing(NamedTuple):
    """A sinusoidal roll or pitch."""

    amplitude_deg: float
    period_s: float

    def at(self, time_s: Vector) -> Vector:
        """Return the angle at the times, degrees (n,)."""
        return self.amplitude_deg * np.sin(2 * np.pi * time_s / self.period_s)


class RecordNoise(NamedTuple):
    """Rate and 1-sigma of a sensor's records."""

    rate_hz: float
    sd: float


@dataclass(frozen=True, slots=True)
class SurveyScenario:
    """What a simulated survey is made of; the course is that of the antenna."""

    name: str
    about: str
    duration_s: float
    legs: tuple[Leg, ...]
    yaw_rad: float
    east_m: float
    north_m: float
    current_mps: tuple[float, float]
    roll: Swing
    pitch: Swing
    position: RecordNoise  # metres
    attitude: RecordNoise  # degrees
    true_values: Vector  # (11,) by geometry.NAMES
    fix_rate_hz: float
    range_sd_m: float
    angle_sd_deg: float
    dof: float  # of the Student-t errors of ranges and angles
    outlier_share: float
    outlier_deg: float  # 1-sigma of the direction of an outlier


def simulate_survey(scenario: SurveyScenario, seed: int) -> UsblSurvey:
    """Return the survey as its records hold it; time_s counts from the beginning of the course."""
    rng = np.random.default_rng(seed)
    spare_s = 2.0 + float(np.abs(scenario.true_values[6:8]).max())
    times_s = np.arange(spare_s, scenario.duration_s - spare_s, 1 / scenario.fix_rate_hz)
    nothing = np.zeros(len(times_s))
    true = UsblSurvey(times_s, nothing, np.zeros((len(times_s), 3)), nothing, _motion(scenario, 0.0, 0.0))
    values = scenario.true_values.copy()
    values[NAMES.index("attitude_latency_s")] = values[NAMES.index("position_latency_s")] = 0.0
    seen = seen_from_head(true, values)
    range_m = np.linalg.norm(seen, axis=1)
    line = seen / range_m[:, None]
    range_m = range_m + scenario.range_sd_m * np.asarray(rng.standard_t(scenario.dof, len(line)))
    outlier = rng.random(len(line)) < scenario.outlier_share
    sd_deg = np.where(outlier, scenario.outlier_deg, scenario.angle_sd_deg)[:, None]
    line = line + np.radians(sd_deg) * np.asarray(rng.standard_t(scenario.dof, (len(line), 3)))
    line = line / np.linalg.norm(line, axis=1, keepdims=True)
    latencies = scenario.true_values[[NAMES.index("attitude_latency_s"), NAMES.index("position_latency_s")]]
    ship = _motion(scenario, *latencies)
    recorded = ship_motion(
        ship.position_time_s,
        ship.position_m + rng.normal(0, scenario.position.sd, ship.position_m.shape),
        ship.attitude_time_s,
        ship.attitude_deg + rng.normal(0, scenario.attitude.sd, ship.attitude_deg.shape),
    )
    return UsblSurvey(times_s, range_m, line, np.arctan2(line[:, 0], line[:, 1]), recorded)


def _motion(scenario: SurveyScenario, attitude_latency_s: float, position_latency_s: float) -> ShipMotion:
    """Return the ship's motion as records that are late and otherwise exact, dense enough to be interpolated."""
    exact = attitude_latency_s == position_latency_s == 0
    position_s, attitude_s = (
        np.arange(0.0, scenario.duration_s, 0.05 if exact else 1 / rate_hz)
        for rate_hz in (scenario.position.rate_hz, scenario.attitude.rate_hz)
    )
    valid_s = attitude_s - attitude_latency_s
    heading = heading_deg(leg_motion(scenario, valid_s).yaw_rad)
    attitude = np.column_stack([heading, scenario.pitch.at(valid_s), scenario.roll.at(valid_s)])
    positions = leg_motion(scenario, position_s - position_latency_s).position_m
    return ship_motion(position_s, positions, attitude_s, attitude)
