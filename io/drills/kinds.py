"""The kinds of faults, as they are written and explained; their effects are in effects.py."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

Rule: TypeAlias = Literal["needed", "optional", "none"]
Units: TypeAlias = Mapping[str, str | None]  # by sensor; "": a factor; None: it takes no number

SENSORS = ("compass", "dvl", "usbl")
SIZES: Units = {"compass": "deg", "dvl": "m/s", "usbl": "m"}
FACTORS: Units = dict.fromkeys(SENSORS, "")
RATES: Units = dict.fromkeys(SENSORS, "Hz")
SECONDS: Units = dict.fromkeys(SENSORS, "s")
NO_NUMBER: Units = dict.fromkeys(SENSORS, None)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of fault: for which sensors, in which unit, and where in a log it may be."""

    meaning: str  # one sentence of help
    example: str
    units: Units
    spans: Rule = "optional"
    share: Rule = "none"
    positive: bool = False  # its number is
    draws: bool = False  # random numbers, even if it hits every record


KINDS: Mapping[str, Kind] = {
    "sd": Kind("The stated sigma is wrong by a factor.", "usbl:4", FACTORS, positive=True),
    "scale": Kind("Velocities are wrong by a factor.", "dvl:1.05", {"dvl": ""}, positive=True),
    "bias": Kind("A constant error: clockwise, forward or east.", "compass:3deg@300:360", SIZES),
    "drift": Kind("An error that grows from 0 over a span.", "compass:10deg@200:500", SIZES, "needed"),
    "lever": Kind("The sensor is ahead of where it is stated.", "dvl:2m", {"dvl": "m", "usbl": "m"}, "none"),
    "scatter": Kind("More Gaussian noise, of this sigma.", "usbl:4m@200:400", SIZES, positive=True, draws=True),
    "spike": Kind("Some records are off by exactly this.", "compass:120deg@0.02", SIZES, share="needed", draws=True),
    "outlier": Kind("Some records have an error of this sigma.", "usbl:20m@0.05", SIZES, share="needed", draws=True),
    "cluster": Kind("Fixes are off by the same vector.", "usbl:32m@320:380", {"usbl": "m"}, "needed", draws=True),
    "stuck": Kind("The first record of a span is repeated.", "usbl@200:260", NO_NUMBER, "needed"),
    "zero": Kind("Velocities are 0, and stated as valid.", "dvl@100:160", {"dvl": None}, "needed"),
    "thin": Kind("At most this many records a second.", "usbl:0.1Hz", RATES, positive=True),
    "drop": Kind("No records in a span, or a share is lost.", "usbl@300:600", NO_NUMBER, share="optional"),
    "latency": Kind("Records are stamped late.", "usbl:2s", SECONDS, "none"),
    "clock": Kind("The clock of a sensor is ahead.", "dvl:1s", SECONDS, "none"),
}
"""Every kind, in the order in which the faults of one drill are put into a log: stamps change last."""
