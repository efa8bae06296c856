"""A simulated survey: a ship moves around a transponder that lies still, and its USBL has known errors."""

from dataclasses import dataclass

import numpy as np

from usbldr.filters.frames import heading_deg
from usbldr.filters.simulation.scenario import Leg
from usbldr.filters.simulation.true_motion import leg_motion
from usbldr.filters.types import Vector
from usbldr.filters.usbl_survey.geometry import LATENCIES, ShipMotion, UsblSurvey, seen_from_head, ship_motion


@dataclass(frozen=True, slots=True)
class SurveyScenario:
    """What a simulated survey is made of; the course is that of the antenna, roll and pitch are sines."""

    name: str
    about: str
    legs: tuple[Leg, ...]
    yaw_rad: float
    true_values: Vector  # (11,) by geometry.NAMES
    east_m: float
    north_m: float
    roll_deg: float  # amplitude
    roll_period_s: float
    pitch_deg: float
    pitch_period_s: float
    position_rate_hz: float  # of the records
    position_sd_m: float
    attitude_rate_hz: float
    attitude_sd_deg: float
    rate_hz: float  # of the fixes
    range_sd_m: float
    angle_sd_deg: float
    dof: float  # of the Student-t errors of ranges and angles
    outlier_share: float
    outlier_deg: float  # 1-sigma of the direction of an outlier
    current_mps: tuple[float, float] = (0.0, 0.0)

    @property
    def duration_s(self) -> float:
        """Length of the course."""
        return sum(leg.duration_s for leg in self.legs)


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
