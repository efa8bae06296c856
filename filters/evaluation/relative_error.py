"""Relative errors: how far a track drifts over segments of the way, in percent of the distance travelled.

The change of the error over a segment does not depend on a constant shift, so it judges a track whose map origin is
unknown. Navigators call it percent of distance travelled; evo and KITTI measure it likewise (A. Geiger, P. Lenz, R.
Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012,
doi:10.1109/CVPR.2012.6248074), but turn each segment onto the truth, which hides a wrong heading.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Indices, Vector

LENGTHS_M = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)  # three a decade
STEP_M = 5.0  # [m] of the way between two points that measure it: shorter ones would add the noise of a GPS
LEAST_SEGMENTS = 2.0  # of a length fit into the way, one behind the other


class RelativeError(NamedTuple):
    """The error over all segments of one length, in percent of the distance travelled."""

    length_m: float
    mean_percent: float
    rms_percent: float
    p95_percent: float
    segments: int  # one from each scored epoch, so that they overlap


def relative_errors(time_s: Vector, error_m: Array, truth_m: Array, max_gap_s: float) -> tuple[RelativeError, ...]:
    """Return the relative errors of each length that fits, of M epochs with errors and truth (M, 2).

    The distance travelled is that of the truth. A segment does not cross a gap longer than ``max_gap_s``.
    """
    way_m = distance_m(truth_m)
    gaps = np.concatenate([[0], np.cumsum(np.diff(time_s) > max_gap_s)])
    found: list[RelativeError] = []
    for length_m in LENGTHS_M:
        if way_m[-1] < LEAST_SEGMENTS * length_m:
            break
        end: Indices = np.searchsorted(way_m, way_m + length_m)
        start = np.flatnonzero(end < len(way_m))
        start = start[gaps[start] == gaps[end[start]]]
        if not len(start):
            continue
        end = end[start]
        change_m: Vector = np.hypot(*(error_m[end] - error_m[start]).T)
        percent = 100 * change_m / (way_m[end] - way_m[start])
        rms = float(np.sqrt(np.mean(percent**2)))
        found.append(RelativeError(length_m, float(percent.mean()), rms, float(np.percentile(percent, 95)), len(start)))
    return tuple(found)


def distance_m(position_m: Array) -> Vector:
    """Return the distance travelled at M positions (M, 2), (M,): between points at least STEP_M apart, else by time."""
    rows = [0]
    for row, place_m in enumerate(position_m):
        if np.hypot(*(place_m - position_m[rows[-1]])) >= STEP_M:
            rows.append(row)
    steps_m = np.hypot(*np.diff(position_m[rows], axis=0).T)
    return np.interp(np.arange(len(position_m)), rows, np.concatenate([[0.0], np.cumsum(steps_m)]))
