"""What a filter is told beside the measurements: how the vehicle moves, how each sensor errs, where it starts.

The defaults are the generic ones that serve every log; a configuration or a scenario states its own.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from usbldr.filters.models.noise import Contamination, Gaussian, NoiseFamily
from usbldr.filters.windows import TimeWindow

LeverArm = tuple[float, float, float]  # starboard, forward, up of the vehicle's reference point, metres


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Random walks of the motion model: 1-sigma after one second."""

    position_m: float = 0.02  # [m/√s] by judgement: what velocity and yaw do not explain
    yaw_rad: float = 0.002  # [rad/√s] small: the turn rate moves the yaw
    velocity_mps: float = 0.05  # [m/s/√s] thrust and current; learnt from cruising it would refuse manoeuvres
    turn_rate_radps: float = 0.1  # [rad/s/√s] by judgement: a turn begins and ends within seconds
    uncalibrated_m: float = 0.0  # beside position_m where no state explains the DVL's scale: that error drifts, too


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """How large a sensor's constant errors may be before a filter estimates them: 1-sigma, and how they wander."""

    scale: float = 0.01  # makers of DVLs state 0.2 to 1 %
    misalignment_rad: float = math.radians(5.0)  # of a mounting that was set by eye
    heading_rad: float = math.radians(5.0)  # of a compass that was never compensated
    heading_walk_rad: float = math.radians(0.02)  # [rad/√s] 1.2 degrees after an hour
    deviation_rad: float = math.radians(2.0)  # amplitude of the sine, and of the cosine
    latency_s: float = 0.3  # sound takes 0.2 s for 300 m, and drivers as long
    usbl_bias_m: float = 0.3  # in the long run, each axis
    usbl_bias_s: float = 60.0  # time constant


@dataclass(frozen=True, slots=True)
class Start:
    """A known start. Without one the first fixes tell the position.

    Yaw and velocity start at the first compass and DVL records, the turn rate at 0; the sigmas say how far off they
    may be. A bootstrap particle filter has to hit the start by chance, and is lost where they are wide.
    """

    east_m: float
    north_m: float
    sd_m: float
    sd_yaw_rad: float = math.radians(5.0)  # as heading_rad of SensorErrors
    sd_mps: float = 0.5  # a vehicle does 1 to 2 m/s
    sd_radps: float = math.radians(3.0)  # of a vehicle that is hardly turning


UNKNOWN_START = Start(math.nan, math.nan, math.nan)


class StateObservability(NamedTuple):
    """What a log tells of one key of calibration.STATES."""

    key: str
    sigma_ratio: float  # sigma at the end of the log, as a share of that before
    conclusion: str  # "observable", "only in turns", "not observable"


class TunedParameter(NamedTuple):
    """A number that the log itself was asked for, see tuning.py."""

    name: str  # with its unit
    before: float
    after: float
    low: float  # one sigma down, by the width of the likelihood
    high: float  # one sigma up
    identified: bool  # False: the log hardly knows it, so it stays as it was


DR_WALK_NAME = "position_walk_m"  # the name under which ProcessNoise.position_m is settled


class NoiseChange(NamedTuple):
    """A number of the noise that a log contradicted, see observability.py."""

    name: str  # with its unit
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Assumptions:
    """The model side of a run, the same for every filter."""

    process: ProcessNoise = ProcessNoise()
    dvl: NoiseFamily = Gaussian()
    compass: NoiseFamily = Gaussian()
    usbl: NoiseFamily = Contamination()
    dvl_lever_m: LeverArm = (0.0, 0.0, 0.0)
    usbl_lever_m: LeverArm = (0.0, 0.0, 0.0)  # the transponder on the vehicle
    start: Start | None = None
    calibrate: tuple[str, ...] = ()  # keys of calibration.STATES, or AUTO until the log has been asked
    errors: SensorErrors = SensorErrors()
    observed: tuple[StateObservability, ...] = ()  # why these are calibrated, where the log was asked
    noise_changes: tuple[NoiseChange, ...] = ()  # what it said of the noise then
    gps: NoiseFamily = Contamination()  # where it aids
    gps_lever_m: LeverArm = (0.0, 0.0, 0.0)  # the antenna
    aid: tuple[TimeWindow, ...] = ()  # windows in which GPS fixes are measurements and no truth
    dvl_sd_scale: float = 1.0  # every sigma of that sensor, whoever stated it, is this many times as large
    usbl_sd_scale: float = 1.0  # the same of the USBL
    tuned: tuple[TunedParameter, ...] = ()  # what the log was asked for of these
