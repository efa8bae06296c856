"""The numbers of configurations and scenarios as types: their units, and the range of meaningful values.

The bounds are far wider than any vehicle. They keep typing errors and wrong units out of the filters, whose sums of
squares would no longer fit a double: a latency in nanoseconds, a sigma of 1e300.
"""

from typing import Annotated, TypeAlias

from msgspec import Meta

from usbldr.filters.models.quantities import METRES, SD, SECONDS, SPREAD, Limits


def meta(limits: Limits) -> Meta:
    """Return declared limits as msgspec's constraint."""
    least, most, above = limits
    return Meta(gt=least, le=most) if above else Meta(ge=least, le=most)


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
