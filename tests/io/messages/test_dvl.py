"""Every family of DVL messages, by a record that its own driver could have written."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from logs import logged, only, refusal
from recordings import DVL, HEADER, ODOMETRY, SECOND, T0, TWIST, define, fields, record, stamp
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.provenance import Convention

VELOCITY = "geometry_msgs/Vector3 velocity\n"
TYPES = {
    "uuv_sensor_msgs/msg/DVL": HEADER + VELOCITY + fields("float64[9] velocity_covariance", "uint8 velocity_reference"),
    "ds_sensor_msgs/msg/Dvl": HEADER
    + VELOCITY
    + fields("float64[9] velocity_covar", "uint8 num_good_beams velocity_mode coordinate_mode"),
    "waterlinked_a50_ros_driver/msg/DVL": HEADER + VELOCITY + fields("float64 fom altitude", "bool velocity_valid"),
    "waterlinked_dvl/msg/TransducerReport": fields("float64 vx vy vz fom", "bool velocity_valid")
    + fields("float64[9] covariance", "builtin_interfaces/Time time_of_validity time_of_transmission"),
    "waterlinked_dvl/msg/TransducerReportStamped": HEADER + "waterlinked_dvl/TransducerReport report\n",
    "nortek_dvl/msg/Dvl": HEADER
    + fields("float64 time", "geometry_msgs/Vector3 velocity", "float64 figureOfMerit", "float64[4] beamDistance"),
    "nortek_dvl333_msgs/msg/BottomTrack": fields("float64 vel_beam0 vel_beam1 vel_beam2"),
    "cola2_msgs/msg/LinkquestDvl": HEADER + fields("float64[3] velocityInst", "int32 velocityInstFlag"),
    "cola2_msgs/msg/TeledyneExplorerDvl": HEADER + fields("float64 bi_x_axis bi_y_axis bi_z_axis", "string bi_status"),
}
define(TYPES, shipped="uuv_sensor_ros_plugins_msgs smarc_msgs cola2_msgs stonefish_ros2 holoocean_interfaces")

row = partial(record, "/sensor")

WATER_LINKED = {"velocity.x": 2.0, "velocity.y": 1.0, "velocity_valid": True, "fom": 0.03}
FORWARD_2_STARBOARD_1 = {
    "uuv_sensor_ros_plugins_msgs/msg/DVL": {"velocity.x": 2.0, "velocity.y": -1.0},  # forward, left, up
    "uuv_sensor_msgs/msg/DVL": {"velocity.x": 2.0, "velocity.y": -1.0, "velocity_reference": 3},
    "ds_sensor_msgs/msg/Dvl": {"velocity.x": 2.0, "velocity.y": -1.0, "coordinate_mode": 2, "num_good_beams": 4},
    "nortek_dvl/msg/Dvl": {"velocity.x": 2.0, "velocity.y": -1.0},
    "smarc_msgs/msg/DVL": {"velocity.x": 2.0, "velocity.y": 1.0},  # forward, starboard, down
    "cola2_msgs/msg/DVL": {"velocity.x": 2.0, "velocity.y": 1.0},
    "stonefish_ros2/msg/DVL": {"velocity.x": 2.0, "velocity.y": 1.0},
    "waterlinked_a50_ros_driver/msg/DVL": WATER_LINKED,
    "old_dvl_msgs/msg/DVL": WATER_LINKED,
    DVL: WATER_LINKED,
    "waterlinked_dvl/msg/TransducerReportStamped": {"report.vx": 2.0, "report.vy": 1.0, "report.velocity_valid": True},
    "cola2_msgs/msg/TeledyneExplorerDvl": {"bi_x_axis": 2.0, "bi_y_axis": 1.0, "bi_status": "A"},
    "cola2_msgs/msg/LinkquestDvl": {"velocityInst": np.array([-2.0, -1.0, 0.0]), "velocityInstFlag": 1},  # the bottom's
}


@pytest.mark.parametrize("kind", FORWARD_2_STARBOARD_1)
def test_each_family_is_found_by_its_fields_and_read_in_its_own_axes(tmp_path: Path, kind: str) -> None:
    values = FORWARD_2_STARBOARD_1[kind]

    log = logged(tmp_path, [row(kind, values)], '[dvl]\nsd_mps = "message"')

    table = log.tables["dvl"]
    assert (table["starboard_mps"].iloc[0], table["forward_mps"].iloc[0]) == (1.0, 2.0)
    assert table["valid"].all()
    assert table["sd_mps"].iloc[0] == pytest.approx(values.get("fom", np.nan), nan_ok=True)
    assert log.provenance["dvl"].type == kind


@pytest.mark.parametrize(
    ("cause", "kind", "change"),
    [
        ("negative covariance", "cola2_msgs/msg/DVL", {"velocity_covariance": np.full(9, -1.0)}),
        ("water track", "uuv_sensor_msgs/msg/DVL", {"velocity_reference": 2}),
        ("not a number", "uuv_sensor_msgs/msg/DVL", {"velocity.x": np.nan, "velocity.y": np.nan}),
        ("in earth coordinates", "ds_sensor_msgs/msg/Dvl", {"coordinate_mode": 3}),
        ("in beam coordinates", "ds_sensor_msgs/msg/Dvl", {"coordinate_mode": 0}),
        ("fewer than 3 good beams", "ds_sensor_msgs/msg/Dvl", {"num_good_beams": 2}),
        ("flagged invalid", "waterlinked_a50_ros_driver/msg/DVL", {"velocity_valid": False, "velocity.x": 0.0}),
        ("flagged invalid", "old_dvl_msgs/msg/DVL", {"velocity_valid": False}),
        ("flagged invalid", DVL, {"velocity_valid": False}),
        ("without status A", "cola2_msgs/msg/TeledyneExplorerDvl", {"bi_status": "V"}),
        ("exactly zero", "smarc_msgs/msg/DVL", {"velocity.x": 0.0, "velocity.y": 0.0}),
        ("faster than 20 m/s", "smarc_msgs/msg/DVL", {"velocity.x": 327.67}),
    ],
)
def test_a_record_that_its_family_calls_invalid_is_counted_and_not_used(tmp_path, cause, kind, change):
    good = FORWARD_2_STARBOARD_1[kind]

    log = logged(tmp_path, [row(kind, good), row(kind, {**good, **change}, 1)])

    assert list(log.tables["dvl"]["valid"]) == [True, False]
    assert only(log, "DVL-INVALID") == f"/sensor: 1 of 2 records are invalid and not used (1 {cause})"


def test_a_covariance_of_zeros_is_unknown_and_no_fault(tmp_path: Path) -> None:
    kind = "cola2_msgs/msg/DVL"
    rows = [
        row(kind, {**FORWARD_2_STARBOARD_1[kind], "velocity_covariance": sd**2 * np.eye(3).ravel()}, k)
        for k, sd in enumerate([0.0, 0.02])
    ]

    log = logged(tmp_path, rows, '[dvl]\nsd_mps = "message"')

    assert log.tables["dvl"]["valid"].all()
    np.testing.assert_allclose(log.tables["dvl"]["sd_mps"], [np.nan, 0.02])


@pytest.mark.parametrize(("mode", "where"), [(0, "beam"), (3, "earth")])
def test_beam_and_earth_coordinates_are_refused_in_a_sentence(tmp_path: Path, mode: int, where: str) -> None:
    assert refusal(
        LogError, logged, tmp_path, [row("ds_sensor_msgs/msg/Dvl", {"velocity.x": 1.0, "coordinate_mode": mode})]
    ) == (
        f"{tmp_path / 'dive.mcap'}: all 1 records of /sensor (dvl) are invalid: 1 in {where} coordinates; "
        "velocities along beams or in earth axes cannot be used: record instrument or ship coordinates"
    )


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("nortek_dvl333_msgs/msg/BottomTrack", "holds only velocities along the beams; record XYZ velocities"),
        ("holoocean_interfaces/msg/DVLSensorRange", "holds ranges, not velocities"),
    ],
)
@pytest.mark.parametrize("named", [True, False])
def test_a_dvl_without_velocity_is_refused_with_the_reason(tmp_path: Path, kind: str, reason: str, named: bool) -> None:
    assert refusal(UsageError, logged, tmp_path, [row(kind, {})], topics={"dvl": "/sensor"} if named else {}) == (
        f"{tmp_path / 'dive.mcap'}: /sensor ({kind}) cannot be used as dvl: "
        f"it {reason} (--dvl none: replay without dvl)"
    )


def test_a_useless_topic_does_no_harm_beside_a_dvl(tmp_path: Path) -> None:
    kind = "smarc_msgs/msg/DVL"
    beams = record("/beams", "nortek_dvl333_msgs/msg/BottomTrack", {})

    log = logged(tmp_path, [beams, row(kind, FORWARD_2_STARBOARD_1[kind])])

    assert log.provenance["dvl"].topic == "/sensor"


@pytest.mark.parametrize(
    ("kind", "velocity", "named_in", "frame", "axes"),
    [
        (TWIST, "twist.linear", "header.frame_id", "dvl_link", "FLU"),
        (TWIST, "twist.linear", "header.frame_id", "base_link_ned", "FRD"),
        (TWIST, "twist.linear", "header.frame_id", "dvl_frd", "FRD"),
        ("uuv_sensor_ros_plugins_msgs/msg/DVL", "velocity", "header.frame_id", "rexrov/dvl_link_ned", "FRD"),
        (ODOMETRY, "twist.twist.linear", "child_frame_id", "base_link_frd", "FRD"),
    ],
)
def test_axes_that_nobody_states_are_those_of_the_frame(tmp_path, kind, velocity, named_in, frame, axes):
    values = {f"{velocity}.x": 2.0, f"{velocity}.y": 1.0, "header.frame_id": "odom", named_in: frame}

    log = logged(tmp_path, [record("/dvl/velocity", kind, values)])

    assert log.tables["dvl"]["starboard_mps"].iloc[0] == (-1.0 if axes == "FLU" else 1.0)
    assert log.provenance["dvl"].conventions[0] == Convention("axes", axes, "frame_id", note=frame)


def test_a_report_that_knows_both_its_times_is_moved_back_by_their_difference(tmp_path: Path) -> None:
    """The DVL's own clock may be anywhere: only the difference of its two times is used."""
    kind = "waterlinked_dvl/msg/TransducerReportStamped"
    values = FORWARD_2_STARBOARD_1[kind]
    uptime = 77 * SECOND
    ages = {"report.time_of_validity": stamp(uptime), "report.time_of_transmission": stamp(uptime + 150_000_000)}
    assert logged(tmp_path, [row(kind, {**values, **ages})]).start_ns == T0 - 150_000_000
