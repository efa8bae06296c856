"""The numbers of configurations and scenarios as types: the unit, and how large one may be and still mean something.

The bounds are far wider than any vehicle. They keep slips of the pen and of the unit out of the filters, whose sums of
squares would no longer fit a double: a latency in nanoseconds, a sigma of 1e300.
"""

from typing import Annotated, TypeAlias

from msgspec import Meta

Positive: TypeAlias = Annotated[float, Meta(gt=0)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0)]
Share: TypeAlias = Annotated[float, Meta(ge=1e-9, le=1 - 1e-9)]
Factor: TypeAlias = Annotated[float, Meta(ge=1e-3, le=1e3)]
VarianceRatio: TypeAlias = Annotated[float, Meta(gt=1, le=1e9)]
Degrees: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
Latitude: TypeAlias = Annotated[float, Meta(ge=-90, le=90)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=360)]
Deviation: TypeAlias = Annotated[float, Meta(ge=-30, le=30)]  # degrees; beyond, a reading no longer tells one heading
Latency: TypeAlias = Annotated[float, Meta(ge=-86400, le=86400)]  # seconds
ClockOffset: TypeAlias = Annotated[float, Meta(ge=-4e9, le=4e9)]  # seconds; a clock may count from power-on, or 1900
Gap: TypeAlias = Annotated[float, Meta(ge=1e-3, le=1e9)]  # seconds
Metres: TypeAlias = Annotated[float, Meta(ge=-1e7, le=1e7)]  # on the plane, which ends long before
Depth: TypeAlias = Annotated[float, Meta(ge=-12000, le=12000)]  # metres, down
Arm: TypeAlias = Annotated[float, Meta(ge=-1000, le=1000)]  # metres
Lever: TypeAlias = tuple[Arm, Arm, Arm]  # starboard, forward, up
SdMetres: TypeAlias = Annotated[float, Meta(ge=1e-6, le=1e6)]
SdDegrees: TypeAlias = Annotated[float, Meta(ge=1e-6, le=360)]
SdSpeed: TypeAlias = Annotated[float, Meta(ge=1e-6, le=1e3)]  # m/s
SpreadMetres: TypeAlias = Annotated[float, Meta(ge=0, le=1e6)]  # of what may have none
SpreadDegrees: TypeAlias = Annotated[float, Meta(ge=0, le=360)]
SpreadSpeed: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]
