"""What can be wrong with a log, beside what the tests of its format show (docs/broken_files.md).

Messages of real systems hold traps: clocks, targets, flags and fields that mean something else. A dive may be logged
twice: the vehicle's DVL and compass below, a survey ship's sentences above.
"""

import json
import math
import tomllib
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from mcap.writer import CompressionType

from commands import output_of
from logs import HEAD, MAP, METRES_A_DEGREE, codes, logged, logged_nmea, read_as, refusal
from recordings import (
    DVL,
    FIX,
    FLOAT64,
    HEADER,
    POINT,
    POSE_COVARIANCE,
    ROS2,
    SECOND,
    T0,
    TWIST,
    Row,
    define,
    point,
    sentence,
    short_dive,
    twist,
    write_mcap,
    write_payloads,
    yaw,
)
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log
from usbldr.io.recordings.mcap_log import McapLog


@pytest.mark.parametrize("folder", [False, True])
def test_what_may_not_be_read_is_named(tmp_path: Path, folder: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "dive"
    if folder:
        log.mkdir()
    else:
        log.write_bytes(b"secret")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir" if folder else "open", refuse)  # a superuser may read all

    assert refusal(LogError, open_reader, log) == f"{log}: cannot be read (Permission denied)"


def test_memory_goes_by_what_is_wanted_and_not_by_the_file(tmp_path: Path) -> None:
    """Reading beside 64 MB of other messages must not cost 20 MB."""
    peaks: list[float] = []
    for size in (0, 1 << 20):
        text = {"data": "x" * size}
        rows = [
            row
            for k in range(64)
            for row in (twist(T0 + k, 1.0, 0.0), (T0 + k, "/camera", "std_msgs/msg/String", text))
        ]
        file = write_mcap(tmp_path / f"{size}.mcap", rows, CompressionType.NONE, True, 1 << 20)
        del rows, text
        tracemalloc.start()
        read_whole(McapLog(file), {"/dvl": ["twist.linear.x"]})
        peaks.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()

    assert peaks[1] - peaks[0] < 20


def test_a_sensor_without_one_readable_message_is_an_error_with_the_reason(tmp_path: Path) -> None:
    file = write_payloads(tmp_path / "a.mcap", "/compass_hdg", "cdr", FLOAT64, [b"\0\7\0\0" + bytes(8)])

    assert refusal(LogError, read_log, file) == (
        f"{file}: no message of /compass_hdg (compass) could be read: /compass_hdg: 1 messages, the first of "
        "2020-09-13T12:26:40.000Z, do not match their definition in the file: they are in XCDR2, not plain CDR"
    )


PLACE = "float64 latitude\nfloat64 longitude\n"
define({"gps_only_msgs/msg/GPSFix": f"{HEADER}{PLACE}float64 track\nfloat64 err_horz\n"})
define({"some_foxglove_msgs/msg/LocationFix": PLACE})
define({"some_foxglove_msgs/msg/LocationFixes": "some_foxglove_msgs/LocationFix[] fixes\n"})


def cola2(k: int, age_s: float) -> Row:
    stamp_ns = T0 + k * SECOND - round(age_s * SECOND)
    values = {"header.stamp": stamp_ns, "pose.pose.position.x": 45.0 + 1e-5 * k, "pose.pose.position.y": 7.0}
    return T0 + k * SECOND, "/usbl", POSE_COVARIANCE, values


def test_a_fix_stamped_hours_before_it_came_is_none_unless_the_clock_of_the_system_is_hours_off(tmp_path: Path) -> None:
    """COLA2 calls a fix invalid by a stamp more than 9900 s old; it must not become the start of the dive."""
    log = logged(tmp_path, [cola2(0, 0.5), cola2(1, 10_000.0), *(cola2(k, 2.0) for k in range(2, 5))], MAP)

    assert len(log.tables["usbl"]) == 4
    assert log.start_ns == T0 - SECOND // 2
    assert "1 stamped hours before arrival" in codes(log)["USBL-INVALID"]
    assert len(logged(tmp_path, [cola2(k, 10_800.5) for k in range(5)], MAP).tables["usbl"]) == 5


def test_local_time_in_a_sentence_is_moved_to_the_clock_of_the_others(tmp_path: Path) -> None:
    """T0 is 12:26:40 UTC; the topside computer writes 14:26:39.50, each fix half a second old."""
    bodies = [f"PSIMSSB,1426{39.5 + k:05.2f},B01,A,,C,N,M,{k}.0,5.0,10.0,1.0,N,," for k in range(11)]
    said = [{"data": sentence(body) + "\r\n"} for body in bodies]
    fixes: list[Row] = [(T0 + k * SECOND, "/usbl/serial", "std_msgs/msg/String", one) for k, one in enumerate(said)]
    rows = [row for row in short_dive() if row[2] != POINT]

    log = logged(tmp_path, [*rows, *fixes], "[usbl]\nhead = { east_m = 0.0, north_m = 0.0 }\n")

    assert log.start_ns == T0
    np.testing.assert_allclose(log.tables["usbl"]["time_s"], np.arange(11.0), atol=1e-6)
    assert "CLOCK-SHIFTED" in codes(log)


@pytest.mark.parametrize("later", [1.4, -0.4])
def test_fixes_around_midnight_stay_in_order(tmp_path: Path, later: float) -> None:
    """The logger's midnight comes a little before or after the sender's."""
    midnight_s = 1_600_041_600  # 2020-09-14T00:00:00Z
    bodies = {-2: "235958.00", -1: "235959.00", 0: "000000.00", 1: "000001.00"}
    lines = [
        f"{midnight_s + k + later:.1f} " + sentence(f"PSIMSSB,{text},B01,A,,C,N,M,{k + 5}.0,5.0,10.0,1.0,N,,")
        for k, text in bodies.items()
    ]

    log = logged_nmea(tmp_path, *lines, toml=HEAD)

    assert log.start_ns == (midnight_s - 2) * SECOND
    assert log.tables["usbl"]["time_s"].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_the_target_of_a_tracked_target_sentence_is_one_of_several(tmp_path: Path) -> None:
    """Water Linked's UGPS may send TLL; status T is a target under way, L a lost one."""
    lines = [
        f"{1600000000 + k} " + sentence(f"RATLL,{n:02d},4500.{54 + k:03d},N,00700.000,E,,12264{k}.00,{status},")
        for k, (n, status) in enumerate([(1, "T"), (2, "T"), (1, "L"), (1, "Q"), (1, "T")])
    ]
    rows = [(T0 + k * SECOND, "/ugps/nmea", "std_msgs/msg/String", {"data": line}) for k, line in enumerate(lines)]

    log = logged(tmp_path, rows, f'{MAP}[usbl]\ntarget = "1"')

    north = log.tables["usbl"]["north_m"].to_numpy()
    assert north == pytest.approx([0.054 / 60 * METRES_A_DEGREE, 0.058 / 60 * METRES_A_DEGREE], abs=0.02)
    assert "2 without fix" in codes(log)["USBL-INVALID"]


def test_what_only_looks_like_a_sensor_serves_where_it_is_named_or_not_at_all(tmp_path: Path) -> None:
    """A radar's target is no fix; a HiPAP has a heading of its own; the fields of PTSAH are not documented."""
    radar, gyro = sentence("RATLL,01,4500.054,N,00700.000,E,,122640.00,T,"), sentence("HEHDT,1.5,T")
    hipap = f"1600000000 {sentence('PSIMSNS,122640.00,M42,01,01,1.0,2.0,0.3,181.5,,1,0.4,,M121')}"
    unknown = f"1600000000 {sentence('PTSAH,#16068,124544.449,18,12,2017,271.5')}"

    assert "usbl" not in logged_nmea(tmp_path, f"1600000000 {radar}", f"1600000000 {gyro}", toml=MAP).tables
    named = logged_nmea(tmp_path, hipap, compass="/PSIMSNS")
    assert named.tables["compass"]["heading_deg"].tolist() == [181.5]
    assert "compass" not in logged_nmea(tmp_path, hipap).tables
    with pytest.raises(UsageError, match=r"/PTSAH .* cannot be used as compass: it has unknown fields"):
        logged_nmea(tmp_path, unknown, compass="/PTSAH")


def test_the_first_of_several_fixes_counts_and_a_message_without_fix_is_none(tmp_path: Path) -> None:
    fix = ROS2.types["some_foxglove_msgs/msg/LocationFix"]
    fixes = [[fix(45.0, 7.0), fix(1.0, 1.0)], [], [fix(45.001, 7.0)]]
    kind = "some_foxglove_msgs/msg/LocationFixes"
    log = logged(tmp_path, [(T0 + k * SECOND, "/gps", kind, {"fixes": one}) for k, one in enumerate(fixes)])

    assert log.tables["gps"]["lat_deg"].tolist() == [45.0, 45.001]
    assert log.tables["gps"]["time_s"].tolist() == [0.0, 2.0]
    assert "1 of 3 records are invalid and left out (1 not a number)" in codes(log)["GPS-INVALID"]


def test_a_course_is_no_heading_and_what_an_autopilot_was_told_of_speed_no_dvl(tmp_path: Path) -> None:
    kind, speed = "gps_only_msgs/msg/GPSFix", "/mavros/vision_speed/speed_twist"
    fix = (T0, "/gps", kind, {"header.stamp": T0, "latitude": 45.0, "longitude": 7.0, "track": 90.0})
    one = (T0, speed, TWIST, {"header.stamp": T0, "twist.linear.x": 1.0})

    assert list(logged(tmp_path, [fix]).tables) == ["gps"]
    with pytest.raises(UsageError, match="holds the course over ground, not a heading"):
        logged(tmp_path, [fix], topics={"compass": "/gps"})
    assert "holds velocities in earth axes" in refusal(UsageError, logged, tmp_path, [one], topics={"dvl": speed})


def test_a_target_that_a_format_has_as_a_float_is_the_same_target(tmp_path: Path) -> None:
    """JSON knows no integers: 3 may come as 3.0."""
    fields = {"source_id": {"type": "number"}, "type": {"type": "number"}}
    place = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
    schema = {"properties": {**fields, "relative_position": place}}
    fixes = [
        {"source_id": target, "type": 2, "relative_position": {"x": 1.0 + k, "y": 2.0, "z": 0.0}}
        for k, target in enumerate([2.0, 3.0, 3.0])
    ]
    definition = ("dmac.mUSBLFix", "jsonschema", json.dumps(schema).encode())
    payloads = (json.dumps(fix).encode() for fix in fixes)
    file = write_payloads(tmp_path / "dive.mcap", "/usbl", "json", definition, payloads)

    assert read_as(file, HEAD + "target = 3").tables["usbl"]["east_m"].tolist() == [102.0, 103.0]


def test_a_repeated_fix_of_unknown_ellipse_is_still_one_fix(tmp_path: Path) -> None:
    lines = [
        f"{1600000000 + k} " + sentence(f"PSONLLD,12264{k}.00,2401,A,45.000{1 + k // 2},7.0,10.0,,,,,,,,")
        for k in range(4)
    ]

    log = logged_nmea(tmp_path, *lines, toml=MAP)

    assert len(log.tables["usbl"]) == 2
    assert codes(log)["USBL-REPEATED"].startswith("/PSONLLD: 2 of 4 fixes repeat")


def test_a_dvl_may_fill_in_its_covariance_now_and_then_and_has_its_figure_of_merit_in_its_own_unit(tmp_path):
    """The newer dvl_msgs/DVL has 9 numbers or none."""
    by_message = '[dvl]\nsd_mps = "message"\n'
    good: dict[str, Any] = {"velocity.x": 1.0, "velocity_valid": True, "fom": 0.5}
    rows: list[Row] = [
        (T0 + k * SECOND, "/dvl", DVL, {"header.stamp": T0 + k * SECOND, **good, "covariance": np.array(c)})
        for k, c in enumerate([[], [0.0004, 0, 0, 0, 0.0004, 0, 0, 0, 0.0004], []])
    ]
    in_mm = good | {"velocity.x": 1500.0, "velocity.y": -200.0, "fom": 30.0, "header.stamp": T0}

    table = logged(tmp_path, rows, by_message).tables["dvl"]
    millimetres = logged(tmp_path, [(T0, "/dvl", DVL, in_mm)], by_message + 'unit = "mm/s"').tables["dvl"]

    assert table["sd_mps"].to_numpy() == pytest.approx([0.5, 0.02, 0.5])
    assert millimetres[["starboard_mps", "forward_mps", "sd_mps"]].to_numpy().tolist() == [[-0.2, 1.5, 0.03]]


def test_sigmas_and_variances_are_not_mixed_up(tmp_path: Path) -> None:
    """A NavSatFix states variances of east and north; accuracy of a HiPAP is a sigma."""
    covariance = np.diag([4.0, 9.0, 1.0]).ravel()
    stated = {"latitude": 45.0, "longitude": 7.0, "position_covariance": covariance, "position_covariance_type": 2}
    by_variance = logged(tmp_path, [(T0, "/usbl/fix", FIX, {"header.stamp": T0, **stated})], MAP).tables["usbl"]
    hipap = sentence("PSIMSSB,122640.00,B01,A,,C,N,M,3.0,5.0,10.0,2.0,N,,")
    by_sigma = logged_nmea(tmp_path, f"1600000000 {hipap}", toml=HEAD).tables["usbl"]

    columns = ["cov_ee_m2", "cov_nn_m2"]
    assert by_variance[columns].to_numpy().tolist() == [[4.0, 9.0]]
    assert by_sigma[columns].to_numpy() == pytest.approx(np.array([[4.0, 4.0]]))


NED = ("world_ned", "NED", "nav/ned", "worldNed", "map_NED_1")


@pytest.mark.parametrize("frame", [*NED, "map_aligned", "tuned", "needle", "planned_map", "ALIGNED", "map"])
def test_a_frame_counts_north_first_if_a_whole_word_of_it_is_ned(tmp_path: Path, frame: str) -> None:
    log_ns, topic, kind, values = point(T0, 3.0, 4.0)

    log = logged(tmp_path, [(log_ns, topic, kind, {**values, "header.frame_id": frame})])

    assert log.tables["usbl"][["east_m", "north_m"]].to_numpy().tolist() == [[4.0, 3.0] if frame in NED else [3.0, 4.0]]
    assert (log.convention("usbl", "frame").chosen_by == "frame_id") == (frame in NED)


ARM = (2.0, -14.0)  # starboard, forward of the antenna: the head
DELAY_S = 2  # a fix comes out 1.5 s after it was true


def vehicle_at(t: float) -> tuple[float, float]:
    """North along a meridian at 1 m/s, 30 m east of the origin."""
    return 30.0, t


def ship_at(t: float) -> tuple[float, float, float]:
    """East, north and heading: round a circle of 60 m within 200 s, clockwise, bow ahead."""
    angle = 2 * math.pi * t / 200
    return 60 * math.sin(angle), 60 * math.cos(angle), math.degrees(angle) + 90


def clock(t: float) -> str:
    """Time of day of T0 + t, hhmmss.ss: T0 is 12:26:40."""
    s = 12 * 3600 + 26 * 60 + 40 + t
    return f"{int(s // 3600):02d}{int(s % 3600 // 60):02d}{s % 60:05.2f}"


def ddmm(degrees: float, digits: int) -> str:
    whole = int(degrees)
    return f"{whole:0{digits}d}{(degrees - whole) * 60:09.6f}"


def topside(file: Path) -> Path:
    """Position and heading each second, and every other second a fix: starboard and forward of the head."""
    lines: list[str] = []
    for k in range(121):
        east, north, heading = ship_at(k)
        lat, lon, _ = pymap3d.enu2geodetic(east, north, 0.0, 45.0, 7.0, 0.0)
        gga = f"GPGGA,{clock(k)},{ddmm(float(lat), 2)},N,{ddmm(float(lon), 3)},E,2,12,0.6,0.0,M,48.0,M,,"
        said = [gga, f"HEHDT,{heading % 360:.6f},T"]
        if k >= DELAY_S and k % 2 == 0:
            fix = f"PSIMSSB,{clock(k - DELAY_S + 0.5)},B01,A,,C,H,M,{seen_at(k - DELAY_S + 0.5)},20.0,0.5,N,,"
            said += [fix, fix.replace("B01", "B02")]
        lines += [f"{T0 // SECOND + k}.000 {sentence(body)}" for body in said]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def seen_at(t: float) -> str:
    """Where the head, turned with the ship, has the vehicle: starboard and forward."""
    east, north, heading = ship_at(t)
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    away_east, away_north = vehicle_at(t)[0] - east, vehicle_at(t)[1] - north
    starboard, forward = away_east * c - away_north * s, away_east * s + away_north * c
    return f"{starboard - ARM[0]:.4f},{forward - ARM[1]:.4f}"


def vehicle(file: Path) -> Path:
    rows: list[Row] = []
    for k in range(600):
        rows += [twist(T0 + k * SECOND // 5, 1.0, 0.0), yaw(T0 + k * SECOND // 5, 90.0)]
    return write_mcap(file, rows)


CONFIGURATION = """
[map]
origin_lat_deg = 45.0
origin_lon_deg = 7.0
[usbl]
target = "B01"
head = { topic = "/GPGGA", heading_topic = "/HEHDT", lever_arm_m = [2.0, -14.0, -5.0], sd_m = 0.0 }
[[file]]
path = "ship.nmea"
"""


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    topside(tmp_path / "ship.nmea")
    (tmp_path / "usbldr.toml").write_text(CONFIGURATION, encoding="utf-8")
    return vehicle(tmp_path / "dive.mcap")


def test_fixes_of_a_ship_that_turns_lie_on_the_vehicles_way(dive: Path) -> None:
    """At 2 m/s round the circle, the chord between two seconds is a centimetre inside the arc."""
    usbl = read_log(dive, Request()).tables["usbl"]
    truth = np.array([vehicle_at(t) for t in usbl["time_s"]])

    assert usbl["time_s"].to_numpy() == pytest.approx(0.5 + 2.0 * np.arange(60))
    assert (usbl["received_s"] - usbl["time_s"]).to_numpy() == pytest.approx(1.5)
    np.testing.assert_allclose(usbl[["east_m", "north_m"]].to_numpy(), truth, atol=0.03)


def test_init_gives_position_and_heading_of_the_ship_to_the_head(dive: Path) -> None:
    """Two headings are in the files: the compass is the one with which the fixes agree with dead reckoning."""
    configuration = dive.with_name("usbldr.toml")
    head = next(line for line in CONFIGURATION.splitlines() if line.startswith("head"))
    configuration.write_text(CONFIGURATION.replace(head, ""), encoding="utf-8")

    output_of("init", dive, "--output", dive.with_name("found.toml"))

    text = dive.with_name("found.toml").read_text(encoding="utf-8")
    found = tomllib.loads(text)
    assert found["usbl"]["head"] == {"topic": "/GPGGA", "heading_topic": "/HEHDT"}
    assert found["compass"]["topic"] == "/imu"
    assert found["gps"]["topic"] == "none"
    assert "CHECK: the ship that carries the head" in text
    assert "# head" not in text
    configuration.write_text(text, encoding="utf-8")
    usbl = read_log(dive, Request()).tables["usbl"]
    truth = np.array([vehicle_at(t) for t in usbl["time_s"]])
    away_m = np.hypot(*(usbl[["east_m", "north_m"]].to_numpy() - truth).T)
    np.testing.assert_allclose(away_m, math.hypot(*ARM), atol=0.1)  # the arm is not known
