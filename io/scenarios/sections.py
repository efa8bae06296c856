"""The sections of a scenario's file as types: their keys, units and valid values.

Angles are degrees clockwise, velocities starboard and forward, positions east and north. docs/scenarios.md explains
each key.
"""

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from usbldr.io.settings.noise_sections import (
    CompassNoise,
    DvlNoise,
    Lever,
    NotNegative,
    Positive,
    ProcessSection,
    Section,
    StartSection,
    UsblNoise,
)

Part: TypeAlias = Annotated[float, Meta(ge=0, lt=1)]
Pair: TypeAlias = tuple[float, float]
Stretch: TypeAlias = tuple[NotNegative, NotNegative]

SPANS = ("silences_s", "water_track_s", "clusters_s", "outlier_mps", "outlier_deg", "outlier_m", "offset_m")
"""Keys that state [from, to], those in seconds any number of them."""

MAX_RECORDS = 10_000_000  # records of a sensor in a dive: three weeks at 5 Hz


class HeadPlaceSection(Section, frozen=True, kw_only=True):
    """The fixed end of the acoustic line of sight."""

    east_m: float = 0.0
    north_m: float = 0.0
    depth_m: NotNegative = 0.0


class VehicleSection(HeadPlaceSection, frozen=True, kw_only=True):
    """The initial state of the dive."""

    heading_deg: float = 0.0


class LegSection(Section, frozen=True, kw_only=True):
    """A leg of constant velocity through the water, in the body frame, and constant turn rate."""

    duration_s: Positive
    starboard_mps: float = 0.0
    forward_mps: float = 0.0
    turn_rate_dps: float = 0.0


class CurrentSection(Section, frozen=True, kw_only=True):
    """The velocity of the water."""

    east_mps: float = 0.0
    north_mps: float = 0.0


class DrawnSection(Section, frozen=True, kw_only=True):
    """A random motion drawn for each seed from the filters' own model."""

    step_s: Positive = 0.2
    dvl_scale_sd: NotNegative = 0.0
    dvl_mount_sd_deg: NotNegative = 0.0


class SensorSection(Section, frozen=True, kw_only=True):
    """The times of a sensor's records, and which are lost."""

    rate_hz: Positive
    latency_s: float = 0.0
    delay_s: NotNegative = 0.0
    delay_spread_s: NotNegative = 0.0
    jitter_s: NotNegative = 0.0
    clock_offset_s: float = 0.0
    dropout_share: Part = 0.0
    silences_s: tuple[Stretch, ...] = ()
    correlated_time_s: Positive = 60.0
    outlier_share: Part = 0.0

    def __post_init__(self) -> None:
        if self.jitter_s * self.rate_hz > 1:
            raise ValueError(f"jitter_s must not exceed the {1 / self.rate_hz:g} s between two records")
        refuse_backwards(self)


class DvlSensor(SensorSection, frozen=True, kw_only=True):
    """The Doppler velocity log."""

    sd_mps: NotNegative
    noise: DvlNoise | None = None
    scale_error: Annotated[float, Meta(gt=-1)] = 0.0
    mount_deg: float = 0.0
    bias_mps: Pair = (0.0, 0.0)
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    water_track_s: tuple[Stretch, ...] = ()
    correlated_sd_mps: NotNegative = 0.0
    outlier_mps: tuple[NotNegative, NotNegative] = (0.5, 2.0)
    assumed_sd_mps: Positive | None = None
    assumed_noise: DvlNoise | None = None


class CompassSensor(SensorSection, frozen=True, kw_only=True):
    """The heading sensor."""

    sd_deg: NotNegative
    noise: CompassNoise | None = None
    bias_deg: float = 0.0
    deviation_sin_deg: float = 0.0
    deviation_cos_deg: float = 0.0
    correlated_sd_deg: NotNegative = 0.0
    outlier_deg: tuple[NotNegative, NotNegative] = (10.0, 90.0)
    assumed_sd_deg: Positive | None = None
    assumed_noise: CompassNoise | None = None


