"""CSV files as `rostopic echo -p` writes them, and long files with a column that names the sensor."""

from pathlib import Path

import numpy as np
import pytest

from logs import read_as, refusal
from recordings import T0, write_csv
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import read_log
from usbldr.io.tables.csv_log import csv_log

STAMP = 1474477150941968287  # no float64
COVARIANCE = ",".join(f"field.twist.covariance{k}" for k in range(36))
VALUES = ",".join(str(k / 8) for k in range(36))
HEADER = "%time,field.header.seq,field.header.stamp,field.header.frame_id"
TWIST = f"""
    {HEADER},field.twist.twist.linear.x,field.twist.twist.linear.y,field.twist.twist.linear.z,{COVARIANCE}
    {STAMP + 3},1,{STAMP},dvl_ned,1.5,-0.25,0.125,{VALUES}
"""


def test_times_are_whole_nanoseconds_and_arrays_have_numbered_fields(tmp_path: Path) -> None:
    log = csv_log(write_csv(tmp_path / "dive", nav__dvl=TWIST))

    (topic,) = log.topics()
    paths = ["header.stamp", "header.frame_id", "twist.twist.linear.y", "twist.covariance.0", "twist.covariance.35"]
    records = read_whole(log, {"/nav/dvl": paths})["/nav/dvl"]

    assert (topic.name, topic.type, topic.count) == ("/nav/dvl", "geometry_msgs/TwistWithCovarianceStamped", 1)
    assert topic.first_ns == STAMP + 3
    assert records.received_ns[0] == STAMP + 3
    assert [records.columns[path][0] for path in paths] == [STAMP, "dvl_ned", -0.25, 0.0, 35 / 8]


def xyz(of: str) -> str:
    return f"{of}.x,{of}.y,{of}.z"


BY_COLUMNS = {
    "TwistStamped": xyz("twist.linear"),
    "PointStamped": xyz("point"),
    "PoseStamped": xyz("pose.position") + ",pose.orientation.x",
    "Imu": "orientation.x,angular_velocity.x",
    "NavSatFix": "status.status,latitude,longitude",
    "DVL": f"time,{xyz('velocity')},fom,velocity_valid",
    "DVL ": "velocity.x,velocity_covariance0",
    "Dvl": "velocity.x,velocity_covar0,num_good_beams,coordinate_mode",
    "TransducerReportStamped": "report.vx,report.velocity_valid",
    "GPSFix": "latitude,longitude,err_horz",
    "": "name",
}


@pytest.mark.parametrize("kind", BY_COLUMNS)
def test_the_type_of_a_message_is_known_by_its_columns(tmp_path: Path, kind: str) -> None:
    columns = [f"field.{name}" for name in BY_COLUMNS[kind].split(",")]
    text = f"{HEADER},{','.join(columns)}\n{T0},1,{T0},f,{','.join('0' * len(columns))}"

    (topic,) = csv_log(write_csv(tmp_path / "dive", a=text)).topics()

    assert (topic.type.rpartition("/")[2], topic.problem) == (kind.strip(), "")


def test_a_frame_is_a_text_wherever_its_type_names_it(tmp_path: Path) -> None:
    linear = ",".join(f"field.twist.twist.linear.{axis}" for axis in "xyz")
    columns = f"field.child_frame_id,field.pose.pose.position.x,{linear},field.twist.covariance0"
    text = f"{HEADER},{columns}\n{T0},1,{T0},odom_frame,base_ned,0,1.5,-0.25,0,0.1"

    log = read_log(write_csv(tmp_path / "dive", dvl=text))

    assert log.tables["dvl"][["starboard_mps", "forward_mps"]].to_numpy()[0].tolist() == [-0.25, 1.5]
    assert Convention("axes", "FRD", "frame_id", note="base_ned") in log.provenance["dvl"].conventions


def test_a_field_called_time_is_not_the_log_time(tmp_path: Path) -> None:
    text = f"{HEADER},field.time,field.velocity.x,field.velocity_valid\n{T0 + 5},1,{T0},f,123.5,1,True"

    records = read_whole(csv_log(write_csv(tmp_path / "dive", dvl=text)), {"/dvl": ["time", "header.stamp"]})["/dvl"]

    stamp, time = records.columns["header.stamp"][0], records.columns["time"][0]
    assert (records.received_ns[0], stamp, time) == (T0 + 5, T0, 123.5)


def test_two_files_of_one_topic_are_an_error(tmp_path: Path) -> None:
    folder = write_csv(tmp_path / "dive", dvl=TWIST)
    (folder / "dvl.txt").write_bytes((folder / "dvl.csv").read_bytes())

    assert refusal(LogError, read_log, folder) == f"{folder}: dvl.csv and dvl.txt are both /dvl; rename one"


LONG = f"""
    sensor,time_ns,received_ns,starboard_mps,forward_mps,heading_deg,east_m,north_m
    dvl,{T0},{T0},0.1,1.0,,,
    compass,{T0 + 1},{T0 + 2},,,45.5,,
    usbl,{T0 + 1},{T0 + 7},,,,10.0,-3.0
    dvl,{T0 + 9},{T0 + 9},0.2,1.5,,,
"""


def test_a_long_file_gives_each_sensor_its_rows(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "dive", everything=LONG) / "everything.csv"

    for log in (read_log(file), read_log(file.parent)):
        assert {role: len(table) for role, table in log.tables.items()} == {"dvl": 2, "compass": 1, "usbl": 1}
        np.testing.assert_array_equal(log.tables["dvl"]["forward_mps"], [1.0, 1.5])
        np.testing.assert_array_equal(log.tables["usbl"][["east_m", "north_m"]], [[10.0, -3.0]])
        np.testing.assert_allclose(log.tables["usbl"]["received_s"] * 1e9, [7], rtol=1e-12)


