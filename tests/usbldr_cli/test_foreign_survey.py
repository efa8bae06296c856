"""A box-in simulated without any code of ours, exported as other programs export: one installation, one answer.

Its conventions are those of aerospace: north, east, down; forward, starboard, down; rotations of SciPy that turn about
z, y, x. The earth is pymap3d's, the antenna is at sea off Sydney, and positions and attitudes are stamped late.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from commands import output_of
from usbldr.filters.simulation.usbl_survey import simulate_survey
from usbldr.filters.usbl_survey.calibration import calibrated, known_of
from usbldr.filters.usbl_survey.geometry import NAMES
from usbldr.io.reading.opening import Request
from usbldr.io.reading.usbl_survey import read_usbl_survey
from usbldr.io.scenarios.survey_scenarios import find_survey

UNKNOWN = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])

MOUNT_DEG = {"mount_heading_deg": 1.5, "mount_pitch_deg": -0.6, "mount_roll_deg": 0.8}
LATE_S = {"attitude_latency_s": 0.1, "position_latency_s": 0.3}
TRUE = MOUNT_DEG | {"scale": 0.99, "arm_starboard_m": 1.2, "arm_forward_m": -8.0} | LATE_S
ARM_FRD_M = [-8.0, 1.2, 0.0]
ORIGIN = (-33.9, 151.4, 0.0)
BEACON_NED_M = np.array([-5.0, 10.0, 100.0])
T0 = 1_767_225_600.0
PERIOD_S = 0.05


def box_in(seed):
    """Return times and records: antenna (degrees) and attitude (NED from FRD) 20 times a second, fixes along FRD."""
    rng = np.random.default_rng(seed)
    there, across, back = [(120, 1.5, 0), (30, 1.5, 3)], [(15, 1.5, 3), (150, 1.5, 0), (45, 1.5, -3)], [(225, 0.8, 0)]
    legs = 4 * there + across + 4 * [*back, (30, 1.5, -3)]  # seconds, metres and degrees per second
    seconds, speed, rate = np.array(legs, dtype=float).T
    steps = np.round(seconds / PERIOD_S).astype(int)
    yaw_deg = np.cumsum(np.repeat(rate, steps)) * PERIOD_S
    yaw = np.radians(yaw_deg)
    along = np.repeat(speed, steps)[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    north_east = np.cumsum(along, axis=0) * PERIOD_S - 100.0
    t = np.arange(len(yaw_deg)) * PERIOD_S
    swing = [1.5 * np.sin(t * 2 * np.pi / 7.0), 4.0 * np.sin(t * 2 * np.pi / 9.0)]
    ship = Rotation.from_euler("ZYX", np.column_stack([yaw_deg, *swing]), degrees=True)
    mount = Rotation.from_euler("ZYX", list(MOUNT_DEG.values()), degrees=True)
    pinged = np.arange(40, len(t) - 40, 40)
    antenna = np.column_stack([north_east, np.zeros(len(t))])
    in_ship = Rotation.from_quat(ship.as_quat()[pinged]).inv().apply(BEACON_NED_M - antenna[pinged])
    seen = mount.inv().apply(in_ship - ARM_FRD_M)
    reach = np.linalg.norm(seen, axis=1)
    sd_deg = np.where(rng.random(len(reach)) < 0.03, 10.0, 0.25)[:, None]
    # small rotations of the head's own axes, heavy-tailed
    wrong = Rotation.from_rotvec(sd_deg * rng.standard_t(4, (len(reach), 3)), degrees=True)
    measured = wrong.apply(seen / reach[:, None]) * (reach / 0.99 + 0.1 * rng.standard_t(4, len(reach)))[:, None]
    noise_m = rng.normal(0, 0.02, (2, len(t)))
    north, east = north_east.T + noise_m
    lat, lon, _ = pymap3d.ned2geodetic(north, east, 0.0, ORIGIN[0], ORIGIN[1], ORIGIN[2])
    noisy = ship * Rotation.from_euler("ZYX", rng.normal(0, 0.02, (len(t), 3)), degrees=True)
    return t, lat, lon, noisy, t[pinged], measured


def write_quaternions(folder: Path, seed: int) -> None:
    """Unix seconds, a quaternion that turns FRD to NED, and fixes forward, starboard, down."""
    t, lat, lon, ship, ping_s, measured = box_in(seed)
    qx, qy, qz, qw = ship.as_quat().T
    save(folder / "nav.csv", {"epoch": T0 + t + 0.3, "latitude": lat, "longitude": lon})
    save(folder / "mru.csv", {"epoch": T0 + t + 0.1, "q0": qw, "q1": qx, "q2": qy, "q3": qz})
    x, y, z = measured.T
    save(folder / "beacon.csv", {"epoch": T0 + ping_s, "X": x, "Y": y, "Z": z})
    (folder / "usbldr.toml").write_text(
        """schema = 1
