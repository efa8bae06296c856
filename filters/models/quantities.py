"""Numbers of the model as users state them: key with unit, limits, and the sensor error that each belongs to.

Each is declared once, in the annotation of its field. The sections of usbldr.toml, their text, --noise and the
states of --calibrate follow from that. A key that ends in _deg or _dps is in degrees, its field in radians.
"""

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import NamedTuple

SENSOR_UNITS: Mapping[str, str] = {"dvl": "mps", "compass": "deg", "usbl": "m", "gps": "m"}
"""Unit of a sensor's noise, as in the endings of keys."""


class Limits(NamedTuple):
    """Least and most allowed value, far wider than any vehicle needs."""

    least: float
    most: float
    above: bool = False  # the least itself is not allowed


SHARE = Limits(1e-9, 1 - 1e-9)
SECONDS = Limits(1e-3, 1e9)
METRES = Limits(-1e7, 1e7)  # far beyond the local plane
SD = {"m": Limits(1e-6, 1e6), "s": Limits(1e-6, 600.0), "deg": Limits(1e-6, 360.0), "mps": Limits(1e-6, 1e3)}
SPREAD = {unit: Limits(0.0, sd.most) for unit, sd in SD.items()}  # of a sigma that may be 0


class Quantity(NamedTuple):
    """Key and limits of the number of a field."""

    key: str  # with its unit; "{unit}" is replaced by that of the sensor
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
    """Name and unit of a sensor error in reports, and the key that removes the error from the records."""

    name: str  # with its unit
    unit: str  # "" for a relative error
    factor: float  # from the state to that unit
    section: str = ""
    key: str = ""  # "" if there is none
    digits: int = 3  # decimal places


class SensorError(NamedTuple):
    """A constant error of a sensor that can be estimated."""

    key: str  # of --calibrate
    states: Mapping[str, ReportedQuantity]


def quantities(owner: type, sensor: str = "") -> dict[str, Quantity]:
    """Return field -> quantity of a dataclass; ``sensor``: replaces "{unit}" by its unit."""
    by_field: dict[str, Quantity] = {}
    hints = typing.get_type_hints(owner, include_extras=True)
    for field in dataclasses.fields(owner):
        for quantity in typing.get_args(hints[field.name])[1:]:
            if isinstance(quantity, Quantity):
                required = field.default is dataclasses.MISSING
                if "{unit}" in quantity.key:
                    unit = SENSOR_UNITS[sensor]
                    required |= unit != "m"  # a default in metres means nothing elsewhere
                    quantity = Quantity(quantity.key.format(unit=unit), SD[unit])
                by_field[field.name] = quantity._replace(required=required)
    return by_field


def sensor_errors_of(owner: type) -> dict[str, SensorError]:
    """Return field -> sensor error whose prior 1-sigma is that field."""
    hints = typing.get_type_hints(owner, include_extras=True)
    return {
        name: error for name, hint in hints.items() for error in typing.get_args(hint) if isinstance(error, SensorError)
    }
