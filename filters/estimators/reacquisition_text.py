"""Sentences on fixes that contradicted the track: one for each time, or a summary with the largest."""

import math
from collections.abc import Sequence

from usbldr.filters.types import Reacquisition

MAX_SENTENCES = 5  # sentences: more hide the other warnings of a run


def reacquisition_texts(found: Sequence[Reacquisition], least_outage_s: float = math.inf) -> tuple[str, ...]:
    """Return sentences on how ambiguities ended; of many, a summary and those that moved the track most.

    Fixes that are ``least_outage_s`` apart have an outage between them.
    """
    if len(found) <= MAX_SENTENCES:
        return tuple(_sentence(one, least_outage_s) for one in found)
    accepted = sum(one.accepted for one in found)
    largest = sorted(found, key=lambda one: -one.jump_m)[:MAX_SENTENCES]
    summary = (
        f"USBL fixes contradicted the track or the fixes around them {len(found)} times: {accepted} times accepted, "
        f"{len(found) - accepted} times rejected; the {MAX_SENTENCES} that moved the track most follow"
    )
    return summary, *(_sentence(one, least_outage_s) for one in sorted(largest, key=lambda one: one.since_s))


def _sentence(one: Reacquisition, least_outage_s: float) -> str:
    outage = f" (after an outage of {one.outage_s:.0f} s)" if least_outage_s <= one.outage_s < math.inf else ""
    fixes = f"USBL fixes from {one.since_s:.1f} s{outage}"
    if one.accepted:
        rejected = f" after {_count(one.refused, 'rejected fix')}" if one.refused else ""
        moved = f"track moved {one.jump_m:.1f} m"
        return f"{fixes} contradicted the track: accepted at {one.resolved_s:.1f} s{rejected}; {moved}"
    moved = f"; track moved back {one.jump_m:.1f} m" if one.jump_m else f" ({_count(one.refused, 'fix')})"
    return f"{fixes} contradicted the fixes before and after them: rejected at {one.resolved_s:.1f} s{moved}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 'es'}"
