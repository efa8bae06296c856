"""Dead reckoning through gaps of the DVL: records left out on purpose, displacement against that of the whole log.

    python benchmarks/field/velocity_gaps.py

"held" keeps the velocity that the filter had at the start of the gap; "usual" is the filters' model, see
filters/models/usual_velocity.py. The compass is used throughout, fixes are not. NEES is divided by 2: 1 is honest.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # field is a package

from field.logs import dive, field_folder
from usbldr.filters.frames import rotated
from usbldr.filters.models.parameters import Parameters, Start
from usbldr.filters.models.states import POSITION
from usbldr.filters.replay.run import run
from usbldr.filters.types import Array, Timeline

LOGS = ("uib_field", "uib_simulation", "stpere_marina")
GAPS_S = (30.0, 60.0, 120.0)
FIRST_S, PAUSE_S = 120.0, 60.0  # records before the first gap, and between two of them
EXACT = Parameters(start=Start(0.0, 0.0, 0.01))  # what counts is the displacement


def without_velocity(line: Timeline, start_s: Array, gap_s: float) -> Timeline:
    """Return the timeline without the DVL records inside the gaps."""
    inside = np.any([(line.time_s > start) & (line.time_s <= start + gap_s) for start in start_s], axis=0)
    mps = np.where(inside[:, None], np.nan, line.dvl_mps)
    return replace(line, dvl_mps=mps, dvl_count=np.where(inside, 0, line.dvl_count))


def errors(line: Timeline, gap_s: float) -> tuple[float, float, float, int]:
    """Return the rms error of the displacement, held and usual, m, NEES / 2 of the latter, and the count of gaps."""
    start_s = np.arange(FIRST_S, line.time_s[-1] - gap_s, gap_s + PAUSE_S)
    whole, gappy = run("ekf", line, EXACT), run("ekf", without_velocity(line, start_s, gap_s), EXACT)
    assert gappy.cov is not None
    held: list[float] = []
    usual: list[float] = []
    nees: list[float] = []
    for a, b in np.searchsorted(line.time_s, np.column_stack([start_s, start_s + gap_s])).tolist():
        true_m = whole.position_m[b] - whole.position_m[a]
        V = rotated(gappy.mean[a : b + 1, 0], np.tile(gappy.mean[a, 1:3], (b + 1 - a, 1)))
        held.append(float(np.sum((np.trapezoid(V, line.time_s[a : b + 1], axis=0) - true_m) ** 2)))
        e = gappy.position_m[b] - gappy.position_m[a] - true_m
        P = (gappy.cov[b] - gappy.cov[a])[np.ix_(POSITION, POSITION)]
        usual.append(float(e @ e))
        nees.append(float(e @ np.linalg.solve(P, e)) / 2)
    return float(np.sqrt(np.mean(held))), float(np.sqrt(np.mean(usual))), float(np.mean(nees)), len(held)


def main() -> None:
    """Print a table."""
    print("log, gap: held, usual (NEES / 2; gaps)")
    for name in LOGS:
        line = dive(name, 0, field_folder()).line
        line = line.with_fixes(np.zeros(len(line.fix_time_s), np.bool_))
        for gap_s in GAPS_S:
            held_m, usual_m, ratio, count = errors(line, gap_s)
            print(f"{name}, {gap_s:.0f} s: {held_m:.2f} m, {usual_m:.2f} m ({ratio:.2f}; {count})", flush=True)


if __name__ == "__main__":
    main()
