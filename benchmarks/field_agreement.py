"""Do fixes, dead reckoning and truth agree on how far and where the vehicle went? What no filter can mend shows here.

Moves over a minute are compared: a common length ratio (a scale) and a common turn (a heading) by least squares.
The truth serves to judge and goes nowhere else.
"""

import math
from typing import NamedTuple

import numpy as np

from field_logs import Dive
from usbldr.filters.alignment import fit_rigid
from usbldr.filters.baselines import at_times, displacement_m
from usbldr.filters.types import Array, Vector

OVER_S = 60.0
TRIMMED = 3.0  # times the median residual: a pair further off holds a gross fix


class Likeness(NamedTuple):
    """How the moves of one track compare with those of another."""

    ratio: float  # of lengths
    turn_deg: float  # clockwise
    pairs: int


def agreement(found: Dive) -> dict[str, Likeness]:
    """Return fixes over dead reckoning, and truth over dead reckoning, at the fixes' own times."""
    line, truth = found.line, found.truth
    t = line.fix_time_s
    reckoned = at_times(line, displacement_m(line), t)
    there = np.column_stack([np.interp(t, truth.time_s, column) for column in truth.position_m.T])
    known = (t >= truth.time_s[0]) & (t <= truth.time_s[-1])
    return {
        "fixes over DR": likeness(t, reckoned, line.fix_m),
        "truth over DR": likeness(t[known], reckoned[known], there[known]),
    }


def likeness(time_s: Vector, base_m: Array, other_m: Array) -> Likeness:
    """Compare the moves over a minute of one track, (F, 2), with those of a base that has less noise."""
    later = np.searchsorted(time_s, time_s + OVER_S)
    first = np.flatnonzero(later < len(time_s))
    base, other = (track[later[first]] - track[first] for track in (base_m, other_m))
    kept = np.ones(len(base), np.bool_)
    ratio, turn = 1.0, 0.0
    for _ in range(10):  # until the same pairs are left
        both = [np.concatenate([moves[kept], -moves[kept]]) for moves in (base, other)]  # about the origin
        alignment = fit_rigid(*both)
        turned = base @ alignment.matrix.T
        ratio = float(np.sum(turned[kept] * other[kept]) / np.sum(turned[kept] ** 2))
        turn = -math.degrees(alignment.rotation_rad)
        off_m = np.hypot(*(ratio * turned - other).T)
        still = off_m <= TRIMMED * np.median(off_m)
        if np.array_equal(still, kept):
            break
        kept = still
    return Likeness(ratio, turn, int(kept.sum()))
