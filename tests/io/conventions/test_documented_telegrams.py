"""Telegrams as makers and users print them, against rotations of scipy and the earth of pymap3d.

EvoLogics' USBLLONG and USBLANGLES state what the head saw along its own axes, its attitude, and what that is towards
east, north and up: the chain must turn the first into the last.
"""

import math
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from logs import logged_csv, logged_nmea, places
from recordings import sentence
from usbldr.filters.usbl_survey.geometry import attitude_matrix

LONG = [
    "10446.991981,10446.534643,3,-0.0604,-1.0888,-0.5851,-0.4233,-1.0020,-0.5901,0.0063,0.0269,-0.3295,825,-36,77,1.2375",
    "1325384364.662679,1325384364.401149,2,0.0234,0.3407,-0.1417,-0.3286,0.0800,-0.1494,-0.0178,0.1164,1.3498,247,-16,388,0.0116",
]
ANGLES = "1325377475.019626,1325377474.170448,2,-2.2959,-0.4586,-1.7643,-0.4293,0.0307,0.0766,0.5695,-16,296,0.0114"
DIGITS = 2e-4  # of the printed numbers, turned by printed angles
SHIP = (51.3306281, -0.83499295)  # of Sonardyne's example
T0 = 1_600_000_000


def parts(text: str, first: int, count: int = 3) -> np.ndarray:
    return np.array(text.split(",")[first : first + count], dtype=float)


def heading_pitch_roll(text: str, first: int) -> list[float]:
    """Their yaw counts from east to the left, about up, and their pitch about port, bow down."""
    roll, pitch, yaw = np.degrees(parts(text, first)).tolist()
    return [90.0 - yaw, -pitch, roll]


def on_map(lat_deg: float, lon_deg: float) -> str:
    return f"[map]\norigin_lat_deg = {lat_deg}\norigin_lon_deg = {lon_deg}\n"


@pytest.mark.parametrize("text", LONG)
def test_what_an_evologics_head_saw_is_turned_to_the_east_north_up_that_it_states(tmp_path: Path, text: str) -> None:
    seen, stated, (roll, pitch, yaw) = (parts(text, first) for first in (3, 6, 9))
    assert Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(seen) == pytest.approx(stated, abs=DIGITS)

    heading, pitch_deg, roll_deg = heading_pitch_roll(text, 9)
    compass = "".join(f"{T0 + k},{heading % 360},{roll_deg},{pitch_deg}\n" for k in range(3))
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
        gps="time_s,lat_deg,lon_deg\n" + "".join(f"{T0 + k},{SHIP[0]},{SHIP[1]}\n" for k in range(3)),
        compass="time_s,heading_deg,roll_deg,pitch_deg\n" + compass,
        usbl=f"time_s,x,y,z\n{T0 + 1},{','.join(map(str, seen))}\n",
    )

    assert places(log)[0] == pytest.approx(stated[:2], abs=DIGITS)


def test_the_angles_of_an_evologics_head_are_turned_to_those_that_it_states() -> None:
    (bearing, elevation), (east_north, up) = parts(ANGLES, 3, 2), parts(ANGLES, 5, 2)
    flat = math.cos(elevation)
    seen = np.array(
        [-flat * math.sin(bearing), flat * math.cos(bearing), math.sin(elevation)]
    )  # starboard, forward, up
    east, north, high = attitude_matrix(*np.array(heading_pitch_roll(ANGLES, 7))[:, None])[0] @ seen

    assert (math.atan2(north, east), math.asin(high)) == pytest.approx((east_north, up), abs=DIGITS)


@pytest.mark.parametrize("heading_deg", [0.0, 123.0, 271.5])
def test_a_hipap_head_up_is_starboard_and_forward_of_the_bow(tmp_path: Path, heading_deg: float) -> None:
    """100.1 m to port and 50.5 m ahead of a ship, turned by scipy and placed by pymap3d."""
    ship = ["GPGGA,102449.00,5119.837686,N,00050.099577,W,2,12,0.6,0.0,M,48.0,M,,", f"HEHDT,{heading_deg},T"]
    fix = "PSIMSSB,102449.231,M23,A,,C,H,M,-100.10,50.50,200.20,1.436,N,,"
    later = [body.replace("102449.00", "102450.00") for body in ship]
    lines = [f"{T0 + k} {sentence(body)}" for k, bodies in enumerate(([*ship], [fix, *later])) for body in bodies]
    toml = on_map(*SHIP) + '[usbl]\nhead = { topic = "/GPGGA", heading_topic = "/HEHDT" }\n'
    log = logged_nmea(tmp_path, *lines, toml=toml)

    north, east, _ = Rotation.from_euler("z", heading_deg, degrees=True).apply([50.5, -100.1, 200.2])
    lat, lon, _ = pymap3d.ned2geodetic(north, east, 0.0, *SHIP, 0.0)
    expected = pymap3d.geodetic2enu(lat, lon, 0.0, *SHIP, 0.0)[:2]
    assert places(log)[0] == pytest.approx(expected, abs=0.002)
