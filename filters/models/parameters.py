"""What a filter is given besides the measurements: process noise, measurement noise, sensor errors, the start.

The defaults apply to every log; a configuration or a scenario states others. Stored in radians, metres and seconds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from usbldr.filters.models.noise import Contamination, Gaussian, NoiseFamily
from usbldr.filters.models.quantities import (
    METRES,
    SD,
    SECONDS,
    SPREAD,
    Limits,
    Quantity,
    ReportedQuantity,
    SensorError,
)
from usbldr.filters.windows import TimeWindow

DEGREES = math.degrees(1.0)  # fixed: in a radian
LeverArm = tuple[float, float, float]  # starboard, forward, up of the vehicle's reference point, metres


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Random walks of the motion model: 1-sigma after one second."""

    # [m/√s] by judgement: drift that velocity and yaw do not explain
    position_m: Annotated[float, Quantity("position_m", SPREAD["m"])] = 0.02
    # [rad/√s] small, as the turn rate has its own noise
    yaw_rad: Annotated[float, Quantity("heading_deg", SPREAD["deg"])] = 0.002
    # [m/s/√s] thrust and current; a value fitted to straight legs would reject manoeuvres
    velocity_mps: Annotated[float, Quantity("velocity_mps", SPREAD["mps"])] = 0.05
    # [rad/s/√s] by judgement: a turn begins and ends within seconds
    turn_rate_radps: Annotated[float, Quantity("turn_rate_dps", SPREAD["deg"])] = 0.1
    # added to position_m if the DVL's scale is not a state: the scale error causes drift, too
    uncalibrated_m: Annotated[float, Quantity("uncalibrated_m", SPREAD["m"])] = 0.0


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Prior 1-sigma of the sensor errors that a filter may estimate, and how they change over time."""

    # makers of DVLs state 0.2 to 1 %
    scale: Annotated[
        float,
        Quantity("scale_sd", Limits(1e-6, 1.0)),
        SensorError("scale", {"dvl_scale": ReportedQuantity("dvl_scale", "", 1.0, "dvl", "scale_error", 5)}),
    ] = 0.01
    # of a mounting that was set by eye
    misalignment_rad: Annotated[
        float,
        Quantity("mount_sd_deg", SD["deg"]),
        SensorError(
            "misalignment", {"dvl_mount": ReportedQuantity("dvl_mount_deg", "deg", -DEGREES, "dvl", "mount_deg")}
        ),
    ] = math.radians(5.0)
    # of a compass that was never compensated
    heading_rad: Annotated[
        float,
        Quantity("heading_sd_deg", SD["deg"]),
        SensorError(
            "heading", {"heading_bias": ReportedQuantity("heading_bias_deg", "deg", -DEGREES, "compass", "bias_deg")}
        ),
    ] = math.radians(5.0)
    # [rad/√s] 1.2 degrees after an hour
    heading_walk_rad: Annotated[float, Quantity("heading_walk_deg", SPREAD["deg"])] = math.radians(0.02)
    # of A and of B each: the compass reads H + A sin H + B cos H at heading H
    deviation_rad: Annotated[
        float,
        Quantity("deviation_sd_deg", SD["deg"]),
        SensorError(
            "deviation",
            {
                "deviation_sin": ReportedQuantity("deviation_sin_deg", "deg", DEGREES, "compass", "deviation_sin_deg"),
                "deviation_cos": ReportedQuantity("deviation_cos_deg", "deg", -DEGREES, "compass", "deviation_cos_deg"),
            },
        ),
    ] = math.radians(2.0)
    # sound takes 0.2 s for 300 m, and drivers about as long
    latency_s: Annotated[
        float,
        Quantity("latency_sd_s", Limits(1e-6, 600.0)),
        SensorError("latency", {"usbl_latency": ReportedQuantity("usbl_latency_s", "s", 1.0, "usbl", "latency_s")}),
    ] = 0.3
    # stationary, each axis; by judgement: 1 % of wrong sound speed and half a degree of mounting at 50 m
    usbl_bias_m: Annotated[
        float,
        Quantity("usbl_bias_sd_m", SD["m"]),
        SensorError(
            "usbl-bias",
            {
                "usbl_bias_east": ReportedQuantity("usbl_bias_east_m", "m", 1.0),
                "usbl_bias_north": ReportedQuantity("usbl_bias_north_m", "m", 1.0),
            },
        ),
    ] = 0.5
    # time constant of the correlated error; by judgement: it changes with bearing and range, over a leg of minutes
    usbl_bias_s: Annotated[float, Quantity("usbl_bias_time_s", SECONDS)] = 120.0
    # of each axis: tidal streams and rivers are often half a metre per second
    current_mps: Annotated[
        float,
        Quantity("current_sd_mps", SD["mps"]),
        SensorError(
            "current",
            {
                "current_east": ReportedQuantity("current_east_mps", "mps", 1.0),
                "current_north": ReportedQuantity("current_north_mps", "mps", 1.0),
            },
        ),
    ] = 0.5
    # [m/s/√s] 0.1 m/s after an hour, as a tide turns within six
    current_walk_mps: Annotated[float, Quantity("current_walk_mps", SPREAD["mps"])] = 0.0017
    # of each axis of the lever arm from the transponder to the DVL: vehicles are 1 to 5 m long; 0: it is as stated
    dvl_lever_m: Annotated[float, Quantity("dvl_lever_sd_m", SPREAD["m"])] = 2.0
    # of the DVL's clock against compass and fixes: without synchronisation clocks differ by about 1 s; 0: it is right
    dvl_clock_s: Annotated[float, Quantity("dvl_clock_sd_s", SPREAD["s"])] = 1.0
    # of the compass's clock against DVL and fixes: as that of the DVL; 0: it is right
    compass_clock_s: Annotated[float, Quantity("compass_clock_sd_s", SPREAD["s"])] = 1.0
    # of the heading of a USBL head that was mounted with care; 0: it is right
    usbl_heading_rad: Annotated[float, Quantity("usbl_heading_sd_deg", SPREAD["deg"])] = math.radians(1.0)
    # of its ranges: 15 m/s of sound speed; 0: they are right
    usbl_range: Annotated[float, Quantity("usbl_range_sd", Limits(0.0, 1.0))] = 0.01
    # of each axis of the lever arm from a ship's antenna to the head, measured with a tape; 0: it is as stated
    usbl_arm_m: Annotated[float, Quantity("usbl_arm_sd_m", SPREAD["m"])] = 0.5


@dataclass(frozen=True, slots=True)
class Start:
    """A known start. Without one the position starts at the first fixes.

    Yaw and velocity start at the first compass and DVL records, the turn rate at 0, with these sigmas. A bootstrap
    particle filter samples the start and diverges if the sigmas are wide.
    """

    east_m: Annotated[float, Quantity("east_m", METRES)]
    north_m: Annotated[float, Quantity("north_m", METRES)]
    sd_m: Annotated[float, Quantity("sd_m", SD["m"])]
    # as heading_rad of SensorErrors
    sd_yaw_rad: Annotated[float, Quantity("heading_sd_deg", SD["deg"])] = math.radians(5.0)
    # a vehicle does 1 to 2 m/s
    sd_mps: Annotated[float, Quantity("velocity_sd_mps", SD["mps"])] = 0.5
    # of a vehicle that is hardly turning
    sd_radps: Annotated[float, Quantity("turn_rate_sd_dps", SD["deg"])] = math.radians(3.0)


UNKNOWN_START = Start(math.nan, math.nan, math.nan)


class FalseStart(NamedTuple):
    """From some time on the fixes that have arrived show how many of the first ones are false."""

    known_s: float
    fixes: int


class SensorChange(NamedTuple):
    """What sensors read wrong from some time on, beyond what they did before the first change."""

    start_s: float
    heading_bias_rad: float  # anticlockwise, as the state
    dvl_scale: float  # [-] of its readings
    lost: tuple[str, ...] = ()  # "dvl", "compass": it does not read this vehicle's motion over ground
    fix_shift_m: tuple[float, float] = (0.0, 0.0)  # of the USBL fixes, east and north
    fix_late_s: float = 0.0  # of their stamps
    fix_sd_scale: float = 1.0  # factor on their sigmas
    current_mps: tuple[float, float] = (0.0, 0.0)  # east and north: the DVL measures through the water
    twice_per_turn_rad: tuple[float, float] = (0.0, 0.0)  # (a, b): headings read a sin 2 psi + b cos 2 psi too much
    dvl_bias_mps: tuple[float, float] = (0.0, 0.0)  # starboard and forward: velocities read so much more at any speed
    gradual: bool = False  # the heading has turned evenly since the change before


class Smoothing(NamedTuple):
    """Software predicts each position from the ones before, and takes shares of how far the fix lies from it.

    Or each position is the mean of the last fixes.
    """

    position: float  # [-] alpha: the share that the position takes; 1: it is the fix
    velocity: float = 0.0  # [-] beta: the share of the same, divided by the time since the fix before
    last: int = 0  # fixes with equal weights; 0: weights decrease by 1 - alpha with each fix since


NOT_SMOOTHED = Smoothing(1.0)  # [-] each position is the fix


@dataclass(frozen=True, slots=True)
class Parameters:
    """The model of motion and sensors, the same for every filter."""

    process: ProcessNoise = ProcessNoise()
    # not contaminated: spikes are left out before, and what remains would hide a sudden change of speed or course
    dvl: NoiseFamily = Gaussian()
    compass: NoiseFamily = Gaussian()
    usbl: NoiseFamily = Contamination()
    dvl_lever_m: LeverArm = (0.0, 0.0, 0.0)
    usbl_lever_m: LeverArm = (0.0, 0.0, 0.0)  # the transponder on the vehicle
    start: Start | None = None
    calibrate: tuple[str, ...] = ()  # keys of calibration.STATES; AUTO until identification has replaced it
    errors: SensorErrors = SensorErrors()
    gps: NoiseFamily = Contamination()  # of fixes in the windows of aid
    gps_lever_m: LeverArm = (0.0, 0.0, 0.0)  # the antenna
    water_track: bool = False  # the DVL measures the velocity through the water: identification adds the current
    aid: tuple[TimeWindow, ...] = ()  # windows in which GPS fixes are measurements and not truth
    dvl_sd_scale: float = 1.0  # factor on every stated sigma of the DVL
    compass_sd_scale: float = 1.0  # factor on every stated sigma of the compass
    usbl_sd_scale: float = 1.0  # factor on every stated sigma of the USBL
    false_fixes: tuple[int, ...] = ()  # rows of USBL fixes that a run leaves out, since the whole log shows them false
    false_starts: tuple[FalseStart, ...] = ()  # the same of the first ones alone, as far as it is known in mid-dive
    changes: tuple[SensorChange, ...] = ()  # that are taken off the readings before a run
    smoothing: Smoothing = NOT_SMOOTHED  # of the USBL fixes by software: taken off before the changes
    rival_shift: tuple[SensorChange, ...] = ()  # of the fixes, nearly as likely as the changes: in the track's sigma
    settled: Mapping[str, float] = field(default_factory=dict[str, float])
    """Sensor errors, state -> value, that are taken off the readings before a run; the states estimate what is left."""
    settled_sd: Mapping[str, float] = field(default_factory=dict[str, float])
    """1-sigma of what no state estimates further: of the errors of the USBL head, of the arm to the DVL."""
    settled_cov: Mapping[tuple[str, str], float] = field(default_factory=dict[tuple[str, str], float])
    """Covariances of two of them, once for a pair: on a ship that circles, an arm is a heading of the head."""

    @property
    def usbl_from_dvl_m(self) -> tuple[float, float]:
        """The lever arm of the transponder from the DVL, starboard and forward."""
        (starboard_m, forward_m, _), dvl_m = self.usbl_lever_m, self.dvl_lever_m
        return starboard_m - dvl_m[0], forward_m - dvl_m[1]
