"""The dives that can be simulated: how the vehicle moves, how its sensors err, and what a filter is told beforehand.

The scenario ``paper`` is section 3.1 of Dou et al., "A USBL/DR underwater integrated positioning method based on the
cubature particle filter"; ``lawnmower`` is ours. Frames, units and signs are the package's; a sensor's scale, bias,
misalignment and latency are its errors: positive means that the sensor reads too much (too far counter-clockwise, too
late).
"""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

from usbldr.filters.assumptions import ProcessNoise, Start
from usbldr.filters.errors import UsageError
from usbldr.filters.noise import Contamination, Gaussian, Mixture, NoiseFamily

Silences: TypeAlias = tuple[tuple[float, float], ...]  # [from, to) in seconds of the dive: no record is stamped there


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
    silences_s: Silences = ()


@dataclass(frozen=True, slots=True)
class Compass:
    """z_psi = psi + b0 + noise."""

    rate_hz: float
    sd_rad: float
    noise: NoiseFamily = Gaussian()
    bias_rad: float = 0.0  # b0
    silences_s: Silences = ()


@dataclass(frozen=True, slots=True)
class Outliers:
    """Gross errors beside the noise: now and then a fix lies far off, in any direction, at any of these distances."""

    share: float
    least_m: float
    most_m: float


@dataclass(frozen=True, slots=True)
class Usbl:
    """A fix stamped t_v tells where the vehicle was at t_v - latency; the vehicle hears of it after the delay."""

    rate_hz: float
    sd_m: float
    noise: NoiseFamily = Gaussian()
    latency_s: float = 0.0
    delay_s: float = 0.0
    delay_spread_s: float = 0.0  # each fix takes up to so much longer, drawn evenly
    jitter_s: float = 0.0  # each stamp lies up to so much later than the rate says, drawn evenly
    outliers: Outliers | None = None
    silences_s: Silences = ()
    told_noise: NoiseFamily | None = None  # what a filter is told where it can't know the truth; None: ``noise``

    @property
    def assumed_noise(self) -> NoiseFamily:
        """What a careful user would state of this sensor."""
        return self.noise if self.told_noise is None else self.told_noise


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

LANE_S, TURN_S, TURN_RADPS = 125.0, 30.0, math.radians(6.0)


def _lawnmower_legs(lanes: int) -> tuple[Leg, ...]:
    """Return lanes at 1 m/s, joined by half circles that turn right and left by turns; they skid outwards a little."""
    legs = [Leg(LANE_S, 0.0, 1.0)]
    for turn in range(lanes - 1):
        left = 1.0 if turn % 2 else -1.0
        legs += [Leg(TURN_S, 0.05 * left, 0.9, TURN_RADPS * left), Leg(LANE_S, 0.0, 1.0)]
    return tuple(legs)


LAWNMOWER = Scenario(
    name="lawnmower",
    about="900 s of six lanes: slow DVL, biased compass, late fixes with outliers, outages of USBL and DVL",
    duration_s=900.0,
    legs=_lawnmower_legs(6),
    dvl=Dvl(rate_hz=2.0, sd_mps=0.02, scale_error=0.004, silences_s=((725.0, 765.0),)),
    compass=Compass(rate_hz=10.0, sd_rad=math.radians(0.3), bias_rad=math.radians(0.8)),
    usbl=Usbl(
        rate_hz=0.5,
        sd_m=0.6,
        delay_s=0.5,
        delay_spread_s=1.5,
        jitter_s=0.4,
        outliers=Outliers(share=0.06, least_m=5.0, most_m=40.0),
        silences_s=((400.0, 550.0),),
        told_noise=Contamination(share=0.05, sd=10.0),
    ),
    gps=Gps(rate_hz=1.0),
    process=ProcessNoise(
        position_m=0.02, yaw_rad=math.radians(0.1), velocity_mps=0.05, turn_rate_radps=math.radians(6)
    ),
    yaw_rad=math.radians(80.0),  # lanes of heading 280 and 100: each turn leads through north, where headings jump
)

SCENARIOS = {scenario.name: scenario for scenario in (PAPER, LAWNMOWER)}


def scenario_named(name: str) -> Scenario:
    """Return a scenario of SCENARIOS; raises UsageError that lists the names."""
    if name not in SCENARIOS:
        raise UsageError(f"there is no scenario {name!r} (scenarios: {', '.join(SCENARIOS)})")
    return SCENARIOS[name]
