"""GPS time: weeks since 1980 and times of the week, ahead of UTC by the leap seconds since then."""

import numpy as np

from usbldr.filters.types import Vector
from usbldr.io.reader import Nanoseconds

EPOCH_S, WEEK_S = 315_964_800, 604_800  # fixed: 1980-01-06 in seconds since 1970
LAST_WEEK = 6000  # [weeks] since then, in the year 2095: a later one is a damaged number
LEAP_S = 18  # fixed: GPS time minus UTC since 2017
LEAPS_S = (1136073600, 1230768000, 1341100800, 1435708800, 1483228800)
"""Fixed by the IERS, Bulletin C: the last leap seconds, in seconds since 1970."""


def utc_ns(week: Nanoseconds, second: Vector) -> Nanoseconds:
    """Return UTC in nanoseconds since 1970, (n,), of weeks since 1980 and seconds of the week, (n,) each.

    Right from 2006 on; before, one second early or more.
    """
    start_s = EPOCH_S + week * WEEK_S
    first_s = LEAP_S - len(LEAPS_S)  # before the first of these
    at_s = np.array(LEAPS_S) + first_s + np.arange(1, len(LEAPS_S) + 1)  # in GPS time
    leap_s = first_s + np.searchsorted(at_s, start_s + second, side="right")
    return (start_s - leap_s) * 1_000_000_000 + np.round(second * 1e9).astype(np.int64)
