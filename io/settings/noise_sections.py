"""The sections of usbldr.toml that state the model, as types: how sensors err, how the vehicle moves, where it starts.

Scenarios have the same ones. docs/configuration.md explains each key.
"""

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta, Struct

from usbldr.io.settings.limits import (
    Gap,
    Metres,
    SdDegrees,
    SdMetres,
    SdSpeed,
    Share,
    SpreadDegrees,
    SpreadMetres,
    SpreadSpeed,
    VarianceRatio,
)

Per: TypeAlias = Literal["scalar", "record"]


class Section(Struct, frozen=True):
    """A table of the file. A key that is not listed is refused."""


class GaussianNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="gaussian"):
    """N(0, R)."""

    per: Per | None = None


class MixtureNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="mixture"):
    """N(0, R), with probability ``share`` N(0, variance_ratio R)."""

    share: Share = 0.30
    variance_ratio: VarianceRatio = 10.0
    per: Per | None = None


class StudentNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="student-t"):
    """Student's t."""

    dof: Annotated[float, Meta(ge=2, le=1e6)] = 4.0  # below 2 the tails have no variance to match
    per: Per | None = None


class DvlContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_mps: SdSpeed
    per: Per | None = None


class CompassContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_deg: SdDegrees
    per: Per | None = None


class UsblContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_m: SdMetres = 10.0
    per: Per | None = None


DvlNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | DvlContamination
CompassNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | CompassContamination
UsblNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | UsblContamination


class ProcessSection(Section, frozen=True, kw_only=True):
    """Random walks of the motion model: 1-sigma after one second."""

    position_m: SpreadMetres | None = None
    heading_deg: SpreadDegrees | None = None
    velocity_mps: SpreadSpeed | None = None
    turn_rate_dps: SpreadDegrees | None = None
    uncalibrated_m: SpreadMetres | None = None


class CalibrateSection(Section, frozen=True, kw_only=True):
    """Which errors of sensors are estimated, and their 1-sigma before anything is measured."""

    states: (
        Literal["auto"] | tuple[Literal["scale", "misalignment", "heading", "deviation", "latency", "usbl-bias"], ...]
    ) = "auto"
    scale_sd: Annotated[float, Meta(ge=1e-6, le=1)] | None = None
    mount_sd_deg: SdDegrees | None = None
    heading_sd_deg: SdDegrees | None = None
    heading_walk_deg: SpreadDegrees | None = None  # after one second
    deviation_sd_deg: SdDegrees | None = None
    latency_sd_s: Annotated[float, Meta(ge=1e-6, le=600)] | None = None
    usbl_bias_sd_m: SdMetres | None = None
    usbl_bias_time_s: Gap | None = None


class StartSection(Section, frozen=True, kw_only=True):
    """Where the vehicle is known to start, and how far off the first heading and velocity may be."""

    east_m: Metres
    north_m: Metres
    sd_m: SdMetres
    heading_sd_deg: SdDegrees = 5.0
    velocity_sd_mps: SdSpeed = 0.5
    turn_rate_sd_dps: SdDegrees = 3.0
