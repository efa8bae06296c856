"""Times of netCDF files: numbers in any unit since any date of the calendar."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from recordings import SECOND, T0
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.read import read_log
from usbldr.io.tables.cf_times import clock_of

COUNT = 20
START = datetime.fromtimestamp(T0 // SECOND, UTC)
UNITS = {
    "days since 2020-01-01": (timedelta(days=1), datetime(2020, 1, 1, tzinfo=UTC)),
    "day since 1950-01-01 00:00:00Z": (timedelta(days=1), datetime(1950, 1, 1, tzinfo=UTC)),
    "hours since 1900-01-01 00:00:0.0": (timedelta(hours=1), datetime(1900, 1, 1, tzinfo=UTC)),
    "Minutes since 2020-9-13T06:30": (timedelta(minutes=1), datetime(2020, 9, 13, 6, 30, tzinfo=UTC)),
    "seconds since 1970-01-01T00:00:00+00:00": (timedelta(seconds=1), datetime(1970, 1, 1, tzinfo=UTC)),
    "seconds since 2020-09-13 12:26:40.250 UTC": (timedelta(seconds=1), START + timedelta(seconds=0.25)),
    "milliseconds since 2020-09-13 12:26:40": (timedelta(milliseconds=1), START),
    "seconds since 2020-09-13 14:26:40 +02:00": (timedelta(seconds=1), START),
    "seconds since 2020-09-13T05:56:40 -0630": (timedelta(seconds=1), START),
    "hours since 2020-09-13 12:00 UTC+2": (timedelta(hours=1), datetime(2020, 9, 13, 10, tzinfo=UTC)),
    "us since 2000-01-01": (timedelta(microseconds=1), datetime(2000, 1, 1, tzinfo=UTC)),
}


def write_nc(file: Path, times: Any, units: str | bytes, **attributes: str | int) -> Path:
    with h5py.File(file, "w") as content:
        time = content.create_dataset("time", data=times)
        time.attrs.update({"units": units, **attributes})
        content.create_dataset("heading", data=np.arange(float(len(times)))).attrs["units"] = "degrees"
    return file


def stamps(file: Path) -> list[int]:
    (topic,) = open_log(file).topics()
    assert topic.problem == ""
    return read_whole(open_log(file), {topic.name: ["heading_deg"]})[topic.name].received_ns.tolist()


@pytest.mark.parametrize("units", UNITS)
def test_times_are_dates_of_the_calendar(tmp_path: Path, units: str) -> None:
    unit, since = UNITS[units]
    moments = [START + timedelta(seconds=k / 4) for k in range(COUNT)]
    file = write_nc(tmp_path / "a.nc", [(moment - since) / unit for moment in moments], units.encode())

    expected = [T0 + k * SECOND // 4 for k in range(COUNT)]
    np.testing.assert_allclose(np.array(stamps(file)) - T0, np.array(expected) - T0, rtol=0, atol=2000)  # 2 us
    assert read_log(file).tables["compass"]["heading_deg"].tolist() == list(range(COUNT))


def test_whole_numbers_are_exact(tmp_path: Path) -> None:
    numbers = np.array([1, 2**53 + 1, 2**53 + 3], dtype=np.int64)

    file = write_nc(tmp_path / "a.nc", numbers, "nanoseconds since 2020-09-13 12:26:40")
    assert stamps(file) == [T0 + number for number in numbers.tolist()]
    days = np.array([18_518, 18_519], dtype=np.uint16)  # 2020-09-13 and the day after
    file = write_nc(tmp_path / "b.nc", days, "days since 1970-01-01")
    assert stamps(file) == [day * 86_400 * SECOND for day in days.tolist()]


@pytest.mark.parametrize(
    ("times", "fill"), [([1.0, np.nan, 2.0, 1e30, -1e30, 9.96921e36], {}), ([1, -9, 2], {"_FillValue": -9})]
)
def test_numbers_that_are_no_times_are_left_out(tmp_path: Path, times: list[float], fill: dict[str, int]) -> None:
    file = write_nc(tmp_path / "a.nc", np.array(times), "seconds since 2020-09-13 12:26:40", **fill)

    assert stamps(file) == [T0 + SECOND, T0 + 2 * SECOND]
    said = f"/a: {len(times) - 2} of {len(times)} rows have no time; left out"
    assert [finding.text for finding in read_log(file).findings if finding.lost_data] == [said]


@pytest.mark.parametrize(
    "units",
    [
        "days since yesterday",
        "months since 2000-01-01",
        "days since 0001-01-01",
        "days since 2000-13-01",
        "seconds since 2000-01-01 00:00 CET",
        "seconds since 2000-01-01 00:00 +24:00",
        "seconds since 2000-01-01 12",
        "seconds",
        "",
    ],
)
def test_units_that_state_no_such_clock_are_none(units: str) -> None:
    assert clock_of(units) is None


def test_the_calendar_of_a_model_is_none() -> None:
    assert clock_of("days since 2000-01-01", "360_day") is None
    assert clock_of("days since 2000-01-01", "Gregorian") is not None


def test_a_clock_that_is_not_understood_is_no_clock_of_1970(tmp_path: Path) -> None:
    """A file of numbers without any unit is read as it is configured; one that states a clock is refused."""
    file = write_nc(tmp_path / "a.nc", np.arange(20.0), "seconds since 2026-01-01 02:00 CEST")

    (topic,) = open_log(file).topics()

    assert topic.count == 0
    assert "a column time [seconds since 2026-01-01 02:00 CEST] of which neither a unit nor a date" in topic.problem
