"""Files of one dive, each with its own clock, are one log."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import refusal
from recordings import T0, Row, define, short_dive, stamp, write_bag, write_csv, write_mcap
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log

VEHICLE, SHIP = ("/dvl", "/imu"), ("/usbl",)


def of(topics: tuple[str, ...], late_ns: int = 0) -> list[Row]:
    """The rows of the short dive on some topics, all stamps late."""
    rows = [row for row in short_dive() if row[1] in topics]
    late = [{**v, "header.stamp": v["header.stamp"] + late_ns} for *_, v in rows]
    return [(t + late_ns, topic, kind, v) for (t, topic, kind, _), v in zip(rows, late, strict=True)]


def offset(folder: Path, file: str, seconds: float) -> None:
    toml = f'[[file]]\npath = "{file}"\nclock_offset_s = {seconds}\n'
    (folder / "usbldr.toml").write_text(toml, encoding="utf-8")


def joined(log: Path, *others: Path | str) -> Log:
    return read_log(log, Request(joined=tuple(map(str, others))))


def test_two_files_are_one_dive(tmp_path: Path) -> None:
    whole = read_log(write_mcap(tmp_path / "whole.mcap", short_dive()))
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    ship = write_bag(tmp_path / "ship.bag", of(SHIP))

    log = joined(vehicle, ship)

    assert log.format == "MCAP + ROS 1 bag"
    assert log.start_ns == whole.start_ns
    for sensor, table in whole.tables.items():
        pd.testing.assert_frame_equal(log.tables[sensor], table)


def test_a_clock_offset_is_subtracted_from_stamps_and_log_times(tmp_path: Path) -> None:
    """The ship's clock shows 2.5 s more than the vehicle's: clock_offset_s = 2.5."""
    whole = read_log(write_mcap(tmp_path / "whole.mcap", short_dive()))
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    write_bag(tmp_path / "ship.bag", of(SHIP, 2_500_000_000))
    offset(tmp_path, "ship.bag", 2.5)

    for log in (read_log(vehicle), joined(vehicle, tmp_path / "ship.bag")):
        assert list(log.tables) == ["dvl", "compass", "usbl"]
        pd.testing.assert_frame_equal(log.tables["usbl"], whole.tables["usbl"])


def test_a_clock_offset_is_subtracted_from_any_field_of_time(tmp_path: Path) -> None:
    kind = "clocks_msgs/msg/LocationFix"
    define({kind: "builtin_interfaces/Time timestamp\nstring frame_id\nfloat64 latitude\nfloat64 longitude\n"})
    late = T0 + 2_500_000_000
    vehicle = write_mcap(tmp_path / "vehicle.mcap", short_dive())
    values = {"timestamp": stamp(late), "latitude": 32.0, "longitude": -64.0}
    write_mcap(tmp_path / "ship.mcap", [(late, "/gps", kind, values)])
    offset(tmp_path, "ship.mcap", 2.5)

    assert read_log(vehicle).tables["gps"]["time_s"].tolist() == [0.0]


def test_the_log_itself_may_have_the_wrong_clock(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "dive.mcap", of(VEHICLE + SHIP, -3_000_000_000))
    offset(tmp_path, "dive.mcap", -3.0)

    assert read_log(file).start_ns == T0
    assert read_log(file, Request("none")).start_ns == T0 - 3_000_000_000


def test_a_topic_in_both_files_is_one_topic(tmp_path: Path) -> None:
    early = [row for row in short_dive() if row[0] < T0 + 5 * 10**9]
    late = [row for row in short_dive() if row[0] >= T0 + 5 * 10**9]
    first, second = write_mcap(tmp_path / "a.mcap", early), write_mcap(tmp_path / "b.mcap", late)
    whole = read_log(write_mcap(tmp_path / "whole.mcap", short_dive()))

    log = joined(second, first)

    for sensor, table in whole.tables.items():
        pd.testing.assert_frame_equal(log.tables[sensor], table)


def test_messages_and_csv_files_can_be_one_dive(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    ship = write_csv(tmp_path / "ship", usbl=f"time_ns,east_m,north_m\n{T0},1,2\n{T0 + 10**9},3,4")

    log = joined(vehicle, ship)

    np.testing.assert_array_equal(log.tables["usbl"][["east_m", "north_m"]], [[1, 2], [3, 4]])


def test_the_digest_changes_with_the_file_joined(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    one, other = (write_bag(tmp_path / f"{k}.bag", of(SHIP, k)) for k in (0, 1))

    digests = {joined(vehicle, ship).sha256 for ship in (one, other)}

    assert len(digests | {read_log(vehicle).sha256}) == 3


def test_a_joined_file_that_is_missing_is_named(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))

    assert refusal(LogError, joined, vehicle, "nowhere.bag") == "nowhere.bag: no such file or folder"


def test_an_unknown_key_of_a_file_is_refused(tmp_path: Path) -> None:
    vehicle = write_mcap(tmp_path / "vehicle.mcap", of(VEHICLE))
    (tmp_path / "usbldr.toml").write_text('[[file]]\npath = "vehicle.mcap"\nclock_s = 1\n', encoding="utf-8")

    with pytest.raises(UsageError, match="clock_s"):
        read_log(vehicle)
