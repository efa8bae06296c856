"""``usbldr calibrate-usbl``: its sentences, exit codes and files; a head by a dive, which SciPy turned and tilted."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from checkout import SAMPLES
from commands import findings, output_of, report_of, run

T0 = 1_767_225_600_000_000_000
LAT_DEG, LON_DEG = 45.0, -30.0
M_PER_DEG = 111_131.78  # of latitude at 45 degrees, on WGS-84
MAP = f"schema = 1\n[map]\norigin_lat_deg = {LAT_DEG}\norigin_lon_deg = {LON_DEG}\n"
HEAD = 'head = { topic = "ship_gps", heading_topic = "gyro", depth_m = 5.0 }\n'


def write_dive(folder: Path, seed: int, *, ship: bool = True, seconds: int = 900, vertical: bool = True, **head):
    """Write a dive at 40 to 80 m with a fix every 3 s.

    ``head`` has heading_deg, pitch_deg, roll_deg and scale (true over measured).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(5 * seconds + 1) / 5
    heading = np.degrees(0.6 + np.pi / 2 * np.sin(t / 23.0))
    mps = np.column_stack([0.1 * np.cos(t / 11), 1.0 + 0.1 * np.sin(t / 7)])  # starboard, forward
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    east_north = np.column_stack([s * mps[:, 1] + c * mps[:, 0], c * mps[:, 1] - s * mps[:, 0]])
    place = np.vstack([np.zeros(2), np.cumsum((east_north[1:] + east_north[:-1]) / 10, axis=0)])
    depth = 60 + 20 * np.sin(t / 60)
    seen = np.arange(5, len(t), 15)
    angle = t / 30.0 if ship else 0 * t
    about = np.outer(t / t[-1], place[-1]) if ship else np.zeros((len(t), 2)) + place[-1] / 2
    ship_at = about + 80 * np.column_stack([np.sin(angle), np.cos(angle)])
    gyro = (np.degrees(angle) * 1.7 + 40) % 360 if ship else np.full(len(t), 40.0)
    north_east_down = np.column_stack([(place - ship_at)[:, ::-1], depth - 5.0])[seen]
    angles = [head.get(name, 0.0) for name in ("heading_deg", "pitch_deg", "roll_deg")]
    mount = Rotation.from_euler("ZYX", angles, degrees=True)
    along = (Rotation.from_euler("Z", gyro[seen, None], degrees=True) * mount).inv().apply(north_east_down)
    slant = np.linalg.norm(along, axis=1) / head.get("scale", 1.0)
    bearing = np.degrees(np.arctan2(along[:, 1], along[:, 0])) + rng.normal(0, 0.3, len(seen))
    down = np.degrees(np.arcsin(along[:, 2] / np.linalg.norm(along, axis=1))) + rng.normal(0, 0.3, len(seen))
    time_ns = T0 + np.round(t * 1e9).astype(np.int64)
    noise = rng.normal(size=(5, len(t)))
    lat_deg, lon_deg = LAT_DEG + ship_at[:, 1] / M_PER_DEG, LON_DEG + ship_at[:, 0] / (M_PER_DEG * 0.70891)
    files = {
        "dvl": {"forward_mps": mps[:, 1] + 0.02 * noise[0], "starboard_mps": mps[:, 0] + 0.02 * noise[1]},
        "compass": {"heading_deg": (heading + 0.3 * noise[2]) % 360},
        "depth": {"depth_m": depth + 0.05 * noise[3]},
        "ship_gps": {"lat_deg": lat_deg, "lon_deg": lon_deg},
        "gyro": {"heading_deg": gyro},
    }
    folder.mkdir()
    for name, columns in files.items():
        pd.DataFrame({"time_ns": time_ns, **columns}).to_csv(folder / f"{name}.csv", index=False)
    fixes = {"slant_range_m": slant + rng.normal(0, 0.2, len(seen)), "bearing_deg": bearing % 360}
    if vertical:
        fixes["elevation_deg"] = down
    pd.DataFrame({"time_ns": time_ns[seen], **fixes}).to_csv(folder / "usbl.csv", index=False)
    (folder / "usbldr.toml").write_text(f'{MAP}[usbl]\nframe = "body"\n{HEAD}[compass]\ntopic = "compass"\n')
    return folder


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("surveys") / "box"
    output_of("simulate", "survey-box", "-o", folder)
    return folder


