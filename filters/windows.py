"""Times in seconds since the start of the log: windows (from, to), both ends included, columns at times, integrals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.types import Array, Vector

TimeWindow = tuple[float, float]  # from, to: seconds since the start of the log


def in_windows(time_s: Vector, windows: Sequence[TimeWindow]) -> NDArray[np.bool_]:
    """Return whether each time, (T,), is in any of the windows: (T,)."""
    inside = np.zeros(len(time_s), np.bool_)
    for start_s, end_s in windows:
        inside |= (time_s >= start_s) & (time_s <= end_s)
    return inside


def windows_text(windows: Sequence[TimeWindow]) -> str:
    """Return the windows as text: "0 to 60, 500 to 520 s"."""
    return ", ".join(f"{start_s:g} to {end_s:g}" for start_s, end_s in windows) + " s"


def columns_at(time_s: Vector, known_s: Vector, values: Array, outside: float | None = None) -> Array:
    """Return columns (k, m) of known times at others, (n, m); before and after, the first and last, or ``outside``."""
    columns: list[Array] = list(values.T)
    return np.column_stack([np.interp(time_s, known_s, one, left=outside, right=outside) for one in columns])


def integrated(time_s: Vector, rate: Array) -> Array:
    """Return the integral of each column (K, k) since the first time by the trapezoidal rule, (K, k)."""
    gained = (rate[1:] + rate[:-1]) / 2 * np.diff(time_s)[:, None]
    return np.vstack([np.zeros((1, rate.shape[1])), np.cumsum(gained, axis=0)])
