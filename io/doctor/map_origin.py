"""Propose the origin of a map of local fixes, from GPS fixes near in time to USBL fixes.

GPS is the truth, so the proposal must not reach a run unless the user states it.
"""

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import Points, as_points
from usbldr.filters.types import Timeline
from usbldr.io.doctor.interpretations import InterpretationResult, reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.geodesy import to_geodetic
from usbldr.io.log import Log

RAYLEIGH_MEDIAN = 1.1774  # fixed: median of a Rayleigh distribution


def propose_origin(
    log: Log, timeline: Timeline | None, result: InterpretationResult | None
) -> tuple[float, float, str] | None:
    """Return the origin that brings the fixes, by their best interpretation, onto the GPS; None for too few pairs.

    It is latitude and longitude in degrees, and of how many pairs it was made.
    """
    if timeline is None or log.origin is None or not len(timeline.fix_time_s) or not len(timeline.gps_time_s):
        return None
    line = reinterpret(log, timeline, result.best.flips) if result else timeline
    rows = np.interp(line.fix_time_s, line.gps_time_s, np.arange(len(line.gps_time_s)))
    nearest = np.rint(rows).astype(np.intp)
    paired = np.abs(line.gps_time_s[nearest] - line.fix_time_s) <= THRESHOLDS.max_pair_gap_s
    if paired.sum() < THRESHOLDS.min_pairs:
        return None
    shifts: Points = as_points(line.gps_m)[nearest[paired]] - as_points(line.fix_m)[paired]
    shift = complex(np.median(shifts.real), np.median(shifts.imag))
    lat, lon = to_geodetic(log.origin, np.array([shift.real]), np.array([shift.imag]))
    sd = float(np.median(np.abs(shifts - shift))) / RAYLEIGH_MEDIAN
    pairs = f"{paired.sum()} pairs within {THRESHOLDS.max_pair_gap_s:g} s, ±{sd:.1f} m"
    return float(lat[0]), float(lon[0]), pairs
