"""Simulated logs: the tables, the files by other people's readers, and the configuration beside them."""

import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from mcap.reader import make_reader

from commands import interrupt, output_of
from logs import refusal
from recordings import decoded
from usbldr.filters.errors import UsageError
from usbldr.filters.simulation.scenario import Timing
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.log import COLUMNS
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import START_NS, simulated_log, write_scenario
from usbldr.io.writers.write_log import log_format_of

PAPER = find_scenario("paper")
SHORT = dataclasses.replace(
    PAPER,
    duration_s=20.0,
    dvl=dataclasses.replace(PAPER.dvl, misalignment_rad=0.0123),
    compass=dataclasses.replace(PAPER.compass, bias_rad=0.0234),
    usbl=dataclasses.replace(PAPER.usbl, timing=Timing(latency_s=0.345, delay_s=1.25)),
)


def _stamp_s(message: Any) -> float:
    return message.header.stamp.sec - START_NS // 10**9 + message.header.stamp.nanosec / 1e9


def test_the_tables_are_the_simulation_in_canonical_columns() -> None:
    log, dive = simulated_log(SHORT, 5), simulate(SHORT, 5)

    columns = {name: COLUMNS[name] for name in ("dvl", "compass", "usbl", "gps")}
    assert {name: tuple(table.columns) for name, table in log.tables.items()} == columns
    np.testing.assert_array_equal(log.tables["dvl"][["starboard_mps", "forward_mps"]], dive.dvl.value)
    heading, yaw = np.radians(log.tables["compass"]["heading_deg"]), dive.compass.value[:, 0]
    np.testing.assert_allclose([np.cos(heading), np.sin(heading)], [np.cos(yaw), -np.sin(yaw)])
    np.testing.assert_array_equal(log.tables["usbl"]["received_s"], dive.usbl.time_s + 1.25)
    assert log.truth.kind == "simulated"
    np.testing.assert_array_equal(log.truth.position_m, dive.truth.position_m[::5])


def test_gps_latitudes_are_at_sea_level_over_the_stated_origin() -> None:
    log = simulated_log(PAPER, 0)
    gps, origin = log.tables["gps"], log.origin

    lat_lon = gps["lat_deg"].to_numpy(), gps["lon_deg"].to_numpy()
    east, north, _ = pymap3d.geodetic2enu(*lat_lon, 0.0, origin.lat_deg, origin.lon_deg, 0.0)

    np.testing.assert_allclose(np.column_stack([east, north]), gps[["east_m", "north_m"]], atol=1e-8)


