"""--tune on the command line: what it writes and says, and that no truth is behind it."""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import output_of, run
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.parameters import Parameters
from usbldr.io.reports.tuned_config import tuned_toml
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.settings.configuration import parameters, parse_configuration
from usbldr.io.settings.validation import read_document
from usbldr.io.writers.export import export

SAMPLE = SAMPLES / "lawnmower.mcap"
STATES = "scale,heading,usbl-bias"


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("tuned") / "run"
    return folder, output_of("replay", str(SAMPLE), "-f", "ekf", "--calibrate", STATES, "--tune", "-o", str(folder))


def test_a_tuned_replay_tells_what_was_found_in_table_report_and_configuration(tuned: tuple[Path, str]) -> None:
    folder, said = tuned
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    found = {number["name"]: number for number in report["assumptions"]["tuned"]}
    stated = parameters(parse_configuration(tomllib.loads((folder / "tuned.toml").read_text(encoding="utf-8")), folder))

    assert "tuned.toml" in report["files"]
    assert stated.calibrate == ("scale", "heading", "usbl-bias")
    assert stated.usbl_sd_scale == found["usbl_sd_scale"]["after"] == report["assumptions"]["usbl_sd_scale"]
    assert stated.dvl_sd_scale == found["dvl_sd_scale"]["after"]
    assert stated.process.velocity_mps == found["velocity_walk_mps"]["after"]
    assert stated.errors.usbl_bias_m == found["usbl_bias_sd_m"]["after"]
    number = found["usbl_sd_scale"]
    row = "usbl sd scale {before:.3g} to {after:.3g} ({low:.3g} to {high:.3g})".format(**number)
    assert row in " ".join(said.split())
    assert row in (folder / "report.md").read_text(encoding="utf-8")
    assert all(math.isfinite(value) for number in found.values() for key, value in number.items() if key != "name")


def test_without_a_truth_the_same_is_found(tuned: tuple[Path, str], tmp_path: Path) -> None:
    folder, _ = tuned
    blind = tmp_path / "blind"
    output_of("replay", str(SAMPLE), "-f", "ekf", "--calibrate", STATES, "--tune", "--truth", "none", "-o", str(blind))

    assert (blind / "tuned.toml").read_text(encoding="utf-8") == (folder / "tuned.toml").read_text(encoding="utf-8")


def test_compare_tunes_filters_and_leaves_tracks_alone(tmp_path: Path) -> None:
    plain, tuned = (
        json.loads(output_of("compare", str(SAMPLE), "-f", "dr,ekf", "-j", "1", "--json", *more))
        for more in ([], ["--tune"])
    )
    (dr, ekf), (same_dr, tuned_ekf) = plain["rows"], tuned["rows"]

    assert same_dr["mean_horizontal_m"] == dr["mean_horizontal_m"]
    assert tuned_ekf["mean_horizontal_m"] != ekf["mean_horizontal_m"]


@pytest.mark.parametrize("command", [("replay", "-f", "dr"), ("compare", "-f", "dr,usbl")])
def test_what_is_no_filter_is_not_tuned(command: tuple[str, ...]) -> None:
    name, *options = command
    done = run(name, SAMPLE, *options, "--tune")

    assert "tune" in str(done.exception)


def test_the_scales_of_a_configuration_come_back_from_an_export(tmp_path: Path) -> None:
    log = simulated_log(replace(find_scenario("paper"), duration_s=10.0), 0)
    scaled = replace(log, parameters=replace(log.parameters, dvl_sd_scale=2.5, usbl_sd_scale=0.5))
    _, configuration = export(scaled, tmp_path / "scaled")
    read = parameters(parse_configuration(read_document(configuration), configuration))

    assert (read.dvl_sd_scale, read.usbl_sd_scale) == (2.5, 0.5)


def test_the_configuration_states_all_that_differs_from_the_defaults() -> None:
    default = Parameters()
    found = replace(default, dvl_sd_scale=2.0, usbl_sd_scale=0.25, calibrate=("latency", "usbl-bias"))
    found = replace(found, errors=replace(default.errors, latency_s=1.0, usbl_bias_m=0.7, usbl_bias_s=90.0))
    text = tuned_toml("paper", Identification(found))

    assert parameters(parse_configuration(tomllib.loads(text), Path("tuned.toml"))) == found
