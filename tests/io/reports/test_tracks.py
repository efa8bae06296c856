import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.tools import file_interface

from textbook import radii_m
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.types import Trajectory, Truth
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.reports import tracks
from usbldr.io.reports.tracks import track_table, write_csv, write_geojson, write_kml, write_tum

START_NS = 1_474_477_150_374_442_123
ORIGIN = Origin(39.718033330, 2.587106667, OriginKind.MAP)
SECONDS = np.arange(0.0, 200.0)
PSI = np.linspace(0.0, -7.0, 200)  # turns clockwise once and a bit

TRACK = Trajectory(
    "ckf",
    ("psi", "u", "v", "x", "y"),
    SECONDS,
    np.column_stack([PSI, 0.1 * np.ones(200), np.ones(200), 3 * SECONDS, 100 * np.sin(SECONDS / 20)]),
    np.broadcast_to(np.diag([1e-4, 1e-4, 1e-4, 4.0, 9.0]), (200, 5, 5)),
)
TRUTH = Truth(SECONDS, TRACK.position_m + np.array([1.0, -2.0]), np.full(200, np.nan), "gps", "/gps")


def test_a_stamp_in_a_tum_file_is_unix_time_to_the_nanosecond(tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", START_NS, np.array([0.0, 0.2, 1e5 + 1e-9]), np.zeros((3, 2)))

    stamps = [line.split()[0] for line in (tmp_path / "t.tum").read_text().splitlines()]

    assert stamps == ["1474477150.374442123", "1474477150.574442123", "1474577150.374442124"]


def test_evo_reads_the_tum_file_with_east_as_x_and_the_bow_as_x_of_the_body(tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", START_NS, SECONDS, TRACK.position_m, PSI, np.where(SECONDS > 10, 3.5, np.nan))

    read = file_interface.read_tum_trajectory_file(tmp_path / "t.tum")

    assert read.positions_xyz[:, :2] == pytest.approx(TRACK.position_m, abs=1e-6)
    assert read.positions_xyz[:, 2] == pytest.approx(np.where(SECONDS > 10, -3.5, 0.0))
    bow = np.array([pose[:3, 0] for pose in read.poses_se3])  # the body's x axis in east, north, up
    assert bow[:, 0] == pytest.approx(-np.sin(PSI), abs=1e-6)
    assert bow[:, 1] == pytest.approx(np.cos(PSI), abs=1e-6)


@pytest.mark.parametrize("align", ["none", "rigid"])
def test_evo_finds_the_same_errors_in_the_written_files(tmp_path: Path, align: str) -> None:
    rng = np.random.default_rng(0)
    noisy = Truth(SECONDS, TRUTH.position_m + rng.normal(0, 3, (200, 2)), TRUTH.sd_m, "gps", "/gps")
    c, s = math.cos(0.3), math.sin(0.3)
    turned = Truth(SECONDS, noisy.position_m @ np.array([[c, -s], [s, c]]), TRUTH.sd_m, "gps", "/gps")

    ours = evaluate(TRACK, turned, align=align)
    unaligned = evaluate(TRACK, turned)
    write_tum(tmp_path / "track.tum", START_NS, unaligned.time_s, unaligned.estimate_m)
    write_tum(tmp_path / "truth.tum", START_NS, unaligned.time_s, unaligned.truth_m)
    reference = file_interface.read_tum_trajectory_file(tmp_path / "truth.tum")
    estimate = file_interface.read_tum_trajectory_file(tmp_path / "track.tum")
    reference, estimate = sync.associate_trajectories(reference, estimate)
    if align == "rigid":
        estimate.align(reference)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))

    for name in ("rmse", "mean", "median", "std", "min", "max"):
        assert ours.flat()[f"{name}_horizontal_m"] == pytest.approx(ape.get_all_statistics()[name], abs=2e-6)


def test_the_track_table_holds_compass_headings_and_leaves_the_unknown_empty(tmp_path: Path) -> None:
    write_csv(tmp_path / "t.csv", track_table(TRACK, None))

    table = pd.read_csv(tmp_path / "t.csv")

    assert list(table) == [
        *("time_s", "east_m", "north_m", "sd_east_m", "sd_north_m", "cov_en_m2"),
        *("heading_deg", "starboard_mps", "forward_mps", "lat_deg", "lon_deg"),
    ]
    assert table.heading_deg.to_numpy() == pytest.approx(np.degrees(-PSI) % 360, abs=1e-4)
    assert (table.sd_east_m == 2).all()
    assert (table.sd_north_m == 3).all()
    assert table.lat_deg.isna().all()


