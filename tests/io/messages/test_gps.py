"""Every kind of GPS message and of depth message, by a record that its own driver could have written."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs import MAP, logged, only
from recordings import HEADER, HEADING, ODOMETRY, POSE, POSE_COVARIANCE, SECOND, T0, define, fix, record, stamp
from usbldr.io.log import Log
from usbldr.io.provenance import Convention
from usbldr.io.reading.read import Request, read_log

PLACE = "float64 latitude\nfloat64 longitude\n"
COVARIANCE = "float64[9] position_covariance\nuint8 position_covariance_type\n"
TYPES = {
    "gps_msgs/msg/GPSStatus": "int16 status\n",
    "gps_msgs/msg/GPSFix": HEADER + "gps_msgs/GPSStatus status\n" + PLACE + "float64 err_horz\n" + COVARIANCE,
    "mavros_msgs/msg/GPSRAW": HEADER + "uint8 fix_type\nint32 lat\nint32 lon\nuint32 h_acc\n",
    "nmea_msgs/msg/Gpgga": HEADER + "float64 lat\nfloat64 lon\nstring lat_dir\nstring lon_dir\nuint32 gps_qual\n",
    "cola2_msgs/msg/GPSData": HEADER
    + PLACE
    + "int32 fix_quality\nfloat32 latitude_stdev\nfloat32 longitude_stdev\nfloat32 heading\n",
    "ds_sensor_msgs/msg/UbloxNav": HEADER + PLACE + "float32 accuracy_horz\nstring fixtype\n",
    "foxglove_msgs/msg/LocationFix": "builtin_interfaces/Time timestamp\nstring frame_id\n" + PLACE + COVARIANCE,
    "smarc_msgs/msg/LatLonStamped": HEADER + PLACE,
    "geographic_msgs/msg/GeoPoint": PLACE + "float64 altitude\n",
    "geographic_msgs/msg/GeoPointStamped": HEADER + "geographic_msgs/GeoPoint position\n",
    "old_geographic_msgs/msg/GeoPointStamped": HEADER + "geographic_msgs/GeoPoint geo_point\n",
    "geographic_msgs/msg/GeoPose": "geographic_msgs/GeoPoint position\ngeometry_msgs/Quaternion orientation\n",
    "geographic_msgs/msg/GeoPoseStamped": HEADER + "geographic_msgs/GeoPose pose\n",
    "riptide_msgs/msg/Depth": HEADER + "float32 depth\nfloat32 variance\n",
    "uuv_sensor_msgs/msg/Depth": HEADER + "float64 depth\nfloat64 depth_variance\n",
    "ds_sensor_msgs/msg/DepthPressure": HEADER + "float64 pressure\nfloat64 depth\n",
    "holoocean_interfaces/msg/DepthSensor": HEADER + "float32 depth\n",
}
define(TYPES)


row = partial(record, "/gps")


BERMUDA = {"latitude": 32.25, "longitude": -64.75}
IN_BERMUDA: dict[str, Mapping[str, Any]] = {
    "gps_msgs/msg/GPSFix": {**BERMUDA, "status.status": 18},
    "sensor_msgs/msg/NavSatFix": BERMUDA,
    "mavros_msgs/msg/GPSRAW": {"lat": 322500000, "lon": -647500000, "fix_type": 3},
    "nmea_msgs/msg/Gpgga": {"lat": 3215.0, "lon": 6445.0, "lat_dir": "N", "lon_dir": "W", "gps_qual": 1},
    "cola2_msgs/msg/GPSData": {**BERMUDA, "fix_quality": 1},
    "ds_sensor_msgs/msg/UbloxNav": {**BERMUDA, "fixtype": "3D"},
    "foxglove_msgs/msg/LocationFix": BERMUDA,
    "smarc_msgs/msg/LatLonStamped": BERMUDA,
    "geographic_msgs/msg/GeoPointStamped": {"position.latitude": 32.25, "position.longitude": -64.75},
    "old_geographic_msgs/msg/GeoPointStamped": {"geo_point.latitude": 32.25, "geo_point.longitude": -64.75},
    "geographic_msgs/msg/GeoPoseStamped": {"pose.position.latitude": 32.25, "pose.position.longitude": -64.75},
}


@pytest.mark.parametrize("kind", IN_BERMUDA)
def test_each_kind_of_fix_is_a_latitude_and_a_longitude(tmp_path: Path, kind: str) -> None:
    topics = {"gps": "/gps"} if kind == "mavros_msgs/msg/GPSRAW" else {}

    log = logged(tmp_path, [row(kind, IN_BERMUDA[kind])], topics=topics)

    table = log.tables["gps"]
    assert (table["lat_deg"].iloc[0], table["lon_deg"].iloc[0]) == pytest.approx((32.25, -64.75), abs=1e-9)
    assert log.truth is not None
    assert log.truth.kind == "gps"


def test_decimal_degrees_of_a_gga_message_are_read_as_such(tmp_path: Path) -> None:
    values = {"lat": 32.25, "lon": 64.75, "lat_dir": "S", "lon_dir": "W", "gps_qual": 1}

    table = logged(tmp_path, [row("nmea_msgs/msg/Gpgga", values)]).tables["gps"]

    assert (table["lat_deg"].iloc[0], table["lon_deg"].iloc[0]) == (-32.25, -64.75)


WITHOUT_FIX: dict[str, tuple[Mapping[str, Any], str]] = {
    "gps_msgs/msg/GPSFix": ({"status.status": -1}, "without fix (status below 0)"),
    "nmea_msgs/msg/Gpgga": ({"gps_qual": 0}, "without fix (by its quality)"),
    "sensor_msgs/msg/NavSatFix": ({"position_covariance": np.full(9, -1.0)}, "of negative variance"),
    "cola2_msgs/msg/GPSData": ({"fix_quality": 0}, "without fix (by its quality)"),
    "ds_sensor_msgs/msg/UbloxNav": ({"fixtype": "NO_FIX"}, "without fix (by its quality)"),
    "foxglove_msgs/msg/LocationFix": ({"latitude": 0.0, "longitude": 0.0}, "at latitude and longitude 0"),
}


@pytest.mark.parametrize("kind", WITHOUT_FIX)
def test_a_message_without_fix_is_counted_and_left_out(tmp_path: Path, kind: str) -> None:
    change, cause = WITHOUT_FIX[kind]

    log = logged(tmp_path, [row(kind, IN_BERMUDA[kind]), row(kind, {**IN_BERMUDA[kind], **change})])

    assert len(log.tables["gps"]) == 1
    assert only(log, "GPS-INVALID") == f"/gps: 1 of 2 records are invalid and left out (1 {cause})"


SIGMA: dict[str, Mapping[str, Any]] = {  # 0.5 m for each axis
    "gps_msgs/msg/GPSFix": {"err_horz": 0.5 * math.sqrt(-2 * math.log(0.05))},  # Rayleigh's 95 %
    "mavros_msgs/msg/GPSRAW": {"h_acc": 500},
    "cola2_msgs/msg/GPSData": {"latitude_stdev": 0.5, "longitude_stdev": 0.5},
    "ds_sensor_msgs/msg/UbloxNav": {"accuracy_horz": 0.5},
    "foxglove_msgs/msg/LocationFix": {
        "position_covariance": np.diag([0.25, 0.25, 9.0]).ravel(),
        "position_covariance_type": 2,
    },
}


@pytest.mark.parametrize("kind", SIGMA)
def test_each_kind_states_its_accuracy_in_its_own_way(tmp_path: Path, kind: str) -> None:
    log = logged(tmp_path, [row(kind, {**IN_BERMUDA[kind], **SIGMA[kind]})], topics={"gps": "/gps"})

    assert log.tables["gps"]["sd_m"].iloc[0] == pytest.approx(0.5, rel=1e-4)


def test_a_known_covariance_beats_an_error_estimate(tmp_path: Path) -> None:
    known = {"position_covariance": np.diag([4.0, 4.0, 9.0]).ravel(), "position_covariance_type": 3, "err_horz": 50.0}
    kind = "gps_msgs/msg/GPSFix"

    assert logged(tmp_path, [row(kind, {**IN_BERMUDA[kind], **known})]).tables["gps"]["sd_m"].iloc[0] == 2.0


def test_a_location_fix_is_timed_by_its_own_timestamp(tmp_path: Path) -> None:
    kind = "foxglove_msgs/msg/LocationFix"

    log = logged(tmp_path, [row(kind, {"timestamp": stamp(T0 - 250_000_000), **BERMUDA})])

    assert log.start_ns == T0 - 250_000_000
    assert Convention("time", "timestamp", "type") in log.provenance["gps"].conventions


def test_the_raw_fix_of_mavros_comes_before_its_estimate(tmp_path: Path) -> None:
    names = ("/mavros/global_position/global", "/mavros/global_position/raw/fix")

    log = logged(tmp_path, [fix(T0, 32.25, -64.75, topic=name) for name in names])

    assert log.provenance["gps"].topic == "/mavros/global_position/raw/fix"


FLOAT32 = "std_msgs/msg/Float32"


@pytest.mark.parametrize(
    ("topic", "kind", "values", "found"),  # whether it is found without being named
    [
        ("/sensor", "riptide_msgs/msg/Depth", {"depth": 4.0}, True),
        ("/sensor", "uuv_sensor_msgs/msg/Depth", {"depth": 4.0}, True),
        ("/sensor", "ds_sensor_msgs/msg/DepthPressure", {"depth": 4.0, "pressure": 4.03}, True),
        ("/sensor", "holoocean_interfaces/msg/DepthSensor", {"depth": 4.0}, True),
        ("/depth", FLOAT32, {"data": 4.0}, True),
        ("/sensor", POSE, {"pose.position.z": -4.0, "header.frame_id": "map"}, False),
        ("/sensor", POSE, {"pose.position.z": 4.0, "header.frame_id": "map_ned"}, False),
        ("/sensor", POSE_COVARIANCE, {"pose.pose.position.z": -4.0, "header.frame_id": "map"}, False),
        ("/sensor", POSE_COVARIANCE, {"pose.pose.position.z": -4.0}, False),
        ("/sensor", ODOMETRY, {"pose.pose.position.z": 4.0, "header.frame_id": "world_ned"}, False),
    ],
)
def test_a_depth_grows_downwards(tmp_path: Path, topic: str, kind: str, values: Mapping[str, Any], found: bool) -> None:
    rows = [record(topic, kind, values)]

    named = logged(tmp_path, rows, topics={"depth": topic})

    assert named.tables["depth"]["depth_m"].iloc[0] == 4.0
    assert ("depth" in logged(tmp_path, rows).tables) == found


def test_the_relative_altitude_of_mavros_is_a_height(tmp_path: Path) -> None:
    rows = [(T0, "/mavros/global_position/rel_alt", HEADING, {"data": -4.0})]

    log = logged(tmp_path, rows, topics={"depth": "/mavros/global_position/rel_alt"})

    assert log.tables["depth"]["depth_m"].iloc[0] == 4.0
    assert Convention("positive", "up", "type") in log.provenance["depth"].conventions


def test_depths_above_the_water_are_pointed_out(tmp_path: Path) -> None:
    log = logged(tmp_path, [record("/sensor", "holoocean_interfaces/msg/DepthSensor", {"depth": -4.0})])

    assert only(log, "DEPTH-SIGN") == (
        "/sensor: a median depth of -4.0 m, above the water; "
        'if it counts the other way, state positive = "up" under [depth]'
    )


def still(log: Log) -> list[str]:
    return [finding.text for finding in log.findings if finding.code == "GPS-REPEATED"]


def test_a_receiver_that_repeats_its_last_fix_is_found_without_a_depth_sensor(tmp_path: Path) -> None:
    """Fifteen seconds at the surface, twenty under it, and then again."""
    surface = [k if k < 15 else 14 if k < 35 else k for k in range(50)]
    rows = [fix(T0 + k * SECOND, 32.25 + 1e-6 * place, -64.75) for k, place in enumerate(surface)]

    log = logged(tmp_path, rows)

    (sentence,) = still(log)
    assert sentence.startswith(
        "/gps/fix: 20 of 50 fixes repeat the previous one to the last digit for more than 5 s, in 1 stretches, "
        "the longest 20.0 s from 14.0 s on"
    )
    assert still(read_log(tmp_path / "dive.mcap", Request(truth="none"))) == []


@pytest.mark.parametrize("drift_deg", [1e-13, 0.0])
def test_a_receiver_at_rest_for_a_moment_is_none_that_repeats(tmp_path: Path, drift_deg: float) -> None:
    """It moves by less than a receiver's resolution, or not at all for five seconds."""
    seconds = 60 if drift_deg else 6
    rows = [fix(T0 + k * SECOND, 32.25 + k * drift_deg, -64.75) for k in range(seconds)]

    assert still(logged(tmp_path, rows)) == []


def test_local_positions_may_stand_still(tmp_path: Path) -> None:
    log = logged(tmp_path, [row(ODOMETRY, {}, k) for k in range(60)], MAP, {"gps": "/gps"})

    assert log.truth is not None
    assert still(log) == []
