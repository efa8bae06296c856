"""Windows of time: from, to, in seconds of the log, both ends included."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.types import Vector

TimeWindow = tuple[float, float]  # from, to: seconds of the log, both ends included


def in_windows(time_s: Vector, windows: Sequence[TimeWindow]) -> NDArray[np.bool_]:
    """Return which times, (T,), lie in any of the windows."""
    found = np.zeros(len(time_s), np.bool_)
    for start_s, end_s in windows:
        found |= (time_s >= start_s) & (time_s <= end_s)
    return found


def windows_text(windows: Sequence[TimeWindow]) -> str:
    """Say the windows as one would write them: "0 to 60, 500 to 520 s"."""
    return ", ".join(f"{start_s:g} to {end_s:g}" for start_s, end_s in windows) + " s"
