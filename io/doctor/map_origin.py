"""Where a map of local fixes might begin: a proposal from GPS fixes that were made beside USBL fixes.

GPS is the truth, so what is found here must not reach a run unless the user states it.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import Points, as_points
from usbldr.filters.types import Timeline
from usbldr.io.doctor.interpretations import InterpretationResult, reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.geodesy import to_geodetic
from usbldr.io.log import Log

RAYLEIGH_MEDIAN = 1.1774  # fixed: median of a Rayleigh distribution


class OriginProposal(NamedTuple):
    """An origin at which the fixes lie on the GPS."""

    lat_deg: float
    lon_deg: float
    pairs: int
    sd_m: float  # of one pair, each axis


def propose_origin(log: Log, timeline: Timeline | None, verdict: InterpretationResult | None) -> OriginProposal | None:
    """Return the origin by which the fixes, read as they fit best, meet the GPS; None where too few came together."""
    if timeline is None or log.origin is None or not len(timeline.fix_time_s) or not len(timeline.gps_time_s):
        return None
    reinterpreted = reinterpret(log, timeline, verdict.best.flips) if verdict else timeline
    near = np.rint(
        np.interp(reinterpreted.fix_time_s, reinterpreted.gps_time_s, np.arange(len(reinterpreted.gps_time_s)))
    ).astype(np.intp)
    beside = np.abs(reinterpreted.gps_time_s[near] - reinterpreted.fix_time_s) <= THRESHOLDS.max_pair_gap_s
    if beside.sum() < THRESHOLDS.min_pairs:
        return None
    shifts: Points = as_points(reinterpreted.gps_m)[near[beside]] - as_points(reinterpreted.fix_m)[beside]
    shift = complex(np.median(shifts.real), np.median(shifts.imag))
    lat, lon = to_geodetic(log.origin, np.array([shift.real]), np.array([shift.imag]))
    sd = float(np.median(np.abs(shifts - shift))) / RAYLEIGH_MEDIAN
    return OriginProposal(float(lat[0]), float(lon[0]), int(beside.sum()), sd)
