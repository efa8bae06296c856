"""USBL heads on ships and on vehicles: geometry worked out by hand, a ship's way by pymap3d itself."""

import math
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from logs import MAP, codes, covariance, logged, logged_csv, places, read_as
from recordings import HEADING, IMU, SECOND, T0, Row, fix, point, record, short_dive, yaw
from textbook import radii_m
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.replay.dead_reckoning import freed
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request
from usbldr.io.reading.survey import survey


def ship(time_ns: int, east_m: float, north_m: float) -> Row:
    lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, 45.0, 7.0, 0.0)
    return fix(time_ns, float(lat), float(lon), topic="/ship/fix")


def gyro(time_ns: int, heading_deg: float) -> Row:
    return time_ns, "/ship/heading", HEADING, {"data": heading_deg}


ON_SHIP = f'{MAP}[usbl]\nhead = {{ topic = "/ship/fix", heading_topic = "/ship/heading", sd_m = 0.0%s }}\n'

FROM_SHIP = f'{MAP}[usbl]\nhead = {{ topic = "/ship/fix" }}\n'
BOW = 'frame = "body"\naxes = "FSD"\n'
BY_IMU = MAP + "[usbl]\n" + BOW + 'head = {{ topic = "/ship/fix", heading_topic = "/ship/imu"{} }}\n'
EASTWARD = [ship(T0 + k * SECOND, 10.0 * k, 5.0) for k in range(4)]
SHIP_IMU = record("/ship/imu", IMU, {"orientation.w": 1.0})
ROLLED = {"orientation.x": math.sin(math.pi / 12), "orientation.w": math.cos(math.pi / 12)}
ROLLED_IMU = record("/ship/imu", IMU, ROLLED)
SOUND = "[usbl]\nsound_speed_scale = 0.98\nhead = { east_m = 100.0, north_m = 0.0 }\n"


def anchored(east_m: float, heading_deg: float) -> list[Row]:
    return [row for k in range(3) for row in (ship(T0 + k * SECOND, east_m, 0), gyro(T0 + k * SECOND, heading_deg))]


