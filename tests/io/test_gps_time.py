"""GPS time against moments of which both times are known."""

import numpy as np
import pytest

from usbldr.io.gps_time import utc_ns


@pytest.mark.parametrize(
    ("week", "second", "utc"),
    [
        (1695, 16.0, "2012-07-01T00:00:00"),  # 16 s ahead since this moment
        (1695, 14.0, "2012-06-30T23:59:59"),  # before it 15
        (1930, 18.0, "2017-01-01T00:00:00"),  # a Sunday; 18 s ahead since
        (2399, 345_618.25, "2026-01-01T00:00:00.250"),
    ],
)
def test_a_week_and_its_second_are_a_moment_of_utc(week: int, second: float, utc: str) -> None:
    assert utc_ns(np.array([week]), np.array([second]))[0] == np.datetime64(utc, "ns").astype(np.int64)