[gps]
topic = "/nav"
columns = { time_unix_s = "epoch", lat_deg = "latitude", lon_deg = "longitude" }
[compass]
topic = "/mru"
columns = { time_unix_s = "epoch", qw = "q0", qx = "q1", qy = "q2", qz = "q3" }
[usbl]
topic = "/beacon"
columns = { time_unix_s = "epoch", x = "X", y = "Y", z = "Z" }
frame = "body"
level = true
head = { topic = "/nav", heading_topic = "/mru", heading_convention = "NED" }
axes = "FSD"
"""
    )


def write_angles(folder: Path, seed: int) -> None:
    """Dates and times, Euler angles, and fixes by slant range, bearing from the bow and depression."""
    t, lat, lon, ship, ping_s, measured = box_in(seed)
    heading, pitch, roll = ship.as_euler("ZYX", degrees=True).T
    save(folder / "nav.csv", {"UTC": dates(t + 0.3), "GPS Latitude (deg)": lat, "GPS Longitude (deg)": lon})
    save(
        folder / "mru.csv", {"time": dates(t + 0.1), "heading_deg": heading % 360, "pitch_deg": pitch, "roll_deg": roll}
    )
    reach = np.linalg.norm(measured, axis=1)
    bearing = np.degrees(np.arctan2(measured[:, 1], measured[:, 0])) % 360
    depression = np.degrees(np.arcsin(measured[:, 2] / reach))
    save(folder / "beacon.csv", {"time": dates(ping_s), "R": reach, "az": bearing, "el": depression})
    (folder / "usbldr.toml").write_text(
        """schema = 1
[compass]
topic = "/mru"
columns = { time_unix_s = "time", heading = "heading_deg", roll_deg = "roll_deg", pitch_deg = "pitch_deg" }
[usbl]
topic = "/beacon"
columns = { time_unix_s = "time", slant_range_m = "R", bearing_deg = "az", elevation_deg = "el" }
frame = "body"
level = true
head = { topic = "/nav", heading_topic = "/mru" }
"""
    )


def dates(seconds):
    return pd.to_datetime(T0 * 1e9 + np.round(seconds * 1e9)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def save(file: Path, columns) -> None:
    pd.DataFrame(columns).to_csv(file, index=False)


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    folders = []
    for write in (write_quaternions, write_angles):
        folders.append(tmp_path_factory.mktemp(write.__name__))
        write(folders[-1], 1)
    return folders


def test_a_foreign_survey_gives_the_installation_that_it_was_made_with(exports):
    """Within its sigmas, which are those of our own simulation of the same installation and pattern."""
    found = json.loads(output_of("calibrate-usbl", exports[0], "--json"))
    assert found["result"] == "good"
    assert found["before"]["median_m"] > 5 * found["after"]["median_m"]
    parameters = {one["name"]: one for one in found["parameters"]}
    sd = np.array([parameters[name]["sd"] for name in TRUE])
    z = (np.array([parameters[name]["value"] for name in TRUE]) - list(TRUE.values())) / sd
    assert np.abs(z).max() < 3.0
    ours = calibrated(simulate_survey(find_survey("survey-box"), 1), UNKNOWN, known_of(UNKNOWN))
    assert sd / ours.sd[[NAMES.index(name) for name in TRUE]] == pytest.approx(np.ones(len(TRUE)), abs=0.3)


def test_quaternions_and_angles_are_one_survey(exports):
    axes, angles = (read_usbl_survey(folder, Request()).survey for folder in exports)
    assert angles.time_s == pytest.approx(axes.time_s, abs=1e-5)
    assert angles.range_m == pytest.approx(axes.range_m)
    assert angles.direction == pytest.approx(axes.direction, abs=1e-9)
    assert angles.ship.position_m == pytest.approx(axes.ship.position_m, abs=1e-6)
    assert angles.ship.attitude_deg == pytest.approx(axes.ship.attitude_deg, abs=1e-6)