class MultipathSection(Section, frozen=True, kw_only=True):
    """Clusters of outlier fixes."""

    offset_m: tuple[NotNegative, NotNegative]
    scatter_m: NotNegative = 0.0
    share: Annotated[float, Meta(gt=0, le=1)] = 1.0
    clusters_s: tuple[Stretch, ...] = ()
    every_s: NotNegative = 0.0
    lasts_s: NotNegative = 0.0

    def __post_init__(self) -> None:
        refuse_backwards(self)


class AccuracySection(Section, frozen=True, kw_only=True):
    """1-sigma of a fix: for each axis, or along and across the line of sight."""

    sd_m: NotNegative = 0.0
    sd_rel: NotNegative = 0.0
    bearing_sd_deg: Positive | None = None

    def __post_init__(self) -> None:
        if not self.sd_m and not self.sd_rel:
            raise ValueError("state sd_m, sd_rel or both")


class UsblSensor(SensorSection, frozen=True, kw_only=True):
    """The acoustic positioning system."""

    accuracy: AccuracySection
    noise: UsblNoise | None = None
    head: HeadPlaceSection = HeadPlaceSection()
    inverted: bool = False
    scale_error: Annotated[float, Meta(gt=-1)] = 0.0
    mount_deg: float = 0.0
    bias_m: Pair = (0.0, 0.0)
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    correlated_sd_m: NotNegative = 0.0
    outlier_m: tuple[NotNegative, NotNegative] = (5.0, 40.0)
    multipath: MultipathSection | None = None
    assumed_accuracy: AccuracySection | None = None
    assumed_noise: UsblNoise | None = None


class GpsSensor(SensorSection, frozen=True, kw_only=True):
    """The satellite receiver: the truth of the log."""

    sd_m: NotNegative = 0.0
    noise: UsblNoise | None = None
    bias_m: Pair = (0.0, 0.0)
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    correlated_sd_m: NotNegative = 0.0
    outlier_m: tuple[NotNegative, NotNegative] = (5.0, 40.0)
    assumed_sd_m: Positive | None = None


class ScenarioFile(Section, frozen=True, kw_only=True):
    """A whole scenario."""

    schema: Literal[1]
    about: str
    duration_s: Positive
    leg: Annotated[tuple[LegSection, ...], Meta(min_length=1)]
    dvl: DvlSensor
    compass: CompassSensor
    usbl: UsblSensor
    gps: GpsSensor
    vehicle: VehicleSection = VehicleSection()
    current: CurrentSection = CurrentSection()
    drawn: DrawnSection | None = None
    process: ProcessSection = ProcessSection()
    start: StartSection | None = None

    def __post_init__(self) -> None:
        if self.drawn is not None and self.start is None:
            raise ValueError("[drawn] needs [start], from which the initial state is drawn")
        if self.drawn is not None and (self.current.east_mps or self.current.north_mps):
            raise ValueError("[drawn] cannot be combined with [current]")
        counts = {f"{name}.rate_hz": getattr(self, name).rate_hz for name in ("dvl", "compass", "usbl", "gps")}
        if self.drawn is not None:
            counts["drawn.step_s"] = 1 / self.drawn.step_s
        if self.usbl.multipath is not None and self.usbl.multipath.every_s:
            counts["usbl.multipath.every_s"] = 1 / self.usbl.multipath.every_s
        for key, per_s in counts.items():
            if self.duration_s * per_s > MAX_RECORDS:
                raise ValueError(
                    f"{key} and duration_s give {self.duration_s * per_s:.2g} records; the limit is {MAX_RECORDS:.0e}"
                )


def refuse_backwards(section: Section) -> None:
    """Refuse a span or range that ends before it begins."""
    for key in SPANS:
        stated = getattr(section, key, ())
        for first, last in stated if key.endswith("_s") else [stated] if stated else ():
            if last < first:
                raise ValueError(f"{key}: [{first:g}, {last:g}] ends before it begins")
