"""USBL fixes of every kind against positions worked out by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from logs import MAP, codes, covariance, logged, logged_csv, places
from recordings import FIX, POSE, POSE_COVARIANCE, SECOND, T0, Row, fix, point, pressure, record
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.provenance import Convention

HEAD = "head = { east_m = 100.0, north_m = -50.0, depth_m = 2.0 }"

PLACES = "time_ns,slant_range_m,bearing_deg"
POINT, LATITUDE = point(T0, 3.0, 4.0), fix(T0, 45.0009, 7.0, topic="/usbl/fix")
POSE_OF_DEGREES = T0, "/usbl", POSE, {"header.stamp": T0, "pose.position.x": 45.0009, "pose.position.y": 7.0}
NORTH_M = 0.0009 * 111132


@pytest.mark.parametrize(
    ("row", "toml", "east_north_m"),
    [
        (POINT, "", [3, 4]),
        (POINT, '[usbl]\nframe = "ENU"', [3, 4]),
        (POINT, '[usbl]\nframe = "NED"', [4, 3]),
        (POINT, f"[usbl]\n{HEAD}", [103, -46]),
        (POINT, f'[usbl]\nrelative_to = "head"\n{HEAD}', [103, -46]),
        (POINT, f'[usbl]\nrelative_to = "map"\n{HEAD}', [3, 4]),
        (LATITUDE, MAP, [0, NORTH_M]),
        (POSE_OF_DEGREES, MAP + '[usbl]\nkind = "latlon"', [0, NORTH_M]),
    ],
)
def test_a_fix_lies_where_frame_or_head_put_it(tmp_path: Path, row: Row, toml: str, east_north_m: list[float]) -> None:
    log = logged(tmp_path, [row], toml)

    assert places(log)[0] == pytest.approx(east_north_m, abs=0.1 if "map" in toml else 1e-9)
    assert ("away_east_m" in log.tables["usbl"]) == ("head" in toml)  # whose errors are then those of the fixes


DEEP = "time_ns,depth_m\n0,10.0\n10000000000,50.0"
OWN = f"{PLACES},depth_m,elevation_deg"


@pytest.mark.parametrize(
    ("fix", "depth", "east_north_m", "by"),
    [
        # the head is 2 m deep: 100 m of slant range to 28 m below it leave 96 m, half of them east at 30 deg
        (f"{PLACES}\n5000000000,100,30", DEEP, [148, -50 + 96 * math.cos(math.pi / 6)], "the vehicle's depth"),
        (f"{PLACES}\n2500000000,100,90", DEEP, [100 + math.sqrt(100**2 - 18**2), -50], "the vehicle's depth"),
        (f"{PLACES}\n14900000000,100,90", DEEP, [100 + math.sqrt(100**2 - 48**2), -50], "the vehicle's depth"),
        (f"{PLACES}\n15100000000,100,90", DEEP, [200, -50], "nothing (taken as horizontal)"),
        (f"{OWN}\n0,100,90,62,", None, [180, -50], "the fix's depth"),
        (f"{OWN}\n0,100,90,,-60", None, [150, -50], "the fix's elevation"),
        (f"{PLACES}\n0,100,90", None, [200, -50], "nothing (taken as horizontal)"),
        (f"{PLACES},depth_m\n0,10,90,20", None, [100, -50], "the fix's depth"),  # too short for its depth
    ],
)
def test_a_bearing_is_clockwise_from_north_and_a_slant_range_as_steep_as_what_is_known_best(
    tmp_path: Path, fix: str, depth: str | None, east_north_m: list[float], by: str
) -> None:
    """The depth of the vehicle at the time of the fix, or else the fix's depth or elevation."""
    log = logged_csv(tmp_path, f"[usbl]\n{HEAD}", usbl=fix, **({"depth": depth} if depth else {}))

    assert places(log)[0] == pytest.approx(east_north_m)
    assert log.convention("usbl", "horizontal_range").value == by
    said = "/usbl: 1 slant ranges are shorter than the depth below the head; placed straight below"
    assert codes(log).get("USBL-SHORT") == (said if "0,10,90,20" in fix else None)


def test_a_head_by_latitude_is_the_origin_unless_there_is_a_map(tmp_path: Path) -> None:
    rows = [point(T0, 3.0, 4.0)]
    head = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }"
    north_of_it = "[map]\norigin_lat_deg = 44.9991\norigin_lon_deg = 7.0\n"

    alone, on_map = logged(tmp_path, rows, head), logged(tmp_path, rows, north_of_it + head)

    assert places(alone)[0] == pytest.approx([3.0, 4.0], abs=1e-6)
    assert (alone.origin.lat_deg, alone.origin.kind) == (45.0, "usbl head")
    assert places(on_map)[0] == pytest.approx([3.0, 4.0 + 0.0009 * 111132], abs=0.1)


