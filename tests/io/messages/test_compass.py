"""Every kind of heading message, magnetic and true, by a record that its own driver could have written."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from logs import codes, logged, only, refusal
from recordings import HEADER, IMU, ODOMETRY, POSE, POSE_COVARIANCE, T0, Row, define, fields, fix, record, turned
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.conventions.declination import declination
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.log import Log
from usbldr.io.provenance import Convention

TURN, PLACE = "geometry_msgs/Quaternion orientation", "float64 latitude longitude"
STAMP = "builtin_interfaces/Time timestamp"
TYPES = {
    "ds_sensor_msgs/msg/Compass": HEADER + fields("float64 heading heading_covar", "bool is_true_heading"),
    "ds_sensor_msgs/msg/Gyro": HEADER + fields("float64 roll pitch heading heading_covar", TURN),
    "old_ds_sensor_msgs/msg/Gyro": HEADER + fields("float64 roll pitch heading"),
    "ds_sensor_msgs/msg/Ins": HEADER + fields("float64 roll pitch heading", TURN),
    "auv_msgs/msg/NavigationStatus": HEADER + fields("geometry_msgs/Vector3 orientation"),
    "beside_position/msg/GPSData": HEADER + fields(PLACE, "int32 fix_quality", "float32 heading"),
    "beside_position/msg/GPSRAW": HEADER + fields("uint8 fix_type", "int32 lat lon", "uint16 yaw"),
    "beside_position/msg/LocationFix": fields(STAMP, "string frame_id", f"{PLACE} heading heading_variance"),
    "heading_geo/msg/GeoPoint": fields(f"{PLACE} altitude"),
    "heading_geo/msg/GeoPose": fields("heading_geo/GeoPoint position", TURN),
    "heading_smarc/msg/LatLonOdometry": HEADER + fields("heading_geo/GeoPose lat_lon_pose"),
}
define(TYPES, shipped="cola2_msgs compass_msgs")
QUATERNION, VECTOR = "geometry_msgs/msg/QuaternionStamped", "geometry_msgs/msg/Vector3Stamped"
FIELD, AZIMUTH, WHOI = "sensor_msgs/msg/MagneticField", "compass_msgs/msg/Azimuth", "ds_sensor_msgs/msg/Compass"
FLOAT = "std_msgs/msg/Float32"

row = partial(record, "/heading")


def heading(log: Log) -> list[float]:
    table: pd.DataFrame = log.tables["compass"]
    return [float(value) for value in table["heading_deg"]]


SOUTH_EAST: dict[str, Mapping[str, Any]] = {
    "ds_sensor_msgs/msg/Compass": {"heading": 135.0, "is_true_heading": True},
    "ds_sensor_msgs/msg/Gyro": {"heading": -45.0, **turned("orientation", -45.0)},  # counter-clockwise from east
    "old_ds_sensor_msgs/msg/Gyro": {"heading": 135.0},
    "ds_sensor_msgs/msg/Ins": {"heading": 135.0, **turned("orientation", -45.0)},  # both in one message
    QUATERNION: turned("quaternion", 135.0),  # HDT put into a quaternion as it came
}
SOUTH_EAST_WHEN_NAMED: dict[str, Mapping[str, Any]] = {
    "cola2_msgs/msg/NavSts": {"orientation.yaw": math.radians(135.0)},
    "auv_msgs/msg/NavigationStatus": {"orientation.z": math.radians(135.0)},
    "beside_position/msg/GPSData": {"heading": 135.0},
    "beside_position/msg/GPSRAW": {"yaw": 13500},
    "beside_position/msg/LocationFix": {"heading": math.radians(135.0)},
    ODOMETRY: turned("pose.pose.orientation", -45.0),
    POSE: turned("pose.orientation", -45.0),
    POSE_COVARIANCE: turned("pose.pose.orientation", -45.0),
    "heading_smarc/msg/LatLonOdometry": turned("lat_lon_pose.orientation", -45.0),
    VECTOR: {"vector.z": math.radians(-45.0)},
    FIELD: {"magnetic_field.x": -3e-5, "magnetic_field.y": 3e-5},  # north lies behind, to port
}


@pytest.mark.parametrize("kind", [*SOUTH_EAST, *SOUTH_EAST_WHEN_NAMED])
def test_a_heading_is_read_by_its_own_convention_and_what_is_no_compass_only_if_named(tmp_path, kind):
    rows = [row(kind, (SOUTH_EAST | SOUTH_EAST_WHEN_NAMED)[kind])]

    log = logged(tmp_path, rows, topics={"compass": "/heading"} if kind in SOUTH_EAST_WHEN_NAMED else {})

    assert heading(log) == pytest.approx([135.0], abs=1e-4 if kind in SOUTH_EAST_WHEN_NAMED else 1e-6)
    assert ("compass" in logged(tmp_path, rows).tables) == (kind in SOUTH_EAST)


@pytest.mark.parametrize(
    ("kind", "values", "stated", "degrees", "unit"),
    [
        (VECTOR, {"vector.z": -45.0}, "", 135.0, "deg"),  # beyond a turn in radians
        (VECTOR, {"vector.z": 1.0}, "", 90 - 57.29578, "rad"),
        (FLOAT, {"data": -45.0}, '[compass]\nunit = "deg"', 315.0, "deg"),
        (FLOAT, {"data": -math.pi / 4}, '[compass]\nunit = "rad"', 315.0, "rad"),
        (FLOAT, {"data": 1600.0}, '[compass]\nunit = "mil"', 90.0, "mil"),
        (FLOAT, {"data": -450.0}, '[compass]\nunit = "0.1deg"', 315.0, "0.1deg"),
        (FLOAT, {"data": 4500.0}, '[compass]\nunit = "0.01deg"', 45.0, "0.01deg"),
    ],
)
def test_a_heading_is_in_degrees_or_radians_as_stated_or_else_as_its_values_show(
    tmp_path: Path, kind: str, values: Mapping[str, Any], stated: str, degrees: float, unit: str
) -> None:
    log = logged(tmp_path, [row(kind, values)], stated, {"compass": "/heading"} if kind == VECTOR else {})

    assert heading(log) == pytest.approx([degrees])
    by = "configuration" if stated else "values"
    assert (log.convention("compass", "unit").value, log.convention("compass", "unit").chosen_by) == (unit, by)
    assert kind == VECTOR or log.convention("compass", "time").value == "log time"


NO_HEADING: dict[str, Mapping[str, Any]] = {
    WHOI: {"heading": -9999.0, "is_true_heading": True},
    "beside_position/msg/GPSRAW": {"yaw": 65535},
    "beside_position/msg/GPSData": {"heading": 0.0},  # no HDT
    "beside_position/msg/LocationFix": {"heading": math.nan},
}


@pytest.mark.parametrize("kind", NO_HEADING)
def test_a_value_that_means_no_data_is_none(tmp_path: Path, kind: str) -> None:
    with pytest.raises(LogError, match=r"all 1 records of /heading .compass. are invalid: 1 not a number"):
        logged(tmp_path, [row(kind, NO_HEADING[kind])], topics={"compass": "/heading"})


@pytest.mark.parametrize(("circle", "damaged"), [(400, 0), (360, 0), (360, 9)])
def test_headings_that_go_round_at_400_are_gon(tmp_path: Path, circle: int, damaged: int) -> None:
    angles = [395.0] * damaged + [float(k % circle) for k in range(0, 1200, 2)]
    rows = [row("old_ds_sensor_msgs/msg/Gyro", {"heading": angle}, k) for k, angle in enumerate(angles)]

    said = [one.text for one in logged(tmp_path, rows).findings if one.code == "HEADING-UNIT"]
    cured = logged(tmp_path, rows, '[compass]\nunit = "gon"\n')

    gon = '/heading: its headings go round at 400, as gon do, not at 360; state [compass] unit = "gon"'
    assert said == ([gon] if circle == 400 else [])
    assert "HEADING-UNIT" not in codes(cured)
    assert cured.tables["compass"]["heading_deg"].max() < 360


NO_TURN = "/heading: 2 of 5 records are invalid and left out (2 far beyond a whole turn)"
NEVER = "/heading: all 100 headings are 90.0 deg; check the sensor"
OF_VECTOR = [(90 - math.degrees(angle)) % 360 for angle in (1.0, 2.0, 3.0)]


@pytest.mark.parametrize(
    ("kind", "values", "headings", "code", "said"),
    [
        *((VECTOR, [{"vector.z": angle} for angle in (1.0, no_data, 2.0, no_data, 3.0)], OF_VECTOR, "COMPASS-INVALID",
           NO_TURN) for no_data in (-9999.0, 511.0)),
        (IMU, [{"orientation.w": 1.0}] * 100, [90.0] * 100, "HEADING-CONSTANT", NEVER),
    ],
)  # fmt: skip
def test_numbers_that_are_no_angles_and_an_imu_that_never_turns_are_pointed_out(
    tmp_path, kind, values, headings, code, said
):
    log = logged(tmp_path, [row(kind, one, k) for k, one in enumerate(values)], topics={"compass": "/heading"})

    assert heading(log) == pytest.approx(headings)
    assert only(log, code) == said


def test_headings_of_which_most_are_beyond_a_turn_are_of_another_unit(tmp_path: Path) -> None:
    rows = [row("old_ds_sensor_msgs/msg/Gyro", {"heading": angle}, k) for k, angle in enumerate([3599.0, 20.0, 1350.0])]

    with pytest.raises(
        LogError, match="most headings of /heading are far beyond a whole turn, up to 3599 deg if their unit is deg"
    ):
        logged(tmp_path, rows)


def test_each_azimuth_is_read_by_its_own_unit_sense_and_north(tmp_path: Path) -> None:
    azimuths = [  # angle, variance, degrees?, clockwise from north?, north: true or of a UTM grid
        (math.pi / 2, 1e-4, 0, 0, 1),
        (0.0, 4.0, 1, 0, 1),
        (0.0, 4.0, 1, 1, 1),
        (math.pi, 1e-4, 0, 1, 1),
        (1.0, 1e-4, 0, 1, 2),
    ]
    names = ("azimuth", "variance", "unit", "orientation", "reference")
    rows = [row(AZIMUTH, dict(zip(names, values, strict=True)), k) for k, values in enumerate(azimuths)]

    log = logged(tmp_path, rows, '[compass]\nsd_deg = "message"')

    assert heading(log) == pytest.approx([0, 90, 0, 180])
    np.testing.assert_allclose(log.tables["compass"]["sd_deg"], [math.degrees(0.01), 2.0, 2.0, math.degrees(0.01)])
    assert Convention("north", "true", "records") in log.provenance["compass"].conventions
    said = "/heading: 1 of 5 records are invalid and left out (1 from the north of a UTM grid)"
    assert only(log, "COMPASS-INVALID") == said


NOAA = [  # test values that NOAA publishes with the models: lat, lon, year, degrees of declination
    (80.0, 0.0, 2025, 1.28),
    (0.0, 120.0, 2025, -0.16),
    (-80.0, 240.0, 2025, 68.78),
    (80.0, 0.0, 2020, -1.28),
    (0.0, 120.0, 2020, 0.16),
    (-80.0, 240.0, 2020, 69.36),
]


@pytest.mark.parametrize(("lat", "lon", "year", "degrees"), NOAA)
def test_the_model_gives_the_values_that_noaa_publishes(lat: float, lon: float, year: int, degrees: float) -> None:
    value, how = declination(Origin(lat, lon, OriginKind.MAP), int(pd.Timestamp(year, 1, 1, tz="UTC").value))

    assert value == pytest.approx(degrees, abs=0.006)
    assert how.startswith(f"WMM-{year} at {lat:.2f}")


SEATTLE = "[map]\norigin_lat_deg = 47.6205\norigin_lon_deg = -122.3493\n"

UNKNOWN = row(QUATERNION, turned("quaternion", 0.0))
TRUE, MAGNETIC = row(WHOI, {"heading": 10.0, "is_true_heading": True}), row(WHOI, {"heading": 10.0}, 1)
BY_3 = "[compass]\ndeclination_deg = 3.0"


@pytest.mark.parametrize(
    ("rows", "toml", "headings", "said"),
    [
        ([UNKNOWN], SEATTLE, [0.0], ""),
        ([UNKNOWN], SEATTLE + '[compass]\ndeclination_deg = "auto"', [15.3], ""),
        ([MAGNETIC, fix(T0, 47.6205, -122.3493)], "", [25.3], ""),  # the first fix of the GPS places the compass
        ([MAGNETIC], SEATTLE, [25.3], ""),
        ([MAGNETIC], SEATTLE + BY_3, [13.0], ""),
        ([TRUE, MAGNETIC], BY_3, [10.0, 13.0], ""),
        ([TRUE], BY_3, [10.0], "/heading: declination_deg of the configuration is not used; its records count from "
         "true north"),
        ([MAGNETIC], "", [10.0], "/heading: headings are magnetic and are not corrected, because no position is known"),
    ],
)  # fmt: skip
def test_a_declination_is_added_to_magnetic_headings_alone_as_stated_or_by_the_model_of_a_known_place(
    tmp_path: Path, rows: list[Row], toml: str, headings: list[float], said: str
) -> None:
    log = logged(tmp_path, rows, toml)

    assert heading(log) == pytest.approx(headings, abs=0.4 if 15.3 in headings or 25.3 in headings else 1e-9)
    texts = [f.text for f in log.findings if f.code in ("KEY-UNUSED", "HEADING-MAGNETIC")]
    assert [text.startswith(said) for text in texts] == [True] * bool(said)
    stated = Convention("declination_deg", 3.0, "configuration", "deg") in log.provenance["compass"].conventions
    assert stated == (headings == [13.0])
    if len(rows) == 2 and 25.3 in headings:
        assert "(first gps fix)" in log.convention("compass", "declination_deg").note
    if rows == [MAGNETIC] and toml == SEATTLE:
        convention = log.convention("compass", "declination_deg")
        assert convention.value == pytest.approx(15.3, abs=0.4)  # 16.4 in 2013 and 15.07 in 2025 (NOAA)
        assert (convention.chosen_by, convention.note) == ("model", "WMM-2020 at 47.62, -122.35 ([map]) on 2020-09-13")


def test_the_name_of_a_frame_cannot_turn_what_a_record_itself_says(tmp_path: Path) -> None:
    """Counter-clockwise from east, by the message; only for a quaternion does the frame's name decide the sense."""
    named = {"header.frame_id": "base_ned"}
    settled = {
        AZIMUTH: {"azimuth": 30.0, "unit": 1, "orientation": 0, "reference": 1},
        "ds_sensor_msgs/msg/Gyro": {"heading": 30.0},
    }
    for kind, values in settled.items():
        assert heading(logged(tmp_path, [row(kind, {**named, **values})])) == pytest.approx([60.0])

    assert heading(logged(tmp_path, [row(IMU, {**named, **turned("orientation", 30.0)})])) == pytest.approx([30.0])
    pose = row(POSE, {**named, **turned("pose.orientation", 135.0)})
    assert heading(logged(tmp_path, [pose], topics={"compass": "/heading"})) == pytest.approx([135.0])


