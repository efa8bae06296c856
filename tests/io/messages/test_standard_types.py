"""Poses, points and plain numbers of the standard packages as each sensor that they can be, and rarer modems."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from logs import MAP, METRES_A_DEGREE, logged
from recordings import HEADER, ODOMETRY, POINT, POSE, POSE_COVARIANCE, T0, Row, define, turned
from usbldr.io.log import Log

FLOAT32 = "std_msgs/msg/Float32"
USBLLONG = HEADER + "float64 current_time\nfloat64 measurement_time\nint32 remote_address\nfloat32 accuracy\n"
SEATRAC = "uint8 source_id\nbool position_valid\nbool position_filter_error\n" + "".join(
    f"float32 position_{axis}\n" for axis in ("easting", "northing", "depth")
)
PLACE = "float64 latitude\nfloat64 longitude\nfloat64 altitude\n"
define(
    {
        "standard_geo/msg/GeoPoint": PLACE,
        "standard_geo/msg/GeoPose": "standard_geo/GeoPoint position\ngeometry_msgs/Quaternion orientation\n",
        "standard_geo/msg/GeoPoseStamped": HEADER + "standard_geo/GeoPose pose\n",
        "standard_geo/msg/GeoPointStamped": HEADER + "standard_geo/GeoPoint geo_point\n",
        "standard_smarc/msg/LatLonOdometry": HEADER + "standard_geo/GeoPose lat_lon_pose\n",
        "foxglove_msgs/msg/Point3InFrame": "builtin_interfaces/Time timestamp\nstring frame_id\n"
        "geometry_msgs/Point point\n",
        "standard_seatrac/msg/AcousticFix": SEATRAC,
        "standard_seatrac/msg/TransceiverFixStatus": "standard_seatrac/AcousticFix acoustic_fix\n",
        "standard_seatrac/msg/NavigationQueryResponseStatus": "standard_seatrac/AcousticFix fix\n",
        "capital_modem/msg/EvologicsUsbllong": USBLLONG + "".join(f"float32 {axis}\n" for axis in "XYZNED"),
        "small_modem/msg/AcousticModemUSBLLONG": USBLLONG + "".join(f"float32 {axis}\n" for axis in "xyzneu"),
        "srv_modem/msg/AcousticModemUSBLLONG": USBLLONG + "".join(f"float32 {axis}\n" for axis in "XYZNED"),
    }
)


def logged_one(tmp_path: Path, kind: str, values: Mapping[str, Any], topic: str, role: str = "", toml: str = "") -> Log:
    header = {"header.stamp": T0} if kind in STAMPED else {}
    rows: list[Row] = [(T0, topic, kind, header | dict(values))]
    return logged(tmp_path, rows, toml, {role: topic} if role else {})


STAMPED = {ODOMETRY, POINT, POSE, POSE_COVARIANCE}


HEADED: dict[str, Mapping[str, Any]] = {  # south-east: 45 degrees to the right of east
    POSE: turned("pose.orientation", -45.0),
    POSE_COVARIANCE: turned("pose.pose.orientation", -45.0),
    "standard_smarc/msg/LatLonOdometry": turned("lat_lon_pose.orientation", -45.0),
}


@pytest.mark.parametrize("kind", HEADED)
def test_a_pose_that_is_named_has_a_heading(tmp_path: Path, kind: str) -> None:
    assert logged_one(tmp_path, kind, HEADED[kind], "/nav", "compass").tables["compass"]["heading_deg"][
        0
    ] == pytest.approx(135)
    assert "compass" not in logged_one(tmp_path, kind, HEADED[kind], "/nav").tables


def test_a_pose_in_a_ned_frame_turns_clockwise_from_north(tmp_path: Path) -> None:
    values = {**turned("pose.orientation", 135.0), "header.frame_id": "world_ned"}

    assert logged_one(tmp_path, POSE, values, "/nav", "compass").tables["compass"]["heading_deg"][0] == pytest.approx(
        135
    )


@pytest.mark.parametrize(("unit", "value"), [("deg", -45.0), ("rad", -math.pi / 4)])
def test_a_float_may_be_a_heading_in_degrees_or_radians(tmp_path: Path, unit: str, value: float) -> None:
    log = logged_one(tmp_path, FLOAT32, {"data": value}, "/heading", toml=f'[compass]\nunit = "{unit}"')

    assert log.tables["compass"]["heading_deg"][0] == pytest.approx(315)
    assert log.convention("compass", "time").value == "log time"


@pytest.mark.parametrize(
    ("kind", "frame", "z"), [(POSE, "map", -12.0), (POSE, "map_ned", 12.0), (POSE_COVARIANCE, "", -12.0)]
)
def test_a_pose_that_is_named_has_a_depth_from_its_z(tmp_path: Path, kind: str, frame: str, z: float) -> None:
    at = "pose.position.z" if kind == POSE else "pose.pose.position.z"

    log = logged_one(tmp_path, kind, {at: z, "header.frame_id": frame}, "/nav", "depth")

    assert log.tables["depth"]["depth_m"].tolist() == [12.0]


def test_a_float_may_be_a_depth(tmp_path: Path) -> None:
    assert logged_one(tmp_path, FLOAT32, {"data": 12.5}, "/depth").tables["depth"]["depth_m"].tolist() == [12.5]


XY: dict[str, str] = {
    POINT: "point",
    POSE: "pose.position",
    POSE_COVARIANCE: "pose.pose.position",
    ODOMETRY: "pose.pose.position",
    "foxglove_msgs/msg/Point3InFrame": "point",
}


@pytest.mark.parametrize("kind", XY)
@pytest.mark.parametrize("role", ["usbl", "gps"])
def test_a_local_position_is_east_and_north_for_whichever_sensor_it_is_named(
    tmp_path: Path, kind: str, role: str
) -> None:
    values = {f"{XY[kind]}.x": 30.0, f"{XY[kind]}.y": 40.0}

    table = logged_one(tmp_path, kind, values, "/place", role).tables[role]

    assert table[["east_m", "north_m"]].to_numpy().tolist() == [[30.0, 40.0]]
    assert role == "usbl" or "gps" not in logged_one(tmp_path, kind, values, "/place").tables


@pytest.mark.parametrize(
    ("kind", "place", "topic", "role"),
    [
        ("standard_geo/msg/GeoPoseStamped", "pose.position", "/gps/pose", "gps"),
        ("standard_geo/msg/GeoPointStamped", "geo_point", "/gps/pose", "gps"),
        ("standard_geo/msg/GeoPointStamped", "geo_point", "/ranger/positions/AUV", "usbl"),
    ],
)
def test_geographic_messages_are_recognised_by_their_names(
    tmp_path: Path, kind: str, place: str, topic: str, role: str
) -> None:
    values = {f"{place}.latitude": 45.001, f"{place}.longitude": 7.0}

    table = logged_one(tmp_path, kind, values, topic, toml=MAP).tables[role]

    assert table["north_m"][0] == pytest.approx(0.001 * METRES_A_DEGREE, abs=0.01)


def seatrac(field: str) -> dict[str, Any]:
    places = {"position_easting": 30.0, "position_northing": 40.0, "position_depth": 12.0, "position_valid": True}
    return {f"{field}.{name}": value for name, value in places.items()}


MODEMS: dict[str, Mapping[str, Any]] = {
    "standard_seatrac/msg/TransceiverFixStatus": seatrac("acoustic_fix"),
    "standard_seatrac/msg/NavigationQueryResponseStatus": seatrac("fix"),
    "capital_modem/msg/EvologicsUsbllong": {"E": 30.0, "N": 40.0, "D": 12.0, "X": 1.0, "Y": 2.0},
    "small_modem/msg/AcousticModemUSBLLONG": {"e": 30.0, "n": 40.0, "u": -12.0, "x": 1.0, "y": 2.0},
    "srv_modem/msg/AcousticModemUSBLLONG": {"E": 30.0, "N": 40.0, "D": 12.0, "X": 1.0, "Y": 2.0},
}


@pytest.mark.parametrize("kind", MODEMS)
def test_every_spelling_of_a_modem_is_known(tmp_path: Path, kind: str) -> None:
    """The line of sight is 51.4 m, and its noise 2 % of that."""
    log = logged_one(
        tmp_path, kind, MODEMS[kind], "/modem", toml="[usbl]\nhead = { east_m = 100.0, north_m = 200.0 }\n"
    )

    usbl = log.tables["usbl"]
    assert usbl[["east_m", "north_m"]].to_numpy()[0] == pytest.approx([130, 240])
    assert usbl["cov_ee_m2"][0] == pytest.approx(0.02**2 * (30**2 + 40**2 + 12**2))
