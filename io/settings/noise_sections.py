"""The sections of usbldr.toml that state the model: sensor noise, process noise, sensor errors and start.

They are made from the declarations in usbldr.filters.models; scenarios use the same ones. docs/configuration.md
explains each key.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar, Union, cast

from msgspec import Meta, Struct, defstruct

from usbldr.filters.models.calibration import AUTO, STATES
from usbldr.filters.models.noise import FAMILIES, NoiseFamily
from usbldr.filters.models.parameters import ProcessNoise, SensorErrors, Start
from usbldr.filters.models.quantities import METRES, SD, SECONDS, SENSOR_UNITS, SPREAD, Limits, quantities

Model = TypeVar("Model")


class Section(Struct, frozen=True):
    """A table of the file. Unlisted keys are refused."""


def meta(limits: Limits) -> Meta:
    """Return declared limits as msgspec's constraint."""
    least, most, above = limits
    return Meta(gt=least, le=most) if above else Meta(ge=least, le=most)


def section_of(owner: type, sensor: str = "", kind: str | None = None, **others: tuple[Any, Any]) -> type[Section]:
    """Return the section that states a declared dataclass; ``others``: more keys, each a type and a default."""
    keys: list[Any] = []
    for quantity in quantities(owner, sensor).values():
        number: Any = Annotated[float, meta(quantity.limits)]
        keys.append((quantity.key, number) if quantity.required else (quantity.key, number | None, None))
    keys += [(name, *stated) for name, stated in others.items()]
    name, bases, field = f"{owner.__name__}Section", (Section,), "kind" if kind else None
    made = defstruct(name, keys, bases=bases, frozen=True, kw_only=True, tag=kind, tag_field=field)
    return cast("type[Section]", made)


def stated_model(usual: Model, stated: Section, sensor: str = "") -> Model:
    """Return the values of a section, ``usual`` for the rest, in the units of the model."""
    declared = quantities(type(usual), sensor)
    values = {name: getattr(stated, quantity.key) for name, quantity in declared.items()}
    given = {name: declared[name].to_model(value) for name, value in values.items() if value is not None}
    known: Any = usual
    return replace(known, **given)


def noise_family_of(noise: Section | None, default: NoiseFamily, sensor: str) -> NoiseFamily:
    """Return the noise family that a sensor's section states; ``per`` is the family's own unless stated."""
    if noise is None:
        return default
    chosen = stated_model(FAMILIES[str(noise.__struct_config__.tag)](), noise, sensor)
    per = getattr(noise, "per")  # noqa: B009
    return chosen if per is None else replace(chosen, per_scalar=per == "scalar")


def calibrated_keys(stated: Section) -> tuple[str, ...]:
    """Return the keys of the errors to estimate in their defined order, or only AUTO."""
    states = getattr(stated, "states")  # noqa: B009
    return (AUTO,) if states == AUTO else tuple(key for key in STATES if key in states)


PER = (Literal["scalar", "record"] | None, None)
NOISES: Mapping[str, Any] = {
    sensor: Union[tuple(section_of(family, sensor, kind, per=PER) for kind, family in FAMILIES.items())]  # noqa: UP007
    for sensor in SENSOR_UNITS
}
"""The possible sections of a sensor's noise."""

if TYPE_CHECKING:
    DvlNoise: TypeAlias = Section
    CompassNoise: TypeAlias = Section
    UsblNoise: TypeAlias = Section
    ProcessSection: TypeAlias = Section
    CalibrateSection: TypeAlias = Section
    StartSection: TypeAlias = Section
else:
    DvlNoise, CompassNoise, UsblNoise = NOISES["dvl"], NOISES["compass"], NOISES["usbl"]
    ProcessSection = section_of(ProcessNoise)
    CalibrateSection = section_of(SensorErrors, states=(Literal["auto"] | tuple[Literal[tuple(STATES)], ...], "auto"))
    StartSection = section_of(Start)


Positive: TypeAlias = Annotated[float, Meta(gt=0)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0)]
Factor: TypeAlias = Annotated[float, Meta(ge=1e-3, le=1e3)]
Degrees: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
Latitude: TypeAlias = Annotated[float, Meta(ge=-90, le=90)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=360)]
Deviation: TypeAlias = Annotated[float, Meta(ge=-30, le=30)]  # degrees; beyond, the heading is ambiguous
ClockStep: TypeAlias = Annotated[float, Meta(ge=0, le=86400)]  # seconds; a clock that went back has parts
Latency: TypeAlias = Annotated[float, Meta(ge=-86400, le=86400)]  # seconds
Gap: TypeAlias = Annotated[float, meta(SECONDS)]  # seconds
Metres: TypeAlias = Annotated[float, meta(METRES)]  # on the local plane, which is much smaller
Depth: TypeAlias = Annotated[float, Meta(ge=-12000, le=12000)]  # metres, down
Arm: TypeAlias = Annotated[float, Meta(ge=-1000, le=1000)]  # metres
Lever: TypeAlias = tuple[Arm, Arm, Arm]  # starboard, forward, up
SdMetres: TypeAlias = Annotated[float, meta(SD["m"])]
SdDegrees: TypeAlias = Annotated[float, meta(SD["deg"])]
SdSpeed: TypeAlias = Annotated[float, meta(SD["mps"])]  # m/s
SpreadMetres: TypeAlias = Annotated[float, meta(SPREAD["m"])]  # of values that may have none
SpreadDegrees: TypeAlias = Annotated[float, meta(SPREAD["deg"])]
