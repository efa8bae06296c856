"""What a user should know of a log: a stable code, its level, a sentence, a place and a value.

docs/findings.md explains each code.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from usbldr.filters.errors import sentence

Level: TypeAlias = Literal["error", "warning", "info"]

_CODES: Mapping[Level, str] = {
    "error": "ROLE-UNDECIDED UNUSABLE SENSOR-MISSING HEADING-CONVENTION MAP-FRAME DVL-AXES DVL-EARTH HEADING-RADIANS "
    "DVL-UNIT PLACES-APART USBL-MOTION",
    "info": "ROLE-PREFERRED ROLE-SHIP COLUMNS-BY-NAME DATE-ORDER DATE-OF-OTHERS CONCATENATED TOPIC-PARTS LAYOUT-FILE "
    "TRUTH-FRAME ESTIMATE-FRAME CONVENTION-CHECKED CONVENTION-UNOBSERVABLE HEADING-CHECKED USBL-DELAYED "
    "USBL-VERTICAL USBL-NOISE REPEATED USBL-REPEATED GPS-HELD DVL-HELD OUT-OF-ORDER NO-HEADER SAME-STAMP "
    "EXCLUDED SET",
}
FINDING_LEVELS: Mapping[str, Level] = {code: level for level, codes in _CODES.items() for code in codes.split()}
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
