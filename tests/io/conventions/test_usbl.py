"""USBL fixes of every kind against positions worked out by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from logs import codes, covariance, logged, logged_csv
from recordings import FIX, POSE, POSE_COVARIANCE, PRESSURE, SECOND, T0, Row, fix, point
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log
from usbldr.io.provenance import Convention

HEAD = "head = { east_m = 100.0, north_m = -50.0, depth_m = 2.0 }"


def place(log: Log) -> list[float]:
    table = log.tables["usbl"]
    return [float(table["east_m"].iloc[0]), float(table["north_m"].iloc[0])]


def test_enu_positions_have_x_east_and_ned_positions_x_north(tmp_path: Path) -> None:
    rows = [point(T0, 3.0, 4.0)]

    assert place(logged(tmp_path, rows)) == [3.0, 4.0]
    assert place(logged(tmp_path, rows, '[usbl]\nframe = "ENU"')) == [3.0, 4.0]
    assert place(logged(tmp_path, rows, '[usbl]\nframe = "NED"')) == [4.0, 3.0]


def test_offsets_from_a_head_are_added_to_it(tmp_path: Path) -> None:
    rows = [point(T0, 3.0, 4.0)]

    assert place(logged(tmp_path, rows, f'[usbl]\nrelative_to = "head"\n{HEAD}')) == [103.0, -46.0]
    assert place(logged(tmp_path, rows, f"[usbl]\n{HEAD}")) == [103.0, -46.0]
    assert place(logged(tmp_path, rows, f'[usbl]\nrelative_to = "map"\n{HEAD}')) == [3.0, 4.0]


def test_a_head_by_latitude_is_the_origin_unless_there_is_a_map(tmp_path: Path) -> None:
    rows = [point(T0, 3.0, 4.0)]
    head = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }"
    north_of_it = "[map]\norigin_lat_deg = 44.9991\norigin_lon_deg = 7.0\n"

    alone, on_map = logged(tmp_path, rows, head), logged(tmp_path, rows, north_of_it + head)

    assert place(alone) == pytest.approx([3.0, 4.0], abs=1e-6)
    assert alone.origin is not None
    assert (alone.origin.lat_deg, alone.origin.kind) == (45.0, "usbl head")
    assert place(on_map) == pytest.approx([3.0, 4.0 + 0.0009 * 111132], abs=0.1)


def test_a_fix_by_latitude_and_longitude_is_put_on_the_plane(tmp_path: Path) -> None:
    rows = [fix(T0, 45.0009, 7.0, topic="/usbl/fix")]
    toml = "[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0"

    assert place(logged(tmp_path, rows, toml)) == pytest.approx([0.0, 0.0009 * 111132], abs=0.1)


def test_a_pose_may_hold_latitude_and_longitude(tmp_path: Path) -> None:
    rows = [(T0, "/usbl", POSE, {"header.stamp": T0, "pose.position.x": 45.0009, "pose.position.y": 7.0})]
    toml = '[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0\n[usbl]\nkind = "latlon"'

    assert place(logged(tmp_path, rows, toml)) == pytest.approx([0.0, 0.0009 * 111132], abs=0.1)


def test_latitudes_give_the_plane_its_origin_before_the_gps_does(tmp_path: Path) -> None:
    log = logged(tmp_path, [fix(T0, 45.0, 7.0, topic="/usbl/fix"), fix(T0, 46.0, 8.0)])

    assert log.origin is not None
    assert (log.origin.lat_deg, log.origin.lon_deg, log.origin.kind) == (45.0, 7.0, "first usbl fix")


def test_poses_of_latitudes_without_a_plane_are_an_error(tmp_path: Path) -> None:
    rows = [(T0, "/usbl", POSE, {"header.stamp": T0, "pose.position.x": 45.0009, "pose.position.y": 7.0})]
    with pytest.raises(LogError) as fault:
        logged(tmp_path, rows, '[usbl]\nkind = "latlon"')

    assert str(fault.value) == (
        f"{tmp_path / 'dive.mcap'}: /usbl holds latitudes and longitudes, but the plane has no origin; "
        "state origin_lat_deg and origin_lon_deg under [map]"
    )


def test_fixes_without_status_or_at_zero_zero_are_left_out(tmp_path: Path) -> None:
    topic, toml = "/usbl/fix", "[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0"
    rows = [fix(T0, 45, 7, topic=topic), fix(T0 + 1, 45, 7, -1, topic), fix(T0 + 2, 0, 0, 0, topic)]

    log = logged(tmp_path, rows, toml)

    assert len(log.tables["usbl"]) == 1
    assert codes(log)["USBL-INVALID"] == (
        "/usbl/fix: 2 of 3 records are invalid and left out "
        "(1 without fix (status below 0), 1 at latitude and longitude 0)"
    )


def test_a_kind_that_the_messages_cannot_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as fault:
        logged(tmp_path, [fix(T0, 45.0, 7.0, topic="/usbl/fix")], '[usbl]\nkind = "position"')

    assert str(fault.value) == (
        f'{tmp_path / "usbldr.toml"}: [usbl] kind = "position": '
        "/usbl/fix (sensor_msgs/msg/NavSatFix) can only be latlon"
    )


def test_a_map_whose_origin_is_not_stated_is_a_finding(tmp_path: Path) -> None:
    log = logged(tmp_path, [point(T0, 3.0, 4.0), fix(T0, 45.0, 7.0)])

    assert codes(log)["MAP-UNKNOWN"] == (
        "/usbl: the map origin is not stated: errors against a truth in latitudes are those that remain after a "
        "constant shift "
        "(state origin_lat_deg and origin_lon_deg under [map], or the position of the USBL transceiver ([usbl] head) "
        "if fixes are relative to it)"
    )


def test_bearing_is_clockwise_from_north_and_range_is_slant(tmp_path: Path) -> None:
    """30 m deep under a head at 2 m: 28 m below it; 100 m of slant range leave 96 m, half of them east at 30 deg."""
    horizontal = math.sqrt(100**2 - 28**2)
    depth = "time_ns,depth_m\n0,30.0\n10000000000,30.0"

    log = logged_csv(
        tmp_path, f"[usbl]\n{HEAD}", usbl="time_ns,slant_range_m,bearing_deg\n5000000000,100,30", depth=depth
    )

    assert place(log) == pytest.approx([100 + horizontal / 2, -50 + horizontal * math.sqrt(3) / 2])
    assert log.convention("usbl", "horizontal_range").value == "the vehicle's depth"


def test_depth_is_interpolated_to_the_time_of_the_fix(tmp_path: Path) -> None:
    depth = "time_ns,depth_m\n0,10.0\n10000000000,30.0"

    log = logged_csv(
        tmp_path, f"[usbl]\n{HEAD}", usbl="time_ns,slant_range_m,bearing_deg\n2500000000,100,90", depth=depth
    )

    assert place(log) == pytest.approx([100 + math.sqrt(100**2 - 13**2), -50])


def test_without_the_vehicles_depth_the_fix_itself_tells_how_steep_it_is(tmp_path: Path) -> None:
    own = "time_ns,slant_range_m,bearing_deg,depth_m,elevation_deg\n0,100,90,62,"
    steep = "time_ns,slant_range_m,bearing_deg,depth_m,elevation_deg\n0,100,90,,-60"
    bare = "time_ns,slant_range_m,bearing_deg\n0,100,90"

    assert place(logged_csv(tmp_path, f"[usbl]\n{HEAD}", usbl=own)) == pytest.approx([180, -50])
    assert place(logged_csv(tmp_path, f"[usbl]\n{HEAD}", usbl=steep)) == pytest.approx([150, -50])
    flat = logged_csv(tmp_path, f"[usbl]\n{HEAD}", usbl=bare)
    assert place(flat) == pytest.approx([200, -50])
    assert flat.convention("usbl", "horizontal_range").value == "nothing (taken as horizontal)"


def test_a_range_shorter_than_the_depth_below_the_head_is_straight_below_and_said(tmp_path: Path) -> None:
    log = logged_csv(tmp_path, f"[usbl]\n{HEAD}", usbl="time_ns,slant_range_m,bearing_deg,depth_m\n0,10,90,20")

    assert place(log) == [100, -50]
    assert codes(log)["USBL-SHORT"] == (
        "/usbl: 1 slant ranges are shorter than the depth below the head; placed straight below"
    )


def test_ranges_without_a_head_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(LogError) as fault:
        logged_csv(tmp_path, "", usbl="time_ns,slant_range_m,bearing_deg\n0,10,90")

    assert str(fault.value) == (
        f"{tmp_path / 'dive'}: /usbl holds ranges and bearings; state head = {{...}} under [usbl], "
        "or beacon = {...} if the vehicle carries the head"
    )


POLAR = f"[usbl]\n{HEAD}\nrange_sd_m = 0.3\nrange_sd_rel = 0.005\nbearing_sd_deg = 1.0"


@pytest.mark.parametrize("bearing_deg", [0, 30, 90, 200, 315])
def test_a_covariance_of_range_and_bearing_lies_across_the_line_of_sight(tmp_path: Path, bearing_deg: float) -> None:
    b = math.radians(bearing_deg)
    along = np.array([math.sin(b), math.cos(b)])
    across = np.array([math.cos(b), -math.sin(b)])

    log = logged(tmp_path, [point(T0, 200 * along[0], 200 * along[1])], POLAR)
    R = covariance(log)

    assert along @ R @ along == pytest.approx(0.3**2 + 1.0**2)
    assert across @ R @ across == pytest.approx((200 * math.pi / 180) ** 2)
    assert along @ R @ across == pytest.approx(0, abs=1e-9)


def test_range_noise_grows_with_the_slant_range(tmp_path: Path) -> None:
    """3-4-5: 30 m north, 40 m below the head are 50 m."""
    R = covariance(logged(tmp_path, [point(T0, 0.0, 30.0, -40.0)], POLAR))

    assert R[1, 1] == pytest.approx(0.3**2 + (0.005 * 50) ** 2)
    assert R[0, 0] == pytest.approx((50 * math.pi / 180) ** 2)


def test_no_fix_is_trusted_to_better_than_15_centimetres(tmp_path: Path) -> None:
    polar = POLAR.replace("0.3", "0.01").replace("0.005", "0.0")
    stated = logged(tmp_path, [point(T0, 3.0, 4.0)], "[usbl]\nsd_m = 0.01")

    near = logged(tmp_path, [point(T0, 0.0, 50.0)], polar)

    np.testing.assert_allclose(covariance(stated), np.eye(2) * 0.15**2)
    np.testing.assert_allclose(covariance(near), np.diag([(50 * math.pi / 180) ** 2, 0.15**2]), atol=1e-12)


def with_covariance(xx: float, xy: float, yy: float) -> Row:
    cov = np.zeros(36)
    cov[0], cov[1], cov[6], cov[7] = xx, xy, xy, yy
    return T0, "/usbl", POSE_COVARIANCE, {"header.stamp": T0, "pose.covariance": cov}


def test_the_covariance_of_a_message_turns_with_its_frame(tmp_path: Path) -> None:
    rows = [with_covariance(4.0, 0.5, 9.0)]

    enu, ned = logged(tmp_path, rows), logged(tmp_path, rows, '[usbl]\nframe = "NED"\nsd_m = "message"')

    np.testing.assert_allclose(covariance(enu), [[4.0, 0.5], [0.5, 9.0]])
    np.testing.assert_allclose(covariance(ned), [[9.0, 0.5], [0.5, 4.0]])
    assert enu.provenance["usbl"].conventions[-2] == Convention("covariance", "of the messages", "default")


def test_the_covariance_of_latitudes_is_east_before_north_as_their_type_has_it(tmp_path: Path) -> None:
    time_ns, topic, kind, values = fix(T0, 45.0, 7.0, topic="/usbl/fix")
    stated = {"position_covariance": np.array([4.0, 0.5, 0, 0.5, 9.0, 0, 0, 0, 1]), "position_covariance_type": 3}

    log = logged(
        tmp_path,
        [(time_ns, topic, kind, {**values, **stated})],
        "[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0",
    )

    np.testing.assert_allclose(covariance(log), [[4.0, 0.5], [0.5, 9.0]])


def test_a_number_in_the_configuration_beats_the_message(tmp_path: Path) -> None:
    log = logged(tmp_path, [with_covariance(4.0, 0.5, 9.0)], "[usbl]\nsd_m = 0.7")

    np.testing.assert_allclose(covariance(log), np.eye(2) * 0.49)


def test_without_any_word_the_noise_is_two_per_cent_of_the_range_and_at_least_a_metre(tmp_path: Path) -> None:
    near = logged(tmp_path, [point(T0, 3.0, 4.0)], f"[usbl]\n{HEAD}")
    far = logged(tmp_path, [point(T0, 300.0, 400.0)], f"[usbl]\n{HEAD}")
    anywhere = logged(tmp_path, [point(T0, 300.0, 400.0)])

    np.testing.assert_allclose(covariance(near), np.eye(2))
    np.testing.assert_allclose(covariance(far), np.eye(2) * 10.0**2)
    np.testing.assert_allclose(covariance(anywhere), np.eye(2))
    assert Convention("sd_rel", 2.0, "default", "%") in far.provenance["usbl"].conventions
    assert Convention("min_sd_m", 1.0, "default", "m") in far.provenance["usbl"].conventions
    assert Convention("sd_m", 1.0, "default", "m") in anywhere.provenance["usbl"].conventions


def test_the_columns_of_a_csv_folder_state_the_noise(tmp_path: Path) -> None:
    full = logged_csv(tmp_path, "", usbl="time_ns,east_m,north_m,cov_ee_m2,cov_en_m2,cov_nn_m2\n0,1,2,4,1,3")
    single = logged_csv(tmp_path, "", usbl="time_ns,east_m,north_m,sd_m\n0,1,2,0.5")

    np.testing.assert_allclose(covariance(full), [[4, 1], [1, 3]])
    np.testing.assert_allclose(covariance(single), np.eye(2) * 0.25)


def test_latency_makes_a_fix_older_and_its_arrival_stays(tmp_path: Path) -> None:
    rows = [point(T0 + k * SECOND, 1.0, 2.0, delay_s=0.5) for k in range(2)]

    log = logged(tmp_path, rows, "[usbl]\nlatency_s = 0.2")
    early = logged(tmp_path, rows, "[usbl]\nlatency_s = -1.5")

    np.testing.assert_allclose(log.tables["usbl"]["time_s"], [-0.2, 0.8])
    np.testing.assert_allclose(log.tables["usbl"]["received_s"], [0.5, 1.5])
    np.testing.assert_allclose(early.tables["usbl"]["time_s"], [1.5, 2.5])
    np.testing.assert_allclose(early.tables["usbl"]["received_s"], [1.5, 2.5])


def test_log_time_may_be_asked_for(tmp_path: Path) -> None:
    log = logged(tmp_path, [point(T0 + k * SECOND, 1.0, 2.0, delay_s=0.5) for k in range(2)], '[usbl]\ntime = "log"')

    assert log.start_ns == T0 + SECOND // 2
    np.testing.assert_allclose(log.tables["usbl"]["time_s"], [0, 1])


def test_surface_gps_of_a_fix_topic_is_told_from_the_usbl_by_name(tmp_path: Path) -> None:
    toml = "[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0"

    log = logged(tmp_path, [fix(T0, 45.0, 7.0, topic="/usbl/fix"), fix(T0, 45.1, 7.0, topic="/gps/fix")], toml)

    assert log.provenance["usbl"].topic == "/usbl/fix"
    assert log.provenance["gps"].topic == "/gps/fix"
    assert log.provenance["gps"].type == FIX


def test_pressure_gives_the_depth_that_slant_ranges_need(tmp_path: Path) -> None:
    pressure = 101325 + 1025 * 9.80665 * 30
    rows = [
        *((T0 + k, "/pressure", PRESSURE, {"header.stamp": T0 + k, "fluid_pressure": pressure}) for k in (0, 2)),
        point(T0 + 1, 0.0, 30.0, math.nan),
    ]

    R = covariance(logged(tmp_path, rows, POLAR))

    assert R[0, 0] == pytest.approx((math.hypot(30, 28) * math.pi / 180) ** 2)


@pytest.mark.parametrize("origin", ["", "[map]\norigin_lat_deg = 45.0\norigin_lon_deg = 7.0\n"])
def test_fixes_that_are_no_numbers_are_all_counted_and_are_the_reason(tmp_path: Path, origin: str) -> None:
    rows = [fix(T0 + k * SECOND, float("nan"), float("nan"), topic="/usbl/fix") for k in range(15)]

    with pytest.raises(LogError, match=r"all 15 records of /usbl/fix \(.*\) are invalid: 15 not a number"):
        logged(tmp_path, rows, origin)
