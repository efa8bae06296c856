"""auv_nav's vehicle.yaml and mission.yaml as a configuration."""

import shutil
from pathlib import Path

import pytest

from checkout import ROOT
from commands import run
from logs import only
from recordings import saved
from usbldr.filters.errors import UsageError
from usbldr.io.reading.opening import Request, configuration_of
from usbldr.io.reading.read import read_log

VEHICLE = """#YAML 1.0
origin: {surge_m: 0.1, sway_m: 0, heave_m: 0, roll_deg: 0, pitch_deg: 0, yaw_deg: 0}
usbl: {surge_m: 0.5, sway_m: -0.2, heave_m: -0.289, roll_deg: 0, pitch_deg: 0, yaw_deg: 0}
ins: {surge_m: -0.09, sway_m: 0, heave_m: 0, roll_deg: 0, pitch_deg: 0, yaw_deg: 0.5}
dvl: {surge_m: -0.7, sway_m: 0, heave_m: 0.2, roll_deg: 1.5, pitch_deg: 0, yaw_deg: 45}
depth: {surge_m: 0., sway_m: 0, heave_m: 0, roll_deg: 0, pitch_deg: 0, yaw_deg: 0}
fore: {surge_m: 0.26, sway_m: 0, heave_m: 0.5, roll_deg: 0, pitch_deg: 0, yaw_deg: 0}
"""
MISSION = """version: 1
origin: {latitude: 43.0, longitude: 6.0, coordinate_reference_system: wgs84, date: 2017/08/17}
velocity: {format: phins, filepath: nav/, timezone: utc, timeoffset: 0.5, std_factor: 0.001, std_offset: 0.2}
orientation: {format: rosbag, filepath: nav/, topic: /imu/data, timezone: 0, timeoffset: 0.25, std_offset: 0.3}
usbl: {format: gaps, filepath: nav/, timezone: 10, timeoffset: 0.0, id: 4, std_factor: 0.0, std_offset: 2.0}
"""
CONVERTED = {
    "schema": 1,
    "map": {"origin_lat_deg": 43.0, "origin_lon_deg": 6.0},
    "dvl": {"lever_arm_m": [0.0, -0.8, -0.2], "mount_deg": 45.0, "latency_s": -0.5},
    "compass": {"topic": "/imu/data", "latency_s": 0.25, "sd_deg": 0.3},
    "usbl": {"lever_arm_m": [-0.2, 0.4, 0.289], "target": 4, "sd_m": 2.0},
}
LEFT_OUT = "dvl roll_deg, velocity std_factor, velocity std_offset, ins yaw_deg, usbl timezone, fore"


def stated(folder: Path, name: str = "vehicle.yaml", **files: str):
    for stem, text in files.items():
        saved(folder / f"{stem}.yaml", text)
    return configuration_of(folder / "dive.mcap", Request(configuration=str(folder / name)))


@pytest.mark.parametrize("name", ["vehicle.yaml", "mission.yaml"])
def test_both_files_are_read_and_what_has_no_key_is_named(tmp_path: Path, name: str) -> None:
    found = stated(tmp_path, name, vehicle=VEHICLE, mission=MISSION)

    assert (found.content, found.left_out) == (CONVERTED, LEFT_OUT)


def test_one_of_them_and_the_node_that_a_sensor_names_suffice(tmp_path: Path) -> None:
    alone = stated(tmp_path, vehicle="dvl: {surge_m: 1, yaw_deg: 2}\nusbl:\n")
    placed = stated(tmp_path, vehicle="nose: {surge_m: 1, sway_m: 2, heave_m: 3}", mission="velocity: {origin: nose}")

    assert alone.content == {"schema": 1, "dvl": {"lever_arm_m": [0.0, 1.0, 0.0], "mount_deg": 2.0}}
    assert (placed.content, placed.left_out) == ({"schema": 1, "dvl": {"lever_arm_m": [2.0, 1.0, -3.0]}}, "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("dvl: {surge_m: forward}", "dvl surge_m is 'forward', not a number"),
        ("dvl: [1, 2]", "dvl is no section with keys, as auv_nav has it"),
        ("dvl: {surge_m: .nan}", "[dvl] lever_arm_m[1] = nan is not a finite number"),
        ("- dvl", "is no vehicle.yaml of auv_nav: it has no sections"),
        ("a: &a [1]\nb: *a", "is not valid YAML (it has aliases, or is nested too deeply)"),
        ("dvl: {", "is not valid YAML ("),
    ],
)
def test_a_file_that_is_not_auv_navs_is_refused_in_a_sentence(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UsageError) as err:
        stated(tmp_path, vehicle=text)

    assert str(err.value).startswith(f"{tmp_path / 'vehicle.yaml'}: {said}")


def test_a_log_is_read_with_them_and_init_writes_them(tmp_path: Path) -> None:
    shutil.copy(ROOT / "sample_logs/lawnmower.mcap", tmp_path / "dive.mcap")
    vehicle = saved(tmp_path / "vehicle.yaml", VEHICLE)

    log = read_log(tmp_path / "dive.mcap", Request(configuration=str(vehicle)))
    run("init", tmp_path / "dive.mcap", "--config", vehicle, "--output", tmp_path / "usbldr.toml")

    assert only(log, "NO-SUCH-KEY").endswith("has no key for, and is not used: dvl roll_deg, ins yaw_deg, fore")
    written = (tmp_path / "usbldr.toml").read_text(encoding="utf-8")
    assert "Not converted, for there is no such key: dvl roll_deg, ins yaw_deg, fore.\n" in written
    assert "mount_deg = 45.0                        # stated in vehicle.yaml" in written
