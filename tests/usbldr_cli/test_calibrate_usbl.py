"""``usbldr calibrate-usbl``: its sentences, exit codes and files; a head by a dive, which SciPy turned and tilted.

A box-in is simulated without any code of ours, and exported as other programs export: one installation, one answer.
Its conventions are those of aerospace: north, east, down; forward, starboard, down; rotations of SciPy that turn about
z, y, x. The earth is pymap3d's, the antenna is at sea off Sydney, and positions and attitudes are stamped late.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

import usbldr
from checkout import SAMPLES
from commands import findings, output_of, report_of, run
from usbldr.filters.simulation.simulate import simulate_survey
from usbldr.filters.usbl_survey.calibration import calibrated, known_of
from usbldr.filters.usbl_survey.geometry import NAMES
from usbldr.io.reading.opening import Request
from usbldr.io.reading.usbl_survey import read_usbl_survey
from usbldr.io.reports.run import Run, ScoredTrack
from usbldr.io.scenarios.survey_scenarios import find_survey

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
    place = next(text for text in report["remarks"] if text.startswith("the transponder lies at latitude"))
    assert place in said
    again = run("calibrate-usbl", survey, "--config", file, "--json")
    assert again.return_value == 0
    found = json.loads(again.output)
    assert found["before"]["drms_m"] == pytest.approx(found["after"]["drms_m"], rel=0.02)


def test_a_circle_is_open_and_leaves_its_keys_as_stated(tmp_path):
    run("simulate", "survey-circle", "-o", tmp_path / "circle")
    done = run("calibrate-usbl", tmp_path / "circle", "--write", tmp_path / "found.toml")
    assert done.return_value == 1
    assert (
        "heading of the head, forward arm, latency of position: open: cannot be separated from each other"
        in done.output
    )
    assert "run straight legs towards the transponder and away from it; " in done.output
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
    shallow = run(*stated, "--write", tmp_path / "shallow.toml")
    assert "by --transponder-depth" not in shallow.output
    assert "A dive needs depth_m" in (tmp_path / "shallow.toml").read_text()
    done = run(*stated, "--config", tmp_path / "deep.toml", "--write", tmp_path / "found.toml")
    assert "the transponder lies 105.0 m deep, but 100.0 m by --transponder-depth" in done.output
    assert "A dive needs depth_m" not in (tmp_path / "found.toml").read_text()


def test_a_plan_needs_a_survey():
    said = output_of("calibrate-usbl", "survey-spin", "--plan")
    assert "transponder depth" in said
    assert "usbldr simulate survey-spin" in str(run("calibrate-usbl", "survey-spin").exception)
    assert "there is no survey 'turns'" in str(run("calibrate-usbl", "turns", "--plan").exception)


def test_a_plan_is_also_json_and_has_no_other_files(tmp_path):
    shown = output_of("calibrate-usbl", "survey-circle", "--plan")
    plan = json.loads(output_of("calibrate-usbl", "survey-circle", "--plan", "--json"))
    found = {one["name"]: one for one in plan["parameters"]}
    assert f"{found['scale']['sd']:.5f}" in shown
    assert (found["scale"]["open"], found["scale"]["rivals"]) == (True, ["mount_roll_deg", "depth_m"])
    assert (plan["scenario"], found["scale"]["value"]) == ("survey-circle", 0.99)
    for option in ("--write", "--output"):
        refused = run("calibrate-usbl", "survey-circle", "--plan", option, tmp_path / "new").exception
        assert f"leave {option} out" in str(refused)
    assert not (tmp_path / "new").exists()


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


def judged(*args):
    done = run("calibrate-usbl", *args, "--json")
    content = json.loads(done.stdout)
    return done.return_value, content, {one["name"]: one for one in content["parameters"]}


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dives") / "beside"
    return write_dive(folder, 1, seconds=600, heading_deg=2.0, pitch_deg=1.0, roll_deg=-0.8, scale=0.985)


def test_a_moving_ship_and_a_depth_settle_the_head_and_its_configuration_needs_no_more(dive, tmp_path):
    code, content, found = judged(dive, "--write", tmp_path / "found.toml", "-o", tmp_path / "calibration")
    assert (code, content["result"]) == (0, "good")
    truth = {"mount_heading_deg": 2.0, "mount_pitch_deg": 1.0, "mount_roll_deg": -0.8, "scale": 0.985}
    for name, value in truth.items():
        assert found[name]["value"] == pytest.approx(value, abs=3.5 * found[name]["sd"])
        assert found[name]["effect_m"] < 0.4
    assert content["after"]["drms_m"] < content["before"]["drms_m"] / 2  # 2 degrees at 100 m are 3.5 m
    written = {*content["files"], "report.json", "fixes.png", "report.html", "report.md"}
    assert {path.name for path in (tmp_path / "calibration").iterdir()} == written
    left = findings(dive, "--config", str(tmp_path / "found.toml"))
    assert {"USBL-HEADING", "USBL-RANGE"}.isdisjoint(left)
    assert "z of 200 fixes against the depth: the head has roll -0.8" in left["USBL-VERTICAL"]["text"]


def test_a_dive_whose_vertical_is_mirrored_is_bad_and_says_why(dive, tmp_path):
    mirrored = shutil.copytree(dive, tmp_path / "mirrored")
    fixes = pd.read_csv(dive / "usbl.csv")
    bearing, down = np.radians(fixes[["bearing_deg", "elevation_deg"]].to_numpy().T)
    forward, starboard = np.cos(down) * np.cos(bearing), np.cos(down) * np.sin(bearing)
    axes = {"x": forward, "y": starboard, "z": -np.sin(down)}  # up, and stated as down
    table = {"time_ns": fixes.time_ns} | {name: fixes.slant_range_m * part for name, part in axes.items()}
    pd.DataFrame(table).to_csv(mirrored / "usbl.csv", index=False)
    keys = 'axes = "FSD"\ncolumns = { time_ns = "time_ns", x = "x", y = "y", z = "z" }\n'
    (mirrored / "usbldr.toml").write_text((dive / "usbldr.toml").read_text().replace("head =", f"{keys}head ="))
    code, content, _ = judged(mirrored)
    assert (code, content["result"]) == (1, "bad")
    for text in (content["why"], findings(mirrored)["USBL-VERTICAL"]["text"]):
        assert "fixes lie as far above the head as the vehicle lies below it: check the third of axes" in text


def test_a_ship_that_rests_without_depths_leaves_the_head_open_and_says_what_would_settle_it(tmp_path):
    dive = write_dive(tmp_path / "rest", 2, ship=False, seconds=300, vertical=False, heading_deg=2.0, scale=0.985)
    code, content, found = judged(dive)
    assert (code, content["result"]) == (1, "open")
    heading = found["mount_heading_deg"]
    assert heading["open"]
    assert heading["rivals"] == ["heading of the compass"]
    assert "drive the ship around" in heading["leg"]
    assert found["mount_roll_deg"]["open"]


def test_the_scatter_of_fixes_is_that_of_a_right_head_if_the_run_has_settled_its_errors(tmp_path):
    drms_m = []
    for name, heading_deg, scale in (("right", 0.0, 1.0), ("turned", 2.0, 0.985)):
        dive = write_dive(tmp_path / name, 1, seconds=400, heading_deg=heading_deg, scale=scale)
        out = str(tmp_path / f"{name}-run")
        run("replay", str(dive), "--filter", "adf", "--smooth", "--plots", "none", "--output", out)
        drms_m.append(report_of(Path(out))["fix_statistics"]["scatter"]["drms_m"])
        depth_m = pd.read_csv(Path(out) / "pose_5hz.csv").depth_m
        page = (Path(out) / "report.md").read_text()
        found = report_of(Path(out))["fix_statistics"]
        spans = [f"{one['from_m']:.0f} to {one['to_m']:.0f} m {one['good_share']:.0%}" for one in found["by_range"]]
        assert f"{found['outliers']} gross outlier" in page
        assert f"good by horizontal range: {', '.join(spans).replace('%', ' %')}" in page
        assert depth_m.between(39.5, 80.5).all()
        assert np.loadtxt(Path(out) / "track.tum")[:, 3] == pytest.approx(-depth_m, abs=1e-3)  # also without a truth
        assert f",{-depth_m[0]:.2f}" in (Path(out) / "track.kml").read_text()
    assert drms_m[1] == pytest.approx(drms_m[0], rel=0.05)


def test_the_slant_range_counts_from_the_depth_of_the_head(dive):
    """Of a vehicle at 40 to 80 m: the farther below the head, the less of the range is the same scatter."""
    log, settings = usbldr.open_log(str(dive)), usbldr.RunSettings(smooth=True, calibrate=())
    line = usbldr.timeline(log)
    track, found = usbldr.replay(log, line, "adf", settings), usbldr.resolve(log, line, "adf", settings)
    assert log.settings.usbl.head is not None
    percent = []
    for depth_m in (60.0, 5.0):
        head = msgspec.structs.replace(log.settings.usbl.head, depth_m=depth_m)
        usbl = msgspec.structs.replace(log.settings.usbl, head=head)
        placed = replace(log, settings=msgspec.structs.replace(log.settings, usbl=usbl))
        percent.append(Run(placed, line, found, ScoredTrack(track, None)).fix_statistics.scatter.drms_percent)
    assert percent[1] < 0.95 * percent[0]


def test_a_head_at_an_unknown_place_is_asked_for(tmp_path):
    assert "state head under [usbl]" in str(run("calibrate-usbl", SAMPLES / "lawnmower.mcap").exception)


UNKNOWN = np.array([0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0])

MOUNT_DEG = {"mount_heading_deg": 1.5, "mount_pitch_deg": -0.6, "mount_roll_deg": 0.8}
LATE_S = {"attitude_latency_s": 0.1, "position_latency_s": 0.3}
TRUE = MOUNT_DEG | {"scale": 0.99, "arm_starboard_m": 1.2, "arm_forward_m": -8.0} | LATE_S
ARM_FRD_M = [-8.0, 1.2, 0.0]
ORIGIN = (-33.9, 151.4, 0.0)
BEACON_NED_M = np.array([-5.0, 10.0, 100.0])
T0_S = 1_767_225_600.0
PERIOD_S = 0.1


def box_in(seed):
    """Return times and records: antenna (degrees) and attitude (NED from FRD) 10 times a second, fixes along FRD."""
    rng = np.random.default_rng(seed)
    there, back = [(90, 2.0, 0), (22.5, 2.0, 4)], [(360, 0.5, 0), (22.5, 2.0, -4)]
    across = [(10, 2.0, 4.5), (112.5, 2.0, 0), (30, 2.0, -4.5)]
    legs = 4 * there + across + 4 * back  # seconds, metres and degrees per second
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
    pinged = np.arange(20, len(t) - 20, 20)
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
    save(folder / "nav.csv", {"epoch": T0_S + t + 0.3, "latitude": lat, "longitude": lon})
    save(folder / "mru.csv", {"epoch": T0_S + t + 0.1, "q0": qw, "q1": qx, "q2": qy, "q3": qz})
    x, y, z = measured.T
    save(folder / "beacon.csv", {"epoch": T0_S + ping_s, "X": x, "Y": y, "Z": z})
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
    return pd.to_datetime(T0_S * 1e9 + np.round(seconds * 1e9)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


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
    assert found["before"]["cep50_m"] > 5 * found["after"]["cep50_m"]
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
    below = np.column_stack([axes.direction[:, :2], -np.abs(axes.direction[:, 2])])  # an elevation has no sign
    assert angles.direction == pytest.approx(below, abs=1e-9)
    assert angles.ship.position_m == pytest.approx(axes.ship.position_m, abs=1e-6)
    assert angles.ship.attitude_deg == pytest.approx(axes.ship.attitude_deg, abs=1e-6)
