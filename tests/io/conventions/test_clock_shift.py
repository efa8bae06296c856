"""Sensors with clocks of their own: what is moved to log time, by how much, and what stays."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import logged, texts
from recordings import SECOND, T0, Row, short_dive

HOUR = 3600 * SECOND


def restamped(topics: dict[str, int]) -> list[Row]:
    """The short dive with the stamps of some topics moved, logged 20 to 40 ms after the true times."""
    rows: list[Row] = []
    for k, (time_ns, topic, kind, values) in enumerate(short_dive()):
        stamped = {**values, "header.stamp": values["header.stamp"] + topics.get(topic, 0)}
        rows.append((time_ns + 20_000_000 + 10_000_000 * (k % 3), topic, kind, stamped))
    return rows


@pytest.mark.parametrize("other", [-T0 + 5 * SECOND, -HOUR, HOUR], ids=["since power-on", "zone west", "zone east"])
def test_a_clock_of_its_own_is_moved_to_log_time_and_keeps_its_spacing(tmp_path: Path, other: int) -> None:
    true = logged(tmp_path, restamped({}))

    log = logged(tmp_path, restamped({"/dvl": other}))

    moved, right = log.tables["dvl"]["time_s"], true.tables["dvl"]["time_s"]
    np.testing.assert_allclose(np.diff(moved), np.diff(right), atol=1e-9)
    absolute = moved[0] + (log.start_ns - true.start_ns) / 1e9 - right[0]
    assert absolute == pytest.approx(0.02)  # the least delay, which cannot be distinguished from the clock's offset
    clocks = "stamps come from another clock than the log's and other sensors'"
    shift_s = f"{0.02 - other / 1e9:.3f} s"
    assert texts(log, "CLOCK-SHIFTED") == [
        f"/dvl: {clocks}; shifted by {shift_s}, the smallest delay from stamp to log"
    ]


def test_two_sensors_of_one_other_clock_are_moved_alike(tmp_path: Path) -> None:
    log = logged(tmp_path, restamped({"/dvl": -T0 + SECOND, "/imu": -T0 + SECOND + 100_000_000}))

    apart = log.tables["compass"]["time_s"] - log.tables["dvl"]["time_s"]
    np.testing.assert_allclose(apart, 0.1, atol=1e-9)
    assert len(texts(log, "CLOCK-SHIFTED")) == 2


def test_stamps_that_all_run_on_one_clock_stay(tmp_path: Path) -> None:
    true = logged(tmp_path, restamped({}))

    simulated = logged(tmp_path, restamped(dict.fromkeys(("/dvl", "/imu", "/usbl"), -T0 + SECOND)))

    assert texts(simulated, "CLOCK-SHIFTED") == []
    assert simulated.start_ns == SECOND
    pd.testing.assert_series_equal(simulated.tables["dvl"]["time_s"], true.tables["dvl"]["time_s"])


def test_late_fixes_and_a_sensor_that_is_timed_by_the_log_are_no_other_clock(tmp_path: Path) -> None:
    by_log = logged(tmp_path, restamped({"/dvl": -T0}), '[dvl]\ntime = "log"')

    late = logged(tmp_path, restamped({"/usbl": -5 * SECOND}))

    assert texts(by_log, "CLOCK-SHIFTED") == texts(late, "CLOCK-SHIFTED") == []
    assert by_log.tables["dvl"]["time_s"].iloc[0] == pytest.approx(0.02)
