"""The first log of a new user: a map of unknown origin is no error of a filter; without a DVL the fixes are judged."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commands import findings, output_of, report_of, run
from curved import curved_dive
from logs import MAP
from recordings import Row, write_mcap
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.reading.read import read_log


def shifted(rows: list[Row], east_m: float, north_m: float) -> list[Row]:
    """Return the rows with the fixes counted from another point of the map."""
    moved = {"point.x": -east_m, "point.y": -north_m}
    return [
        (t, topic, kind, {k: v + moved.get(k, 0.0) if k in moved else v for k, v in values.items()})
        for t, topic, kind, values in rows
    ]


def replayed(folder: Path, name: str, rows: list[Row], toml: str = "", *options: str) -> dict[str, Any]:
    log = write_mcap(folder / f"{name}.mcap", rows)
    (folder / f"{name}.usbldr.toml").write_text(toml, encoding="utf-8")
    run("replay", log, "--filter", "adf", "--output", folder / name, *options)
    return report_of(folder / name)


def test_an_unknown_origin_moves_no_number_of_the_report(tmp_path: Path) -> None:
    rows = curved_dive(gps=True)
    here = replayed(tmp_path, "here", rows)
    far = replayed(tmp_path, "far", shifted(rows, 192.0, -5000.0))

    assert far["alignment"]["name"] == here["alignment"]["name"] == "shift"
    names = ("mean_horizontal_m", "rmse_horizontal_m", "nees_mean", "max_horizontal_m")
    for name in names:
        assert far["metrics"][name] == pytest.approx(here["metrics"][name], abs=1e-5), name
    assert "constant shift removed" in far["verdict"]
    assert far["verdict"] == here["verdict"]
    page = (tmp_path / "far" / "report.md").read_text(encoding="utf-8")
    assert "state origin_lat_deg and origin_lon_deg under [map]" in page


def test_with_a_stated_origin_the_shift_counts_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    right = replayed(tmp_path, "right", curved_dive(gps=True), MAP)
    wrong = replayed(tmp_path, "wrong", shifted(curved_dive(gps=True), 30.0, 40.0), MAP)

    assert right["alignment"]["name"] == wrong["alignment"]["name"] == "none"
    assert wrong["metrics"]["shift_m"] == pytest.approx(50.0, abs=0.5)
    assert wrong["metrics"]["unshifted_mean_m"] == pytest.approx(right["metrics"]["unshifted_mean_m"], abs=1e-3)
    assert any("a constant shift (30." in text and "the origin under [map]" in text for text in wrong["warnings"])


def test_a_track_on_an_unknown_map_has_no_latitudes_but_lies_on_the_truth_in_the_map_files(tmp_path: Path) -> None:
    replayed(tmp_path, "far", shifted(curved_dive(gps=True), 3000.0, 0.0))

    header, first = (tmp_path / "far" / "track_5hz.csv").read_text().splitlines()[:2]
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    shapes = json.loads((tmp_path / "far" / "track.geojson").read_text())["features"]
    lines = {one["properties"]["role"]: one["geometry"]["coordinates"] for one in shapes}
    ends = np.array([lines["estimate"][0], lines["truth"][0][0]])

    assert cells["lat_deg"] == cells["lon_deg"] == ""
    assert np.ptp(ends, axis=0) == pytest.approx([0, 0], abs=2e-4)  # 20 m, of 3000; the track begins 10 s earlier


def test_gps_does_not_aid_on_a_map_that_it_has_no_place_on(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "dive.mcap", curved_dive(gps=True))

    fault = run("replay", log, "--filter", "adf", "--aid", "gps@0:20").exception

    assert isinstance(fault, UsageError)
    assert "state origin_lat_deg and origin_lon_deg under [map]" in str(fault)


def test_a_local_truth_beside_latitudes_has_an_unknown_place(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    truth.write_text("time_ns,east_m,north_m\n1600000000000000000,0,0\n1600000009000000000,0,0\n", encoding="utf-8")
    latlon = "[usbl]\nhead = { lat_deg = 45.0, lon_deg = 7.0 }\n"
    log = write_mcap(tmp_path / "dive.mcap", curved_dive())
    known: list[bool] = []
    for toml in ("", latlon, MAP + latlon):
        (tmp_path / "dive.usbldr.toml").write_text(f'{toml}[truth]\nfile = "truth.csv"\n', encoding="utf-8")
        read = read_log(log).truth
        known.append(not read.place_unknown)

    assert known == [True, False, True]


ADVICE = "--filter usbl judges the raw fixes"


@pytest.fixture(params=["/dvl", "/imu"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A dive without one of the two topics."""
    return write_mcap(tmp_path / "dive.mcap", [row for row in curved_dive(gps=True) if row[1] != request.param])


def test_the_raw_fixes_have_the_errors_of_the_whole_log(log: Path, tmp_path: Path) -> None:
    whole = write_mcap(tmp_path / "whole.mcap", curved_dive(gps=True))
    errors: list[float] = []
    for one in (log, whole):
        (tmp_path / f"{one.stem}.usbldr.toml").write_text(MAP, encoding="utf-8")
        reported = json.loads(output_of("replay", one, "-f", "usbl", "--json", "-o", tmp_path / one.stem))
        errors.append(reported["metrics"]["mean_horizontal_m"])

    assert errors[0] == pytest.approx(errors[1], abs=1e-9)


def test_what_needs_the_sensor_says_so_and_what_still_works(log: Path) -> None:
    fault = run("replay", log, "-f", "adf").exception

    assert isinstance(fault, LogError)
    assert ADVICE in str(fault)
    assert ADVICE in run("info", log).stdout
    found = findings(log)
    assert ADVICE in found["SENSOR-MISSING"]["text"]
    assert found["SENSOR-MISSING"]["level"] == "error"


def test_init_asks_for_the_sensor_in_a_file_with_which_the_fixes_are_judged(log: Path, tmp_path: Path) -> None:
    fault = run("init", log).exception
    missing = next(role for role in ("dvl", "compass") if f"no topic is known to be {role};" in str(fault))

    text = (tmp_path / "dive.usbldr.toml").read_text(encoding="utf-8")
    assert isinstance(fault, LogError)
    assert text.count('topic = "none"') == 1  # the depth
    assert "without it, only --filter usbl works" in text
    assert "usbl: mean horizontal error" in output_of("replay", log, "-f", "usbl", "-q", "-o", tmp_path / "run")
    output_of("init", log, f"--{missing}", "none", "--force")
