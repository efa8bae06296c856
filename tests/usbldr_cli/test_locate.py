"""``usbldr locate``: closed forms of motion, arm and radius, the times that it reads, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import usbldr
from checkout import SAMPLES
from commands import output_of, report_of, run
from usbldr.io.geodesy import Origin, OriginKind, to_plane
from usbldr.io.reports.locate import BEFORE, OUTSIDE, SmoothedRun, located, radius, read_smoothed_run
from usbldr.io.reports.run import ScoredTrack
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log


def circling(step_s=1.0, radius_m=20.0, speed_mps=2.0):
    """A track on a circle, clockwise from its westernmost point, with a roll of 10 and a pitch of -5 degrees."""
    time_s = np.arange(0, 61, step_s)
    angle = speed_mps / radius_m * time_s
    place = {"east_m": radius_m * (1 - np.cos(angle)), "north_m": radius_m * np.sin(angle), "depth_m": 30.0}
    velocity = {"starboard_mps": 0.0, "forward_mps": speed_mps}
    attitude = {"heading_deg": np.degrees(angle) % 360, "roll_deg": 10.0, "pitch_deg": -5.0}
    sigmas = {"sd_east_m": 0.3, "sd_north_m": 0.4, "cov_en_m2": 0.05, "sd_heading_deg": 2.0}
    sigmas |= {"cov_east_heading_mdeg": 0.1, "cov_north_heading_mdeg": -0.2}
    table = pd.DataFrame({"time_s": time_s, **place, **velocity, **attitude, **sigmas})
    return SmoothedRun(Path("run"), 10**18, None, table, 5.0, (("dvl", 20.0, 30.0),), Path("log"))


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


CHEAPLY = ("--filter", "ekf", "--calibrate", "none", "--plots", "none", "-q")


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dive")
    output_of("replay", "lawnmower", *CHEAPLY, "--smooth", "-o", folder / "run")
    return folder / "run"


def test_what_a_run_keeps_for_it_is_less_than_10_megabytes_an_hour(dive):
    length_h = np.ptp(pd.read_csv(dive / "track_5hz.csv").time_s) / 3600
    kept = [dive / name for name in ("track_5hz.csv", "pose_5hz.csv", "fixes.csv", "report.json")]
    assert sum(file.stat().st_size for file in kept) < 10e6 * length_h


def test_rows_of_a_table_keep_their_columns_in_every_format(dive, tmp_path):
    (tmp_path / "samples.csv").write_text(
        "time,bottle,lat_deg\n2026-01-01T00:01:40.5Z,7,60.1234567\n2026-01-01T00:00:00Z,8,60\n2027-01-01,9,60\n"
    )
    files = [tmp_path / f"found{end}" for end in (".csv", ".geojson", ".kml")]
    args = [word for file in files for word in ("-o", file)]
    said = run("locate", dive, "--at", tmp_path / "samples.csv", *args).stderr
    assert said == "usbldr: of 3 times, outside the run and without a position: 1; with another note: 1\n"
    table = pd.read_csv(files[0])
    assert list(table.bottle) == [7, 8, 9]
    assert table.own_lat_deg[0] == 60.1234567
    track = pd.read_csv(dive / "track_5hz.csv").set_index("time_s")
    around = track.loc[[100.4, 100.6], "east_m"]
    assert around.min() - 0.01 <= table.east_m[0] <= around.max() + 0.01
    assert table.note[2] == OUTSIDE
    features = json.loads(files[1].read_text())["features"]
    assert [one["properties"]["bottle"] for one in features] == [7, 8]
    assert features[0]["geometry"]["coordinates"] == pytest.approx([table.lon_deg[0], table.lat_deg[0]])
    assert files[2].read_text().count("<Placemark>") == 2


def test_photos_are_timed_by_exif_and_the_clock(dive, tmp_path):
    """Taken 100.25 s after the start by a clock of UTC+2 that is 7 s ahead, as it says itself or a photo shows."""
    folder = tmp_path / "photos"
    folder.mkdir()
    image, exif = Image.new("RGB", (4, 4)), Image.Exif()
    image.save(folder / "two.jpg")
    untimed = str(run("locate", dive, "--at", folder).exception)
    assert untimed == f"{folder}: no time (EXIF DateTimeOriginal) in two.jpg"
    exif.get_ifd(34665).update({36867: "2026:01:01 02:01:47", 37521: "25", 36881: "+02:00"})
    image.save(folder / "one.jpg", exif=exif)
    for clock in ("7", "one.jpg=2026-01-01T00:01:40.25Z", "one.jpg=2026-01-01 00:01:40.250"):
        done = run("locate", dive, "--at", folder, "--clock", clock, "-o", tmp_path / "found.csv", "--force")
        assert done.stderr == "usbldr: left out, without a time (EXIF DateTimeOriginal): two.jpg\n"
        found = pd.read_csv(tmp_path / "found.csv")
        assert list(found.name) == ["one.jpg"]
        assert found.time_ns[0] == 1_767_225_600_000_000_000 + 100_250_000_000
    for clock, fault in (("two.jpg=2026-01-01", "two.jpg is no photo"), ("noon", "neither"), ("nan", "neither")):
        assert fault in str(run("locate", dive, "--at", folder, "--clock", clock).exception)


@pytest.mark.long
def test_the_radius_holds_the_true_places_of_a_sensor_in_simulated_dives(tmp_path):
    """1,000 random times of 12 dives whose errors are what a run assumes, 2 m ahead of the vehicle's reference point.

    Errors last within a dive, so that its share scatters by 0.045 and its NEES by 0.6, and their means by 0.013 and
    0.17. The bounds are 3.5 of these. Sigmas that are wrong by a fifth give a NEES of 1.4 or 3.1.
    """
    paper, arm = find_scenario("paper-drawn"), (0.5, 2.0, 0.0)
    carried = replace(paper, gps=replace(paper.gps, lever_m=arm))  # the truth is the sensor's
    held, nees = [], []
    for seed in range(12):
        log = simulated_log(carried, seed)
        line, settings = usbldr.timeline(log, fast_hz=1.0), usbldr.RunSettings(smooth=True, calibrate=("scale",))
        scored = ScoredTrack(usbldr.replay(log, line, "ekf", settings), None)
        there = read_smoothed_run(usbldr.write_run(tmp_path / str(seed), log, line, scored))
        time_s = np.random.default_rng(seed).uniform(line.time_s[0], line.time_s[-1], 1000)
        found = located(there, log.start_ns + np.round(time_s * 1e9).astype(np.int64), arm)
        true_m = [np.interp(time_s, log.truth.time_s, axis) for axis in log.truth.position_m.T]
        off_m = found[["east_m", "north_m"]].to_numpy() - np.column_stack(true_m)
        cov_m2 = found[["sd_east_m", "cov_en_m2", "cov_en_m2", "sd_north_m"]].to_numpy() ** [2, 1, 1, 2]
        nees.append(np.mean(np.einsum("ni,nij,nj->n", off_m, np.linalg.inv(cov_m2.reshape(-1, 2, 2)), off_m)))
        held.append(np.mean(np.hypot(*off_m.T) <= found.radius95_m))
    assert 0.90 < np.mean(held) < 0.99
    assert 1.4 < np.mean(nees) < 2.6


def test_places_err_as_the_track_does(dive, tmp_path):
    truth = pd.read_csv(dive / "truth.tum", sep=" ", header=None, dtype={0: str})
    stamps = truth[0].str.replace(".", "").rename("time_ns").astype("int64")
    stamps.to_csv(tmp_path / "times.csv", index=False)
    output_of("locate", dive, "--at", tmp_path / "times.csv", "-o", tmp_path / "found.csv")
    found, report = pd.read_csv(tmp_path / "found.csv"), report_of(dive)
    for axis, column in (("east", 1), ("north", 2)):
        error_m = found[f"{axis}_m"] - truth[column]
        assert np.sqrt(np.mean(error_m**2)) == pytest.approx(report["metrics"][f"rmse_{axis}_m"], abs=1e-3)


def test_what_cannot_be_located_is_one_sentence(dive, tmp_path):
    table = tmp_path / "samples.csv"
    table.write_text("moment\n1\n")
    assert str(run("locate", dive, "--at", table).exception).startswith(f"{table}: no column of times: name one ")
    table.write_text("time_s\n1\nnoon\n")
    assert "row 3: 'noon' is no time" in str(run("locate", dive, "--at", table).exception)
    assert "not a run directory" in str(run("locate", tmp_path, "--at", table).exception)
    assert "is no file and no folder" in str(run("locate", dive, "--at", "/camera").exception)
    output_of("replay", SAMPLES / "lawnmower_turn_db3", *CHEAPLY, "-o", tmp_path / "forward")
    refused = str(run("locate", tmp_path / "forward", "--at", table).exception)
    assert "is not smoothed" in refused
    assert "--smooth --force" in refused


def photo(path, moment, order="<"):
    """Write a JPEG with a maker note whose bytes hold an offset into its EXIF block, taken at a moment in UTC."""
    exif = Image.Exif()
    exif.endian = order
    exif[271] = "Camera Works"
    exif.get_ifd(34665).update({36867: moment, 36881: "+00:00", 37500: b"maker\0\1\2" * 9})
    Image.effect_noise((64, 48), 60).convert("RGB").save(path, exif=exif, quality=90)


def scan(content):
    """Return the segments of a JPEG but for EXIF, and the picture data."""
    at, others = 2, []
    while content[at + 1] != 0xDA:
        length = int.from_bytes(content[at + 2 : at + 4], "big")
        others += [content[at : at + 2 + length]] if content[at + 1] != 0xE1 else []
        at += 2 + length
    return others, content[at:]


def test_copies_of_photos_have_the_place_and_the_same_picture(dive, tmp_path):
    """Pillow, which wrote nothing of the tags, reads the copy; a PNG gets a sidecar, one outside the run nothing."""
    folder, tagged = tmp_path / "photos", tmp_path / "tagged"
    folder.mkdir()
    photo(folder / "one.jpg", "2026:01:01 00:01:40")
    photo(folder / "two.JPG", "2026:01:01 00:02:40", ">")
    photo(folder / "late.jpg", "2027:01:01 00:01:40")
    exif = Image.Exif()
    exif[271] = "Camera Works"
    exif.get_ifd(34665).update({36867: "2026:01:01 00:01:40"})
    Image.new("RGB", (4, 4)).save(folder / "three.png", exif=exif)
    args = ("locate", dive, "--at", folder, "--lever-arm", 0, 0, -30, "-o", tmp_path / "found.csv", "--geotag", tagged)
    said = output_of(*args)
    assert "2 copies with GPS tags and 1 sidecars written" in said
    assert sorted(file.name for file in tagged.iterdir()) == ["one.jpg", "three.png.xmp", "two.JPG"]
    found = pd.read_csv(tmp_path / "found.csv").set_index("name")
    for name in ("one.jpg", "two.JPG"):
        before, after = (folder / name).read_bytes(), (tagged / name).read_bytes()
        assert scan(before) == scan(after)
        with Image.open(folder / name) as one, Image.open(tagged / name) as two:
            old, new = one.getexif(), two.getexif()
        assert dict(old.get_ifd(34665)) == dict(new.get_ifd(34665))
        assert new[271] == "Camera Works"
        gps = new.get_ifd(0x8825)
        degrees = [float(gps[tag] @ np.array([1, 1 / 60, 1 / 3600])) for tag in (2, 4)]
        assert (gps[1], gps[3]) == ("N", "W")
        assert degrees == pytest.approx([found.lat_deg[name], -found.lon_deg[name]], abs=1e-9)
        assert float(gps[31]) == pytest.approx(found.radius95_m[name], abs=1e-4)
    tags = ElementTree.parse(tagged / "three.png.xmp").getroot()[0][0].attrib
    degrees, minutes = tags["{http://ns.adobe.com/exif/1.0/}GPSLatitude"].split(",")
    assert int(degrees) + float(minutes[:-1]) / 60 == pytest.approx(found.lat_deg["three.png"], abs=1e-9)
    other = [*args[:8], *args[10:]]
    assert "exists already" in str(run(*other).exception)
    assert "the photos are there" in str(run(*other[:-1], folder, "--force").exception)


def test_a_footprint_is_where_the_corners_of_the_view_meet_the_bottom():
    """Against rays turned by scipy; without a tilt it is twice the altitude times the tangent of half an angle."""
    level = circling()
    level = level._replace(origin=Origin(45.0, -30.0, OriginKind.MAP))
    level.epochs["altitude_m"] = 6.0
    found = located(level, at([10.0]), (0.0, 2.0, -1.0), (60.0, 40.0))
    heading, pitch, roll = found.heading_deg[0], -5.0, 10.0
    turn = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    high = found.altitude_m[0]
    assert high == pytest.approx(6.0 - turn.apply([2.0, 0.0, 1.0])[2])
    text = found.footprint[0].removeprefix("POLYGON ((").removesuffix("))")
    lon, lat = np.array([place.split() for place in text.split(", ")], dtype=float).T
    assert level.origin is not None
    east, north = to_plane(level.origin, lat, lon)
    across, along = np.tan(np.radians([30.0, 20.0]))
    for corner, (s, f) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
        ray = turn.apply([f * along, s * across, 1.0])  # north, east, down
        n, e, _ = ray * high / ray[2]
        assert east[corner] == pytest.approx(found.east_m[0] + e, abs=1e-3)
        assert north[corner] == pytest.approx(found.north_m[0] + n, abs=1e-3)
    level.epochs[["roll_deg", "pitch_deg"]] = 0.0
    flat = located(level, at([10.0]), opening_deg=(60.0, 40.0))
    assert [flat.footprint_across_m[0], flat.footprint_along_m[0]] == pytest.approx([12 * across, 12 * along])
    level.epochs["roll_deg"] = 70.0
    assert located(level, at([10.0]), opening_deg=(60.0, 40.0)).footprint[0] == ""
