"""What a doctor says of a log: a stable code, how bad it is, a sentence, and where and how much.

docs/findings.md explains each code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from usbldr.io.log import Finding

Level: TypeAlias = Literal["error", "warning", "info"]

FINDING_LEVELS: Mapping[str, Level] = {
    "ROLE-UNDECIDED": "error",
    "UNUSABLE": "error",
    "SENSOR-MISSING": "error",
    "HEADING-CONVENTION": "error",
    "MAP-FRAME": "error",
    "DVL-AXES": "error",
    "HEADING-RADIANS": "error",
    "DVL-UNIT": "error",
    "PLACES-APART": "error",
    "ROLE-PREFERRED": "info",
    "CONVENTION-CHECKED": "info",
    "CONVENTION-UNOBSERVABLE": "info",
    "HEADING-CHECKED": "info",
    "USBL-DELAYED": "info",
    "USBL-NOISE": "info",
    "REPEATED": "info",
    "USBL-REPEATED": "info",
    "OUT-OF-ORDER": "info",
    "NO-HEADER": "info",
    "SAME-STAMP": "info",
}
"""Codes that are more or less than a warning."""


@dataclass(frozen=True, slots=True)
class GradedFinding:
    """One finding, with its place and its size."""

    code: str
    level: Level
    text: str  # one sentence
    topic: str = ""
    time_s: float | None = None  # since the log's start: where it is worst
    worst: float | None = None
    unit: str = ""


def graded_finding(
    code: str, text: str, topic: str = "", time_s: float | None = None, worst: float | None = None, unit: str = ""
) -> GradedFinding:
    """Return a diagnosis at the level of its code."""
    return GradedFinding(code, FINDING_LEVELS.get(code, "warning"), text, topic, time_s, worst, unit)


def grade(finding: Finding) -> GradedFinding:
    """Return what reading noticed as a diagnosis; its topic stands before the colon."""
    head, colon, _ = finding.text.partition(": ")
    level: Level = "error" if finding.lost_data else FINDING_LEVELS.get(finding.code, "warning")
    return GradedFinding(finding.code, level, finding.text, head if colon and head.startswith("/") else "")