@pytest.mark.parametrize("count", [0, 1, 6, 7])
def test_a_table_is_written_the_same_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(tracks, "ROWS", 3)
    table = pd.DataFrame({"time_s": np.arange(count) / 7, "outcome": "used", "sd_m": np.full(count, np.nan)})

    write_csv(tmp_path / "table.csv", table)

    rows = [f"{round(k / 7, 9)!r},used,\n" for k in range(count)]
    assert (tmp_path / "table.csv").read_bytes().decode() == "".join(["time_s,outcome,sd_m\n", *rows])


def test_a_plain_track_has_neither_sigma_nor_heading() -> None:
    table = track_table(Trajectory("usbl", ("x", "y"), SECONDS, TRACK.position_m, None), ORIGIN)

    assert table[["sd_east_m", "cov_en_m2", "heading_deg", "forward_mps"]].isna().all(axis=None)
    assert table.lat_deg.notna().all()


def test_latitude_and_longitude_grow_north_and_east_by_the_radii_of_the_ellipsoid() -> None:
    table = track_table(TRACK, ORIGIN)

    meridian, vertical = radii_m(ORIGIN.lat_deg)
    north = np.radians(table.lat_deg - ORIGIN.lat_deg) * meridian
    east = np.radians(table.lon_deg - ORIGIN.lon_deg) * vertical * math.cos(math.radians(ORIGIN.lat_deg))
    assert north.to_numpy() == pytest.approx(table.north_m.to_numpy(), abs=0.03)
    assert east.to_numpy() == pytest.approx(table.east_m.to_numpy(), abs=0.03)


def fixes(time_s) -> pd.DataFrame:
    return pd.DataFrame({"time_s": time_s, "east_m": 3.0, "north_m": 4.0, "outcome": "used"})


def test_geojson_holds_the_track_the_truth_cut_at_its_gaps_and_each_fix(tmp_path: Path) -> None:
    kept = (SECONDS < 50) | (SECONDS > 120)
    truth = Truth(SECONDS[kept], TRUTH.position_m[kept], TRUTH.sd_m[kept], "gps", "/gps")

    write_geojson(tmp_path / "t.geojson", TRACK, truth, fixes([1.0, 2.5]), ORIGIN)
    features = json.loads((tmp_path / "t.geojson").read_text())["features"]

    assert [f["geometry"]["type"] for f in features] == ["LineString", "MultiLineString", "Point", "Point"]
    assert [len(part) for part in features[1]["geometry"]["coordinates"]] == [50, 79]
    lon, lat = features[0]["geometry"]["coordinates"][0]
    assert (lat, lon) == pytest.approx((ORIGIN.lat_deg, ORIGIN.lon_deg))  # longitude first, RFC 7946
    assert features[3]["properties"] == {"name": "USBL fix", "role": "fix", "time_s": 2.5, "outcome": "used"}


def test_a_map_shows_a_fast_track_once_a_second_and_nothing_undefined(tmp_path: Path) -> None:
    fast = np.arange(0, 501) / 5
    points = np.column_stack([fast, fast])
    points[:100] = np.nan

    write_geojson(tmp_path / "t.geojson", Trajectory("pf", ("x", "y"), fast, points, None), None, fixes([]), ORIGIN)
    (feature,) = json.loads((tmp_path / "t.geojson").read_text())["features"]

    assert len(feature["geometry"]["coordinates"]) == 81  # 20 s to 100 s


def test_kml_is_well_formed_and_holds_the_same_lines(tmp_path: Path) -> None:
    write_kml(tmp_path / "t.kml", "ckf on <dive & co>", TRACK, TRUTH, ORIGIN)

    root = ElementTree.parse(tmp_path / "t.kml").getroot()

    space = "{http://www.opengis.net/kml/2.2}"
    assert root.findtext(f".//{space}name") == "ckf on <dive & co>"
    lines = [line.text.split() for line in root.iter(f"{space}coordinates") if line.text]
    assert [len(line) for line in lines] == [200, 200]
    assert [float(x) for x in lines[0][0].split(",")] == pytest.approx([ORIGIN.lon_deg, ORIGIN.lat_deg])
    write_kml(tmp_path / "t.kml", "deep", TRACK, TRUTH, ORIGIN, np.linspace(0.0, 40.0, len(TRACK.time_s)))
    estimate, truth = ElementTree.parse(tmp_path / "t.kml").getroot().iter(f"{space}LineString")
    assert estimate.findtext(f"{space}altitudeMode") == "absolute"
    assert (estimate.findtext(f"{space}coordinates") or "").split()[-1].split(",")[2] == "-40.0"
    assert truth.findtext(f"{space}altitudeMode") is None  # the GPS of a ship is at the surface
