"""Files of one dive, with other clocks or without dates, are one log; tables that follow each other are one topic."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs import read_as, refusal
from pd45_recordings import pd45_ensemble
from recordings import SECOND, T0, Row, define, saved, sentence, short_dive, stamp, write_bag, write_csv, write_mcap
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log
from usbldr.io.reading.opening import DEFAULT_REQUEST, Request, open_configured
from usbldr.io.reading.read import read_log

VEHICLE, SHIP = ("/dvl", "/imu"), ("/usbl",)


def of(topics: tuple[str, ...], late_ns: int = 0) -> list[Row]:
    """The rows of the short dive on some topics, all stamps late."""
    return [
        (t + late_ns, topic, kind, {**values, "header.stamp": values["header.stamp"] + late_ns})
        for t, topic, kind, values in short_dive()
        if topic in topics
    ]


AHEAD = '[[file]]\npath = "{}"\nclock_offset_s = 2.5\n'


def joined(log: Path, *others: Path | str) -> Log:
    return read_log(log, Request(joined=tuple(map(str, others))))


def test_a_clock_offset_is_subtracted_from_stamps_and_log_times(tmp_path: Path) -> None:
    """The ship's clock shows 2.5 s more than the vehicle's: clock_offset_s = 2.5."""
    whole = read_log(write_mcap(tmp_path / "whole.mcap", short_dive()))
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    ship = write_bag(tmp_path / "ship.bag", of(SHIP, 2_500_000_000))

    for log in (read_as(vehicle, AHEAD.format("ship.bag")), joined(vehicle, ship)):
        assert list(log.tables) == ["dvl", "compass", "usbl"]
        pd.testing.assert_frame_equal(log.tables["usbl"], whole.tables["usbl"])


def test_a_clock_offset_is_subtracted_from_any_field_of_time(tmp_path: Path) -> None:
    kind = "clocks_msgs/msg/LocationFix"
    define({kind: "builtin_interfaces/Time timestamp\nstring frame_id\nfloat64 latitude\nfloat64 longitude\n"})
    late = T0 + 2_500_000_000
    vehicle = write_mcap(tmp_path / "vehicle.mcap", short_dive())
    values = {"timestamp": stamp(late), "latitude": 32.0, "longitude": -64.0}
    write_mcap(tmp_path / "ship.mcap", [(late, "/gps", kind, values)])

    assert read_as(vehicle, AHEAD.format("ship.mcap")).tables["gps"]["time_s"].tolist() == [0.0]


def test_the_order_of_dates_is_said_once_for_all_files(tmp_path: Path) -> None:
    rows = "08.07.2026 12:20:00;1\n08.07.2026 12:21:00;2"
    write_csv(tmp_path / "dive", ship=f"Zeit;Heading [deg]\n{rows}", auv=f"Zeit;Tiefe [m]\n{rows}")
    saved(tmp_path / "usbldr.toml", AHEAD.format("dive/auv.csv").replace("2.5", "0.0"))

    said = [one.text for one in read_log(tmp_path / "dive").findings if one.code == "DATE-ORDER"]

    assert len(said) == 1
    assert "08.07.2026 is read as 2026-07-08" in said[0]


def test_a_topic_in_a_bag_and_in_a_file_of_ros_2_is_one_topic(tmp_path: Path) -> None:
    rows = short_dive()
    first, second = write_bag(tmp_path / "a.bag", rows[:15]), write_mcap(tmp_path / "b.mcap", rows[15:])
    whole = read_log(write_mcap(tmp_path / "whole.mcap", rows))

    log = joined(second, first)

    assert log.tables.keys() == whole.tables.keys()
    for sensor, table in whole.tables.items():
        pd.testing.assert_frame_equal(log.tables[sensor], table)


def test_the_digest_changes_with_the_file_joined(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    one, other = (write_bag(tmp_path / f"{k}.bag", of(SHIP, k)) for k in (0, 1))

    digests = {joined(vehicle, ship).sha256 for ship in (one, other)}

    assert len(digests | {read_log(vehicle).sha256}) == 3


def test_a_joined_file_that_is_missing_is_named(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))

    assert refusal(LogError, joined, vehicle, "nowhere.bag") == "nowhere.bag: no such file or folder"


COUNT = 40
COMPASS = "time_ns,heading_deg\n" + "".join(f"{T0 + k * SECOND},{k}\n" for k in range(COUNT))


def velocities(start: int, end: int, shift_s: int = 0) -> str:
    rows = "".join(f"{T0 + (k + shift_s) * SECOND},{1 + k / 100},0.5\n" for k in range(start, end))
    return f"time_ns,forward_mps,starboard_mps\n{rows}"


def forward_mps(log: Log) -> list[float]:
    return log.tables["dvl"]["forward_mps"].tolist()


WHOLE = [1 + k / 100 for k in range(COUNT)]

IN_THREE = velocities(0, 15), velocities(15, 16), velocities(16, COUNT)
OTHER_ORDER = "\n".join(",".join(line.split(",")[k] for k in (0, 2, 1)) for line in velocities(15, COUNT).splitlines())
EARLIER = "they follow each other; of times that two of them have, the records of the earlier one are read"


@pytest.mark.parametrize(
    ("names", "parts", "why"),
    [
        (("dvl_001", "dvl_002", "dvl_003"), IN_THREE, "they follow each other"),
        (("dvl", "dvl-2", "dvl 3"), IN_THREE, "they follow each other"),
        (("dvl_20200913T12", "dvl_20200913T13", "dvl"), IN_THREE, "they follow each other"),
        (("dvl", "continued", "rest_of_dvl"), IN_THREE, "they follow each other"),
        (("dvl_1", "dvl_2"), (velocities(0, 15), OTHER_ORDER), "they follow each other"),
        (("dvl_1", "dvl_2"), (velocities(0, 15), velocities(13, COUNT)), EARLIER),
        (("dvl_1", "dvl_2"), (velocities(0, 15), velocities(15, COUNT).partition("\n")[2]), "they follow each other"),
    ],
)
def test_tables_that_follow_each_other_are_one_topic(tmp_path, names, parts, why):
    log = read_log(write_csv(tmp_path / "dive", compass=COMPASS, **dict(zip(names, parts, strict=True))))

    assert forward_mps(log) == pytest.approx(WHOLE)
    assert log.provenance["dvl"].topic == f"/{names[0]}"
    assert log.provenance["dvl"].used == COUNT
    others = ", ".join(f"/{name}" for name in names[1:])
    assert [(one.text, one.level) for one in log.findings if one.code == "TOPIC-PARTS"] == [
        (f"/{names[0]}: read as one topic with {others}: {why}", "info")
    ]


def test_a_part_may_be_added_where_the_first_is_named_and_else_a_part_that_is_named_is_read_alone(tmp_path):
    first = write_csv(tmp_path / "dive", compass=COMPASS, dvl_1=velocities(0, 15))
    (file,) = write_csv(tmp_path / "more", dvl_2=velocities(15, COUNT)).glob("*.csv")
    both = write_csv(tmp_path / "both", compass=COMPASS, dvl_1=velocities(0, 15), dvl_2=velocities(15, COUNT))

    added = read_log(first, Request(joined=(str(file),), topics={"dvl": "dvl_1"}))

    assert forward_mps(added) == pytest.approx(WHOLE)
    assert forward_mps(read_log(both, Request(topics={"dvl": "/dvl_2"}))) == pytest.approx(WHOLE[15:])


def test_tables_of_several_sensors_follow_each_other_sensor_by_sensor(tmp_path: Path) -> None:
    head = "Time [s],Heading [deg],DVL Forward [m/s],DVL Starboard [m/s]\n"
    rows = [f"{T0 / SECOND + k:.1f},{k},{1 + k / 100},0.5\n" for k in range(COUNT)]
    folder = write_csv(tmp_path / "dive", dive_001=head + "".join(rows[:15]), dive_002=head + "".join(rows[15:]))

    log = read_log(folder)

    assert forward_mps(log) == pytest.approx(WHOLE)
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], np.arange(COUNT))


def test_a_table_of_the_ship_or_of_computed_values_is_no_part(tmp_path: Path) -> None:
    parts = {"dvl": velocities(0, 15), "dvl_ship": velocities(15, 25), "dvl_filtered": velocities(25, COUNT)}

    assert forward_mps(read_log(write_csv(tmp_path / "dive", compass=COMPASS, **parts))) == pytest.approx(WHOLE[:15])


@pytest.mark.parametrize(
    "second",
    [
        velocities(10, COUNT),
        velocities(3, COUNT),
        velocities(15, COUNT, 700),
        velocities(15, COUNT).replace(",0.5", ",0.5,1").replace("starboard_mps", "starboard_mps,valid"),
    ],
    ids=["overlap", "two instruments beside each other", "pause", "columns"],
)
def test_tables_that_overlap_or_are_far_apart_or_have_other_columns_are_a_choice(tmp_path: Path, second: str) -> None:
    folder = write_csv(tmp_path / "dive", compass=COMPASS, dvl_1=velocities(0, 15), dvl_2=second)

    assert "2 topics could be the dvl" in refusal(UsageError, read_log, folder)


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


def rows_at(times: Sequence[datetime], row: str) -> str:
    return "".join(row.format(k, f"{time:%H:%M:%S}") for k, time in enumerate(times))


UNDATED: dict[str, Callable[[Sequence[datetime]], str | bytes]] = {
    "csv": lambda times: "Time,Heading (deg)\n" + rows_at(times, "{1},{0}\n"),
    "jsonl": lambda times: rows_at(times, '{{"time": "{1}", "heading_deg": {0}}}\n'),
    "nmea": lambda times: "".join(
        sentence(f"GPGGA,{t:%H%M%S},4500.0,N,00700.0,E,1,9,0.6,0,M,20,M,,") + "\n" for t in times
    ),
    "pd4": lambda times: b"".join(
        pd45_ensemble(4, 100 * (round(t.timestamp()) % 86400), x=0, y=1000 + k, z=10) for k, t in enumerate(times)
    ),
}  # fmt: skip


@settings(max_examples=60)
@given(
    form=st.sampled_from(sorted(UNDATED)),
    numbers=st.tuples(st.integers(2000, 2099), st.integers(1, 14), st.integers(1, 33)),
    mark=st.sampled_from(["", "-", "_", "."]),
    around=st.tuples(st.sampled_from(["", "a_", "a ", "7"]), st.sampled_from(["", "_a", " 2", "T2359", "235900", "1"])),
)
def test_a_date_in_the_name_of_a_file_is_that_of_its_first_time(form, numbers, mark, around) -> None:
    """Not a day that there is not, nor one beside digits of no time; a date that the user states comes first."""
    days = [datetime(1970, 1, 1, tzinfo=UTC), MIDNIGHT]
    with suppress(ValueError):
        days[0] = datetime(*numbers, tzinfo=UTC) if around[0] != "7" and around[1] != "1" else days[0]
    name = mark.join(f"{number:02d}" for number in numbers).join(around)

    with TemporaryDirectory() as folder:
        log = saved(Path(folder) / f"{name}.{form}", UNDATED[form](moments(-60, 60)))
        named = open_configured(log, DEFAULT_REQUEST).reader
        saved(Path(folder) / "usbldr.toml", f'[[file]]\npath = "{log.name}"\ndate = {MIDNIGHT:%Y-%m-%d}\n')
        stated = open_configured(log, DEFAULT_REQUEST).reader
        spans = [(topic.first_ns, topic.last_ns) for reader in (named, stated) for topic in reader.topics()]
        undated = {"NO-DATE", "NMEA-DATE"} & {one.code for one in named.findings()}

    begins_s = [round(day.timestamp()) + 86400 - 60 for day in days]
    assert spans == [(begin_s * SECOND, (begin_s + 119) * SECOND) for begin_s in begins_s]
    assert bool(undated) == (days[0].year == 1970)


def test_dates_of_other_sensors_come_before_those_in_names(tmp_path: Path) -> None:
    """A name may hold the day on which the table was exported."""
    clocks(tmp_path, moments(-40, 60))
    (tmp_path / "compass.csv").rename(tmp_path / "compass_20240512.csv")

    log = read_log(receiver(tmp_path, moments(-60, 60)))

    assert log.start_ns == (MIDNIGHT.timestamp() - 40) * SECOND  # the compass begins


def test_the_date_in_a_name_counts_if_no_other_sensor_is_near(tmp_path: Path) -> None:
    saved(tmp_path / "compass_20240512.csv", UNDATED["csv"](moments(6 * 3600, 6 * 3600 + 60)))
    receiver(tmp_path, moments(-60, 60))

    reader = open_configured(tmp_path, DEFAULT_REQUEST).reader

    (first_ns,) = (topic.first_ns for topic in reader.topics() if "compass" in topic.name)
    assert first_ns == datetime(2024, 5, 12, 6, tzinfo=UTC).timestamp() * SECOND
