"""What a user should know of a log: a stable code, its level, a sentence, a place and a value.

docs/findings.md explains each code.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from usbldr.filters.errors import sentence

Level: TypeAlias = Literal["error", "warning", "info"]

FINDING_LEVELS: Mapping[str, Level] = {
    "ROLE-UNDECIDED": "error",
    "UNUSABLE": "error",
    "SENSOR-MISSING": "error",
    "HEADING-CONVENTION": "error",
    "MAP-FRAME": "error",
    "DVL-AXES": "error",
    "DVL-EARTH": "error",
    "HEADING-RADIANS": "error",
    "DVL-UNIT": "error",
    "PLACES-APART": "error",
    "USBL-MOTION": "error",
    "ROLE-PREFERRED": "info",
    "ROLE-SHIP": "info",
    "COLUMNS-BY-NAME": "info",
    "DATE-ORDER": "info",
    "DATE-OF-OTHERS": "info",
    "CONCATENATED": "info",
    "TOPIC-PARTS": "info",
    "LAYOUT-FILE": "info",
    "TRUTH-FRAME": "info",
    "ESTIMATE-FRAME": "info",
    "CONVENTION-CHECKED": "info",
    "CONVENTION-UNOBSERVABLE": "info",
    "HEADING-CHECKED": "info",
    "USBL-DELAYED": "info",
    "USBL-VERTICAL": "info",
    "USBL-NOISE": "info",
    "REPEATED": "info",
    "USBL-REPEATED": "info",
    "USBL-INTERPOLATED": "warning",
    "GPS-HELD": "info",
    "DVL-HELD": "info",
    "OUT-OF-ORDER": "info",
    "NO-HEADER": "info",
    "SAME-STAMP": "info",
    "EXCLUDED": "info",
    "SET": "info",
}
"""Codes whose level is not a warning."""


UNDATED = (
    "the times have no date; the first day is taken as 1970-01-01; state path and date of each file under [[file]]"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding of a reader, of the doctor or of replay; its level follows from its code, and from data lost."""

    code: str  # "DVL-INVALID", "OUT-OF-ORDER", "TRUNCATED"
    level: Level = field(init=False)
    text: str  # one sentence
    topic: str = ""  # "": concerns no single topic
    time_s: float | None = None  # of the worst value, since the log's start
    worst: float | None = None
    unit: str = ""  # of worst
    lost_data: bool = False  # part of the input could not be read: exit code 3

    def __post_init__(self) -> None:
        level = "error" if self.lost_data else FINDING_LEVELS.get(self.code, "warning")
        object.__setattr__(self, "level", level)
        object.__setattr__(self, "text", sentence(self.text))
