"""Eastings and northings of a grid against the series of the transverse Mercator projection, worked out here."""

import math
from pathlib import Path

import numpy as np
import pytest

from commands import drafted, output_of, run
from logs import MAP, codes, logged, logged_csv
from recordings import T0, Row, point
from textbook import utm_m
from usbldr.filters.errors import UsageError
from usbldr.io.log import Log

pytest.importorskip("pyproj")
LAT_DEG, LON_DEG, ZONE = 45.0009, 7.0004, 32  # of the map's origin: 45, 7
EAST_M, NORTH_M = math.radians(0.0004) * 6_388_838 * math.cos(math.radians(LAT_DEG)), 0.0009 * 111_132
GRID = 'grid = "EPSG:32632"'


def fix_at(place: tuple[float, float]) -> Row:
    return point(T0, *place)


@pytest.mark.parametrize(("frame", "order"), [("", (0, 1)), ('frame = "NED"\n', (1, 0))])
def test_a_fix_on_a_grid_lies_where_its_latitude_puts_it(tmp_path: Path, frame: str, order: tuple[int, int]) -> None:
    easting_northing = utm_m(LAT_DEG, LON_DEG, ZONE)
    row = fix_at((easting_northing[order[0]], easting_northing[order[1]]))
    log = logged(tmp_path, [row], f"{MAP}[usbl]\n{frame}{GRID}\n")

    found = log.tables["usbl"].iloc[0]
    assert [found["east_m"], found["north_m"]] == pytest.approx([EAST_M, NORTH_M], abs=0.01)
    assert log.convention("usbl", "grid").value == "EPSG:32632"
    assert "GRID-UNKNOWN" not in codes(log)


def test_a_grid_may_count_in_feet_and_a_place_of_zeros_is_none(tmp_path: Path) -> None:
    # EPSG:2263, Long Island in US survey feet: its false origin, 984 250 ft east at 40 deg 10' N, 74 deg W
    rows = f"time_ns,east_m,north_m\n{T0},300000.0,0.0\n{T0 + 1},0,0"
    toml = '[map]\norigin_lat_deg = 40.1666666667\norigin_lon_deg = -74.0\n[usbl]\ngrid = "EPSG:2263"\n'
    log = logged_csv(tmp_path, toml, usbl=rows)

    table = log.tables["usbl"]
    assert len(table) == 1
    assert float(np.hypot(table["east_m"], table["north_m"])[0]) < 3
    assert "1 at latitude and longitude 0" in codes(log)["USBL-INVALID"]


def in_utm(tmp_path: Path, truth: str) -> Log:
    """Return a log whose fix and GPS are latitudes and whose file of truth is on a grid."""
    easting, northing = utm_m(LAT_DEG, LON_DEG, ZONE)
    (tmp_path / "truth.csv").write_text(f"time_ns,x,y\n{T0},{easting},{northing}\n", encoding="utf-8")
    toml = f'{MAP}[truth]\nfile = "truth.csv"\n{truth}'
    return logged(tmp_path, [fix_at((1.0, 2.0))], toml)


def test_a_truth_file_may_be_on_a_grid(tmp_path: Path) -> None:
    log = in_utm(tmp_path, GRID)

    assert log.truth.position_m[0] == pytest.approx([EAST_M, NORTH_M], abs=0.01)
    assert log.convention("truth", "grid").value == "EPSG:32632"


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ("EPSG:99999", '[truth] grid = "EPSG:99999": pyproj knows no such code; epsg.io lists them'),
        ("EPSG:4326", '[truth] grid = "EPSG:4326": WGS 84 is no grid of eastings and northings'),
    ],
)
def test_what_is_no_grid_is_refused(tmp_path: Path, grid: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        in_utm(tmp_path, f'grid = "{grid}"')
    assert refused.value.text == said


def test_latitudes_and_offsets_from_a_head_are_on_no_grid(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\[usbl\] grid = .*/usbl holds no eastings and northings"):
        logged_csv(tmp_path, f"{MAP}[usbl]\n{GRID}\n", usbl=f"time_ns,lat_deg,lon_deg\n{T0},45,7")
    from_head = f'[usbl]\n{GRID}\nrelative_to = "head"\nhead = {{ east_m = 0, north_m = 0 }}'
    with pytest.raises(UsageError, match="positions on a grid do not count from the head"):
        logged(tmp_path, [fix_at((1.0, 2.0))], from_head)


def test_an_unnamed_grid_is_said_and_init_asks_for_its_code(tmp_path: Path) -> None:
    times = [T0 + k * 10**9 for k in range(5)]
    places = [utm_m(45.0, 7.0 + k * 1e-5, ZONE) for k in range(5)]
    rows = "\n".join(f"{t / 1e9:.1f},{e:.3f},{n:.3f}" for t, (e, n) in zip(times, places, strict=True))
    for name in ("usbl", "gps"):
        (tmp_path / f"{name}.csv").write_text(f"Time [s],Easting [m],Northing [m]\n{rows}\n", encoding="utf-8")

    output_of("init", tmp_path, "--dvl", "none", "--compass", "none")

    written = (tmp_path / "usbldr.toml").read_text(encoding="utf-8")
    assert written.count('# grid = "EPSG:?"                       # CHECK') == 2
    assert run("info", tmp_path).stdout.count("GRID-UNKNOWN") == 2
    (tmp_path / "usbldr.toml").write_text(written.replace('# grid = "EPSG:?"', GRID), encoding="utf-8")
    said = run("info", tmp_path).stdout
    assert "GRID-UNKNOWN" not in said
    assert "KEY-UNUSED" not in said


@pytest.mark.parametrize(
    ("easting", "northing"),
    [("Easting UTM 32N (m)", "Northing UTM 32N (m)"), ("utm_zone_32N_east_m", "utm_zone_32N_north_m")],
)
def test_a_zone_in_the_names_of_columns_is_proposed_as_the_grid(tmp_path: Path, easting: str, northing: str) -> None:
    rows = "".join(f"{1_600_000_000 + k},{500_000 + k},{5_000_000 + k}\n" for k in range(9))
    (tmp_path / "usbl.csv").write_text(f"Time [s],{easting},{northing}\n{rows}", encoding="utf-8")

    assert '\ngrid = "EPSG:32632"' in drafted(tmp_path / "usbl.csv", "--dvl", "none", "--compass", "none")