def test_latitudes_of_the_usbl_are_told_from_those_of_the_gps_by_name_and_place_the_origin(tmp_path: Path) -> None:
    log = logged(tmp_path, [fix(T0, 45.0, 7.0, topic="/usbl/fix"), fix(T0, 46.0, 8.0)])

    assert {role: p.topic for role, p in log.provenance.items()} == {"usbl": "/usbl/fix", "gps": "/gps/fix"}
    assert log.provenance["gps"].type == FIX
    assert (log.origin.lat_deg, log.origin.lon_deg, log.origin.kind) == (45.0, 7.0, "first usbl fix")


@pytest.mark.parametrize(
    ("row", "toml", "fault", "said"),
    [
        (POSE_OF_DEGREES, '[usbl]\nkind = "latlon"', LogError, "{folder}/dive.mcap: /usbl holds latitudes and "
         "longitudes, but the plane has no origin; state origin_lat_deg and origin_lon_deg under [map]"),
        (LATITUDE, '[usbl]\nkind = "position"', UsageError, '{folder}/usbldr.toml: [usbl] kind = "position": '
         "/usbl/fix (sensor_msgs/msg/NavSatFix) can only be latlon"),
        (None, "", LogError, "{folder}/dive: /usbl holds ranges and bearings; state head = {{...}} under [usbl], "
         "or beacon = {{...}} if the vehicle carries the head"),
    ],
)  # fmt: skip
def test_a_fix_that_cannot_be_placed_is_one_sentence(tmp_path, row, toml, fault, said):
    with pytest.raises(fault) as found:
        logged(tmp_path, [row], toml) if row else logged_csv(tmp_path, toml, usbl=f"{PLACES}\n0,10,90")

    assert str(found.value) == said.format(folder=tmp_path)


POLAR = f"[usbl]\n{HEAD}\nrange_sd_m = 0.3\nrange_sd_rel = 0.005\nbearing_sd_deg = 1.0"


@pytest.mark.parametrize("bearing_deg", [0, 30, 90, 200, 315])
def test_a_covariance_of_range_and_bearing_lies_across_the_line_of_sight(tmp_path: Path, bearing_deg: float) -> None:
    b = math.radians(bearing_deg)
    along = np.array([math.sin(b), math.cos(b)])
    across = np.array([math.cos(b), -math.sin(b)])

    R = covariance(logged(tmp_path, [point(T0, 200 * along[0], 200 * along[1])], POLAR))

    assert along @ R @ along == pytest.approx(0.3**2 + 1.0**2)
    assert across @ R @ across == pytest.approx((200 * math.pi / 180) ** 2)
    assert along @ R @ across == pytest.approx(0, abs=1e-9)


def with_covariance(xx: float, xy: float, yy: float, k: int = 0) -> Row:
    cov = np.zeros(36)
    cov[[0, 1, 6, 7]] = xx, xy, xy, yy
    return record("/usbl", POSE_COVARIANCE, {"pose.pose.position.x": 10.0 * k, "pose.covariance": cov}, k)


WITH_COVARIANCE = with_covariance(4.0, 0.5, 9.0)
OF_LATITUDES = (*LATITUDE[:3], dict(LATITUDE[3]) | {"position_covariance_type": 3,
                "position_covariance": np.array([4.0, 0.5, 0, 0.5, 9.0, 0, 0, 0, 1])})  # fmt: skip
PER_DEG = math.pi / 180


@pytest.mark.parametrize(
    ("row", "toml", "ee", "en", "nn"),
    [
        (WITH_COVARIANCE, "", 4.0, 0.5, 9.0),
        (WITH_COVARIANCE, '[usbl]\nframe = "NED"\nsd_m = "message"', 9.0, 0.5, 4.0),
        (WITH_COVARIANCE, "[usbl]\nsd_m = 0.7", 0.49, 0, 0.49),
        (OF_LATITUDES, MAP, 4.0, 0.5, 9.0),  # east before north, as their type has it
        (point(T0, 0.0, 30.0, -40.0), POLAR, (50 * PER_DEG) ** 2, 0, 0.3**2 + 0.25**2),  # 3-4-5: 50 m of slant range
        (POINT, "[usbl]\nsd_m = 0.01", 0.15**2, 0, 0.15**2),  # no fix is trusted to better than 15 cm
        (point(T0, 0.0, 50.0), POLAR.replace("0.3", "0.01").replace("0.005", "0.0"), (50 * PER_DEG) ** 2, 0, 0.15**2),
        (POINT, f"[usbl]\n{HEAD}", 1, 0, 1),
        ("cov_ee_m2,cov_en_m2,cov_nn_m2\n0,1,2,4,1,3", "", 4, 1, 3),
        ("sd_m\n0,1,2,0.5", "", 0.25, 0, 0.25),
    ],
)
def test_the_noise_of_a_fix_is_that_of_the_configuration_or_else_of_the_record(tmp_path, row, toml, ee, en, nn):
    of_csv = isinstance(row, str)
    log = logged_csv(tmp_path, toml, usbl=f"time_ns,east_m,north_m,{row}") if of_csv else logged(tmp_path, [row], toml)

    np.testing.assert_allclose(covariance(log), [[ee, en], [en, nn]], atol=1e-12)


