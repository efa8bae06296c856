"""What makes a reader doubt the errors of a track: low coverage, a shift, another clock, another vehicle."""

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import ConstantShift, moves_otherwise
from usbldr.filters.evaluation.error_report import Matching
from usbldr.filters.types import Array, Truth, Vector

FEW_EPOCHS = 5  # [epochs] with fewer, mean and RMS say next to nothing
APART_EXTENTS = 10.0  # times the larger extent of track and truth: a lever arm or an origin nearby explains less
LEAST_EXTENT_M = 100.0  # [m] of a vehicle at rest: a map's origin may be off by a kilometre and still be of this dive
ALONG_RAD = np.radians(15.0)  # [rad] a shift that near to the course may be a time: a lever arm points anywhere


def refuse_apart(estimate_m: Array, truth_m: Array, names: str) -> None:
    """Raise LogError if a track and the truth are so far apart that one of them must be of another place."""
    apart_m = float(np.hypot(*(estimate_m.mean(axis=0) - truth_m.mean(axis=0))))
    extent_m = max(float(np.hypot(*np.ptp(points_m, axis=0))) for points_m in (estimate_m, truth_m))
    if apart_m > APART_EXTENTS * max(extent_m, LEAST_EXTENT_M):
        raise LogError(
            f"{names} are {apart_m:,.0f} m apart, and neither extends over more than {extent_m:,.0f} m, so that errors "
            "would say nothing: check whether latitude and longitude are exchanged in the truth, in the fixes or under "
            "[map], and that both are of this dive; --align shift takes a constant shift off"
        )


def coverage_warnings(matching: Matching, truth: Truth) -> tuple[str, ...]:
    """Say a low coverage, unless the user chose it by the window, and a track that broke off."""
    found: list[str] = []
    if matching.low:
        outside = f"{matching.outside_truth} lie before or after it" if matching.outside_truth else ""
        gaps = f"{matching.in_gap} in its gaps over {truth.max_gap_s:g} s" if matching.in_gap else ""
        why = ", ".join(filter(None, (outside, gaps)))
        found.append(
            f"only {matching.matched} of {matching.asked} epochs could be compared with the truth{why and ': '}{why}"
        )
    if matching.matched < FEW_EPOCHS:
        found.append(f"these numbers rest on {matching.matched} of the track's epochs alone: they say next to nothing")
    if matching.undefined:
        found.append(f"the track has no position at {matching.undefined} epochs; they are left out of the errors")
    return tuple(found)


def shift_text(shift: ConstantShift, error_m: Array, time_s: Vector, truth_m: Array) -> str:
    """Say that a constant shift makes up most of the error, and what may cause it."""
    east_m, north_m = error_m.mean(axis=0)
    east, north = "east" if east_m > 0 else "west", "north" if north_m > 0 else "south"
    where = f"{abs(east_m):.2f} m {east}, {abs(north_m):.2f} m {north}"
    return (
        f"a constant shift ({where} of the truth) makes up {100 * shift.share:.0f} % of the mean square error: check "
        "the origin under [map] and the lever arm of the truth, and that the truth is of this vehicle"
        f"{_clock_instead(error_m, time_s, truth_m)}; --align shift takes the shift off"
    )


def _clock_instead(error_m: Array, time_s: Vector, truth_m: Array) -> str:
    """Return which clock would explain a shift along a straight course; empty if none does.

    An offset of the truth's clock moves errors along the velocity, which is the same all the time: no shift and no
    offset can then be distinguished.
    """
    way_m, shift_m = truth_m[-1] - truth_m[0], error_m.mean(axis=0)
    path_m = float(np.hypot(*np.diff(truth_m, axis=0).T).sum())
    along_m = float(shift_m @ way_m) / max(float(np.hypot(*way_m)), 1e-9)
    straight = float(np.hypot(*way_m)) > np.cos(ALONG_RAD) * path_m > 0
    if not straight or abs(along_m) < np.cos(ALONG_RAD) * float(np.hypot(*shift_m)):
        return ""
    late_s = along_m * float(time_s[-1] - time_s[0]) / float(np.hypot(*way_m))
    return (
        f"; the shift lies along the straight course, so that it may be a clock as well: stamps of the truth that are "
        f"{abs(late_s):.1f} s {'late' if late_s > 0 else 'early'}, or stamps of the fixes that are as much "
        f"{'early' if late_s > 0 else 'late'}"
    )


def motion_text(shift: ConstantShift, time_s: Vector, estimate_m: Array, truth_m: Array) -> str:
    """Return that track and truth move differently, empty if they do not."""
    if not moves_otherwise(shift, time_s, estimate_m - truth_m, truth_m):
        return ""
    return (
        "track and truth move differently: the track explains less than half of how the truth moves in a minute, "
        f"and without a constant shift they are {shift.rmse_m:.1f} m (RMS) apart, far more than the sigmas allow; "
        "check that the truth is of this vehicle (not of a ship), and the conventions of the sensors with usbldr "
        "doctor"
    )