def test_another_reader_finds_the_same_values_in_the_mcap_file_at_their_arrival(tmp_path: Path) -> None:
    log, _ = write_scenario(SHORT, 5, tmp_path / "dive.mcap")

    found = list(decoded(tmp_path / "dive.mcap"))

    topics = ("/dvl/data", "/imu/data", "/usbl/fix", "/gps/fix")
    by_topic = {topic: [m for t, _, m in found if t == topic] for topic in topics}
    dvl, compass, usbl, gps = (log.tables[name] for name in ("dvl", "compass", "usbl", "gps"))
    for name, messages in zip(("dvl", "compass", "usbl", "gps"), by_topic.values(), strict=True):
        np.testing.assert_allclose([_stamp_s(m) for m in messages], log.tables[name]["time_s"], atol=1e-9)
    seen = by_topic["/dvl/data"]
    np.testing.assert_array_equal([m.velocity.x for m in seen], dvl["forward_mps"])  # x forward, y starboard
    np.testing.assert_array_equal([m.velocity.y for m in seen], dvl["starboard_mps"])
    assert {m.num_good_beams for m in seen} == {4}
    np.testing.assert_allclose([m.velocity_covar[0] for m in seen], 0.02**2)
    yaw_from_east = np.array([2 * math.atan2(m.orientation.z, m.orientation.w) for m in by_topic["/imu/data"]])
    np.testing.assert_allclose((90 - np.degrees(yaw_from_east)) % 360, compass["heading_deg"], atol=1e-11)
    np.testing.assert_array_equal([(m.point.x, m.point.y) for m in by_topic["/usbl/fix"]], usbl[["east_m", "north_m"]])
    seen = by_topic["/gps/fix"]
    np.testing.assert_array_equal([(m.latitude, m.longitude) for m in seen], gps[["lat_deg", "lon_deg"]])
    late = [log_time - START_NS - round(_stamp_s(m) * 1e9) for topic, log_time, m in found if topic == "/usbl/fix"]
    assert set(late) == {1_250_000_000}
    assert np.all(np.diff([log_time for _, log_time, _ in found]) >= 0)
    with (tmp_path / "dive.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
    assert metadata == {"usbldr": {"scenario": "paper", "seed": "5"}}


def test_the_configuration_states_noise_start_and_conventions(tmp_path: Path) -> None:
    _, configuration = write_scenario(PAPER, 0, tmp_path / "dive.mcap")
    mixture = {"kind": "mixture", "share": 0.3, "variance_ratio": 10.0, "per": "scalar"}
    of_usbl = {"topic": "/usbl/fix", "kind": "position", "frame": "ENU", "relative_to": "map"}
    start = {"east_m": 0.0, "north_m": 0.0, "sd_m": 0.01, "heading_sd_deg": 0.5, "velocity_sd_mps": 0.1}

    stated = tomllib.loads(configuration.read_text())

    assert configuration == tmp_path / "dive.usbldr.toml"
    process = stated.pop("process")
    assert stated == {
        "schema": 1,
        "map": {"origin_lat_deg": 45.0, "origin_lon_deg": -30.0},
        "dvl": {"topic": "/dvl/data", "axes": "FRD", "sd_mps": 0.02, "noise": mixture},
        "compass": {"topic": "/imu/data", "convention": "ENU", "sd_deg": 0.1, "noise": mixture},
        "usbl": {**of_usbl, "sd_m": 1.0, "noise": mixture},
        "gps": {"topic": "/gps/fix"},
        "truth": {"kind": "simulated"},
        "start": {**start, "turn_rate_sd_dps": 0.01},
    }
    angles_deg = {"heading_deg": math.degrees(2.2e-4), "turn_rate_dps": math.degrees(2.2e-5)}
    assert {key: process.pop(key) for key in angles_deg} == pytest.approx(angles_deg, rel=1e-14)
    assert process == {"position_m": 0.0022, "uncalibrated_m": 0.067, "velocity_mps": 2.2e-3}


@pytest.mark.parametrize("name", ["dive.mcap", "dive.bag", "dive.db3", "dive_db3", "dive"])
def test_nothing_is_overwritten_without_force(tmp_path: Path, name: str) -> None:
    write_scenario(SHORT, 0, tmp_path / name)
    before = sorted((f, f.read_bytes()) for f in tmp_path.rglob("*") if f.is_file())

    with pytest.raises(UsageError, match=f"{name}: exists already; .*--force"):
        write_scenario(SHORT, 1, tmp_path / name)

    assert sorted((f, f.read_bytes()) for f in tmp_path.rglob("*") if f.is_file()) == before
    write_scenario(SHORT, 1, tmp_path / name, force=True)
    after = sorted((f, f.read_bytes()) for f in tmp_path.rglob("*") if f.is_file())
    assert [f for f, _ in after] == [f for f, _ in before]
    assert after != before


@pytest.mark.parametrize(
    ("there", "name", "said"),
    [("dive.usbldr.toml", "dive.mcap", r"dive\.usbldr\.toml: exists already"), ("file", "file/dive.mcap", "cannot")],
)
def test_the_users_own_configuration_and_a_file_where_a_folder_must_be_stay(tmp_path, there, name, said):
    (tmp_path / there).write_text("schema = 1\n")

    with pytest.raises(UsageError, match=said):
        write_scenario(SHORT, 0, tmp_path / name)

    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [(there, "schema = 1\n")]


@pytest.mark.parametrize("name", ["dive.zip", "dive.csv", "dive.MAT", "dive.mcap.x1"])
def test_an_ending_without_a_format_is_refused_with_those_that_have_one(tmp_path: Path, name: str) -> None:
    ending = name[name.rindex(".") :]
    wanted = f"there is no format with the ending {ending}: choose NAME.mcap, .bag, .db3, NAME_db3, or a name without"
    assert wanted in refusal(UsageError, write_scenario, SHORT, 0, tmp_path / name)

    assert list(tmp_path.iterdir()) == []
    assert log_format_of(Path(name), "csv") == "csv"  # --format says it


def test_a_number_at_the_end_of_a_folder_is_no_ending(tmp_path: Path) -> None:
    assert [log_format_of(Path(name)) for name in ("dive.2", "2026.05.12", "a.mcap/b")] == ["csv"] * 3


def test_the_command_reports_what_it_wrote(tmp_path: Path) -> None:
    out = tmp_path / "new" / "paper.mcap"

    reported = output_of("simulate", "paper", "-o", out, "--seed", 4)

    assert reported == (
        f"{out}: scenario paper, seed 4, 1000 s, records: 5001 dvl, 5001 compass, 1001 usbl, 1001 gps\n"
        f"{out.with_name('paper.usbldr.toml')}: noise, start and conventions\n"
    )
    assert sorted(f.name for f in out.parent.iterdir()) == ["paper.mcap", "paper.usbldr.toml"]


def test_the_command_lists_the_scenarios_and_answers_an_unknown_name_with_them(tmp_path: Path) -> None:
    listed = output_of("simulate", "--list").splitlines()
    names = [line.split()[0] for line in listed]
    assert {"paper", "lawnmower"} <= set(names)
    assert "section 3.1 of the paper" in listed[names.index("paper")]

    said = f"there is no scenario 'pool' (scenarios: {', '.join(names)}, or a file NAME.toml)"
    assert refusal(UsageError, output_of, "simulate", "pool", "-o", tmp_path / "x") == said


def test_an_interrupted_run_leaves_nothing_behind(tmp_path: Path) -> None:
    scenario, folder = tmp_path / "long.toml", tmp_path / "logs"
    scenario.write_text("schema = 1\nlike = 'paper'\nabout = 'a log that takes seconds to write'\nduration_s = 10000\n")
    folder.mkdir()

    interrupt("simulate", scenario, "-o", folder / "x.mcap", once=lambda: list(folder.glob(".x.mcap.*/x.mcap")))

    assert list(folder.iterdir()) == []
