"""Dives along a parallel, whose end is known in closed form: the compass reads east all the way."""

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs import on_map, read_as, with_table
from recordings import saved_lines
from textbook import radii_m
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.dead_reckoning import dr
from usbldr.filters.replay.online import OnlineFilter
from usbldr.filters.replay.prior import find_anchor
from usbldr.io.conventions.map_north import headings_on_plane
from usbldr.io.geodesy import Origin, OriginKind, to_plane
from usbldr.io.log import Log
from usbldr.io.messages import layouts
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import Request, read_log
from usbldr.io.writers.export import export

T0_S, SPEED_MPS, SECONDS, LON_DEG = 1_600_000_000, 2.0, 10_000, 7.0
LATITUDES = [45.0, -33.0, 80.0]


def parallel_m(lat_deg: float, along_m: float) -> np.ndarray:
    """Return the point of the plane at a distance east of its origin along the origin's parallel."""
    lon = LON_DEG + math.degrees(along_m / (radii_m(lat_deg)[1] * math.cos(math.radians(lat_deg))))
    return np.concatenate(to_plane(Origin(lat_deg, LON_DEG, OriginKind.MAP), np.array([lat_deg]), np.array([lon])))


def dive(folder: Path, lat_deg: float, fixes: str) -> Log:
    """Write a dive of 20 km to the east with fixes in its first seconds only."""
    folder.mkdir(exist_ok=True)
    seconds = range(T0_S, T0_S + SECONDS + 1)
    dvl = ["time_ns,starboard_mps,forward_mps", *(f"{s}000000000,0,{SPEED_MPS}" for s in seconds)]
    compass = ["time_ns,heading_deg", *(f"{s}000000000,90" for s in seconds)]
    for name, lines in (("dvl", dvl), ("compass", compass), ("usbl", fixes.split())):
        saved_lines(folder / f"{name}.csv", lines)
    return read_as(folder, on_map(lat_deg, LON_DEG))


def by_latitude(lat_deg: float) -> str:
    step_deg = math.degrees(SPEED_MPS / 6378137.0 / math.cos(math.radians(lat_deg)))
    rows = (f"{T0_S + k}000000000,{lat_deg},{LON_DEG + k * step_deg:.9f}" for k in range(5))
    return "time_ns,lat_deg,lon_deg " + " ".join(rows)


def end_m(log: Log) -> np.ndarray:
    line = timeline(log)
    anchor = find_anchor("start", line, Parameters(), None)
    return dr(line, anchor.position_m).position_m[-1]


@pytest.mark.parametrize("lat_deg", LATITUDES)
def test_dead_reckoning_due_east_stays_on_its_parallel(tmp_path: Path, lat_deg: float) -> None:
    end = end_m(dive(tmp_path, lat_deg, by_latitude(lat_deg)))

    expected = parallel_m(lat_deg, SPEED_MPS * SECONDS)
    assert abs(expected[1]) > 20  # on the plane the parallel bends by as much
    assert end == pytest.approx(expected, abs=0.3)


def test_headings_of_a_log_with_a_frame_of_its_own_count_from_the_north_of_that_frame(tmp_path: Path) -> None:
    fixes = "time_ns,east_m,north_m " + " ".join(f"{T0_S + k}000000000,{SPEED_MPS * k},0" for k in range(5))

    assert end_m(dive(tmp_path, 80.0, fixes)) == pytest.approx([SPEED_MPS * SECONDS, 0.0], abs=1e-6)


def test_an_export_replays_to_the_same_track(tmp_path: Path) -> None:
    log = dive(tmp_path / "dive", 80.0, by_latitude(80.0))

    export(log, tmp_path / "out")

    assert end_m(read_log(tmp_path / "out", Request())) == pytest.approx(end_m(log), abs=1e-3)


def test_far_fixes_move_the_headings_but_two_wrong_ones_do_not(tmp_path: Path) -> None:
    """The dive begins 20 km west of the origin; two of its fixes lie on the other side of the earth."""
    lon = LON_DEG - math.degrees(20e3 / 6378137.0 / math.cos(math.radians(80.0)))
    places = [lon, lon + 150.0, lon, lon + 150.0, lon]
    fixes = [f"{T0_S + k}000000000,80.0,{place:.9f}" for k, place in enumerate(places)]

    line = timeline(dive(tmp_path, 80.0, "time_ns,lat_deg,lon_deg " + " ".join(fixes)))

    assert np.degrees(line.yaw_rad[0]) == pytest.approx(-90.0 - 1.015, abs=0.01)  # 20 km / radius * tan(80 deg)


def test_later_fixes_place_the_headings_that_follow(tmp_path: Path) -> None:
    """Against a current the vehicle stays where it is: at the origin no heading is turned."""
    fixes = "time_ns,lat_deg,lon_deg " + " ".join(f"{T0_S + k}000000000,80.0,{LON_DEG}" for k in range(0, SECONDS, 10))

    line = timeline(dive(tmp_path, 80.0, fixes))

    np.testing.assert_allclose(np.degrees(line.yaw_rad[::5]), -90.0, atol=0.01)


@pytest.mark.parametrize("lat_deg", LATITUDES)
def test_a_filter_in_a_loop_of_ones_own_knows_the_convergence_by_the_latitude_of_its_origin(lat_deg: float) -> None:
    online = OnlineFilter("ekf", Parameters(), origin_lat_deg=lat_deg)
    online.heading(0.0, 90.0, 0.1)
    online.velocity(0.0, 0.0, 20.0, 0.01)
    online.fix(0.0, 0.0, 0.0, 0.01 * np.eye(2))
    for second in range(1, 1001):
        online.velocity(float(second), 0.0, 20.0, 0.01)
        online.heading(float(second), 90.0, 0.1)

    assert online.estimate.position_m == pytest.approx(parallel_m(lat_deg, 20e3), abs=1.0)
    assert online.estimate.heading_deg == pytest.approx(90.0, abs=0.05)


def test_headings_turn_alike_in_blocks_of_any_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = dive(tmp_path, 80.0, by_latitude(80.0))
    compass = log.tables["compass"].copy()
    compass.loc[[0, 6, 7, 8, 5000], "heading_deg"] = np.nan
    log = with_table(log, "compass", compass)
    whole = headings_on_plane(log).tables["compass"]

    monkeypatch.setattr(layouts, "BLOCK_RECORDS", 7)
    in_blocks = headings_on_plane(log).tables["compass"]

    assert whole["heading_deg"].std() > 0.2
    pd.testing.assert_frame_equal(in_blocks, whole, check_exact=True)


def test_the_headings_of_a_dense_compass_are_turned_in_little_memory(tmp_path: Path) -> None:
    log = dive(tmp_path, 80.0, by_latitude(80.0))
    t = np.linspace(0, SECONDS, 1_000_000)
    compass = pd.DataFrame({"time_s": t, "received_s": t, "heading_deg": 90.0, "sd_deg": 0.1})
    log = with_table(log, "compass", compass)

    tracemalloc.start()
    turned = headings_on_plane(log)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert turned.tables["compass"]["heading_deg"].iloc[-1] < 89.1
    assert peak < 40 * len(t)  # five columns; 136 bytes were used when all were turned at once