def test_a_survey_is_calibrated_and_its_configuration_needs_no_more(survey, tmp_path):
    folder, file = tmp_path / "calibration", tmp_path / "found.toml"
    said = output_of("calibrate-usbl", survey, "-o", folder, "--write", file)
    assert "good: the fixes settle every error of the installation" in said
    report = report_of(folder)
    assert set(report["files"]) | {"report.json"} == {path.name for path in folder.iterdir()}
    assert {one["name"]: one["open"] for one in report["parameters"]}["scale"] is False
    again = run("calibrate-usbl", survey, "--config", file, "--json")
    assert again.return_value == 0
    found = json.loads(again.output)
    assert found["before"]["drms_m"] == pytest.approx(found["after"]["drms_m"], rel=0.02)


def test_a_circle_is_open_and_leaves_its_keys_as_stated(tmp_path):
    run("simulate", "survey-circle", "-o", tmp_path / "circle")
    done = run("calibrate-usbl", tmp_path / "circle", "--write", tmp_path / "found.toml")
    assert done.return_value == 1
    assert "heading of the head: open: cannot be separated from latency of position" in done.output
    written = (tmp_path / "found.toml").read_text()
    assert "heading of the head is left as stated" in written
    assert "mount_deg" not in written


def test_a_configuration_with_an_inline_table_is_completed(survey, tmp_path):
    usbl = 'usbl = { frame = "body", head = { topic = "gps", heading_topic = "compass" } }\n'
    (tmp_path / "inline.toml").write_text(MAP.replace("[map]", f"{usbl}[map]"))
    output_of("calibrate-usbl", survey, "--config", tmp_path / "inline.toml", "--write", tmp_path / "found.toml")
    assert "mount_deg" in (tmp_path / "found.toml").read_text()


def test_depths_count_from_the_surface_and_one_that_is_stated_wrong_is_said(survey, tmp_path):
    deep = (survey / "usbldr.toml").read_text().replace('"compass" }', '"compass", depth_m = 5.0 }')
    (tmp_path / "deep.toml").write_text(deep)
    stated = ("calibrate-usbl", survey, "--transponder-depth", 100)
    assert "by --transponder-depth" not in run(*stated).output
    done = run(*stated, "--config", tmp_path / "deep.toml", "--write", tmp_path / "found.toml")
    assert "the transponder lies 105.0 m deep, but 100.0 m by --transponder-depth" in done.output
    assert "A dive needs depth_m" not in (tmp_path / "found.toml").read_text()
    run(*stated, "--write", tmp_path / "shallow.toml")
    assert "A dive needs depth_m" in (tmp_path / "shallow.toml").read_text()


def test_a_plan_needs_a_survey():
    said = output_of("calibrate-usbl", "survey-spin", "--plan")
    assert "transponder depth" in said
    assert "usbldr simulate survey-spin" in str(run("calibrate-usbl", "survey-spin").exception)
    assert "is not a survey" in str(run("calibrate-usbl", "turns", "--plan").exception)


def test_nothing_of_the_user_is_replaced(survey, tmp_path):
    (tmp_path / "mine.toml").write_text("schema = 1\n")
    done = run("calibrate-usbl", survey, "--write", tmp_path / "mine.toml")
    assert "exists already" in str(done.exception)
    assert (tmp_path / "mine.toml").read_text() == "schema = 1\n"


def test_a_survey_is_a_folder(tmp_path):
    assert "folder of CSV files" in str(run("simulate", "survey-box", "-o", tmp_path / "box.mcap").exception)


def test_clocks_that_are_synchronised_can_be_stated():
    """A circle at one speed separates a late position from a heading only if it is known not to be late."""
    plans = [run("calibrate-usbl", "survey-circle", "--plan", *more).output for more in ((), ("--latency-sd", 0.02))]
    assert ["--latency-sd" in plan for plan in plans] == [True, False]


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
        drms_m.append(report_of(Path(out))["fix_statistics"]["scatter"]["drms_m"])
    assert drms_m[1] == pytest.approx(drms_m[0], rel=0.05)


def test_a_head_at_an_unknown_place_is_asked_for(tmp_path):
    assert "state head under [usbl]" in str(run("calibrate-usbl", SAMPLES / "lawnmower.mcap").exception)
