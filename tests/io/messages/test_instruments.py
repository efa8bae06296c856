"""Messages of the drivers of Nortek, SBG, u-blox, Septentrio, VectorNav and mavros, as published."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs import MAP, codes, logged, refusal
from recordings import FIX, HEADER, IMU, SECOND, T0, Row, define, fields, fix, turned, twist
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log

TYPES = {  # further ones have the layouts that their drivers publish, which test_definitions holds to checksums
    "ds_sensor_msgs/msg/NortekBTStatus": fields("uint8 xVelValid yVelValid z1VelValid z2VelValid"),
    "ds_sensor_msgs/msg/NortekDF21": HEADER
    + fields("uint8 dvl_type good_beams", "ds_sensor_msgs/NortekBTStatus status", "float32[4] velBeam fomBeam")
    + fields(*(f"float32 {what}{axis}" for what in ("vel", "fom") for axis in ("X", "Y", "Z1", "Z2"))),
    "sbg_driver/msg/SbgImuData": HEADER + fields("geometry_msgs/Vector3 accel gyro"),
    "vectornav/msg/Ins": HEADER
    + fields("uint16 week insStatus", "float32 yaw pitch roll", "float64 latitude longitude", "float32 posUncertainty"),
}
define(TYPES, shipped="interfaces sbg_ ublox_ sept vectornav mavros_msgs/msg/VfrHud")


def row(kind: str, values: Mapping[str, Any], after_s: int = 0, topic: str = "/topic") -> Row:
    time_ns = T0 + after_s * SECOND
    path = "system_timestamp.sec" if kind.startswith("interfaces/") else "header.stamp"
    stamped = {path: time_ns if path == "header.stamp" else time_ns // SECOND}
    return time_ns + 7, topic, kind, ({} if kind.startswith("ublox") else stamped) | dict(values)


def read(tmp_path: Path, role: str, *records: Row, toml: str = "") -> Log:
    return logged(tmp_path, records, MAP + toml, {role: "/topic"})


NUCLEUS = {"velocity_x": 2.0, "velocity_y": 1.0, "velocity_z": 0.5, "fom_x": 0.02, "x_velocity_valid": True,
           "y_velocity_valid": True}  # fmt: skip
NORTEK = {"velX": 2.0, "velY": 1.0, "velZ1": 0.5, "velZ2": 0.5, "fomX": 0.02, "good_beams": 4, "status.xVelValid": 1,
          "status.yVelValid": 1}  # fmt: skip
DVLS: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "interfaces/msg/BottomTrack": (NUCLEUS, {"y_velocity_valid": False}),
    "ds_sensor_msgs/msg/NortekDF21": (NORTEK, {"status.xVelValid": 0, "velX": -32.768}),
}


@pytest.mark.parametrize("kind", DVLS)
def test_velocities_of_nortek_are_found_and_point_forward_starboard_down(tmp_path: Path, kind: str) -> None:
    good, change = DVLS[kind]
    rows = [row(kind, good), row(kind, {**good, **change}, 1)]

    log = logged(tmp_path, rows, '[dvl]\nsd_mps = "message"')

    table = log.tables["dvl"]
    np.testing.assert_allclose(table[["forward_mps", "starboard_mps", "up_mps"]].iloc[0], [2.0, 1.0, -0.5])
    assert table["sd_mps"].iloc[0] == pytest.approx(0.02)
    assert list(table["valid"]) == [True, False]
    assert log.start_ns == T0  # the driver's stamp, not the log's


def test_a_figure_of_ten_and_a_velocity_of_minus_32_768_mean_no_data(tmp_path: Path) -> None:
    kind = "ds_sensor_msgs/msg/NortekDF21"
    unknown = {**NORTEK, "velZ1": -32.768, "fomX": 10.0}
    rows = [row(kind, NORTEK), row(kind, unknown, 1), row(kind, {**NORTEK, "velY": -32.768}, 2)]
    table = logged(tmp_path, rows, '[dvl]\nsd_mps="message"').tables["dvl"]
    np.testing.assert_allclose(table["up_mps"].iloc[:2], [-0.5, np.nan])
    np.testing.assert_allclose(table["sd_mps"].iloc[:2], [0.02, np.nan], rtol=1e-6)
    assert list(table["valid"]) == [True, True, False]


UNFLAGGED = {"status.heading_valid": False}
COMPASSES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {  # 200 degrees; what makes it invalid, if known
    "interfaces/msg/AHRS": ({"heading": 200.0, "declination": 3.0}, {}),
    "interfaces/msg/INS": ({"heading": 200.0}, {}),
    "sbg_driver/msg/SbgEkfEuler": ({"angle.z": math.radians(-110.0), "status.heading_valid": True}, UNFLAGGED),
    "sbg_driver/msg/SbgEkfQuat": ({**turned("quaternion", -110.0), "status.heading_valid": True}, UNFLAGGED),
    "septentrio_gnss_driver/msg/AttEuler": ({"heading": -110.0}, {"error": 1}),
    "septentrio_gnss_driver/msg/INSNavGeod": ({"heading": -110.0}, {"heading": math.nan}),
    "vectornav_msgs/msg/CommonGroup": ({"yawpitchroll.x": -160.0}, {}),
    "vectornav/msg/Ins": ({"yaw": -160.0}, {}),
    "mavros_msgs/msg/VfrHud": ({"heading": 200}, {}),
}

NED = {"status.heading_valid": True, "header.frame_id": "imu_link_ned"}  # SBG counts from north if its frame says so


@pytest.mark.parametrize(
    ("kind", "values", "change"),
    [
        *((kind, *case) for kind, case in COMPASSES.items()),
        ("sbg_driver/msg/SbgEkfEuler", {"angle.z": math.radians(-160.0), **NED}, {}),
        ("sbg_driver/msg/SbgEkfQuat", {**turned("quaternion", -160.0), **NED}, {}),
    ],
)
def test_headings_of_each_driver_count_as_it_sends_them_and_invalid_ones_are_left_out(tmp_path, kind, values, change):
    invalid = [row(kind, {**values, **change}, 1)] if change else []

    log = read(tmp_path, "compass", row(kind, values), *invalid)

    assert log.tables["compass"]["heading_deg"].tolist() == pytest.approx([200.0], abs=1e-4)
    assert log.start_ns == T0


DEGREES = {"latitude": 45.01, "longitude": 7.02}
RADIANS = {"latitude": math.radians(45.01), "longitude": math.radians(7.02)}
UBX = {"lat": 450100000, "lon": 70200000, "fixType": 3, "flags": 1, "hAcc": 1500}
GPSES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any], float]] = {  # good, invalid, sd in metres
    "ublox_msgs/msg/NavPVT": (UBX, {"fixType": 5}, 1.5),
    "ublox_msgs/msg/NavPVT7": (UBX, {"flags": 2}, 1.5),
    "sbg_driver/msg/SbgGpsPos": (
        {**DEGREES, "status.type": 2, "position_accuracy.x": 1.5, "position_accuracy.y": 1.5}, {"status.status": 1}, 1.5
    ),
    "septentrio_gnss_driver/msg/PVTGeodetic": ({**RADIANS, "mode": 4}, {"mode": 0, "error": 5}, math.nan),
    "vectornav_msgs/msg/GpsGroup": (
        {"poslla.x": 45.01, "poslla.y": 7.02, "fix": 3, "posu.x": 1.5, "posu.y": 1.5}, {"fix": 1}, 1.5
    ),
    "interfaces/msg/INS": ({**DEGREES, "lat_long_is_valid": True}, {"lat_long_is_valid": False}, math.nan),
    "sbg_driver/msg/SbgEkfNav": (
        {**DEGREES, "status.position_valid": True}, {"status.position_valid": False}, math.nan
    ),
    "septentrio_gnss_driver/msg/INSNavGeod": (
        {**RADIANS, "latitude_std_dev": 1.5, "longitude_std_dev": 1.5}, {"latitude": -2e10}, 1.5
    ),
    "vectornav_msgs/msg/InsGroup": (
        {"poslla.x": 45.01, "poslla.y": 7.02, "posu": 1.5, "insstatus.mode": 2}, {"insstatus.mode": 0}, 1.5
    ),
    "vectornav_msgs/msg/CommonGroup": (
        {"position.x": 45.01, "position.y": 7.02, "insstatus.mode": 2}, {"insstatus.mode": 0}, math.nan
    ),
    "vectornav/msg/Ins": ({**DEGREES, "posUncertainty": 1.5}, {"latitude": 0.0, "longitude": 0.0}, 1.5),
}  # fmt: skip


@pytest.mark.parametrize("kind", GPSES)
def test_positions_of_each_driver_are_degrees_and_invalid_ones_are_left_out(tmp_path: Path, kind: str) -> None:
    good, change, sd_m = GPSES[kind]

    table = read(tmp_path, "gps", row(kind, good), row(kind, {**good, **change}, 1)).tables["gps"]
    assert len(table) == 1
    np.testing.assert_allclose(table[["lat_deg", "lon_deg"]].iloc[0], [45.01, 7.02], atol=1e-9)
    np.testing.assert_allclose(table["sd_m"].iloc[0], sd_m, rtol=1e-6)


def test_the_depth_of_a_nucleus_is_used_if_it_is_named(tmp_path: Path) -> None:
    log = read(tmp_path, "depth", row("interfaces/msg/AHRS", {"depth": 12.5}))

    assert log.tables["depth"]["depth_m"][0] == 12.5


@pytest.mark.parametrize(
    ("kind", "role", "why"),
    [
        ("interfaces/msg/WaterTrack", "dvl",
         'holds velocities through the water; name its fields by columns and state track = "water"'),
        ("ublox_msgs/msg/NavPVT", "compass", "holds the course over ground, not a heading"),
        ("sbg_driver/msg/SbgImuData", "compass", "holds no orientation; use SbgEkfEuler or SbgEkfQuat"),
    ],
)  # fmt: skip
def test_messages_without_the_quantity_are_refused_with_what_to_use(tmp_path, kind, role, why):
    assert f"cannot be used as {role}: it {why}" in refusal(UsageError, read, tmp_path, role, row(kind, {}))


def test_what_drivers_log_beside_standard_messages_makes_no_choice_necessary(tmp_path: Path) -> None:
    """Logs that were read before these types were known are read as before."""
    rows = [
        fix(T0, 45.0, 7.0, topic="/ublox/fix"),
        row("ublox_msgs/msg/NavPVT", UBX, topic="/ublox/navpvt"),
        row("sbg_driver/msg/SbgGpsPos", GPSES["sbg_driver/msg/SbgGpsPos"][0], topic="/sbg/gps_pos"),
        row("septentrio_gnss_driver/msg/PVTGeodetic", RADIANS | {"mode": 4}, topic="/pvtgeodetic"),
        (T0, "/imu", IMU, {"header.stamp": T0, **turned("orientation", 10.0)}),
        row("vectornav_msgs/msg/CommonGroup", COMPASSES["vectornav_msgs/msg/CommonGroup"][0], topic="/vectornav/raw"),
        row("septentrio_gnss_driver/msg/AttEuler", {"heading": 1.0}, topic="/atteuler"),
        row("interfaces/msg/AHRS", {"heading": 1.0}, topic="/nucleus_node/ahrs_packets"),
        row("interfaces/msg/BottomTrack", NUCLEUS, topic="/nucleus_node/bottom_track_packets"),
        twist(T0, 1.0, 0.0, topic="/dvl/twist"),
    ]

    log = logged(tmp_path, rows)

    chosen = {role: p.topic for role, p in log.provenance.items()}
    assert chosen == {"dvl": "/nucleus_node/bottom_track_packets", "compass": "/imu", "gps": "/ublox/fix"}
    assert log.provenance["gps"].type == FIX


def test_all_records_of_a_receiver_without_fix_are_an_error_with_the_cause(tmp_path: Path) -> None:
    log = read(tmp_path, "gps", row("ublox_msgs/msg/NavPVT", {**UBX, "fixType": 0}))

    assert "1 without fix (by its quality)" in codes(log)["GPS-INVALID"]
    with pytest.raises(LogError, match=r"1 flagged invalid"):
        read(tmp_path, "compass", row("sbg_driver/msg/SbgEkfEuler", {"angle.z": 1.0}))
