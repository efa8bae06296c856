"""Clocks that go back, put into every container: nothing is swapped, and each record keeps its place in the dive."""

import gzip
import json
import math
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosbags.rosbag2 import StoragePlugin

from autopilot_recordings import DEFINITIONS, write_packets, write_rows
from blueos_recordings import write_blueos
from commands import run
from dvl_recordings import ensemble, velocity
from imc_recordings import sent, write_messages
from logs import codes, read_as
from moos_recordings import HEAD, line
from pd45_recordings import pd45_ensemble
from recordings import (
    SECOND,
    T0,
    Row,
    point,
    saved,
    saved_lines,
    sentence,
    twist,
    write_bag,
    write_mcap,
    write_rosbag2,
    yaw,
)
from table_recordings import WRITERS, Tables, as_csv, as_netcdf
from usbldr.filters.errors import UsageError
from usbldr.io.conventions.clock_parts import PartsError
from usbldr.io.conventions.clock_steps import examined
from usbldr.io.formats.detect import open_reader
from usbldr.io.log import Log
from usbldr.io.reading.read import Request, read_log
from usbldr.io.reading.survey import survey

COUNT, STEP = 80, SECOND // 5
TOML = '[compass]\ncolumns = {{ heading = "{}" }}\nconvention = "compass"\nunit = "deg"\n'
Times = np.ndarray
STEADY = T0 + np.arange(COUNT) * STEP


def back(cut: int, by_ns: int) -> Times:
    """Return times of a clock that goes back before a record."""
    return STEADY - np.where(np.arange(COUNT) >= cut, by_ns, 0)


def rows_of(times: Times) -> list[Row]:
    return [row for k, t in enumerate(times.tolist()) for row in (twist(t, 1 + k / 100, 0.0), yaw(t, k / 10))]


def tables_of(times: Times) -> Tables:
    k = np.arange(len(times))
    dvl = {"time_ns": times, "starboard_mps": 0.0 * k, "forward_mps": 1 + k / 100}
    return {"dvl": dvl, "compass": {"time_ns": times, "heading_deg": 90 - k / 10}}


def timed(times: Times, text: Callable[[int], str]) -> list[str]:
    """Return a line for each record, by its number, behind its time."""
    return [f"{t // SECOND}.{t % SECOND:09d} {text(k)}" for k, t in enumerate(times.tolist())]


def true_heading(k: int) -> str:
    return sentence(f"HEHDT,{90 - k / 10:.1f},T")


def as_nmea(folder: Path, times: Times) -> Path:
    return saved_lines(folder / "a.nmea", timed(times, true_heading))


def as_tlog(folder: Path, times: Times) -> Path:
    made, angles = mavlink.MAVLink_attitude_message, [math.radians(90 - k / 10) for k in range(len(times))]
    attitudes = (made(0, 0, 0, angle, 0, 0, 0) for angle in angles)
    return write_packets(folder / "a.tlog", zip(times.tolist(), attitudes, strict=True))


def as_alog(folder: Path, times: Times) -> Path:
    log = [line((t - T0) / SECOND + 10**6, "HEADING", "iCompass", 90 - k / 10) for k, t in enumerate(times.tolist())]
    (folder / "usbldr.toml").write_text(TOML.format("HEADING"))
    return saved(folder / "a.alog", HEAD, *log)


def as_json_lines(folder: Path, times: Times) -> Path:
    (folder / "usbldr.toml").write_text(TOML.format("h"))
    return saved_lines(folder / "a.jsonl", timed(times, lambda k: f'{{"h": {90 - k / 10}}}'))


def as_lsf(folder: Path, times: Times) -> Path:
    angles = np.radians(90 - np.arange(len(times)) / 10).tolist()
    sequence = [sent("EulerAngles", t / SECOND, 6, psi=psi) for t, psi in zip(times.tolist(), angles, strict=True)]
    return write_messages(folder, sequence)


def as_blueos(folder: Path, times: Times) -> Path:
    rows = [(t, "ATTITUDE", {"yaw": math.radians(90 - k / 10)}) for k, t in enumerate(times.tolist())]
    return write_blueos(folder / "a.mcap", rows)


