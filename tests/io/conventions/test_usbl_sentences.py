"""Sentences of acoustic positioning systems that a few makers alone send, by their manuals' and drivers' examples."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs import HEAD, logged_csv, logged_nmea, on_map, only, places, refusal
from recordings import sentence
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.log import Log

LAKE = "[map]\norigin_lat_deg = 44.986266\norigin_lon_deg = -93.5761859\n"
METRES_A_DEGREE = 111132.95 - 559.85 * math.cos(2 * math.radians(44.986))  # of latitude there, by the usual series


def logged(tmp_path: Path, *bodies: str, toml: str = HEAD) -> Log:
    lines = [f"{1600000000 + k} {sentence(body)}" for k, body in enumerate(bodies)]
    return logged_nmea(tmp_path, *lines, toml=toml)


LOCATOR = (
    "USRTH,358.5,1.5,2.8,142.8,52.8,37.2,2.8,-0.6,1.9,178.1,271.9,16"  # 52.8 from east to the left, 37.2 by compass
)
SHALLOW_M = 142.8 * math.cos(math.radians(2.8))


@pytest.mark.parametrize("added", ["", ",T,T,1,3313,B,-2,-2", ",T,T,1,3313,B,-2,-2,and,more"])
def test_a_rov_locator_tells_slant_range_true_bearing_and_elevation_of_what_it_heard(tmp_path, added):
    log = logged(tmp_path, LOCATOR + added, "USRTH,,,,,,,,-0.6,1.9,178.1,271.9,16")

    (place,), bearing = places(log), math.radians(37.2)
    assert place == pytest.approx([100 + SHALLOW_M * math.sin(bearing), 200 + SHALLOW_M * math.cos(bearing)])
    assert "1 not a number" in only(log, "USBL-INVALID")


def test_a_locator_with_a_gps_compass_tells_where_and_when_it_heard_the_vehicle(tmp_path: Path) -> None:
    """On 21 June 2025, a ten-thousandth of a degree north of its own antenna."""
    head, turned = "1.0,MkIII,A,T,44.98626600,-93.57618590,90.0", "0.993873,0.009705,-0.001716,0.110093"
    body = f"USTLC,{head},{turned},11.1,0.0,0.0,44.98636600,-93.57618590,34,39,210625 130042.60,"

    log = logged(tmp_path, body, toml=LAKE)

    assert places(log)[0] == pytest.approx([0, 1e-4 * METRES_A_DEGREE], abs=1e-3)
    assert log.start_ns == np.datetime64("2025-06-21T13:00:42.600", "ns").astype(int)

    silent = "USTLC,1.0,MkIII,A,T,44.98626600,-93.57618590,,0.993873,0.009705,-0.001716,0.110093,,,,,,34,39,%s,"

    with pytest.raises(LogError, match=r"all 1 records of /USTLC .usbl. are invalid: 1 not a number"):
        logged(tmp_path, silent % "210625 130042.60", toml=LAKE)


HIPAP, SURER = "PSIMSSB,180554.432,M44,A,,", "log Cartesian coordinates (C) or latitudes and longitudes (R)"
NOT_READ = {
    f"{HIPAP}P,N,M,61.3,39.0,34.0,0.1,N,,": "holds polar coordinates, whose order and units are unknown; log",
    f"{HIPAP}U,E,M,461300.0,5039017.0,34.0,0.1,N,,": f"holds UTM coordinates without their zone; {SURER}",
    f"{HIPAP}C,G,M,61.3,39.0,34.0,0.1,N,,": "holds Cartesian coordinates in the unknown orientation G",
    f"{HIPAP}R,E,M,0.785,0.122,34.0,0.1,N,,": "holds radians east-up, and it is unknown which one is",
    "PSONALL,2401,CRP,133707.52,461300.0,5039017.0,999.9": "holds eastings and northings of an unnamed grid",
    "PTSAY,#1,124544.4,18,12,2017,1,17.9,-25.5,F,13.1,1,9999.0": "holds offsets along unknown axes",
    "PEVOSSA,122640.00,2,1,N,R,12.5,-30.0,1.0,-30,180,,": "holds only angles, not a fix; log PEVOSSB",
    "PEVOSSB,122640.00,2,1,B,T,R,1.0,2.0,3.0,0.5,-30,180,,": "has a frame that is tilted with the instrument",
    "PEVOSSB,122640.00,2,1,T,T,R,1.0,2.0,3.0,0.5,-30,180,,": "has a frame that is tilted with the instrument",
}


@pytest.mark.parametrize("body", NOT_READ)
def test_what_no_manual_settles_is_refused_with_the_reason(tmp_path: Path, body: str) -> None:
    said = refusal(UsageError, logged, tmp_path, body)

    assert f"cannot be used as usbl: it {NOT_READ[body]}" in said
    assert said.endswith("(--usbl none: replay without usbl)")


RADIANS = f"{math.radians(44.986366):.12f},{math.radians(-93.5761859):.12f}"
GEODETIC = {
    f"PSIMSSB,122640.00,B01,A,,R,N,M,{RADIANS},3.0,1.5,N,,": "usbl",
    f"PSIMSSB,122640.00,B01,A,,R,G,M,{RADIANS},3.0,1.5,N,,": "usbl",
    "PSIMSSB,122640.00,B01,A,,D,G,M,4459.181960,N,09334.571154,W,3.0,1.5,N,,": "usbl",
    "PEVOSSB,122640.00,2,1,G,T,R,44.986366,-93.5761859,-3.0,1.5,-30,180,,": "usbl",
    "PSONLLD,122640.00,2401,A,44.986366,-93.5761859,999.916,5.33,5.33,0.00,0.62,,,,": "usbl",
    "PSONLLD,122640.00,ALVIN 914,A,44.986366,-93.5761859,1951.156,13.96,13.96,0.00,2.62,,,,": "usbl",
    "INGNS,122640.00,4459.181960,N,09334.571154,W,AN,8,0.9,1.0,48.0,,": "gps",
    "INGLL,4459.181960,N,09334.571154,W,122640.00,A,A": "gps",
}


@pytest.mark.parametrize("body", GEODETIC)
def test_latitudes_are_read_in_whatever_way_they_are_written(tmp_path: Path, body: str) -> None:
    table = logged(tmp_path, body, toml=LAKE).tables[GEODETIC[body]]

    assert table[["east_m", "north_m"]].to_numpy()[0] == pytest.approx([0, 1e-4 * METRES_A_DEGREE], abs=1e-3)


SHIPS = {
    "PTSAG,#1,122640.000,13,09,2020,0,4459.181960,N,09334.571154,W,F,2.9,1,9999.0": "/PTSAG_ship",
    "PSONLLD,122640.00,Ship 1,A,44.986366,-93.5761859,0.0,0.1,0.1,0.0,0.1,,,,": "/PSONLLD_ship",
}


@pytest.mark.parametrize("body", SHIPS)
def test_a_ship_among_the_targets_is_where_the_head_is(tmp_path: Path, body: str) -> None:
    """A HiPAP's target 40 m to the north of it."""
    head = f'{LAKE}[usbl]\nhead = {{ topic = "{SHIPS[body]}" }}\n'

    log = logged(tmp_path, body, "PSIMSSB,122640.00,B01,A,,C,N,M,40.0,0.0,10.0,0.5,N,,", toml=head)

    assert places(log)[0] == pytest.approx([0, 40 + 1e-4 * METRES_A_DEGREE], abs=1e-3)


