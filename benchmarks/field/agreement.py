"""Whether fixes, dead reckoning and truth agree on scale, rotation and time; no filter can correct a disagreement.

    python benchmarks/field/agreement.py

Moves between fixes are compared: the time by which one source is ahead of the other, a common length ratio (a scale)
and a common turn (a heading), by least squares. The truth serves to judge and goes nowhere else.
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # field is a package

from field.logs import FOLDERS, SCENARIO, Dive, dive
from usbldr.filters.evaluation.alignment import fit_rigid
from usbldr.filters.replay.dead_reckoning import displacement_m, velocity_mps
from usbldr.filters.types import Array, Timeline, Vector
from usbldr.filters.windows import columns_at

OVER_S = 60.0  # long enough for moves well above the noise of both
LEADS_S = np.arange(-16, 17) / 4
MIN_RESIDUAL_RATIO = 1.05  # residual a second off the best lead over the least one; below, not observable
TRIMMED = 3.0  # times the median residual: a pair further off holds a gross fix


class Likeness(NamedTuple):
    """How the moves of a source compare with those of dead reckoning."""

    lead_s: float  # the source is this much ahead of dead reckoning; NaN: not observable
    lead_m: float  # at the vehicle's median speed
    ratio: float  # of lengths
    turn_deg: float  # clockwise


def agreement(found: Dive) -> dict[str, Likeness]:
    """Return how fixes and truth compare with dead reckoning, both at the fixes' own times."""
    line, truth = found.line, found.truth
    t = line.fix_time_s
    there = np.column_stack([np.interp(t, truth.time_s, column) for column in truth.position_m.T])
    known = (t >= truth.time_s[0]) & (t <= truth.time_s[-1])
    return {"fixes": likeness(line, t, line.fix_m), "truth": likeness(line, t[known], there[known])}


def likeness(line: Timeline, time_s: Vector, source_m: Array) -> Likeness:
    """Compare the moves of a source, (F, 2), with those of dead reckoning, which has less noise."""
    later = np.searchsorted(time_s, time_s + OVER_S)
    first = np.flatnonzero(later < len(time_s))
    moved, travelled_m = source_m[later[first]] - source_m[first], displacement_m(line)
    fits: dict[float, Fit] = {}
    for lead_s in LEADS_S.tolist():
        reckoned = columns_at(time_s + lead_s, line.time_s, travelled_m)
        fits[lead_s] = _fitted(reckoned[later[first]] - reckoned[first], moved)
    best = min(fits, key=lambda lead_s: fits[lead_s].residual_m)
    beside = min(fits[lead_s].residual_m for lead_s in (best - 1.0, best + 1.0) if lead_s in fits)
    if beside < MIN_RESIDUAL_RATIO * fits[best].residual_m:
        return Likeness(math.nan, math.nan, fits[0.0].ratio, fits[0.0].turn_deg)
    speed_mps = float(np.median(np.hypot(*velocity_mps(line).T)))
    return Likeness(best, speed_mps * best, fits[best].ratio, fits[best].turn_deg)


class Fit(NamedTuple):
    """The best ratio and turn of some moves."""

    residual_m: float  # median
    ratio: float
    turn_deg: float


def _fitted(base: Array, other: Array) -> Fit:
    """Fit the moves of a source without the gross ones among them."""
    kept = np.ones(len(base), np.bool_)
    while True:
        both = [np.concatenate([moves[kept], -moves[kept]]) for moves in (base, other)]  # about the origin
        alignment = fit_rigid(both[0], both[1])
        turned = base @ alignment.matrix.T
        ratio = float(np.sum(turned[kept] * other[kept]) / np.sum(turned[kept] ** 2))
        off_m = np.hypot(*(ratio * turned - other).T)
        still = kept & (off_m <= TRIMMED * np.median(off_m))  # never taken in again, so that this ends
        if np.array_equal(still, kept):
            return Fit(float(np.median(off_m)), ratio, -math.degrees(alignment.rotation_rad))
        kept = still


def main() -> None:
    print(f"| log | against DR | ahead by | at median speed | length ratio | rotated clockwise |\n|{'---|' * 6}")
    for name in (*FOLDERS, SCENARIO):
        for source, one in agreement(dive(name)).items():
            lead = f"{one.lead_s:+.2f} s | {one.lead_m:+.2f} m" if math.isfinite(one.lead_s) else "· | ·"
            print(f"| {name} | {source} | {lead} | {one.ratio:.3f} | {one.turn_deg:+.1f}° |")


if __name__ == "__main__":
    main()
