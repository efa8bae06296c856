"""``usbldr locate``: closed forms of motion, arm and radius, the times that it reads, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from PIL import Image
from scipy.spatial.transform import Rotation

from usbldr.io.reports.locate import BEFORE, OUTSIDE, SmoothedRun, located, radius
from usbldr_cli.main import cli


def run(*args):
    return CliRunner().invoke(cli, [str(arg) for arg in args], standalone_mode=False)


def circling(step_s=1.0, radius_m=20.0, speed_mps=2.0):
    """A track on a circle, clockwise from its westernmost point, with a roll of 10 and a pitch of -5 degrees."""
    time_s = np.arange(0, 61, step_s)
    angle = speed_mps / radius_m * time_s
    table = {
        "time_s": time_s,
        "east_m": radius_m * (1 - np.cos(angle)),
        "north_m": radius_m * np.sin(angle),
        "heading_deg": np.degrees(angle) % 360,
        "starboard_mps": 0.0,
        "forward_mps": speed_mps,
        "sd_east_m": 0.3,
        "sd_north_m": 0.4,
        "cov_en_m2": 0.05,
        "depth_m": 30.0,
        "roll_deg": 10.0,
        "pitch_deg": -5.0,
        "sd_heading_deg": 2.0,
        "cov_east_heading_mdeg": 0.1,
        "cov_north_heading_mdeg": -0.2,
    }
    return SmoothedRun(Path("run"), 10**18, None, pd.DataFrame(table), 5.0, (("dvl", 20.0, 30.0),), Path("log"))


def at(time_s):
    return 10**18 + np.round(np.asarray(time_s) * 1e9).astype(np.int64)


def test_between_epochs_the_vehicle_moves_on_its_curve():
    time_s = np.random.default_rng(0).uniform(0, 60, 200)
    found = located(circling(), at(time_s))
    angle = 0.1 * time_s
    assert found.east_m.to_numpy() == pytest.approx(20 * (1 - np.cos(angle)), abs=1e-4)  # a chord errs by 25 mm
    assert found.north_m.to_numpy() == pytest.approx(20 * np.sin(angle), abs=1e-4)
    assert found.heading_deg.to_numpy() == pytest.approx(np.degrees(angle) % 360, abs=1e-6)


def test_a_lever_arm_turns_with_the_vehicle_and_takes_its_heading_error_along():
    arm = np.array([0.7, 2.0, -1.5])  # starboard, forward, up
    time_s = np.array([3.0, 33.3])
    bare, found = located(circling(), at(time_s)), located(circling(), at(time_s), tuple(arm))
    angles = np.column_stack([bare.heading_deg, np.full(2, -5.0), np.full(2, 10.0)])
    north, east, down = Rotation.from_euler("ZYX", angles, degrees=True).apply(arm[[1, 0, 2]] * [1, 1, -1]).T
    moved = found[["east_m", "north_m", "depth_m"]].to_numpy() - bare[["east_m", "north_m", "depth_m"]].to_numpy()
    assert moved == pytest.approx(np.column_stack([east, north, down]))
    state = np.array([[0.09, 0.05, 0.1], [0.05, 0.16, -0.2], [0.1, -0.2, 4.0]])  # east, north, heading in degrees
    for row in range(2):
        J = np.array([[1, 0, np.radians(north[row])], [0, 1, -np.radians(east[row])]])
        expected = J @ state @ J.T
        assert found.sd_east_m[row] ** 2 == pytest.approx(expected[0, 0])
        assert found.cov_en_m2[row] == pytest.approx(expected[0, 1])


def test_the_radius_holds_95_percent():
    shapes = np.array([np.diag([1.0, 1.0]), np.diag([4.0, 1e-9]), [[2.0, 0.8], [0.8, 1.0]]])
    found = radius(shapes)
    assert found[:2] == pytest.approx([np.sqrt(-2 * np.log(0.05)), 2 * 1.959964], rel=2e-3)
    drawn = np.random.default_rng(1).multivariate_normal([0, 0], shapes[2], 400_000)
    assert found[2] == pytest.approx(np.quantile(np.hypot(*drawn.T), 0.95), rel=5e-3)


def test_times_without_an_estimate_are_marked_and_not_extrapolated():
    found = located(circling(), at([-0.1, 2.0, 25.0, 40.0, 60.1]))
    assert list(found.note) == [OUTSIDE, BEFORE, "in an outage of the DVL", "", OUTSIDE]
    assert list(found.east_m.isna()) == [True, False, False, False, True]


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dive")
    done = run("replay", "lawnmower", "--filter", "ekf", "--smooth", "--plots", "none", "-o", folder / "run", "-q")
    assert done.exception is None
    return folder / "run"


def test_rows_of_a_table_keep_their_columns_in_every_format(dive, tmp_path):
    (tmp_path / "samples.csv").write_text(
        "time,bottle\n2026-01-01T00:01:40.5Z,7\n2026-01-01T00:00:00Z,8\n2027-01-01,9\n"
    )
    files = [tmp_path / f"found{end}" for end in (".csv", ".geojson", ".kml")]
    args = [word for file in files for word in ("-o", file)]
    done = run("locate", dive, "--at", tmp_path / "samples.csv", *args)
    assert done.exception is None
    table = pd.read_csv(files[0])
    assert list(table.bottle) == [7, 8, 9]
    track = pd.read_csv(dive / "track_5hz.csv").set_index("time_s")
    around = track.loc[[100.4, 100.6], "east_m"]
    assert around.min() - 0.01 <= table.east_m[0] <= around.max() + 0.01
    assert table.note[2] == OUTSIDE
    features = json.loads(files[1].read_text())["features"]
    assert [one["properties"]["bottle"] for one in features] == [7, 8]
    assert features[0]["geometry"]["coordinates"] == pytest.approx([table.lon_deg[0], table.lat_deg[0]])
    assert files[2].read_text().count("<Placemark>") == 2


def test_photos_are_timed_by_exif_and_the_clock(dive, tmp_path):
    """Taken 100.25 s after the start by a clock of UTC+2 that is 7 s ahead."""
    image, exif = Image.new("RGB", (4, 4)), Image.Exif()
    exif.get_ifd(34665).update({36867: "2026:01:01 02:01:47", 37521: "25", 36881: "+02:00"})
    (tmp_path / "photos").mkdir()
    image.save(tmp_path / "photos" / "one.jpg", exif=exif)
    done = run("locate", dive, "--at", tmp_path / "photos", "--clock", 7, "-o", tmp_path / "found.csv")
    assert done.exception is None
    found = pd.read_csv(tmp_path / "found.csv")
    assert list(found.name) == ["one.jpg"]
    assert found.time_ns[0] == 1_767_225_600_000_000_000 + 100_250_000_000
    image.save(tmp_path / "photos" / "two.jpg")
    assert "two.jpg states no time" in str(run("locate", dive, "--at", tmp_path / "photos").exception)


def test_what_cannot_be_located_is_one_sentence(dive, tmp_path):
    table = tmp_path / "samples.csv"
    table.write_text("moment\n1\n")
    assert "no column of times" in str(run("locate", dive, "--at", table).exception)
    table.write_text("time_s\n1\nnoon\n")
    assert "row 3: 'noon' is no time" in str(run("locate", dive, "--at", table).exception)
    assert "not a run directory" in str(run("locate", tmp_path, "--at", table).exception)
    assert "is no file and no folder" in str(run("locate", dive, "--at", "/camera").exception)
    run("replay", "lawnmower", "--filter", "ekf", "--plots", "none", "-o", tmp_path / "forward", "-q")
    refused = str(run("locate", tmp_path / "forward", "--at", table).exception)
    assert "is not smoothed" in refused
    assert "--smooth --force" in refused
