"""Topics of types that nobody here knows: the configuration names their fields."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from damage import recorded
from damaged_formats import FORMATS
from logs import logged, logged_csv, read_as, refusal
from recordings import HEADER, SECOND, T0, Row, define, fields, write_bag, write_mcap, write_rosbag2
from usbldr.filters.errors import UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.log import Log
from usbldr.io.reading.opening import ConfigurationFile
from usbldr.io.reading.read import Request, read_log
from usbldr.io.settings.sensor_sections import Configuration

DEEPEST_M = 1000.0  # of a field to be read as a depth
INS = "acme_msgs/msg/InsOutput"
DEFINITION = HEADER + fields("acme_msgs/Speeds speeds", "float64[3] position_rad_m", "float32 azimuth")
DEFINITION += fields("float64 pressure_bar", "uint8 fault", "uint64 utc_us", "float64 since_1970", "string note")
SPEEDS = "float32[3] along\nbool locked\n"
TYPES = {"acme_msgs/msg/Speeds": SPEEDS, INS: DEFINITION}
define(TYPES, ros_1=True)

CONFIGURATION = """
[dvl]
topic = "/ins"
columns = { x = "speeds.along[0]", y = "speeds.along.1", z = "speeds.along[2]", valid = "speeds.locked" }
axes = "SFD"
unit = "mm/s"
[compass]
topic = "/ins"
columns = { time_unix_us = "utc_us", heading = "azimuth [rad]", error = "fault" }
convention = "ENU"
[gps]
topic = "/ins"
columns = { time_unix_s = "since_1970", lat_deg = "position_rad_m[0] [rad]", lon_deg = "position_rad_m[1] (rad)" }
[depth]
topic = "/ins"
columns = { time_ns = "header.stamp", pressure = "pressure_bar" }
surface_pa = 100000.0
"""


def rows(count: int = 20) -> list[Row]:
    made: list[Row] = []
    for k in range(count):
        t = T0 + k * SECOND
        along, place = [100 + k, 1000 - 3 * k, 7.5], [0.75 + k * 1e-7, 0.12 - k * 2e-7, 3.0]
        values = {"speeds.along": np.array(along, dtype=np.float32), "speeds.locked": k != 4}
        values |= {"position_rad_m": np.array(place), "azimuth": 0.3 + 0.01 * k, "pressure_bar": 1.25 + 0.01 * k}
        values |= {"fault": 17 if k == 9 else 0, "utc_us": t // 1000 + 250_000, "since_1970": t / 1e9 + 0.5}
        made.append((t + 5, "/ins", INS, {"header.stamp": t - 3, **values}))
    return made


WRITERS: Mapping[str, Callable[[Path], Path]] = {
    "MCAP": lambda folder: write_mcap(folder / "dive.mcap", rows()),
    "ROS 1 bag": lambda folder: write_bag(folder / "dive.bag", rows()),
    "rosbag2 db3": lambda folder: write_rosbag2(folder / "dive_db3", rows()),
    "rosbag2 MCAP": lambda folder: write_rosbag2(folder / "dive_mcap", rows(), StoragePlugin.MCAP),
}


def decoded_by_rosbags(log: Path) -> dict[str, np.ndarray]:
    """Return the fields as rosbags decodes them; of a bare MCAP file, those of the same messages in a folder."""
    source = log if log.suffix != ".mcap" else write_rosbag2(log.parent / "again", rows())
    with AnyReader([source], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        messages: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]
    stamps = [one.header.stamp.sec * SECOND + one.header.stamp.nanosec for one in messages]
    found = {"along": np.array([one.speeds.along for one in messages], dtype=np.float64), "stamp": np.array(stamps)}
    found["locked"] = np.array([one.speeds.locked for one in messages])
    for name in ("position_rad_m", "azimuth", "pressure_bar", "fault", "utc_us", "since_1970"):
        found[name] = np.array([getattr(one, name) for one in messages])
    return found


def stamps_ns(log: Log, role: str) -> list[int]:
    return [log.start_ns + round(t * 1e9) for t in log.tables[role]["time_s"]]


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=4)
@given(data=st.data())
def test_columns_name_every_field_that_a_topic_lists(form: str, data: st.DataObject) -> None:
    """Its values as a depth are those that are read of it."""
    with recorded(form) as (_, path, _, _):
        log = open_reader(path)
        topic = data.draw(st.sampled_from([topic for topic in log.topics() if topic.count and not topic.problem]))
        field, shown = data.draw(st.sampled_from([*zip(topic.fields, topic.shown_fields, strict=True)]))
        field = f"{field}.0" if field in topic.arrays else field
        values = read_whole(log, {topic.name: [field]})[topic.name].columns[field]
        assert len(values) == topic.count

        time = "time_s" if form == "netCDF-4" else "time_ns"
        columns = {"depth_m": shown} | ({time: time.removesuffix("_s")} if topic.is_table else {})
        sections = {"depth": {"topic": topic.name, "columns": columns}, "gps": {"topic": "none"}}
        stated = ConfigurationFile(None, msgspec.convert(sections, Configuration))
        if values.dtype.kind in "iuf" and field != "header.stamp" and np.all(np.abs(values) < DEEPEST_M):
            read = read_log(path, Request(stated, topics=dict.fromkeys(("dvl", "compass", "usbl"), "none")))
            assert read.provenance["depth"].messages == topic.count
            assert np.isin(np.round(read.tables["depth"]["depth_m"], 6), np.round(values.astype(float), 6)).all()


@pytest.mark.parametrize("kind", WRITERS)
def test_fields_of_an_unknown_type_have_the_values_that_rosbags_decodes(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    truth, log = decoded_by_rosbags(file), read_as(file, CONFIGURATION)

    tables = log.tables
    np.testing.assert_allclose(tables["dvl"]["starboard_mps"], truth["along"][:, 0] / 1000, rtol=1e-12)
    np.testing.assert_allclose(tables["dvl"]["forward_mps"], truth["along"][:, 1] / 1000, rtol=1e-12)
    np.testing.assert_allclose(tables["dvl"]["up_mps"], -truth["along"][:, 2] / 1000, rtol=1e-12)
    np.testing.assert_array_equal(tables["dvl"]["valid"], truth["locked"])
    assert stamps_ns(log, "dvl") == truth["stamp"].tolist()  # the header's, for no time is named
    good = truth["fault"] == 0
    np.testing.assert_allclose(tables["compass"]["heading_deg"], 90 - np.degrees(truth["azimuth"][good]), atol=1e-5)
    assert stamps_ns(log, "compass") == (truth["utc_us"][good].astype(np.int64) * 1000).tolist()
    np.testing.assert_allclose(tables["gps"]["lat_deg"], np.degrees(truth["position_rad_m"][:, 0]), atol=1e-12)
    np.testing.assert_allclose(tables["gps"]["lon_deg"], np.degrees(truth["position_rad_m"][:, 1]), atol=1e-12)
    np.testing.assert_allclose(stamps_ns(log, "gps"), truth["since_1970"] * 1e9, atol=500)
    depth_m = (truth["pressure_bar"] - 1.0) * 1e5 / (1025.0 * 9.80665)
    np.testing.assert_allclose(tables["depth"]["depth_m"], depth_m, rtol=1e-12)
    assert {p.type.replace("/msg/", "/") for p in log.provenance.values()} == {"acme_msgs/InsOutput"}


def ins_with(tmp_path: Path, toml: str) -> Log:
    return logged(tmp_path, rows(), toml)


HERE = '[dvl]\ntopic = "/ins"\ncolumns = '
FIELDS = (
    "header.stamp, header.frame_id, speeds.along[0], speeds.locked, position_rad_m[0], azimuth, pressure_bar, fault, "
    "utc_us, since_1970, note"
)


@pytest.mark.parametrize(
    ("toml", "sentence"),
    [
        (HERE + '{ x = "speed.along[0]", y = "speeds.along[1]" }',
         "/ins has no speed.along[0] ([dvl] columns x); did you mean speeds.along[0]? (it has " + FIELDS + ")"),
        (HERE + '{ x = "azimuth[0]", y = "speeds.along[1]" }',
         "/ins has no azimuth[0] ([dvl] columns x); did you mean azimuth? (it has " + FIELDS + ")"),
        (HERE + '{ x = "speeds.along", y = "speeds.along[1]" }',
         "/ins has no speeds.along ([dvl] columns x); did you mean speeds.along[0] or speeds.locked? (it has "
         + FIELDS + ")"),
        (HERE + '{ x = "speeds.along[0]" }', "[dvl] columns must name x, y"),
        (HERE + '{ x = "speeds.along[0]", y = "speeds.along[1]", time_ns = "header.stamp", time_s = "since_1970" }',
         "[dvl] columns name time_ns and time_s; state one of them"),
        (HERE + '{ x = "speeds.along[0]", y = "speeds.along[1]", received_ns = "header.stamp" }',
         "[dvl] columns: messages arrive at their log time; leave out received_ns and received_unix_s"),
        (HERE + '{ x = "speeds.along[0] [furlong/day]", y = "speeds.along[1]" }',
         "[dvl] columns x: the unit of speeds.along[0] [furlong/day] is not one of m/s, cm/s, mm/s, km/h, ft/s, knots"),
        (HERE + '{ x = "speeds.along[0]", y = "speeds.along[1]", time_unix_s = "header.stamp" }',
         "/ins: header.stamp under columns has values beyond 2116 in the unit of its key; is it time_ns?"),
        (HERE + '{ x = "speeds.along[0]", y = "speeds.along[1]", time_unix_s = "note" }',
         "/ins: note under columns is text, not a time"),
        ('[dvl]\ncolumns = { x = "vx", y = "vy" }', "no topic has the columns vx, vy of [dvl]; state topic, too"),
        ('[usbl]\ntopic = "/ins"\ncolumns = { lat_deg = "azimuth", lon_deg = "azimuth", x = "azimuth" }',
         "[usbl] columns: x cannot be used beside lat_deg, lon_deg"),
    ],
)  # fmt: skip
def test_columns_that_do_not_fit_are_one_sentence(tmp_path: Path, toml: str, sentence: str) -> None:
    assert refusal(UsageError, ins_with, tmp_path, toml) == f"{tmp_path / 'dive.mcap'}: {sentence}"


def test_a_unit_that_a_name_ends_in_holds_unless_the_section_states_one(tmp_path: Path) -> None:
    sheet = f"time_ns,vx_cm_s,vy [mm/s]\n{T0},100,200\n{T0 + SECOND},110,210"
    columns = '[dvl]\ncolumns = { time_ns = "time_ns", x = "vx_cm_s", y = "vy [mm/s]" }\naxes = "FSD"\n'

    by_name = logged_csv(tmp_path, columns, doppler=sheet)
    decimals = sheet.replace("0,1", "0,1.").replace("0,2", "0,2.")
    by_section = logged_csv(tmp_path, columns + 'unit = "knots"\n', doppler=decimals)

    np.testing.assert_allclose(by_name.tables["dvl"][["forward_mps", "starboard_mps"]], [[1.0, 0.2], [1.1, 0.21]])
    assert by_section.convention("dvl", "unit").value == "knots"


def test_two_sensors_of_one_csv_file_share_its_time(tmp_path: Path) -> None:
    sheet = f"utc_ms,vx,vy,hdg\n{T0 // 10**6},1,2,30\n{T0 // 10**6 + 1000},1,2,31"
    toml = """
