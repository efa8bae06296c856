"""Numbers of the model as people state them: the key with its unit, the limits, the sensor error that it belongs to.

Each is declared once, in the annotation of its field. The sections of usbldr.toml, their text, --noise and the
states of --calibrate follow from that. A key that ends in _deg or _dps is in degrees, its field in radians.
"""

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import NamedTuple

SENSOR_UNITS: Mapping[str, str] = {"dvl": "mps", "compass": "deg", "usbl": "m", "gps": "m"}
"""The unit of a sensor's noise, as keys end in it."""


class Limits(NamedTuple):
    """How small and how large a number may be and still mean something, far wider than any vehicle."""

    least: float
    most: float
    above: bool = False  # the least itself is refused


SHARE = Limits(1e-9, 1 - 1e-9)
SECONDS = Limits(1e-3, 1e9)
METRES = Limits(-1e7, 1e7)  # on the plane, which ends long before
SD = {"m": Limits(1e-6, 1e6), "deg": Limits(1e-6, 360.0), "mps": Limits(1e-6, 1e3)}
SPREAD = {unit: Limits(0.0, sd.most) for unit, sd in SD.items()}  # of what may have none


class Quantity(NamedTuple):
    """How the number of a field is stated."""

    key: str  # with its unit; "{unit}" stands for the one of the sensor
    limits: Limits = SD["m"]  # of a key in the sensor's unit: SD of that unit
    required: bool = False  # there is no default

    @property
    def angle(self) -> bool:
        """Whether it is stated in degrees."""
        return self.key.endswith(("_deg", "_dps"))

    def to_model(self, stated: float) -> float:
        """Return the number in the unit of its field."""
        return math.radians(stated) if self.angle else stated


class ReportedQuantity(NamedTuple):
    """How a state of an error is told to people, and which key takes that error off the readings."""

    name: str  # with its unit
    unit: str  # "" for a share of the reading
    factor: float  # from the state to that unit
    section: str = ""
    key: str = ""  # "" if there is none
    digits: int = 3  # written of it


class SensorError(NamedTuple):
    """A constant error of a sensor that can be estimated."""

    key: str  # of --calibrate
    states: Mapping[str, ReportedQuantity]


def quantities(owner: type, sensor: str = "") -> dict[str, Quantity]:
    """Return field -> quantity of a dataclass; ``sensor``: the one whose unit "{unit}" is."""
    found: dict[str, Quantity] = {}
    hints = typing.get_type_hints(owner, include_extras=True)
    for field in dataclasses.fields(owner):
        for quantity in typing.get_args(hints[field.name])[1:]:
            if isinstance(quantity, Quantity):
                required = field.default is dataclasses.MISSING
                if "{unit}" in quantity.key:
                    unit = SENSOR_UNITS[sensor]
                    required |= unit != "m"  # a default in metres means nothing elsewhere
                    quantity = Quantity(quantity.key.format(unit=unit), SD[unit])
                found[field.name] = quantity._replace(required=required)
    return found


def sensor_errors_of(owner: type) -> dict[str, SensorError]:
    """Return field -> sensor error whose 1-sigma before anything is measured that field holds."""
    hints = typing.get_type_hints(owner, include_extras=True)
    return {
        name: error for name, hint in hints.items() for error in typing.get_args(hint) if isinstance(error, SensorError)
    }
