"""Times of tables: day numbers, and those of netCDF in any unit since any date of the calendar."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from logs import read_as
from recordings import SECOND, T0, Row, define, saved, write_csv, write_mcap
from table_recordings import WRITERS, Tables, as_csv
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.log import Log
from usbldr.io.reading.read import read_log
from usbldr.io.tables.cf_times import clock_of

DAY_S = 86_400
FIRST = datetime.fromisoformat("2020-09-13T12:26:40")  # T0
MATLAB = 366  # days from the year 0, with which MATLAB begins, to the year 1, with which Python's ordinals do
KNOWN_NS = 12_000  # a 64-bit number near 738,000 resolves 1.2e-10 days, 10 us
GYRO = "acme_msgs/msg/Gyro"
define({GYRO: "float64 datenum\nfloat64 heading\n"})


def day_number(seconds: float) -> float:
    """Return a day number: whole days by the calendar, the part of the day by its seconds."""
    of_day = FIRST.hour * 3600 + FIRST.minute * 60 + FIRST.second
    return FIRST.toordinal() + MATLAB + (of_day + seconds) / DAY_S


def read(log: Path, topic: str = "nav", **columns: str) -> Log:
    named = ", ".join(f'{key} = "{column}"' for key, column in columns.items()) or 'time_datenum = "t", heading = "psi"'
    return read_as(log, f'[compass]\ntopic = "{topic}"\ncolumns = {{ {named} }}\n')


@pytest.mark.parametrize("write", [*WRITERS.values(), as_csv])
def test_day_numbers_are_dates_of_the_calendar(tmp_path: Path, write: Callable[[Path, Tables], Path]) -> None:
    seconds = np.arange(50) / 4
    log = read(write(tmp_path, {"nav": {"t": [day_number(s) for s in seconds], "psi": np.arange(50.0)}}))

    assert abs(log.start_ns - T0) <= KNOWN_NS
    np.testing.assert_allclose(log.tables["compass"]["time_s"], seconds, rtol=0, atol=2e-9 * KNOWN_NS)


def test_day_numbers_of_digits_and_of_whole_numbers_are_exact(tmp_path: Path) -> None:
    days = Fraction(T0 + 7, DAY_S * SECOND) + 719_529
    text = f"{days.numerator * 10**20 // days.denominator:021d}"
    folder = write_csv(tmp_path / "dive", nav=f"t,psi\n{text[:-20]}.{text[-20:]},1\n")

    assert read(folder).start_ns == T0 + 7

    nav = {"t": np.array([738_047, 738_048], dtype=np.int32), "psi": np.arange(2.0)}  # 2020-09-13 and the day after
    log = read(WRITERS["HDF5"](tmp_path, {"nav": nav}))

    assert log.start_ns == T0 - T0 % (DAY_S * SECOND)
    np.testing.assert_array_equal(log.tables["compass"]["time_s"], [0.0, DAY_S])


def gyro(numbers: list[float]) -> list[Row]:
    return [(T0 + 9 * SECOND + k, "/gyro", GYRO, {"datenum": n, "heading": 1.0}) for k, n in enumerate(numbers)]


def test_day_numbers_of_messages_are_stamps_and_zero_is_none(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", gyro([day_number(0.0), day_number(1.0), 0.0]))
    log = read(file, "/gyro", time_datenum="datenum", heading="heading")

    stamps = log.start_ns + log.tables["compass"]["time_s"].to_numpy() * SECOND
    np.testing.assert_allclose(stamps - T0, [0.0, SECOND, 9 * SECOND + 2], rtol=0, atol=3 * KNOWN_NS)


def test_times_that_are_no_day_numbers_are_refused_in_one_sentence(tmp_path: Path) -> None:
    file = WRITERS["HDF5"](tmp_path, {"nav": {"t": [1.6e9, 1.6e9 + 1], "psi": np.arange(2.0)}})
    with pytest.raises(LogError, match=r'/nav: row 1: t is "1600000000.0", no time before 2116 in its unit'):
        read(file)


@pytest.mark.parametrize("columns", [{}, {"time_labview": "X_Value", "heading": "Heading (deg)"}])
@pytest.mark.parametrize("comment", ["", "\tComment"])
def test_times_of_labview_count_from_1904(tmp_path: Path, columns: dict[str, str], comment: str) -> None:
    first = (FIRST - datetime(1904, 1, 1)).total_seconds()
    head = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t,\nTime_Pref\tAbsolute\n***End_of_Header***\n\n"
    rows = "".join(f"{first + k / 4:.2f}\t{k}\n".replace(".", ",") for k in range(8))
    file = saved(tmp_path / "nav.lvm", f"{head}X_Value\tHeading (deg){comment}\n{rows}")

    log = read(file, **columns) if columns else read_log(file)

    assert log.start_ns == T0
    assert log.tables["compass"]["time_s"].tolist() == [k / 4 for k in range(8)]


@pytest.mark.parametrize(
    ("name", "at_1970"),
    [("JD", 2_440_587.5), ("Julian Date", 2_440_587.5), ("Time", 2_440_587.5), ("MJD", 40_587), ("Time", 40_587),
     ("Date", 25_569), ("Time", 25_569)],
)  # fmt: skip
@pytest.mark.parametrize("write", [*WRITERS.values(), as_csv])
def test_day_numbers_of_other_calendars_are_known_by_name_or_size(tmp_path, write, name, at_1970):
    days = np.array([at_1970 + (T0 // SECOND + k / 4) / DAY_S for k in range(8)])
    log = read_log(write(tmp_path, {"nav": {name: days, "heading_deg": np.arange(8.0)}}))

    assert abs(log.start_ns - T0) < 5 * KNOWN_NS
    np.testing.assert_allclose(log.tables["compass"]["time_s"], np.arange(8) / 4, rtol=0, atol=1e-8 * KNOWN_NS)


def test_julian_dates_of_digits_are_exact_and_begin_at_noon(tmp_path: Path) -> None:
    folder = write_csv(tmp_path, nav="t,psi\n2451545.00000000,1\n2451545.50000000,2\n2451546.00000001,3\n")
    noon = datetime(2000, 1, 1, 12, tzinfo=UTC)

    log = read(folder, time_julian="t", heading="psi")

    assert log.start_ns == int(noon.timestamp()) * SECOND
    assert log.tables["compass"]["time_s"].tolist() == [0, DAY_S / 2, DAY_S + 864e-6]


@pytest.mark.parametrize(("name", "year"), [("FileTime", 1601), ("Ticks", 1), ("Time", 1601), ("Time", 1)])
@pytest.mark.parametrize("write", [*WRITERS.values(), as_csv])
def test_steps_of_100_ns_count_from_1601_or_from_the_year_1(tmp_path, write, name, year):
    first = (FIRST - datetime(year, 1, 1)) // timedelta(seconds=1) * 10**7
    steps = np.array([first + k * 2_500_001 for k in range(8)])

    log = read_log(write(tmp_path, {"nav": {name: steps, "heading_deg": np.arange(8.0)}}))

    assert log.start_ns == T0
    np.testing.assert_allclose(log.tables["compass"]["time_s"], 0.2500001 * np.arange(8), rtol=0, atol=1e-9)


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
    (topic,) = open_reader(file).topics()
    assert topic.problem == ""
    return read_whole(open_reader(file), {topic.name: ["heading_deg"]})[topic.name].received_ns.tolist()


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
    (said,) = (finding.text for finding in read_log(file).findings if finding.lost_data)
    begin = (
        f'/a: {len(times) - 2} of {len(times)} rows are left out: row 2: time is "", no time before 2116 in its unit'
    )
    assert said.partition("; so are rows")[0] == begin


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
def test_units_that_state_no_such_clock_are_none_nor_is_the_calendar_of_a_model(units: str) -> None:
    assert clock_of(units) is None
    assert clock_of("days since 2000-01-01", "360_day") is None
    assert clock_of("days since 2000-01-01", "Gregorian") is not None


def test_a_clock_that_is_not_understood_is_no_clock_of_1970(tmp_path: Path) -> None:
    """A file of numbers without any unit is read as it is configured; one that states a clock is refused."""
    file = write_nc(tmp_path / "a.nc", np.arange(20.0), "seconds since 2026-01-01 02:00 CEST")

    (topic,) = open_reader(file).topics()

    assert topic.count == 0
    assert "a column time [seconds since 2026-01-01 02:00 CEST] without a known unit" in topic.problem