@pytest.mark.parametrize(
    ("rows", "toml", "east_north_m"),
    [
        # the ship is where it was when the fix was true: at 10 m/s half a second after the first second
        ([*EASTWARD, point(T0 + SECOND * 3 // 2, 3.0, 4.0)], FROM_SHIP, [15 + 3, 5 + 4]),
        ([*EASTWARD, point(T0 + 2 * SECOND, 0.0, 0.0, delay_s=0.9)], f"{FROM_SHIP}latency_s = 0.5", [15, 5]),
        # heading east, forward is east and starboard is south
        ([*anchored(0, 90), point(T0 + SECOND, 30.0, 4.0)], ON_SHIP % "" + BOW, [30, -4]),
        # a heading that passes north is interpolated the short way
        ([ship(T0, 0, 0), ship(T0 + 2 * SECOND, 0, 0), gyro(T0, 358.0), gyro(T0 + 2 * SECOND, 2.0),
          point(T0 + SECOND, 100.0, 0.0)], ON_SHIP % "" + BOW, [0, 100]),
        # the head hangs 2 m to starboard and 10 m ahead of the antenna; heading 270, ahead is west, starboard is north
        ([*anchored(50, 270), point(T0 + SECOND, 7.0, 8.0)], ON_SHIP % ", lever_arm_m = [2.0, 10.0, -3.0]",
         [50 - 10 + 7, 2 + 8]),
        # mounted 30 deg clockwise: dead ahead of the instrument is 30 deg to starboard of the bow, and the bow is north
        ([point(T0, 100.0, 0.0)], f"[usbl]\n{BOW}mount_deg = 30\nhead = {{ east_m = 0, north_m = 0, heading_deg = 0 }}",
         [50, 100 * math.cos(math.pi / 6)]),
        # rolled by 30 deg to starboard, heading east: the head, 8 m below the antenna, hangs to port, which is north
        ([ship(T0, 0, 0), ROLLED_IMU, point(T0, 10.0, 0.0)],
         MAP + '[usbl]\nhead = { topic = "/ship/fix", heading_topic = "/ship/imu", lever_arm_m = [0.0, 0.0, -8.0] }\n',
         [10, 4]),
        # an Imu on the ship counts from east unless stated
        ([ship(T0, 0, 0), SHIP_IMU, point(T0, 10.0, 0.0)], BY_IMU.format(""), [10, 0]),
        ([ship(T0, 0, 0), SHIP_IMU, point(T0, 10.0, 0.0)],
         BY_IMU.format(', heading_convention = "NED", heading_bias_deg = 90.0'), [-10, 0]),
        # heading east, the beacon at (100, 50) is 20 m ahead and 5 m to starboard of the vehicle that carries the head
        ([*(yaw(T0 + k * SECOND, 0.0) for k in range(3)), point(T0 + SECOND, 20.0, 5.0)],
         f"[usbl]\n{BOW}beacon = {{ east_m = 100.0, north_m = 50.0, depth_m = 10.0 }}", [100 - 20, 50 + 5]),
        # offsets scale with the speed of sound, places do not
        ([point(T0, 50.0, 20.0)], SOUND, [149, 19.6]),
        ([point(T0, 50.0, 20.0)], SOUND + 'relative_to = "map"', [50, 20]),
    ],
)  # fmt: skip
def test_a_fix_from_a_head_lies_where_the_head_was_and_turns_with_its_bow(tmp_path, rows, toml, east_north_m):
    log = logged(tmp_path, rows, toml)

    assert places(log)[0] == pytest.approx(east_north_m, abs=1e-3)
    assert ("sound_speed_scale" in codes(log).get("KEY-UNUSED", "")) == ("relative_to" in toml)
    stated = {(said.key, said.chosen_by) for said in log.provenance["usbl"].conventions}
    assert (("axes", "configuration") in stated) == (BOW in toml)


@pytest.mark.parametrize("missing", ["position", "heading"])
def test_fixes_inside_a_gap_of_the_ship_are_refused(tmp_path: Path, missing: str) -> None:
    seconds = {"position": range(20), "heading": range(20)} | {missing: [*range(5), *range(15, 20)]}
    rows = [ship(T0 + k * SECOND, 0.0, 0.0) for k in seconds["position"]]
    rows += [gyro(T0 + k * SECOND, 0.0) for k in seconds["heading"]]
    rows += [point(T0 + k * SECOND, 1.0, 2.0) for k in (2, 4, 9, 15, 25)]

    log = logged(tmp_path, rows, ON_SHIP % "" + BOW)

    assert log.tables["usbl"]["time_s"].tolist() == [0, 2, 13]
    assert "2 of 5 records are invalid" in codes(log)["USBL-INVALID"]
    assert "without the ship's position within 3 s" in codes(log)["USBL-INVALID"]


def test_the_ships_receiver_is_no_truth_of_the_vehicle(tmp_path: Path) -> None:
    rows = [*short_dive(), *(ship(T0 + k * SECOND, 0.0, 0.0) for k in range(11))]

    log = logged(tmp_path, rows, FROM_SHIP)

    assert "gps" not in log.tables
    assert log.truth is None
    assert "gps" not in survey(tmp_path / "dive.mcap", Request()).roles
    with pytest.raises(UsageError, match="/ship/fix cannot be the ship and the truth at once"):
        logged(tmp_path, rows, f'{FROM_SHIP}[gps]\ntopic = "/ship/fix"')


def test_what_would_mend_a_ships_heading_is_a_key_of_the_head(tmp_path: Path) -> None:
    seconds = [T0 + k * SECOND for k in range(4)]
    rows = [ship(t, 0.0, 0.0) for t in seconds] + [point(T0 + SECOND, 3.0, 4.0)]
    rows += [(t, "/ship/hdm", HEADING, {"data": 3.0}) for t in seconds]

    log = logged(tmp_path, sorted(rows, key=lambda row: row[0]), ON_SHIP.replace("/ship/heading", "/ship/hdm") % "")

    assert "state heading_declination_deg in head of [usbl]" in codes(log)["HEADING-MAGNETIC"]
    assert "[compass]" not in codes(log)["HEADING-UNIT"]


def test_heading_noise_of_a_fix_agrees_with_drawn_headings(tmp_path: Path) -> None:
    """Draws of the heading turn lever arm and offset together; sensor and ship's receiver add 0.2 m and 0.5 m."""
    rng = np.random.default_rng(0)
    headings = np.radians(40.0 + 0.5 * rng.standard_normal(20_000))
    starboard, forward = 30.0 + 2.0, 80.0 + 10.0
    east = starboard * np.cos(headings) + forward * np.sin(headings)
    north = forward * np.cos(headings) - starboard * np.sin(headings)
    rows = [ship(T0, 0.0, 0.0), gyro(T0, 40.0), point(T0, 80.0, 30.0)]
    toml = (ON_SHIP % ", lever_arm_m = [2.0, 10.0, 0.0]").replace("sd_m = 0.0", "sd_m = 0.5")

    log = logged(tmp_path, rows, f"{toml}{BOW}sd_m = 0.2\nheading_sd_deg = 0.5")

    of_heading = covariance(log) - np.eye(2) * (0.2**2 + 0.5**2)
    np.testing.assert_allclose(of_heading, np.cov(east, north), rtol=0.03, atol=0.01)
    np.testing.assert_allclose(places(log)[0], [east.mean(), north.mean()], atol=0.05)


def test_inverted_fixes_need_the_heading_of_the_vehicle_near_their_time(tmp_path: Path) -> None:
    rows = [yaw(T0, 0.0), yaw(T0 + 10 * SECOND, 0.0), *(point(T0 + k * SECOND, 20.0, 0.0) for k in (0, 5))]

    log = logged(tmp_path, rows, f"[usbl]\n{BOW}beacon = {{ east_m = 0.0, north_m = 0.0 }}")

    assert len(log.tables["usbl"]) == 1
    assert "1 without a heading at their time" in codes(log)["USBL-INVALID"]


def test_a_range_and_bearing_of_a_beacon_from_the_vehicles_bow(tmp_path: Path) -> None:
    """3-4-5: 50 m of slant range to a beacon 40 m below leave 30 m; heading 60, bearing 30: due east of the vehicle."""
    log = logged_csv(
        tmp_path,
        '[usbl]\nframe = "body"\nbeacon = { east_m = 0.0, north_m = 0.0, depth_m = 45.0 }',
        usbl="time_ns,slant_range_m,bearing_deg\n1000000000,50,30",
        compass="time_ns,heading_deg\n0,60\n2000000000,60",
        depth="time_ns,depth_m\n0,5.0\n2000000000,5.0",
    )

    assert places(log)[0] == pytest.approx([-30, 0], abs=1e-9)


def test_a_range_that_is_too_long_is_the_same_error_before_and_after_the_depth_is_taken_off(tmp_path: Path) -> None:
    log = logged_csv(
        tmp_path,
        "[usbl]\nhead = { east_m = 10.0, north_m = 0.0 }",
        usbl="time_ns,slant_range_m,bearing_deg\n0,100,90\n1000000000,100,90",
        depth="time_ns,depth_m\n0,57.6\n2000000000,57.6",
        compass="time_ns,heading_deg\n0,60\n2000000000,60",
        dvl="time_ns,starboard_mps,forward_mps\n0,0,1\n2000000000,0,1",
    )

    line = timeline(log)
    scaled = "[usbl]\nsound_speed_scale = 0.96\nhead = { east_m = 10.0, north_m = 0.0 }"

    assert places(read_as(tmp_path / "dive", scaled))[0] == pytest.approx([10 + 76.8, 0])  # 96 m, 57.6 m below the head
    assert line.fix_away_m[0] == pytest.approx([(100**2 - 57.6**2) ** 0.5, 0])
    assert freed(line, {"usbl_range": 1 / 0.96 - 1}).fix_m[0] == pytest.approx([10 + 76.8, 0])


@pytest.mark.parametrize("turnaround_s", [0.0, 0.5])
def test_a_reply_is_of_where_the_vehicle_was_and_its_range_of_both_ways(tmp_path: Path, turnaround_s: float) -> None:
    """A ship sails east at 5 m/s past a vehicle at rest, 900 m away; sound does 1500 m/s there and back."""
    vehicle, hears_s = np.array([700.0, 800.0]), 4.0
    heard_m = np.array([5 * hears_s, 0.0])
    back_m = float(np.hypot(*(vehicle - heard_m)))

    def asked_m(way_m: float) -> float:
        sent_m = heard_m - [5 * ((way_m + back_m) / 1500 + turnaround_s), 0]
        return float(np.hypot(*(vehicle - sent_m)))

    out_m = back_m
    for _ in range(20):
        out_m = asked_m(out_m)
    measured_m = (vehicle - heard_m) * (out_m + back_m) / 2 / back_m
    rows = [ship(T0 + k * SECOND, 5.0 * k, 0.0) for k in range(8)]
    rows.append(point(T0 + round(hears_s * SECOND), *measured_m.tolist()))
    stated = f'stamped_at = "reply"\nturnaround_s = {turnaround_s}\nhead = {{ topic = "/ship/fix" }}'

    log = logged(tmp_path, rows, f"{MAP}[usbl]\n{stated}")

    assert places(log)[0] == pytest.approx(vehicle, abs=0.03)  # the line of sight turns by 0.5 degrees
    time_s = (log.start_ns - T0) / 1e9 + log.tables["usbl"]["time_s"][0]
    assert time_s == pytest.approx(hears_s - back_m / 1500, abs=0.005)


@pytest.mark.parametrize(
    ("usbl", "sentence"),
    [
        ('frame = "body"\nbeacon = { east_m = 0.0, north_m = 0.0 }', "the vehicle has no compass"),
        ('frame = "body"\nhead = { east_m = 0.0, north_m = 0.0 }', "state heading_topic or heading_deg in head"),
        ('head = { heading_topic = "/gyro" }', "state either lat_deg and lon_deg or east_m and north_m"),
        ('head = { topic = "/ship", lever_arm_m = [1.0, 0.0, 0.0] }', "state heading_topic or heading_deg"),
        ("beacon = { lat_deg = 45.0 }", "state either lat_deg and lon_deg or east_m and north_m"),
        ("beacon = { east_m = 0.0, north_m = 0.0 }\nhead = { east_m = 0.0, north_m = 0.0 }", "state either head"),
    ],
)
def test_a_head_that_makes_no_sense_is_refused(tmp_path: Path, usbl: str, sentence: str) -> None:
    with pytest.raises((UsageError, LogError), match=sentence):
        logged(tmp_path, [point(T0, 1.0, 2.0)], f"[usbl]\n{usbl}")


def test_an_offset_from_a_moving_ship_that_is_sent_again_is_one_fix(tmp_path: Path) -> None:
    rows = [ship(T0 + k * SECOND, 0.0, 2.0 * k) for k in range(61)]
    offsets = np.random.default_rng(8).normal(20, 1, (20, 2))
    fixes = [point(T0 + k * SECOND, *offsets[k // 3]) for k in range(60)]

    log = logged(tmp_path, [*rows, *fixes], FROM_SHIP)

    assert log.tables["usbl"]["time_s"].tolist() == list(range(0, 60, 3))
    assert codes(log)["USBL-REPEATED"].startswith("/usbl: 40 of 60 fixes repeat the previous one")


@pytest.mark.parametrize("bow", [False, True])
def test_offsets_from_a_ship_count_from_true_north_where_the_ship_is(tmp_path: Path, bow: bool) -> None:
    """Half a kilometre north of a ship that is 20 km east of the origin lies on the ship's own meridian."""
    ship_lat, ship_lon, _ = pymap3d.enu2geodetic(20e3, 0.0, 0.0, 70.0, 7.0, 0.0)
    north_m = 500.0
    lat = ship_lat + math.degrees(north_m / radii_m(ship_lat)[0])
    expected = pymap3d.geodetic2enu(lat, ship_lon, 0.0, 70.0, 7.0, 0.0)[:2]
    rows = [fix(T0 + k * SECOND, ship_lat, ship_lon, topic="/ship/fix") for k in range(3)]
    rows += [gyro(T0 + k * SECOND, 0.0) for k in range(3)]
    toml = "[map]\norigin_lat_deg = 70.0\norigin_lon_deg = 7.0\n" + ON_SHIP.removeprefix(MAP) % ""
    toml += 'frame = "body"\naxes = "SFU"' if bow else ""

    log = logged(tmp_path, [*rows, point(T0 + SECOND, 0.0, north_m)], toml)

    assert places(log)[0] == pytest.approx(expected, abs=0.02)  # 4.3 m without
    assert log.provenance["usbl"].geodetic
