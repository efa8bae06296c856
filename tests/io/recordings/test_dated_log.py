"""Times of day without a date beside files of other formats with dates: one dive, without a day's jump."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from recordings import sentence, write_csv
from usbldr.io.reading.opening import DEFAULT_REQUEST, open_configured
from usbldr.io.reading.read import read_log

MIDNIGHT = datetime(2020, 9, 13, tzinfo=UTC)


def moments(first_s: int, last_s: int) -> list[datetime]:
    """Return one a second, counted from midnight."""
    return [MIDNIGHT + timedelta(seconds=second) for second in range(first_s, last_s)]


def clocks(folder: Path, times: list[datetime]) -> Path:
    rows = "".join(f"{time:%H:%M:%S},{time.timestamp() - MIDNIGHT.timestamp():.0f}\n" for time in times)
    return write_csv(folder, compass=f"Time,Heading (deg)\n{rows.replace(',-', ',3')}")


def receiver(folder: Path, times: list[datetime]) -> Path:
    lines = [sentence(f"GPRMC,{time:%H%M%S},A,4500.0,N,00700.0,E,1.0,0.0,{time:%d%m%y},,") for time in times]
    (folder / "gps.nmea").write_text("\n".join(lines) + "\n", encoding="ascii")
    return folder


@pytest.mark.parametrize("of_clocks", [(-40, 60), (10, 60), (-40, -10)], ids=["over midnight", "after", "before"])
@pytest.mark.parametrize("of_dates", [(-60, 60), (-60, -20), (20, 90)], ids=["over midnight", "before", "after"])
def test_times_of_day_get_the_dates_of_another_format(tmp_path, of_clocks, of_dates):
    log = read_log(receiver(clocks(tmp_path, moments(*of_clocks)), moments(*of_dates)))

    for sensor, (first_s, last_s) in {"compass": of_clocks, "gps": of_dates}.items():
        begin = (log.start_ns / 1e9 - MIDNIGHT.timestamp()) if log.start_ns else 0.0
        assert (log.tables[sensor]["time_s"] + begin).tolist() == pytest.approx(range(first_s, last_s))
    assert {one.code for one in log.findings} & {"NO-DATE", "DATE-OF-OTHERS"} == {"DATE-OF-OTHERS"}


@pytest.mark.parametrize("dates", [(5 * 3600, 5 * 3600 + 60), (-86400, 86400)], ids=["far", "two days"])
def test_times_of_day_that_fit_no_day_or_several_have_none(tmp_path: Path, dates: tuple[int, int]) -> None:
    folder = receiver(clocks(tmp_path, moments(-40, 60)), moments(*dates)[:: max(1, (dates[1] - dates[0]) // 500)])

    reader = open_configured(folder, DEFAULT_REQUEST).reader

    assert reader.topics()[0].first_ns == (86400 - 40) * 10**9
    assert "NO-DATE" in {one.code for one in reader.findings()}