def as_onboard(folder: Path, times: Times) -> Path:
    clocks = ((times - T0) // 1000 + 2 * 10**12).tolist()
    rows = ((us, 0, 0, 0.0, (90 - k / 10) % 360, 0) for k, us in enumerate(clocks))
    return write_rows(folder / "a.BIN", DEFINITIONS[0], rows)


def pd_clock(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns // SECOND, UTC):%y%m%d%H%M%S}{time_ns // 10**7 % 100:02d}"


def as_pd0(folder: Path, times: Times) -> Path:
    clocks = [pd_clock(t) for t in times.tolist()]
    velocity = (250, -1500, 10, 0)
    parts = (ensemble(k, 1, velocity, gga=False, clock=t, heading=9000 - 10 * k) for k, t in enumerate(clocks))
    return saved(folder / "a.pd0", *parts)


def as_pd45(form: int, folder: Path, times: Times) -> Path:
    """Write PD5, which has headings, or PD4, whose records are recognised by their velocities."""
    own = [{"heading": 9000 - 10 * k, "depth": 100} if form == 5 else {} for k in range(len(times))]
    clocks = enumerate((times // 10**7 % 8_640_000).tolist())
    return saved(
        folder / f"a.pd{form}", *(pd45_ensemble(form, t, x=0, y=1000 + 10 * k, z=10, **own[k]) for k, t in clocks)
    )


def as_lines(folder: Path, times: Times) -> Path:
    """Write lines that begin with a word, behind their log times."""
    lines = timed(times, lambda k: f"wrz,{1 + k / 100},0.25,-0.01,y,1.30,1.855,0,,,123.0,1")
    return saved_lines(folder / "a.log", lines)


def as_reports(folder: Path, times: Times) -> Path:
    clocks = [dict.fromkeys(("time_of_validity", "time_of_transmission"), t // 1000) for t in times.tolist()]
    reports = (velocity(0) | clock | {"vx": 1 + k / 100} for k, clock in enumerate(clocks))
    return saved_lines(folder / "a.jsonl", map(json.dumps, reports))


def as_pd6(folder: Path, times: Times) -> Path:
    lines: list[str] = []
    for k, t in enumerate(times.tolist()):
        lines += [f":SA, +1.00, -2.00,{90 - k / 10:6.2f}\r"]
        lines += [f":TS,{pd_clock(t)}, 0.0, +0.0,{k / 10:6.1f},1475.0,  0\r"]
        lines += [f":BI,  +{100 + k},  -420, +2000,    +0,A\r"]
    return saved_lines(folder / "a.pd6", lines)


def as_sentences(folder: Path, times: Times) -> Path:
    """Write headings without times between fixes that have the only ones, and no place."""
    lines: list[str] = []
    for k, t in enumerate(times.tolist()):
        moment, hundredths = datetime.fromtimestamp(t // SECOND, UTC), t % SECOND // 10**7
        lines += [sentence(f"GPRMC,{moment:%H%M%S}.{hundredths:02d},A,,,,,1.0,90.0,{moment:%d%m%y},,,A")]
        lines += [true_heading(k)]
    return saved_lines(folder / "a.nmea", lines)


def as_carried(folder: Path, times: Times) -> Path:
    """Write sentences as texts of a topic."""
    kind = "std_msgs/msg/String"
    rows = [(t, "/gyro/nmea", kind, {"data": true_heading(k)}) for k, t in enumerate(times.tolist())]
    return write_bag(folder / "a.bag", rows)


def packed(writer: Callable[[Path, Times], Path], folder: Path, times: Times) -> Path:
    file = writer(folder, times)
    return saved(file.with_name(file.name + ".gz"), gzip.compress(file.read_bytes()))


CONTAINERS: dict[str, Callable[[Path, Times], Path]] = {
    "mcap": lambda folder, times: write_mcap(folder / "a.mcap", rows_of(times)),
    "unchunked mcap": lambda folder, times: write_mcap(folder / "a.mcap", rows_of(times), chunked=False),
    "bag": lambda folder, times: write_bag(folder / "a.bag", rows_of(times), chunk_size=2000),
    "rosbag2": lambda folder, times: write_rosbag2(folder / "a", rows_of(times)),
    "rosbag2 mcap": lambda folder, times: write_rosbag2(folder / "a", rows_of(times), StoragePlugin.MCAP),
    "csv": lambda folder, times: as_csv(folder, tables_of(times)),
    "netCDF": lambda folder, times: as_netcdf(folder, tables_of(times)),
    **{form: lambda folder, times, write=write: write(folder, tables_of(times)) for form, write in WRITERS.items()},
    "nmea": as_nmea,
    "sentences that hold the time": as_sentences,
    "sentences in a topic": as_carried,
    "lines of a DVL": as_lines,
    "reports of a DVL": as_reports,
    "tlog": as_tlog,
    "alog": as_alog,
    "json lines": as_json_lines,
    "lsf": as_lsf,
    "MCAP of BlueOS": as_blueos,
    "BIN": as_onboard,
    "PD0": as_pd0,
    "PD0.gz": partial(packed, as_pd0),
    "MCAP.gz": partial(packed, as_blueos),
    "PD4": partial(as_pd45, 4),
    "PD5": partial(as_pd45, 5),
    "PD6": as_pd6,
}

UNDATED, HOUR = ("PD4", "PD5"), 3600 * SECOND  # times of the day, as PD4: a step of half a day and more is a midnight


def headings(log: Log) -> list[int]:
    """Return the numbers of the records in the order in which they are used; without a compass those of the DVL."""
    if "compass" not in log.tables:
        return np.rint((log.tables["dvl"]["forward_mps"].to_numpy() - 1) * 100).astype(int).tolist()
    return np.rint((90 - log.tables["compass"]["heading_deg"].to_numpy()) * 10).astype(int).tolist()


def with_fixes(folder: Path, times: Times, fix_times: Times, gap: slice) -> Path:
    """Write a dive with fixes at some times but those of a gap; each is as far east as its record's number."""
    k = np.delete(np.arange(COUNT), gap)
    fixes = {"time_ns": fix_times[k], "east_m": 1.0 * k, "north_m": 0.0 * k}
    return as_csv(folder, {**tables_of(times), "usbl": fixes})


@pytest.mark.parametrize("container", CONTAINERS)
@settings(max_examples=1)
@given(cut=st.integers(10, COUNT - 10), back_ns=st.integers(3 * SECOND // 2, 10**6 * SECOND))
@example(cut=COUNT // 2, back_ns=100 * SECOND)  # the last record is neither the first nor the last in time
def test_a_clock_that_goes_back_makes_two_parts(container: str, cut: int, back_ns: int) -> None:
    times = back(cut, back_ns if container not in UNDATED else min(back_ns, 10 * HOUR))

    with TemporaryDirectory() as folder:
        log = CONTAINERS[container](Path(folder), times)
        with pytest.raises(PartsError, match=r"part 1: .*; part 2: ") as stopped:
            read_log(log)
        found = survey(log, Request())
        spans = [
            topic.last_ns - topic.first_ns for topic in open_reader(log).topics() if topic.last_ns and topic.first_ns
        ]
        parts = [read_log(log, Request(part=part)) for part in ("1", "2", "joined")]

    assert stopped.value.exit_code == 2
    assert [finding.code for finding in found.findings].count("CLOCK-BACK") == 1
    np.testing.assert_allclose(max(spans), np.ptp(times), atol=SECOND)  # PD0 has slower topics, too
    assert [headings(part) for part in parts] == [[*range(cut)], [*range(cut, COUNT)], [*range(COUNT)]]
    times_s = parts[2].tables["compass" if "compass" in parts[2].tables else "dvl"]["time_s"]
    np.testing.assert_allclose(np.diff(times_s), 0.2, atol=2e-5)  # of .alog's digits


def test_records_in_another_order_are_refused_in_a_short_sentence(tmp_path: Path) -> None:
    times = T0 + np.random.default_rng(1).permutation(COUNT) * 10 * SECOND

    with pytest.raises(PartsError) as stopped:
        read_log(as_csv(tmp_path, tables_of(times)))

    assert stopped.value.text.endswith("; the records are not in the order of their times: sort them")
    assert len(stopped.value.text) < 250


@pytest.mark.parametrize("container", ["mcap", "bag", "csv", "HDF5", "lsf"])
@pytest.mark.parametrize("cut", [10, 37, COUNT - 10])
@pytest.mark.parametrize(
    ("by_ns", "said"),
    [
        (T0 - 30 * SECOND, r"forward by 15999999\d\d\.\d{3} s .*part 1: 1970-.*; part 2: "),
        (HOUR, r"forward by 3600\.000 s .*all sensors pause.*part 1: .*; part 2: "),
    ],
)
def test_a_clock_that_was_set_forward_and_a_long_pause_make_parts(tmp_path, by_ns, said, cut, container):
    """As of a computer without a battery, before NTP answers; the time after that is right for all."""
    log = CONTAINERS[container](tmp_path, STEADY - np.where(np.arange(COUNT) < cut, by_ns, 0))

    with pytest.raises(PartsError, match=said):
        read_log(log)
    parts = [read_log(log, Request(part=part)) for part in ("1", "2", "joined")]

    assert [finding.code for finding in survey(log, Request()).findings].count("CLOCK-FORWARD") == 1
    assert [headings(part) for part in parts] == [[*range(cut)], [*range(cut, COUNT)], [*range(COUNT)]]
    np.testing.assert_allclose(np.diff(parts[2].tables["compass"]["time_s"]), 0.2, atol=1e-5)
    assert by_ns == HOUR or abs(parts[2].start_ns - T0) < SECOND // 1000


@pytest.mark.parametrize("cut", [10, 37, COUNT - 10])
def test_stamps_that_go_forward_alone_make_parts(tmp_path: Path, cut: int) -> None:
    """The clock of the sensors was set, and that of the recorder goes on."""
    times = STEADY - np.where(np.arange(COUNT) < cut, HOUR, 0)
    rows = [(arrived, *row[1:]) for arrived, row in zip(np.repeat(STEADY, 2).tolist(), rows_of(times), strict=True)]
    log = write_mcap(tmp_path / "a.mcap", rows)

    with pytest.raises(PartsError, match=r"forward by 3600\.000 s .*part 1: .*; part 2: "):
        read_log(log)
    joined = read_log(log, Request(part="joined"))

    np.testing.assert_allclose(np.diff(joined.tables["compass"]["time_s"]), 0.2, atol=1e-5)


def test_three_recordings_are_three_parts_and_each_has_its_few_fixes(tmp_path: Path) -> None:
    k = np.arange(COUNT)
    times = STEADY + 2 * HOUR * (k >= 20) + HOUR * (k >= 60)
    fixes = {"time_ns": times[4::5] + STEP // 2, "east_m": 1.0 * k[4::5], "north_m": 0.0 * k[4::5]}

    log = as_csv(tmp_path, {**tables_of(times), "usbl": fixes})
    parts = [read_log(log, Request(part=part)).tables["usbl"]["east_m"].tolist() for part in "123"]

    assert parts == [[4, 9, 14, 19], [*range(24, 60, 5)], [*range(64, COUNT, 5)]]


PAUSED = T0 + np.arange(COUNT) * 60 * SECOND + np.where(np.arange(COUNT) < 20, 0, HOUR)
NEWEST_FIRST = T0 + np.arange(COUNT)[::-1] * 5 * SECOND


@pytest.mark.parametrize(
    ("times", "order", "said"),
    [
        (PAUSED, [*range(COUNT)], "all sensors pause for 3660 s together after 2020-09-13T12:45:40.000Z"),
        (NEWEST_FIRST, [*range(COUNT)][::-1], ""),
    ],
)
def test_a_shorter_pause_of_all_sensors_is_said_and_the_newest_row_may_be_the_first(tmp_path, times, order, said):
    log = read_log(as_csv(tmp_path, tables_of(times)))

    assert headings(log) == order
    assert said in codes(log).get("PAUSE", "")


def test_a_pause_of_one_sensor_is_none(tmp_path: Path) -> None:
    """The fixes go on an hour later, where no other sensor has a record."""
    log = with_fixes(tmp_path, STEADY, back(37, -HOUR), slice(0, 0))

    assert {"PAUSE", "CLOCK-FORWARD"}.isdisjoint(codes(read_log(log)))


FAR_AHEAD = STEADY + np.where((np.arange(COUNT) >= 20) & (np.arange(COUNT) < 29), 10**9 * SECOND, 0)
TWICE = np.concatenate([np.arange(30), np.arange(30)]) * SECOND


@pytest.mark.parametrize(
    ("times", "targets", "rows"),
    [
        (FAR_AHEAD, [], []),
        (TWICE, [np.arange(30), np.arange(30, 60)], []),
        (TWICE, [], [30]),
        (back(40, 3 * SECOND), [np.arange(0, COUNT, 2), np.arange(1, COUNT, 2)], [40]),
    ],
    ids=["a few far ahead", "targets one after the other", "one target", "targets in turn"],
)
def test_a_step_is_one_of_all_targets_that_stays(times: Times, targets: list[Times], rows: list[int]) -> None:
    assert [step.row for step in examined(times, targets or None).steps] == rows


@settings(max_examples=20)
@given(
    container=st.sampled_from(sorted(CONTAINERS)),
    wrong=st.sets(st.integers(0, COUNT - 1), max_size=3),
    ahead=st.booleans(),
)
def test_single_wrong_times_make_no_parts(container: str, wrong: set[int], ahead: bool) -> None:
    times = STEADY.copy()
    times[sorted(wrong)] += (500 if ahead else -500) * SECOND

    with TemporaryDirectory() as folder:
        log = read_log(CONTAINERS[container](Path(folder), times))

    assert sorted(headings(log)) == [*range(COUNT)]
    assert bool(np.any(np.diff(times) < 0)) == ("sorted" in codes(log).get("OUT-OF-ORDER", ""))


WIDTHS = {
    "microseconds": 2**32 * 1_000,
    "milliseconds": 2**32 * 1_000_000,
    "the day": 86_400 * SECOND,
    "the week": 604_800 * SECOND,
}


@settings(max_examples=16)
@given(
    counter=st.sampled_from(sorted(WIDTHS)),
    container=st.sampled_from(["csv", "Parquet", "HDF5", "MATLAB"]),
    first=st.integers(1, COUNT - 1),
    offset_ns=st.integers(0, STEP - 1),
)
def test_a_counter_that_is_full_counts_on(counter: str, container: str, first: int, offset_ns: int) -> None:
    """The first records after the counter began again, were it only one."""
    width = WIDTHS[counter]
    times = (width - first * STEP + offset_ns + np.arange(COUNT) * STEP) % width

    with TemporaryDirectory() as folder:
        log = read_log(CONTAINERS[container](Path(folder), times))

    assert headings(log) == [*range(COUNT)]
    assert counter in codes(log)["CLOCK-WRAP"]
    np.testing.assert_allclose(np.diff(log.tables["compass"]["time_s"]), 0.2, atol=1e-6)


@pytest.mark.parametrize(
    "counter", [(16, 10**6, "milliseconds"), (24, 1000, "microseconds"), (24, 10**6, "milliseconds")]
)
@settings(max_examples=4)
@given(
    container=st.sampled_from(["csv", "Parquet", "HDF5", "MATLAB"]),
    rounds=st.integers(22, COUNT // 2 - 5),
    phase=st.integers(0, 2**16 - 1),
)
def test_a_narrow_counter_that_is_full_twice_counts_on(counter, container, rounds, phase) -> None:
    """A clock that goes back once by as much was set."""
    bits, unit_ns, name = counter
    width, step = 2**bits, 2**bits // rounds
    times = (phase + np.arange(COUNT) * step) % width * unit_ns
    _, second = np.flatnonzero(np.diff(times) < 0)[:2] + 1

    with TemporaryDirectory() as folder, TemporaryDirectory() as once:
        log = read_log(CONTAINERS[container](Path(folder), times))
        with pytest.raises(PartsError):
            read_log(CONTAINERS[container](Path(once), times[second - 11 : second + 11]))

    assert f"{bits}-bit counter of {name}" in codes(log)["CLOCK-WRAP"]
    np.testing.assert_allclose(np.diff(log.tables["compass"]["time_s"]), step * unit_ns / SECOND, rtol=1e-6)


@pytest.mark.parametrize("width", WIDTHS.values())
def test_a_wrap_that_a_gap_of_the_fixes_hides_is_that_of_the_other_sensors(tmp_path: Path, width: int) -> None:
    times = (width + (np.arange(COUNT) - COUNT // 2) * STEP) % width

    log = read_log(with_fixes(tmp_path, times, times, slice(COUNT // 2 - 15, COUNT // 2 + 15)))

    fixes = log.tables["usbl"]
    np.testing.assert_allclose(fixes["time_s"], fixes["east_m"] * STEP / SECOND, atol=1e-6)


@pytest.mark.parametrize(("own_clock", "gap_ends"), [(False, 50), (True, 35)])
def test_a_gap_of_the_fixes_may_hide_a_step_of_their_clock(tmp_path: Path, own_clock: bool, gap_ends: int) -> None:
    """A clock of their own, without the step, goes on for longer."""
    times = back(COUNT // 2, 3 * SECOND)

    log = with_fixes(tmp_path, times, STEADY if own_clock else times, slice(25, gap_ends))
    parts = {part: read_log(log, Request(part=part)) for part in ("2", "joined")}

    fixes = parts["joined"].tables["usbl"]
    np.testing.assert_allclose(fixes["time_s"], fixes["east_m"] * STEP / SECOND, atol=1e-6)
    assert own_clock or parts["2"].tables["usbl"]["east_m"].tolist() == [*range(gap_ends, COUNT)]


def test_stamps_have_no_step_that_a_gap_hides_in_the_log_times_alone(tmp_path: Path) -> None:
    fixes = [point(t, float(k), 0.0) for k, t in enumerate(STEADY.tolist()) if not 25 <= k < 50]
    rows = sorted([*rows_of(STEADY), *fixes], key=lambda row: row[0])
    logged = [(row[0] - 3 * SECOND * (row[0] >= STEADY[COUNT // 2]), *row[1:]) for row in rows]

    log = read_log(write_mcap(tmp_path / "a.mcap", logged), Request(part="joined"))

    np.testing.assert_allclose(log.tables["usbl"]["time_s"], log.tables["usbl"]["east_m"] * STEP / SECOND, atol=1e-6)


def test_stamps_of_delayed_fixes_may_go_back(tmp_path: Path) -> None:
    delays = np.where(np.arange(40) % 3 == 1, 4.0, 0.5)
    rows = [row for k in range(40) for row in (twist(T0 + k * SECOND, 1.0, 0.0), yaw(T0 + k * SECOND, 0.0))]
    fixes = [
        point(T0 + k * 2 * SECOND - round(d * SECOND), float(k), 0.0, delay_s=d) for k, d in enumerate(delays.tolist())
    ]

    log = read_log(write_mcap(tmp_path / "a.mcap", sorted(rows + fixes, key=lambda row: row[0])))

    assert len(log.tables["usbl"]) == 40


def test_only_the_stamps_of_one_sensor_go_back(tmp_path: Path) -> None:
    """Its driver started again: the compass has no step and is cut to the time of the part."""
    rows = rows_of(STEADY)
    for k in range(80, 2 * COUNT, 2):  # of the DVL
        time_ns, topic, kind, values = rows[k]
        rows[k] = time_ns, topic, kind, dict(values) | {"header.stamp": time_ns - 5 * SECOND}
    log = write_mcap(tmp_path / "a.mcap", rows)

    with pytest.raises(PartsError, match=r"/dvl: the clock goes back by 5\.000 s"):
        read_log(log)
    whole = read_log(log, Request(part="joined"))
    np.testing.assert_allclose(np.diff(whole.tables["dvl"]["time_s"]), 0.2, atol=1e-6)
    assert headings(whole) == [*range(COUNT)]


def test_a_part_that_there_is_not_is_refused_and_one_without_a_step_is_said(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "a.mcap", rows_of(back(40, 100 * SECOND)))

    with pytest.raises(UsageError, match=r"there is no part 3: /dvl, /imu: the clock goes back by 100\.000 s"):
        read_log(log, Request(part="3"))
    assert headings(read_as(log, "part = 2\n")) == [*range(40, COUNT)]
    assert "part 2: 2020-09-13T12:25:08.000Z" in run("info", log, "--config", "none").output
    assert "only part 2 is used" in run("info", log, "--config", "none", "--part", "2").output

    log = read_log(write_mcap(tmp_path / "a.mcap", rows_of(STEADY)), Request(part="2"))

    assert "part is not used" in codes(log)["KEY-UNUSED"]
