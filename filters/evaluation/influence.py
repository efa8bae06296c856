"""Which fixes the track hangs on: how far each moved it when it came, and what the track would be without it.

A recursive filter that leaves a fix out has, until the next one, the track of before: so the shift at the update is the
effect of leaving it out (the case deletion of R. D. Cook, "Detection of influential observation in linear regression",
Technometrics 19(1), 1977, for a filter as it stands at that moment). Later fixes wear it off, and how soon they do, or
whether later fixes are accepted at all then, only a run without the fix shows. Metres, east and north.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Timeline, Trajectory
from usbldr.filters.updates import UpdateTable


class Influence(NamedTuple):
    """What one USBL fix did to the track."""

    row: int  # of the Timeline's fixes
    time_s: float  # when it was used
    shift_east_m: float
    shift_north_m: float
    innovation_east_m: float  # how far the fix lay from where the filter expected it
    innovation_north_m: float
    outcome: str

    @property
    def shift_m(self) -> float:
        """How far the track would lie elsewhere without it."""
        return math.hypot(self.shift_east_m, self.shift_north_m)


class LeaveOneOut(NamedTuple):
    """What the whole run would have been without one fix."""

    fix: Influence
    largest_shift_m: float  # of the track: how far it lies elsewhere with the fix
    largest_at_s: float
    mean_shift_m: float  # over the whole run
    error_change_m: float  # of the mean horizontal error, without minus with; NaN where there is no truth


def influences(trajectory: Trajectory) -> Mapping[int, Influence]:
    """Return by row every fix that the filter judged; none for a method that reports no shift."""
    x, y = (trajectory.names.index(state) for state in ("x", "y"))
    fixes = UpdateTable.of(trajectory.updates).of_sensor("usbl")
    columns = (fixes.row, fixes.time_s, fixes.shift(x), fixes.shift(y), *fixes.vectors("innovation").T, fixes.outcome)
    found = map(Influence, *(column.tolist() for column in columns))
    return {one.row: one for one in found if math.isfinite(one.shift_east_m)}


def most_influential(trajectory: Trajectory, count: int = 5) -> tuple[Influence, ...]:
    """Return the fixes that moved the track most, the first of them first."""
    return tuple(sorted(influences(trajectory).values(), key=lambda fix: -fix.shift_m)[:count])


def without_fix(timeline: Timeline, row: int) -> Timeline:
    """Return the timeline as if this USBL fix had never come; outages stay those of the log."""
    kept = np.arange(len(timeline.fix_time_s)) != row
    return timeline.with_fixes(kept)


def compare_without(
    fix: Influence, whole: Trajectory, without: Trajectory, error_change_m: float = math.nan
) -> LeaveOneOut:
    """Compare the track with that of a run without the fix, epoch by epoch."""
    shift_m = np.hypot(*(whole.position_m - without.position_m).T)
    largest = int(np.argmax(shift_m))
    at_s, mean_m = float(whole.time_s[largest]), float(shift_m.mean())
    return LeaveOneOut(fix, float(shift_m[largest]), at_s, mean_m, error_change_m)
