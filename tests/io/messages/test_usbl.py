"""Every kind of USBL message, by a record that its own driver could have written."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs import HEAD, MAP, codes, logged, places, refusal
from recordings import FIX, HEADER, ODOMETRY, POINT, POSE, POSE_COVARIANCE, SECOND, T0, Row, define, fields, record, yaw
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.provenance import Convention

LONG = "float64 current_time measurement_time", "int32 remote_address"
QUALITY = "float32 propagation_time", "int32 rssi integrity", "float32 accuracy"
VECTOR, PLACE = "geometry_msgs/Vector3", "float64 latitude longitude"
TYPES = {
    "dmac/msg/mUSBLFix": HEADER
    + fields("int32 source_id", "string source_name", "int32 type", "geometry_msgs/Point relative_position")
    + fields("float32 range bearing elevation sound_speed"),
    "evologics_ros_sync/msg/EvologicsUsbllong": HEADER + fields(*LONG, "float32 x y z n e u", *QUALITY),
    "vehicle_interface/msg/AcousticModemUSBLLONG": HEADER + fields(*LONG, "float32 X Y Z E N U", *QUALITY),
    "capital_modem/msg/EvologicsUsbllong": HEADER + fields(*LONG, "float32 X Y Z N E D", *QUALITY),
    "small_modem/msg/AcousticModemUSBLLONG": HEADER + fields(*LONG, "float32 x y z n e u", *QUALITY),
    "srv_modem/msg/AcousticModemUSBLLONG": HEADER + fields(*LONG, "float32 X Y Z N E D", *QUALITY),
    "mvp_acomm/msg/EvologicsUsbllong": fields(*LONG, f"{VECTOR} xyz enu rpy", *QUALITY),
    "vehicle_interface/msg/AcousticLocalization": HEADER
    + fields("uint8 sender_address", PLACE, "float32 depth", "float64 measurement_time", "float32 accuracy"),
    "later_driver/msg/TransceiverFixStatus": "seatrac_driver/AcousticFix acoustic_fix\n",
    "sonardyne_msgs/msg/Position": HEADER + fields("string UID name", PLACE, "float64 depth age"),
    "old_usbl_geo/msg/GeoPointStamped": HEADER + "geographic_msgs/GeoPoint geo_point\n",
    "foxglove_msgs/msg/Point3InFrame": fields(
        "builtin_interfaces/Time timestamp", "string frame_id", "geometry_msgs/Point point"
    ),
    "vehicle_interface/msg/AcousticModemUSBLANGLES": HEADER + "float32 bearing\n",
    "collaborative/msg/USBL": "float32 distance\nfloat32 bearing\n",
    "labust_msgs/msg/AcousticModemRange": HEADER + "float32 range_m\nuint8 id\n",
}
define(TYPES, shipped="acomms_msgs seatrac_ stonefish_ros2 geographic_msgs holoocean_interfaces")

row = partial(record, "/usbl")


def seatrac(field: str) -> dict[str, Any]:
    places = {"position_easting": 30.0, "position_northing": 40.0, "position_depth": 12.0, "position_valid": True}
    return {f"{field}.{name}": value for name, value in places.items()}


DMAC, SEATRAC_RAW = "dmac/msg/mUSBLFix", "seatrac_interfaces/msg/ModemRec"
THIRTY_EAST_FORTY_NORTH: dict[str, Mapping[str, Any]] = {
    DMAC: {"type": 2, "relative_position.x": 30.0, "relative_position.y": 40.0, "relative_position.z": -12.0},
    "evologics_ros_sync/msg/EvologicsUsbllong": {"e": 30.0, "n": 40.0, "u": -12.0, "x": 1.0, "y": 2.0},
    "vehicle_interface/msg/AcousticModemUSBLLONG": {"E": 30.0, "N": 40.0, "U": -12.0, "X": 1.0, "Y": 2.0},
    "capital_modem/msg/EvologicsUsbllong": {"E": 30.0, "N": 40.0, "D": 12.0, "X": 1.0, "Y": 2.0},
    "small_modem/msg/AcousticModemUSBLLONG": {"e": 30.0, "n": 40.0, "u": -12.0, "x": 1.0, "y": 2.0},
    "srv_modem/msg/AcousticModemUSBLLONG": {"E": 30.0, "N": 40.0, "D": 12.0, "X": 1.0, "Y": 2.0},
    "mvp_acomm/msg/EvologicsUsbllong": {"enu.x": 30.0, "enu.y": 40.0, "enu.z": -12.0, "xyz.x": 1.0},
    "acomms_msgs/msg/UsblData": {"enu.x": 30.0, "enu.y": 40.0, "enu.z": -12.0, "xyz.x": 1.0},
    SEATRAC_RAW: {"includes_position": True, "position_easting": 300, "position_northing": 400, "position_depth": 120},
    "seatrac_driver/msg/TransceiverFixStatus": seatrac("fix"),
    "later_driver/msg/TransceiverFixStatus": seatrac("acoustic_fix"),
    "seatrac_driver/msg/NavigationQueryResponseStatus": seatrac("fix"),
}


@pytest.mark.parametrize("kind", THIRTY_EAST_FORTY_NORTH)
def test_modems_measure_east_and_north_of_their_head(tmp_path: Path, kind: str) -> None:
    """The line of sight is 51.4 m, and its noise 2 % of that."""
    rows = [row(kind, THIRTY_EAST_FORTY_NORTH[kind])]

    log = logged(tmp_path, rows, HEAD)

    assert places(log)[0] == pytest.approx([130, 240])
    assert log.tables["usbl"]["cov_ee_m2"][0] == pytest.approx(0.02**2 * (30**2 + 40**2 + 12**2))
    assert Convention("relative_to", "head", "type") in log.provenance["usbl"].conventions
    assert "holds positions relative to the head; state head" in refusal(LogError, logged, tmp_path, rows, "")


XY = {
    POINT: "point",
    POSE: "pose.position",
    POSE_COVARIANCE: "pose.pose.position",
    ODOMETRY: "pose.pose.position",
    "foxglove_msgs/msg/Point3InFrame": "point",
}


@pytest.mark.parametrize("kind", XY)
@pytest.mark.parametrize("role", ["usbl", "gps"])
def test_a_local_position_is_east_and_north_of_any_sensor(tmp_path: Path, kind: str, role: str) -> None:
    rows = [record("/place", kind, {f"{XY[kind]}.x": 30.0, f"{XY[kind]}.y": 40.0})]

    table = logged(tmp_path, rows, topics={role: "/place"}).tables[role]

    assert table[["east_m", "north_m"]].to_numpy().tolist() == [[30.0, 40.0]]
    assert role == "usbl" or "gps" not in logged(tmp_path, rows).tables


@pytest.mark.parametrize(
    ("kind", "toml", "said"),
    [
        ("vehicle_interface/msg/AcousticModemUSBLANGLES", "", "it holds only angles, not a fix"),
        ("labust_msgs/msg/AcousticModemRange", "", "it holds only ranges, not a fix"),
        ("collaborative/msg/USBL", 'topic = "/usbl"', r"/usbl is of type collaborative/msg/USBL, which cannot be used "
         r"as usbl \(only "),
    ],
)  # fmt: skip
def test_messages_that_hold_no_fix_or_have_an_unknown_layout_are_refused(tmp_path, kind, toml, said):
    with pytest.raises(UsageError, match=said):
        logged(tmp_path, [row(kind, {})], HEAD + toml)


LONG_FIX = THIRTY_EAST_FORTY_NORTH["evologics_ros_sync/msg/EvologicsUsbllong"]
SONARDYNE = {"name": "AUV", "latitude": 45.0009, "longitude": 7.0}
AGED: dict[str, tuple[str, list[tuple[float, Mapping[str, Any]]], list[float]]] = {  # records, seconds between fixes
    # sent 0.4 s after it was measured by the modem's own clock, whatever that counts from; the second states no age
    "evologics_ros_sync/msg/EvologicsUsbllong": (
        HEAD,
        [(0, {**LONG_FIX, "current_time": 1234.9, "measurement_time": 1234.5}),
         (5, {**LONG_FIX, "current_time": 1240.0, "measurement_time": 0.0})],
        [5.4],
    ),
    "sonardyne_msgs/msg/Position": (
        MAP,
        [(0, {**SONARDYNE, "age": 0.75}), (1, {**SONARDYNE, "latitude": 45.001, "age": 0.25}),
         *((2 + 0.3 * k, {**SONARDYNE, "latitude": 45.002 + 1e-5 * (k // 3), "age": 0.3 * (k % 3)}) for k in range(6))],
        [1.5, 1.25, 0.9],  # a position that only grew older is the same position
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", AGED)
def test_a_fix_is_as_old_as_it_states(tmp_path: Path, kind: str) -> None:
    toml, records, seconds = AGED[kind]

    log = logged(tmp_path, [row(kind, values, after_s) for after_s, values in records], toml)

    assert np.diff(log.tables["usbl"]["time_s"]) == pytest.approx(seconds, abs=1e-6)
    if kind == "sonardyne_msgs/msg/Position":
        assert places(log)[0] == pytest.approx([0, 0.0009 * 111132], abs=0.1)
        assert log.convention("usbl", "age_s").note == "median of their age"


def test_several_targets_are_not_guessed_between(tmp_path: Path) -> None:
    fix = THIRTY_EAST_FORTY_NORTH[DMAC]
    rows = [row(DMAC, {**fix, "source_id": 2 + k % 2, "relative_position.x": 30.0 + k}, k) for k in range(5)]

    with pytest.raises(UsageError, match=r"holds fixes of 2 targets: 2 \(3 fixes\), 3 \(2 fixes\); choose one"):
        logged(tmp_path, rows, HEAD)

    log = logged(tmp_path, rows, HEAD + "target = 3")
    assert places(log)[:, 0] == pytest.approx([131, 133])
    assert Convention("target", "3", "configuration") in log.provenance["usbl"].conventions
    said = refusal(UsageError, logged, tmp_path, rows, HEAD + "target = 7")
    file, targets = tmp_path / "usbldr.toml", "2 (3 fixes), 3 (2 fixes)"
    assert said == f"{file}: [usbl] target: /usbl holds no fix of 7 (its targets: {targets})"


HOLOOCEAN = "holoocean_interfaces/msg/AcousticBeaconSensor"
ABEAM: Mapping[str, Any] = {  # to port, 30 deg below the horizon, 50 m away
    "timestamp": T0, "msg_type": "MSG_RESPU", "from_beacon": 1,
    "azimuth": math.pi / 2, "elevation": -math.pi / 6, "range": 50.0,
}  # fmt: skip

EASTWARD = "[usbl]\nhead = { east_m = 100.0, north_m = 200.0, heading_deg = 90.0 }"
BEACON = "[usbl]\nbeacon = { east_m = 100.0, north_m = 200.0 }"
STONEFISH = {"relative_position.x": 30.0, "relative_position.y": 4.0, "relative_position.z": 12.0}
NORTHWARD = {"includes_position": True, "position_easting": 0, "position_northing": 1000}
LEVEL_M, TURN = 50 * math.cos(math.radians(30)), math.radians(10)
OF_RANGER = {"position.latitude": 45.0009, "position.longitude": 7.0, "position.altitude": -30.0}


def cola2(lat: float, lon: float, k: int, more: Mapping[str, Any] = {}) -> Row:
    return row(POSE_COVARIANCE, {"pose.pose.position.x": lat, "pose.pose.position.y": lon, **more}, k)


@pytest.mark.parametrize(
    ("rows", "toml", "east_north_m"),
    [
        # forward, starboard, down of a head whose bow points to the east
        ([row("stonefish_ros2/msg/BeaconInfo", STONEFISH)], EASTWARD, [130, 196]),
        # counter-clockwise from that bow: port is north
        ([row(HOLOOCEAN, ABEAM, 0.25)], EASTWARD, [100, 200 + LEVEL_M]),
        # the vehicle carries the head, heads east and has the beacon to port, so it is south of it
        ([*(yaw(T0 + k * SECOND, 0.0) for k in range(-1, 2)), row(HOLOOCEAN, ABEAM)], BEACON, [100, 200 - LEVEL_M]),
        # Sonardyne's points are known by their topic
        ([record("/ranger/positions/AUV", "geographic_msgs/msg/GeoPointStamped", OF_RANGER)], MAP,
         [0, 0.0009 * 111132]),
        ([record("/ranger/positions/AUV", "old_usbl_geo/msg/GeoPointStamped",
                 {"geo_point.latitude": 45.0009, "geo_point.longitude": 7.0})], MAP, [0, 0.0009 * 111132]),
        # 10 deg east of true north: a point 100 m along magnetic north is 17.4 m east
        ([row(SEATRAC_RAW, NORTHWARD)], HEAD + "mount_deg = 10.0",
         [100 + 100 * math.sin(TURN), 200 + 100 * math.cos(TURN)]),
        # metres far from the degrees of the origin stay metres
        ([cola2(5.0 + 1e-3 * k, 3.0, k) for k in range(4)], MAP, [5, 3]),
    ],
)  # fmt: skip
def test_a_fix_lies_along_its_own_axes(tmp_path: Path, rows: list[Row], toml: str, east_north_m: list[float]) -> None:
    log = logged(tmp_path, rows, toml)

    assert places(log)[0] == pytest.approx(east_north_m, abs=0.1 if toml == MAP else 1e-4)
    if rows[0][2] == HOLOOCEAN:
        assert log.start_ns == T0
        assert Convention("time", "timestamp", "type") in log.provenance["usbl"].conventions


USBL_DATA = "acomms_msgs/msg/UsblData"
NO_REPLIES = ("OWAY", "OWAYU", "MSG_REQ", "MSG_RESP", "MSG_REQU", "MSG_REQX", "")


@pytest.mark.parametrize(
    ("kind", "values", "changes", "used", "said"),
    [
        (SEATRAC_RAW, THIRTY_EAST_FORTY_NORTH[SEATRAC_RAW], [{}, {"includes_position": False},
         {"position_flt_error": True}, {}], [0, 3],
         "1 flagged invalid, 1 flagged as an outlier by the system itself"),
        (DMAC, THIRTY_EAST_FORTY_NORTH[DMAC], [{"type": kind} for kind in range(4)], [2, 3],
         "2 of range or angle alone"),
        (USBL_DATA, THIRTY_EAST_FORTY_NORTH[USBL_DATA], [{"accuracy": 2.5}, {"accuracy": -1.0}], [0],
         "1 of negative accuracy"),
        *((HOLOOCEAN, ABEAM, [{"msg_type": "MSG_RESPX"}, {"timestamp": T0 + SECOND, "msg_type": kind}], [0],
           "1 of range or angle alone") for kind in NO_REPLIES),
    ],
)  # fmt: skip
def test_what_a_system_marks_as_no_fix_is_left_out(tmp_path, kind, values, changes, used, said):
    rows = [row(kind, {**values, **change}, k) for k, change in enumerate(changes)]

    log = logged(tmp_path, rows, EASTWARD if kind == HOLOOCEAN else HEAD)

    times_ns = log.start_ns + log.tables["usbl"]["time_s"].to_numpy() * SECOND
    assert times_ns - T0 == pytest.approx(np.array(used) * SECOND, abs=1000)
    assert said in codes(log)["USBL-INVALID"]
    if kind == USBL_DATA:
        assert log.tables["usbl"]["cov_ee_m2"].to_numpy() == pytest.approx([2.5**2])


def test_an_acoustic_localization_is_a_latitude_and_a_longitude_with_its_accuracy(tmp_path: Path) -> None:
    kind = "vehicle_interface/msg/AcousticLocalization"
    fix = {"sender_address": 3, "latitude": 45.0009, "longitude": 7.0, "measurement_time": 12.0}

    log = logged(tmp_path, [row(kind, {**fix, "accuracy": a}, k) for k, a in enumerate([2.0, -1.0])], MAP)

    assert places(log)[0] == pytest.approx([0, 0.0009 * 111132], abs=0.1)
    assert log.tables["usbl"]["cov_nn_m2"].tolist() == [4.0]
    assert log.start_ns == T0  # by the header: nobody says what measurement_time counts from
    assert Convention("target", "3", "data", note="the only one") in log.provenance["usbl"].conventions


@pytest.mark.parametrize(
    ("topic", "kind", "sentence"),
    [
        ("/waterlinked/odom", ODOMETRY,
         "it is measured along the axes of the topside box from its first fix; use /waterlinked/fix"),
        ("/waterlinked/utm", "geometry_msgs/msg/Point",
         "it holds UTM coordinates without their zone; use the topic of"),
    ],
)  # fmt: skip
def test_only_the_latitudes_of_a_topside_box_are_used(tmp_path: Path, topic: str, kind: str, sentence: str) -> None:
    rows = [record(topic, kind, {}), record("/waterlinked/fix", FIX, {"latitude": 45.0, "longitude": 7.0})]

    assert logged(tmp_path, rows, MAP).provenance["usbl"].topic == "/waterlinked/fix"
    with pytest.raises(UsageError, match=sentence):
        logged(tmp_path, rows, f'{MAP}[usbl]\ntopic = "{topic}"')


@pytest.mark.parametrize("section", ["", '[usbl]\nkind = "latlon"'])
def test_latitude_and_longitude_in_a_pose_are_found_out(tmp_path: Path, section: str) -> None:
    """Their first variance is north's."""
    covariance = {"pose.covariance": np.diag([9.0, 4.0, 0.0, 0.0, 0.0, 0.0]).ravel()}
    fixes = [cola2(0.0, 0.0, 0), *(cola2(45.0 + 1e-5 * k, 7.0, k, covariance) for k in range(1, 5))]

    log = logged(tmp_path, fixes, MAP + section)

    assert places(log) == pytest.approx(np.outer(np.arange(1, 5), [0, 1e-5 * 111132]), abs=0.01)
    assert ('state kind = "position"' in codes(log).get("USBL-LATLON", "")) == (not section)
    assert log.tables["usbl"][["cov_ee_m2", "cov_nn_m2"]].to_numpy()[0] == pytest.approx([4.0, 9.0])
    assert "1 at latitude and longitude 0" in codes(log)["USBL-INVALID"]


def test_a_pose_of_degrees_polled_again_is_one_fix_and_metres_are_each_their_own(tmp_path: Path) -> None:
    fixes = [cola2(45.0 + 1e-5 * (k // 5), 7.0, k) for k in range(15)]

    log = logged(tmp_path, fixes, MAP)
    metres = logged(tmp_path, fixes, f'{MAP}[usbl]\nkind = "position"')

    assert log.tables["usbl"]["time_s"].to_numpy() == pytest.approx([0, 5, 10])
    assert codes(log)["USBL-REPEATED"].startswith("/usbl: 12 of 15 fixes repeat the previous one")
    assert len(metres.tables["usbl"]) == 15


@pytest.mark.parametrize("stated", ['kind = "position"', 'frame = "NED"', "head = { east_m = 0.0, north_m = 0.0 }"])
def test_a_statement_of_metres_is_followed(tmp_path: Path, stated: str) -> None:
    log = logged(tmp_path, [cola2(45.0 + 1e-5 * k, 7.0, k) for k in range(4)], f"{MAP}[usbl]\n{stated}")

    assert sorted(places(log)[0]) == pytest.approx([7, 45])
