"""A USBL's head by a dive, against the turn, tilt and scale that rotations of SciPy put into the fixes."""

import json
from pathlib import Path

import pytest
from tests.support.ship_dive import write_dive

from checkout import SAMPLES
from commands import findings, run


def calibrated(*args):
    done = run("calibrate-usbl", *args, "--json")
    content = json.loads(done.stdout)
    return done.return_value, content, {one["name"]: one for one in content["parameters"]}


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dives") / "beside"
    return write_dive(folder, 1, seconds=600, heading_deg=2.0, pitch_deg=1.0, roll_deg=-0.8, scale=0.985)


def test_a_moving_ship_and_a_depth_settle_the_head_and_its_configuration_needs_no_more(dive, tmp_path):
    code, content, found = calibrated(dive, "--write", tmp_path / "found.toml", "-o", tmp_path / "calibration")
    assert (code, content["result"]) == (0, "good")
    truth = {"mount_heading_deg": 2.0, "mount_pitch_deg": 1.0, "mount_roll_deg": -0.8, "scale": 0.985}
    for name, value in truth.items():
        assert found[name]["value"] == pytest.approx(value, abs=3.5 * found[name]["sd"])
        assert found[name]["effect_m"] < 0.4
    assert content["after"]["drms_m"] < content["before"]["drms_m"] / 2  # 2 degrees at 100 m are 3.5 m
    written = {*content["files"], "report.json", "fixes.png", "report.html", "report.md"}
    assert {path.name for path in (tmp_path / "calibration").iterdir()} == written
    assert {"USBL-HEADING", "USBL-RANGE"}.isdisjoint(findings(dive, "--config", str(tmp_path / "found.toml")))


def test_a_ship_that_rests_without_depths_leaves_the_head_open_and_says_what_would_settle_it(tmp_path):
    dive = write_dive(tmp_path / "rest", 2, ship=False, seconds=300, vertical=False, heading_deg=2.0, scale=0.985)
    code, content, found = calibrated(dive)
    assert (code, content["result"]) == (1, "open")
    heading = found["mount_heading_deg"]
    assert heading["open"]
    assert heading["rival"] == "heading of the compass"
    assert "drive the ship around" in heading["leg"]
    assert found["mount_roll_deg"]["open"]


def test_the_scatter_of_fixes_is_that_of_a_right_head_if_the_run_has_settled_its_errors(tmp_path):
    drms_m = []
    for name, heading_deg, scale in (("right", 0.0, 1.0), ("turned", 2.0, 0.985)):
        dive = write_dive(tmp_path / name, 1, seconds=400, heading_deg=heading_deg, scale=scale)
        out = str(tmp_path / f"{name}-run")
        run("replay", str(dive), "--filter", "adf", "--smooth", "--plots", "none", "--output", out)
        drms_m.append(json.loads((Path(out) / "report.json").read_text())["fix_statistics"]["scatter"]["drms_m"])
    assert drms_m[1] == pytest.approx(drms_m[0], rel=0.05)


def test_a_head_at_an_unknown_place_is_asked_for(tmp_path):
    assert "state head under [usbl]" in str(run("calibrate-usbl", SAMPLES / "lawnmower.mcap").exception)
