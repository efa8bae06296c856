"""Which fixes the track hangs on: how far each moved it when it came, which is where it would lie without it.

A recursive filter that leaves a fix out has, until the next one, the track of before: so the shift at the update is the
effect of leaving it out (the case deletion of R. D. Cook, "Detection of influential observation in linear regression",
Technometrics 19(1), 1977, for a filter as it stands at that moment). Later fixes wear it off. Metres, east and north.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from usbldr.filters.consistency import worst_fate
from usbldr.filters.types import Trajectory, Update


class Influence(NamedTuple):
    """What one USBL fix did to the track."""

    row: int  # of the Timeline's fixes
    time_s: float  # when it was used
    shift_east_m: float
    shift_north_m: float
    innovation_east_m: float  # how far the fix lay from where the filter expected it
    innovation_north_m: float
    fate: str

    @property
    def shift_m(self) -> float:
        """How far the track would lie elsewhere without it."""
        return math.hypot(self.shift_east_m, self.shift_north_m)


def influences(trajectory: Trajectory) -> Mapping[int, Influence]:
    """Return by row every fix that the filter judged; none for a method that tells of no shift."""
    by_fix: dict[int, list[Update]] = {}
    for update in trajectory.updates:
        if update.sensor == "usbl" and update.shift is not None:
            by_fix.setdefault(update.row, []).append(update)
    return {row: _influence(row, updates, trajectory.names) for row, updates in by_fix.items()}


def influential(trajectory: Trajectory, count: int = 5) -> tuple[Influence, ...]:
    """Return the fixes that moved the track most, the first of them first."""
    return tuple(sorted(influences(trajectory).values(), key=lambda fix: -fix.shift_m)[:count])


def innovation_m(updates: Iterable[Update]) -> tuple[float, float]:
    """Return the innovation east and north of one fix, which is one update of two axes or two of one; NaN unknown."""
    e: dict[str, float] = {}
    for update in updates:
        axes = ("east", "north") if update.axis == "position" else (update.axis,)
        e.update(zip(axes, update.innovation, strict=True))
    return e.get("east", math.nan), e.get("north", math.nan)


def _influence(row: int, updates: Sequence[Update], names: Sequence[str]) -> Influence:
    east_m, north_m = (sum(u.shift[names.index(state)] for u in updates if u.shift is not None) for state in ("x", "y"))
    fate = worst_fate(u.fate for u in updates)
    return Influence(row, updates[0].time_s, east_m, north_m, *innovation_m(updates), fate)
