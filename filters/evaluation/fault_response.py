"""What a fault did to a track: its drift during the fault, and how long its error stayed larger afterwards.

Both compare the track with the truth and with the track of the same method without the fault. Metres and seconds.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector
from usbldr.filters.windows import TimeWindow

REACQUIRED_RATIO = 1.5  # times the error without the fault: what remains is then less than the scatter of seeds
REACQUIRED_OVER_S = 10.0  # over which errors are averaged: a wrong track may cross the truth for a moment


class FaultResponse(NamedTuple):
    """The answer of one track to a fault of limited duration."""

    drift_m: float  # displacement of the error from the start of the fault to its end
    reacquired_s: float | None  # from the end of the fault until the error is as small as without it; None: never


def fault_response(
    time_s: Vector, error_m: Array, usual_time_s: Vector, usual_error_m: Array, span_s: TimeWindow
) -> FaultResponse | None:
    """Return drift and time to re-acquire of errors (M, 2), given those without the fault, (L, 2).

    The position is re-acquired as soon as the mean error of the next REACQUIRED_OVER_S is at most REACQUIRED_RATIO
    times the larger of two errors without the fault: that of the same seconds, and that of the whole run. None if
    there is no error before the end of the fault.
    """
    start_s, end_s = span_s
    before, during = np.flatnonzero(time_s <= start_s), np.flatnonzero(time_s <= end_s)
    if not len(during):
        return None
    first = before[-1] if len(before) else 0
    drift_m = float(np.hypot(*(error_m[during[-1]] - error_m[first])))
    usual = np.hypot(*usual_error_m.T)
    error = np.hypot(*error_m.T)
    for at_s in time_s[(time_s >= end_s) & (time_s <= time_s[-1] - REACQUIRED_OVER_S)]:
        now = (time_s >= at_s) & (time_s < at_s + REACQUIRED_OVER_S)
        then = (usual_time_s >= at_s) & (usual_time_s < at_s + REACQUIRED_OVER_S)
        limit_m = REACQUIRED_RATIO * max(float(usual.mean()), float(usual[then].mean()) if then.any() else 0.0)
        if float(error[now].mean()) <= limit_m:
            return FaultResponse(drift_m, float(at_s - end_s))
    return FaultResponse(drift_m, None)
