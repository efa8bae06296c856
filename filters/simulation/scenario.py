"""A scenario of a simulated dive: motion of the vehicle, errors of its sensors, and the assumptions given to a filter.

The dives themselves are TOML files (docs/scenarios.md). Frames, units and signs are the package's; a sensor's scale,
bias, misalignment, latency and clock offset are its errors: positive means that the sensor reads too much (too far
counter-clockwise, too late).
"""

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from usbldr.filters.models.noise import Gaussian, NoiseFamily
from usbldr.filters.models.parameters import LeverArm, ProcessNoise, Start
from usbldr.filters.types import Array, Vector

Intervals: TypeAlias = tuple[tuple[float, float], ...]  # each [from, to) in seconds of the dive

AT_REFERENCE: LeverArm = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch of constant velocity through the water, in the body, and constant turn rate (counter-clockwise)."""

    duration_s: float
    starboard_mps: float
    forward_mps: float
    turn_rate_radps: float = 0.0


@dataclass(frozen=True, slots=True)
class RandomWalkMotion:
    """Instead of legs, a random walk drawn per seed from the filters' assumptions: start, process noise, DVL scale."""

    step_s: float = 0.2  # fixed: of the filters' motion model
    dvl_scale_sd: float = 0.0  # about the stated scale error
    dvl_misalignment_sd_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Timing:
    """Stamps, delays and losses of records.

    A record stamped t (by the clock of the dive) is valid at t - latency, arrives after the delay, and is written with
    the clock of the sensor.
    """

    latency_s: float = 0.0
    delay_s: float = 0.0
    delay_spread_s: float = 0.0  # additional delay of each record, uniform from 0
    jitter_s: float = 0.0  # additional lateness of each stamp, uniform from 0
    clock_offset_s: float = 0.0  # of stamps and arrivals: the sensor's clock minus the dive's
    dropout_share: float = 0.0  # of the records, independently
    silences_s: Intervals = ()  # outages: no record is stamped in them


@dataclass(frozen=True, slots=True)
class CorrelatedError:
    """A slowly changing error beside the noise, a first-order Gauss-Markov process for each axis."""

    sd: float  # stationary, in the sensor's unit
    time_constant_s: float


@dataclass(frozen=True, slots=True)
class Outliers:
    """Gross errors besides the noise: a share of the records is off in a random direction, by a uniform distance."""

    share: float
    least: float  # in the sensor's unit
    most: float


@dataclass(frozen=True, slots=True)
class Dvl:
    """(z_u, z_v) = (1 + s)(u' cos d + v' sin d, -u' sin d + v' cos d) + bias + noise, u' and v' at the DVL."""

    rate_hz: float
    sd_mps: float
    noise: NoiseFamily = Gaussian()
    scale_error: float = 0.0  # s
    misalignment_rad: float = 0.0  # d: angle of the DVL's axes in the body
    bias_mps: tuple[float, float] = (0.0, 0.0)  # starboard, forward
    lever_m: LeverArm = AT_REFERENCE
    water_track_s: Intervals = ()  # without bottom lock: velocity through the water, and flagged as such
    correlated: CorrelatedError | None = None
    outliers: Outliers | None = None
    timing: Timing = Timing()
    assumed_sd_mps: float | None = None  # assumed by a filter; None, here and below: as simulated
    assumed_noise: NoiseFamily | None = None


@dataclass(frozen=True, slots=True)
class Compass:
    """z_psi = psi + b0 + b_s sin psi + b_c cos psi + noise."""

    rate_hz: float
    sd_rad: float
    noise: NoiseFamily = Gaussian()
    bias_rad: float = 0.0  # b0
    deviation_rad: tuple[float, float] = (0.0, 0.0)  # b_s, b_c
    correlated: CorrelatedError | None = None
    outliers: Outliers | None = None
    timing: Timing = Timing()
    assumed_sd_rad: float | None = None
    assumed_noise: NoiseFamily | None = None


