"""A dive logged twice: the vehicle's DVL and compass below, a survey ship's sentences above."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from commands import output_of
from recordings import SECOND, T0, Row, sentence, twist, write_mcap, yaw
from usbldr.io.reading.read import Request, read_log

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