[dvl]
topic = "/nav"
columns = { time_unix_ms = "utc_ms", x = "vx", y = "vy" }
axes = "FSD"
[compass]
topic = "/nav"
columns = { time_unix_ms = "utc_ms", heading = "hdg" }
"""
    log = logged_csv(tmp_path, toml, nav=sheet)

    np.testing.assert_array_equal(log.tables["dvl"]["forward_mps"], [1, 1])
    np.testing.assert_array_equal(log.tables["compass"]["heading_deg"], [30, 31])
    assert stamps_ns(log, "compass") == [T0, T0 + SECOND]
    with pytest.raises(UsageError, match=r"nav.csv: \[dvl\] and \[compass\] name different times of one file"):
        logged_csv(tmp_path, toml.replace('"utc_ms", heading', '"hdg", heading'), nav=sheet)


def test_the_clock_offset_of_a_file_moves_times_in_every_unit(tmp_path: Path) -> None:
    here = ins_with(tmp_path, CONFIGURATION)
    moved = ins_with(tmp_path, CONFIGURATION + '[[file]]\npath = "dive.mcap"\nclock_offset_s = 1.5\n')

    for role in ("dvl", "compass", "gps", "depth"):
        apart = np.array(stamps_ns(here, role)) - np.array(stamps_ns(moved, role))
        np.testing.assert_allclose(apart, 1.5 * SECOND, atol=500)


def test_fields_of_the_truth_are_never_those_of_a_sensor(tmp_path: Path) -> None:
    position = 'columns = { lat_deg = "position_rad_m[0] [rad]", lon_deg = "position_rad_m[1] [rad]" }\n'
    twice = "".join(f'[{sensor}]\ntopic = "/ins"\n{position}' for sensor in ("usbl", "gps"))

    assert "/ins cannot be the usbl and the truth at once" in refusal(UsageError, ins_with, tmp_path, twice)
