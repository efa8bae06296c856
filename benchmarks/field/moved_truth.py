"""Write the truth of uib_field, turned and shifted once to where its raw fixes lie.

    python benchmarks/field/moved_truth.py moved.csv
    usbldr compare uib_field.mcap --truth moved.csv --set truth.skip_rows=0

It hangs on no filter and on no single point, so that filters can be compared although the map of a visual SLAM run has
a frame of its own. Metres and seconds, east before north.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # field is a package

from field.logs import dive
from usbldr.filters.evaluation.alignment import fit_rigid
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.types import Timeline, Truth

TRIMMED = 3.0  # times the median residual: a fix further off has no part in the alignment
FIXES_FROM = Window(4.0, 1084.0)  # of uib_field, as its authors scored it


def moved_onto_fixes(truth: Truth, line: Timeline, window: Window = FIXES_FROM) -> Truth:
    """Turn and shift a truth to where the raw fixes lie, without the gross ones among them."""
    stamps = line.fix_time_s
    among = (stamps > max(window.start_s, truth.time_s[0])) & (stamps < min(window.end_s, truth.time_s[-1]))
    fix_m = line.fix_m[among]
    there_m = np.column_stack([np.interp(stamps[among], truth.time_s, column) for column in truth.position_m.T])
    near, alignment = np.ones(len(fix_m), np.bool_), fit_rigid(there_m, fix_m)
    while True:
        off_m = np.hypot(*(alignment.points(there_m) - fix_m).T)
        still = off_m < TRIMMED * np.median(off_m)
        if np.array_equal(still, near):
            source = f"{truth.source}, moved once onto the fixes"
            return replace(truth, position_m=alignment.points(truth.position_m), source=source)
        near, alignment = still, fit_rigid(there_m[still], fix_m[still])


def main(file: str) -> None:
    log, line, truth = dive("uib_field")
    moved = moved_onto_fixes(truth, line)
    rows = zip(log.start_ns + np.rint(1e9 * moved.time_s).astype(np.int64), moved.position_m, strict=True)
    text = "".join(f"{ns // 10**9}.{ns % 10**9:09d},{north_m:.9f},{east_m:.9f}\n" for ns, (east_m, north_m) in rows)
    Path(file).write_text("timestamp,x,y\n" + text, encoding="utf-8")  # as uib_field.toml reads the truth


if __name__ == "__main__":
    main(*sys.argv[1:])