def test_a_broken_number_of_a_long_file_is_reported_with_its_line(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "dive", everything=LONG.replace("0.2,1.5", "0.2,fast")) / "everything.csv"

    findings = csv_log(file)
    read_whole(findings, {"/dvl": ["forward_mps"]})

    said = '1 of 4 rows are left out: line 5: forward_mps is "fast", not a number'
    assert [finding.text.partition(": ")[2] for finding in findings.findings()] == [said]


RECORDED: dict[str, tuple[str, str, str, tuple[float, ...]]] = {  # type: its columns, a row of them, what is made of it
    "mUSBLFix": (
        "relative_position.x relative_position.y relative_position.z source_id type", "30 40 -1 3 2", "usbl", (30, 40)
    ),
    "BeaconInfo": (
        "relative_position.x relative_position.y relative_position.z beacon_id", "40 30 1 3", "usbl", (30, 40)
    ),
    "AcousticModemUSBLLONG": ("X Y Z E N U propagation_time remote_address", "1 2 3 30 40 -1 620 3", "usbl", (30, 40)),
    "EvologicsUsbllong": ("x y z e n u propagation_time accuracy", "1 2 3 30 40 -1 620 1.5", "usbl", (30, 40)),
    "Position": ("name latitude longitude depth age", "AUV 45 7 10 0.5", "usbl", (0, 0)),
    "AcousticLocalization": ("sender_address latitude longitude accuracy", "3 45 7 2", "usbl", (0, 0)),
    "GeoPointStamped": ("position.latitude position.longitude position.altitude", "45 7 -3", "usbl", (0, 0)),
    "GPSData": ("latitude longitude fix_quality heading", "45 7 1 0", "gps", (45, 7)),
    "UbloxNav": ("latitude longitude accuracy_horz fixtype", "45 7 0.5 3D", "gps", (45, 7)),
    "Gpgga": ("lat lon lat_dir lon_dir gps_qual", "4500.0 700.0 S W 1", "gps", (-45, -7)),
    "Azimuth": ("azimuth variance unit orientation reference", "90 1 1 1 1", "compass", (90,)),
    "Compass": ("heading heading_covar is_true_heading", "90 1 True", "compass", (90,)),
    "QuaternionStamped": ("quaternion.x quaternion.y quaternion.z quaternion.w", "0 0 0 1", "compass", (0,)),
    "LinkquestDvl": ("velocityInst0 velocityInst1 velocityInst2 velocityInstFlag", "-2 -1 0 1", "dvl", (1, 2)),
    "TeledyneExplorerDvl": ("bi_x_axis bi_y_axis bi_z_axis bi_status", "2 1 0 A", "dvl", (1, 2)),
    "DepthPressure": ("depth pressure pressure_raw", "12.5 13 13", "depth", (12.5,)),
    "Depth": ("depth variance", "12.5 0.1", "depth", (12.5,)),
}  # fmt: skip
MADE = {
    "usbl": ["east_m", "north_m"],
    "gps": ["lat_deg", "lon_deg"],
    "compass": ["heading_deg"],
    "dvl": ["starboard_mps", "forward_mps"],
    "depth": ["depth_m"],
}


@pytest.mark.parametrize("kind", RECORDED)
def test_messages_of_ros_1_are_known_by_their_columns_and_read_as_such(tmp_path: Path, kind: str) -> None:
    names, row, sensor, want = RECORDED[kind]
    columns = ",".join(f"field.{name}" for name in names.split())
    text = f"{HEADER},{columns}\n{T0},1,{T0},f,{','.join(row.split())}"
    folder = write_csv(tmp_path / "dive", **{"ranger__positions__auv" if sensor == "usbl" else sensor: text})
    head = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0, heading_deg = 0.0 }\n"

    log = read_as(folder, head)

    assert log.provenance[sensor].type.endswith(f"/{kind}")
    assert log.tables[sensor][MADE[sensor]].to_numpy()[0] == pytest.approx(np.array(want), abs=1e-6)


@pytest.mark.parametrize(("seconds", "array"), [("secs", "_{}"), ("sec", "[{}]")])
def test_messages_in_csv_with_stamps_in_two_columns_are_of_their_type(tmp_path: Path, seconds: str, array: str) -> None:
    """As bagpy writes them, and pandas' json_normalize."""
    stamps = f"Time,header.seq,header.stamp.{seconds},header.stamp.n{'ano' if seconds == 'sec' else ''}{seconds}"
    covariance = ",".join(f"position_covariance{array.format(k)}" for k in range(9))
    fix = f"{T0 / 1e9 + 9},1,{T0 // 10**9},{T0 % 10**9}"
    rows = f"{fix},-1,46,7,{','.join('012345678')}\n{fix},0,45,7,{','.join('012345678')}"
    folder = write_csv(tmp_path / "dive", gps_fix=f"{stamps},status.status,latitude,longitude,{covariance}\n{rows}")

    (topic,) = csv_log(folder).topics()
    paths = ["header.stamp", "position_covariance.8"]
    records = read_whole(csv_log(folder), {topic.name: paths})[topic.name]

    assert (topic.type, topic.count) == ("sensor_msgs/NavSatFix", 2)
    assert [records.columns[path][0] for path in paths] == [T0, 8]
    assert read_log(folder).tables["gps"]["lat_deg"].tolist() == [45]