NEGATIVE = "1 of 2 records are invalid and left out (1 of negative variance)"
INDEFINITE = "1 of 2 covariances are negative or not positive semidefinite"


@pytest.mark.parametrize(
    ("matrix", "second", "east_m", "said"),
    [
        ((-1.0, 0.0, 1.0), (4.0, 1.0, 9.0), [10], NEGATIVE),
        ((-4.0, 0.0, -4.0), (4.0, 1.0, 9.0), [10], NEGATIVE),
        ((1.0, 2.0, 1.0), (4.0, 1.0, 9.0), [0, 10], INDEFINITE),  # counts as unknown
        *((flat, flat, [0, 10], "") for flat in ((-1.0, 0.0, -1.0), (0.0, 0.0, 0.0), (1.0, 3.0, 9.0))),
    ],
)
def test_a_fix_of_negative_variance_is_left_out_and_no_unknown_flat_or_impossible_covariance(
    tmp_path, matrix, second, east_m, said
):
    log = logged(tmp_path, [with_covariance(*matrix), with_covariance(*second, k=1)])

    assert places(log).tolist() == [[east, 0] for east in east_m]
    assert said in codes(log).get("USBL-INVALID", "") + codes(log).get("COVARIANCE-INVALID", "")
    assert said or "COVARIANCE-INVALID" not in codes(log)
    if said == INDEFINITE:
        assert covariance(log) == pytest.approx(np.eye(2))  # the sigma of a fix that states none is 1 m


def test_without_any_word_the_noise_is_two_per_cent_of_the_range_and_at_least_a_metre(tmp_path: Path) -> None:
    far = logged(tmp_path, [point(T0, 300.0, 400.0)], f"[usbl]\n{HEAD}")
    anywhere = logged(tmp_path, [point(T0, 300.0, 400.0)])

    np.testing.assert_allclose(covariance(far), np.eye(2) * 10.0**2)
    np.testing.assert_allclose(covariance(anywhere), np.eye(2))
    said = {Convention("sd_rel", 2.0, "default", "%"), Convention("min_sd_m", 1.0, "default", "m")}
    assert said <= {*far.provenance["usbl"].conventions}
    assert Convention("sd_m", 1.0, "default", "m") in anywhere.provenance["usbl"].conventions
    stated = logged(tmp_path, [WITH_COVARIANCE]).provenance["usbl"].conventions
    assert stated[-2] == Convention("covariance", "of the messages", "default")


@pytest.mark.parametrize(
    ("key", "start_s", "time_s", "received_s"),
    [("latency_s = 0.2", 0, -0.2, 0.5), ("latency_s = -1.5", 0, 1.5, 1.5), ('time = "log"', 0.5, 0, 0)],
)
def test_a_fix_is_older_by_its_latency_and_its_arrival_stays_or_is_its_time(tmp_path, key, start_s, time_s, received_s):
    rows = [point(T0 + k * SECOND, 1.0, 2.0, delay_s=0.5) for k in range(2)]

    log = logged(tmp_path, rows, f"[usbl]\n{key}")

    assert log.start_ns == T0 + round(start_s * SECOND)
    np.testing.assert_allclose(log.tables["usbl"]["time_s"], [time_s, time_s + 1])
    np.testing.assert_allclose(log.tables["usbl"]["received_s"], [received_s, received_s + 1])


def test_pressure_gives_the_depth_that_slant_ranges_need(tmp_path: Path) -> None:
    rows = [pressure(T0 + k, 101325 + 1025 * 9.80665 * 30) for k in (0, 2)]

    R = covariance(logged(tmp_path, [*rows, point(T0 + 1, 0.0, 30.0, math.nan)], POLAR))

    assert R[0, 0] == pytest.approx((math.hypot(30, 28) * math.pi / 180) ** 2)


@pytest.mark.parametrize("origin", ["", MAP])
def test_fixes_that_are_no_numbers_are_all_counted_and_are_the_reason(tmp_path: Path, origin: str) -> None:
    rows = [fix(T0 + k * SECOND, float("nan"), float("nan"), topic="/usbl/fix") for k in range(15)]

    with pytest.raises(LogError, match=r"all 15 records of /usbl/fix \(.*\) are invalid: 15 not a number"):
        logged(tmp_path, rows, origin)