EAST_30_NORTH_40 = {
    "PSIMSSB,122640.00,B01,A,,C,N,M,40.0,30.0,10.0,0.5,N,,": 0.0,
    "PSIMSSB,122640.00,B01,A,,C,E,M,30.0,40.0,10.0,0.5,N,,": 0.0,
    "PSIMSSB,122640.00,B01,A,,C,H,M,-40.0,30.0,10.0,0.5,N,,": 90.0,  # 40 m to port and 30 m ahead of a bow to the east
    "PEVOSSB,122640.00,2,1,N,T,R,40.0,30.0,10.0,0.5,-30,180,,": 0.0,
    "PEVOSSB,122640.00,2,1,E,T,R,30.0,40.0,10.0,0.5,-30,180,,": 0.0,
    "PEVOSSB,122640.00,2,1,H,T,R,30.0,-40.0,10.0,0.5,-30,180,,": 90.0,
    "PTSAX,#16069,122640.000,13,09,2020,1,30.0,-40.0,F,10.0,1,9999.00": 90.0,
}


@pytest.mark.parametrize("body", EAST_30_NORTH_40)
def test_every_orientation_of_every_maker_is_turned_to_east_and_north(tmp_path: Path, body: str) -> None:
    toml = f"[usbl]\nhead = {{ east_m = 100.0, north_m = 200.0, heading_deg = {EAST_30_NORTH_40[body]} }}\n"

    assert places(logged(tmp_path, body, toml=toml))[0] == pytest.approx([130, 240])


LONG = [
    "10446.991981,10446.534643,3,-0.0604,-1.0888,-0.5851,-0.4233,-1.0020,-0.5901,0.0063,0.0269,-0.3295,825,-36,77,1.2375",
    "1325384364.662679,1325384364.401149,2,0.0234,0.3407,-0.1417,-0.3286,0.0800,-0.1494,-0.0178,0.1164,1.3498,247,-16,388,0.0116",
]
DIGITS = 2e-4  # of the printed numbers, turned by printed angles
SHIP = (51.3306281, -0.83499295)  # of Sonardyne's example
T0_S = 1_600_000_000


def parts(text: str, first: int, count: int = 3) -> np.ndarray:
    return np.array(text.split(",")[first : first + count], dtype=float)


def heading_pitch_roll(text: str, first: int) -> list[float]:
    """Their yaw counts from east to the left, about up, and their pitch about port, bow down."""
    roll, pitch, yaw = np.degrees(parts(text, first)).tolist()
    return [90.0 - yaw, -pitch, roll]


@pytest.mark.parametrize("text", LONG)
def test_what_an_evologics_head_saw_is_turned_to_the_east_north_up_that_it_states(tmp_path: Path, text: str) -> None:
    seen, stated, (roll, pitch, yaw) = (parts(text, first) for first in (3, 6, 9))
    assert Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(seen) == pytest.approx(stated, abs=DIGITS)

    heading, pitch_deg, roll_deg = heading_pitch_roll(text, 9)
    compass = "".join(f"{T0_S + k},{heading % 360},{roll_deg},{pitch_deg}\n" for k in range(3))
    toml = """[usbl]
topic = "/usbl"
columns = { time_unix_s = "time_s", x = "x", y = "y", z = "z" }
frame = "body"
axes = "FPU"
level = true
head = { topic = "/gps", heading_topic = "/compass" }
"""
    log = logged_csv(
        tmp_path,
        on_map(*SHIP) + toml,
        gps="time_s,lat_deg,lon_deg\n" + "".join(f"{T0_S + k},{SHIP[0]},{SHIP[1]}\n" for k in range(3)),
        compass="time_s,heading_deg,roll_deg,pitch_deg\n" + compass,
        usbl=f"time_s,x,y,z\n{T0_S + 1},{','.join(map(str, seen))}\n",
    )

    assert places(log)[0] == pytest.approx(stated[:2], abs=DIGITS)