@dataclass(frozen=True, slots=True)
class AcousticHead:
    """The fixed end of the acoustic line of sight: the USBL head, or the beacon of an inverted USBL."""

    east_m: float = 0.0
    north_m: float = 0.0
    depth_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Accuracy:
    """1-sigma of a fix: sqrt(sd_m^2 + (sd_rel r)^2) at slant range r, for each axis.

    With a bearing sigma this is the sigma along the line of sight, and r times the bearing sigma the one across.
    """

    sd_m: float = 0.0
    sd_rel: float = 0.0
    bearing_sd_rad: float | None = None

    @property
    def constant(self) -> bool:
        """Whether every fix has the same sigma."""
        return not self.sd_rel and self.bearing_sd_rad is None

    def variances(self, offset_m: Array, drop_m: float) -> Array:
        """Return the variances of the two axes, (n, 2), at horizontal offsets (n, 2) and a depth below the head."""
        range2 = np.sum(offset_m**2, axis=1) + drop_m**2
        first = self.sd_m**2 + self.sd_rel**2 * range2
        return np.column_stack([first, first if self.bearing_sd_rad is None else self.bearing_sd_rad**2 * range2])

    def axes(self, offset_m: Array) -> Array:
        """Return the axes in columns, (n, 2, 2): east and north, or along and across the line of sight."""
        if self.bearing_sd_rad is None:
            return np.broadcast_to(np.eye(2), (len(offset_m), 2, 2))
        bearing = np.arctan2(offset_m[:, 0], offset_m[:, 1])
        c, s = np.cos(bearing), np.sin(bearing)
        return np.stack([s, c, c, -s], axis=-1).reshape(-1, 2, 2)

    def covariance(self, offset_m: Array, drop_m: float) -> Array:
        """Return the covariance of east and north, (n, 2, 2)."""
        U = self.axes(offset_m)
        return np.einsum("nij,nj,nkj->nik", U, self.variances(offset_m, drop_m), U)


@dataclass(frozen=True, slots=True)
class Multipath:
    """Clusters of outliers: affected fixes of one cluster have the same offset."""

    least_m: float
    most_m: float
    scatter_m: float = 0.0
    share: float = 1.0  # fixed, all: of the fixes in a cluster
    clusters_s: Intervals = ()
    every_s: float = 0.0  # mean interval between the starts of random clusters; 0: none
    lasts_s: float = 0.0  # mean duration of a random cluster


@dataclass(frozen=True, slots=True)
class Usbl:
    """A fix is head + (1 + s) R(d) (transponder - head) + bias + noise, the transponder at position + R(psi) lever.

    An ``inverted`` one is mounted on the vehicle and measures a fixed beacon, here the head; it rotates its
    measurements by the vehicle's compass, whose systematic error adds to d.
    """

    rate_hz: float
    accuracy: Accuracy
    noise: NoiseFamily = Gaussian()
    head: AcousticHead = AcousticHead()
    inverted: bool = False
    scale_error: float = 0.0  # s: of ranges
    misalignment_rad: float = 0.0  # d: rotation of the head
    bias_m: tuple[float, float] = (0.0, 0.0)  # east, north
    lever_m: LeverArm = AT_REFERENCE  # of the end that is on the vehicle
    correlated: CorrelatedError | None = None
    outliers: Outliers | None = None
    multipath: Multipath | None = None
    timing: Timing = Timing()
    assumed_accuracy: Accuracy | None = None
    assumed_noise: NoiseFamily | None = None


@dataclass(frozen=True, slots=True)
class Gps:
    """The truth of the log: the position of the antenna, without noise unless the scenario has some."""

    rate_hz: float
    sd_m: float = 0.0
    noise: NoiseFamily = Gaussian()
    lever_m: LeverArm = AT_REFERENCE
    bias_m: tuple[float, float] = (0.0, 0.0)  # east, north
    correlated: CorrelatedError | None = None
    outliers: Outliers | None = None
    timing: Timing = Timing()
    assumed_sd_m: float | None = None


Sensor: TypeAlias = Dvl | Compass | Usbl | Gps


@dataclass(frozen=True, slots=True)
class Scenario:
    """A dive: motion of the vehicle, errors of its sensors, and the assumptions given to a filter."""

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
    depth_m: float = 0.0
    current_mps: tuple[float, float] = (0.0, 0.0)  # of the water, east and north
    drawn: RandomWalkMotion | None = None
    process: ProcessNoise = field(default_factory=ProcessNoise)  # assumed by a filter; part of the truth only if drawn
    start: Start | None = None  # assumed by a filter


@dataclass(frozen=True, slots=True)
class SurveyScenario:
    """What a simulated survey is made of; the course is that of the antenna, roll and pitch are sines."""

    name: str
    about: str
    legs: tuple[Leg, ...]
    yaw_rad: float
    true_values: Vector  # (11,) by usbl_survey/geometry.py: NAMES
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
