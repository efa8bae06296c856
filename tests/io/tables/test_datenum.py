"""Times as MATLAB's day numbers, named by columns: the dates of the calendar in tables, CSV files and messages."""

from collections.abc import Callable
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from recordings import SECOND, T0, Row, define, write_csv, write_mcap
from table_recordings import WRITERS, Tables, as_csv
from usbldr.filters.errors import LogError
from usbldr.io.log import Log
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log

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
    own = log.with_name("own.toml")
    own.write_text(f'[compass]\ntopic = "{topic}"\ncolumns = {{ {named} }}\n', encoding="utf-8")
    return read_log(log, Request(configuration=str(own)))


@pytest.mark.parametrize("write", [*WRITERS.values(), as_csv])
def test_day_numbers_are_dates_of_the_calendar(tmp_path: Path, write: Callable[[Path, Tables], Path]) -> None:
    seconds = np.arange(50) / 4
    nav = {"t": [day_number(s) for s in seconds], "psi": np.arange(50.0)}
    log = read(write(tmp_path, {"nav": nav}))

    assert abs(log.start_ns - T0) <= KNOWN_NS
    np.testing.assert_allclose(log.tables["compass"]["time_s"], seconds, rtol=0, atol=2e-9 * KNOWN_NS)


def test_day_numbers_of_whole_numbers_are_midnights(tmp_path: Path) -> None:
    nav = {"t": np.array([738_047, 738_048], dtype=np.int32), "psi": np.arange(2.0)}  # 2020-09-13 and the day after
    log = read(WRITERS["HDF5"](tmp_path, {"nav": nav}))

    assert log.start_ns == T0 - T0 % (DAY_S * SECOND)
    np.testing.assert_array_equal(log.tables["compass"]["time_s"], [0.0, DAY_S])


def test_day_numbers_of_csv_files_are_exact_to_the_nanosecond(tmp_path: Path) -> None:
    days = Fraction(T0 + 7, DAY_S * SECOND) + 719_529
    text = f"{days.numerator * 10**20 // days.denominator:021d}"
    folder = write_csv(tmp_path / "dive", nav=f"t,psi\n{text[:-20]}.{text[-20:]},1\n")

    assert read(folder).start_ns == T0 + 7


def gyro(numbers: list[float]) -> list[Row]:
    return [(T0 + 9 * SECOND + k, "/gyro", GYRO, {"datenum": n, "heading": 1.0}) for k, n in enumerate(numbers)]


def test_day_numbers_of_messages_are_stamps_and_zero_is_none(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", gyro([day_number(0.0), day_number(1.0), 0.0]))
    log = read(file, "/gyro", time_datenum="datenum", heading="heading")

    stamps = log.start_ns + log.tables["compass"]["time_s"].to_numpy() * SECOND
    np.testing.assert_allclose(stamps - T0, [0.0, SECOND, 9 * SECOND + 2], rtol=0, atol=3 * KNOWN_NS)


def test_times_that_are_no_day_numbers_are_refused_in_one_sentence(tmp_path: Path) -> None:
    nav = {"t": [1.6e9, 1.6e9 + 1], "psi": np.arange(2.0)}
    file = WRITERS["HDF5"](tmp_path, {"nav": nav})
    with pytest.raises(LogError, match="/nav: no value of the column t is a time before 2116 in its unit"):
        read(file)


@pytest.mark.parametrize("columns", [{}, {"time_labview": "X_Value", "heading": "Heading (deg)"}])
def test_times_of_labview_count_from_1904(tmp_path: Path, columns: dict[str, str]) -> None:
    first = (FIRST - datetime(1904, 1, 1)).total_seconds()
    head = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t,\nTime_Pref\tAbsolute\n***End_of_Header***\n\n"
    rows = "".join(f"{first + k / 4:.2f}\t{k}\n".replace(".", ",") for k in range(8))
    file = tmp_path / "nav.lvm"
    file.write_text(f"{head}X_Value\tHeading (deg)\n{rows}", encoding="utf-8")

    log = read(file, **columns) if columns else read_log(file)

    assert log.start_ns == T0
    assert log.tables["compass"]["time_s"].tolist() == [k / 4 for k in range(8)]
