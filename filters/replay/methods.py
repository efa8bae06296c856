"""Every way of making a track, by its name on the command line: the filters, and the tracks without one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.models.parameters import Assumptions
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay import dead_reckoning
from usbldr.filters.replay.position_fixes import usbl_fixes
from usbldr.filters.replay.prior import starting_fixes, vehicle_positions_m
from usbldr.filters.replay.run import FILTERS, FilterSettings, run
from usbldr.filters.types import Timeline, Trajectory, Truth, Vector

METHODS = (*FILTERS, "nudge", "dr", "usbl")


class Anchor(NamedTuple):
    """Where dead reckoning is tied to the map."""

    position_m: Vector  # (2,) east, north
    time_s: float
    description: str  # "the first five fixes"


def track(
    method: str,
    timeline: Timeline,
    assumptions: Assumptions,
    settings: FilterSettings,
    anchor: Anchor | None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Trajectory:
    """Make a track by one of METHODS; ``dr`` alone needs the anchor."""
    if method == "usbl":
        return dead_reckoning.usbl(timeline)
    if method == "nudge":
        return dead_reckoning.nudge(timeline)
    if method == "dr":
        if anchor is None:
            raise LogError(
                "dead reckoning has nothing to start from: give --dr-from first-gps or LAT,LON, or state [start]"
            )
        return dead_reckoning.dr(timeline, anchor.position_m, anchor.time_s)
    return run(method, timeline, assumptions, settings, progress)


def find_anchor(where: str, timeline: Timeline, assumptions: Assumptions, truth: Truth | None) -> Anchor | None:
    """Return the anchor "start", "first-fix", "first-gps" or "first-truth" of a log, None where it has no such thing.

    "start" is the stated start, else the first fixes: what a filter starts from too. A single fix may be a gross
    error, so "first-fix" is the median of the first five.
    """
    if where == "start" and assumptions.start is not None:
        start = assumptions.start
        return Anchor(np.array([start.east_m, start.north_m]), 0.0, "the stated start")
    if where in ("start", "first-fix"):
        usbl = usbl_fixes(timeline, assumptions, StateLayout())
        fixes = (
            (usbl.time_s, vehicle_positions_m(timeline, usbl))
            if where == "first-fix"
            else starting_fixes(timeline, assumptions)
        )
        if not len(fixes[0]):
            return None
        return Anchor(dead_reckoning.start_position(timeline, *fixes)[0], 0.0, "the first five fixes")
    if where == "first-gps":
        if not len(timeline.gps_time_s):
            return None
        return Anchor(timeline.gps_m[0], float(timeline.gps_time_s[0]), "the first GPS fix")
    if truth is None or not len(truth.time_s):
        return None
    inside = truth.time_s >= 0
    first = int(inside.argmax()) if inside.any() else 0
    return Anchor(truth.position_m[first], max(0.0, float(truth.time_s[first])), "the first row of the truth")