@pytest.mark.parametrize(
    ("topic", "toml", "reported"),
    [
        ("/adcp/heading_magnetic", "", True),
        ("/nmea/hdm/heading", "", True),
        ("/compass_hdg", "", False),
        ("/adcp/heading_magnetic", "[compass]\ndeclination_deg = 0", False),
    ],
)
def test_a_heading_called_magnetic_asks_for_declination(tmp_path: Path, topic: str, toml: str, reported: bool) -> None:
    log = logged(tmp_path, [(T0 + k, topic, "std_msgs/msg/Float64", {"data": 10.0 + k}) for k in range(3)], toml)

    assert heading(log) == [10.0, 11.0, 12.0]
    assert ("HEADING-MAGNETIC" in {finding.code for finding in log.findings}) == reported


def test_a_declination_that_cannot_be_computed_is_refused(tmp_path: Path) -> None:
    auto = '[compass]\ndeclination_deg = "auto"'
    long_ago = row(QUATERNION, turned("quaternion", 0.0), -20 * 365 * 86400)

    assert refusal(UsageError, logged, tmp_path, [UNKNOWN], auto) == (
        f'{tmp_path / "usbldr.toml"}: declination_deg under [compass] = "auto": no position is known; '
        "state origin_lat_deg and origin_lon_deg under [map], or the declination as a number"
    )
    assert refusal(UsageError, logged, tmp_path, [long_ago], SEATTLE + auto) == (
        f"{tmp_path / 'dive.mcap'}: /heading: no magnetic model for 2000-09-18 (available: 2010 to 2029); "
        "state declination_deg under [compass] as a number"
    )
