"""What one dive found of its sensors serves the next: simulate +x, replay, replay with what was written, find 0."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from checkout import SAMPLES
from commands import output_of, report_of
from logs import refusal
from recordings import saved
from usbldr.filters.errors import UsageError
from usbldr.filters.identification.identification import ErrorEstimate, Explanation, Identification, SensorErrorEvidence
from usbldr.filters.replay.run import run as run_filter
from usbldr.io.conventions.compass import without_deviation
from usbldr.io.reading.epochs import timeline
from usbldr.io.reading.read import read_log
from usbldr.io.reports.calibration_config import calibrated_configuration
from usbldr.io.reports.report_json import report_content
from usbldr.io.reports.run import Run, ScoredTrack

SCENARIO = """\
schema = 1
like = "square"
about = "round a small square, with one thing wrong"
duration_s = 240.0

[vehicle]
heading_deg = 10.0

[[leg]]
duration_s = 20.0
forward_mps = 1.5

[[leg]]
duration_s = 30.0
forward_mps = 1.5
starboard_mps = 0.5
turn_rate_dps = 9.0

[[leg]]
duration_s = 20.0
forward_mps = 0.8

[[leg]]
duration_s = 170.0
forward_mps = 1.5
starboard_mps = -0.3
turn_rate_dps = 4.0
"""
CASES: dict[str, tuple[str, dict[str, float]]] = {
    "scale": ("dvl", {"scale_error": 0.03}),
    "misalignment": ("dvl", {"mount_deg": 4.0}),
    "heading": ("compass", {"bias_deg": 4.0}),
    "deviation": ("compass", {"deviation_sin_deg": 4.0, "deviation_cos_deg": -3.0}),
    "latency": ("usbl", {"latency_s": 0.6}),
}
NAMES = {
    "scale_error": "dvl_scale",
    "mount_deg": "dvl_mount_deg",
    "bias_deg": "heading_bias_deg",
    "latency_s": "usbl_latency_s",
}


def simulated(folder: Path, section: str, wrong: dict[str, float]) -> Path:
    stated = {"usbl": ["accuracy = { sd_m = 0.2 }"]}
    stated.setdefault(section, []).extend(f"{key} = {value}" for key, value in wrong.items())
    sections = "".join(f"\n[{name}]\n" + "\n".join(keys) + "\n" for name, keys in stated.items())
    output_of("simulate", saved(folder / "wrong.toml", SCENARIO + sections), "-o", folder / "dive.mcap")
    return folder / "dive.mcap"


def calibrated(log: Path, key: str, run: Path, *options: str) -> dict[str, Any]:
    output_of("replay", str(log), "-f", "adf", "--calibrate", key, "-o", str(run), "-q", "--plots", "none", *options)
    return report_of(run)["calibration"]


@pytest.mark.parametrize("key", list(CASES))
def test_the_next_dive_finds_nothing_of_what_this_one_wrote(key: str, tmp_path: Path) -> None:
    section, wrong = CASES[key]
    log, file = simulated(tmp_path, section, wrong), tmp_path / "next.toml"

    first = calibrated(log, key, tmp_path / "first", "--write-calibration", str(file))
    second = calibrated(log, key, tmp_path / "second", "--config", str(file))

    written = tomllib.loads(file.read_text(encoding="utf-8"))[section]
    for name, truth in wrong.items():
        reported = NAMES.get(name, name)
        sd = first[reported]["sd"]
        assert abs(written[name] - truth) < 4 * sd < abs(truth)
        assert abs(second[reported]["value"]) < sd


def test_a_deviation_is_undone_exactly_however_large() -> None:
    H = np.arange(0.0, 360.0, 0.5)

    for A, B in ((30.0, 30.0), (30.0, -30.0), (-3.0, 2.0)):
        read = H + A * np.sin(np.radians(H)) + B * np.cos(np.radians(H))
        assert without_deviation(read, A, B) == pytest.approx(H, abs=1e-9)


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("dive"), "dvl", {"scale_error": 0.03})


def following(dive: Path, own: str, *keys: str) -> str:
    """Return what is written for the next dive where this one's configuration says ``own``."""
    place = dive.with_name("dive.usbldr.toml")
    place.write_text(own, encoding="utf-8")
    log = read_log(dive)
    log = replace(log, parameters=replace(log.parameters, calibrate=keys))
    track = run_filter("adf", timeline(log), log.parameters)
    return calibrated_configuration(log, Identification(log.parameters), track)


OWN = """\
schema = 1  # mine

[dvl]
axes = "FRD"          # by the drawing
scale_error = 0.01    # a guess

[usbl]
noise = { kind = "gaussian" }

[start]
east_m = 0.0
north_m = 0.0
sd_m = 1.0
"""


def test_what_was_found_is_added_to_what_was_stated_and_all_else_stays_as_it_was(dive: Path) -> None:
    text = following(dive, OWN, "scale", "usbl-bias")

    said = tomllib.loads(text)
    sd = float(text.partition(" ± ")[2].partition(" estimated")[0].rpartition(" ± ")[2])
    assert abs(said["dvl"].pop("scale_error") - 0.03) < 2 * sd < 0.01
    assert said == {"schema": 1, "dvl": {"axes": "FRD"}, "usbl": {"noise": {"kind": "gaussian"}}}
    assert 'axes = "FRD"          # by the drawing\n' in text
    assert "schema = 1  # mine\n" in text
    assert "  # 0.01 stated, +0.01" in text
    assert "# [start]\n# east_m = 0.0\n" in text
    assert "# usbl bias east " in text
    assert "left out: it drifts" in text


def test_an_error_that_was_hardly_observable_is_left_out(dive: Path) -> None:
    text = following(dive, "[calibrate]\nscale_sd = 1e-5\n", "scale")

    assert tomllib.loads(text) == {"calibrate": {"scale_sd": 1e-5}}
    assert "left out: it was hardly observable" in text


@pytest.mark.parametrize(
    ("own", "kept"),
    [
        ('dvl = { axes = "FRD", scale_error = 0.01 }\n', 'dvl = { axes = "FRD", scale_error = 0.0'),
        ('dvl.axes = "FRD"  # mine\ndvl.scale_error = 0.01\n', 'dvl.axes = "FRD"  # mine\ndvl.scale_error = 0.0'),
        ('[dvl]\naxes = "FRD"\n\n[usbl]\n[dvl.noise]\nkind = "gaussian"\n', 'axes = "FRD"\nscale_error = 0.0'),
        ("start = { east_m = 0.0, north_m = 0.0, sd_m = 1.0 }\n[dvl]\n", "known:\n# start = { east_m"),
    ],
)
def test_a_configuration_of_any_form_is_changed_in_place(dive: Path, own: str, kept: str) -> None:
    text = following(dive, own, "scale")

    assert kept in text
    assert tomllib.loads(text)["dvl"]["scale_error"] == pytest.approx(0.03, abs=0.01)
    assert "start" not in tomllib.loads(text)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("-f", "dr"), "--write-calibration: dr is not a filter, so it estimates no sensor errors"),
        (("-f", "adf", "--calibrate", "none"), "no sensor errors are estimated; add --calibrate auto"),
    ],
)
def test_without_an_error_to_write_it_says_so_before_it_runs(dive, tmp_path, options, sentence):
    file, run = tmp_path / "next.toml", tmp_path / "run"

    said = refusal(UsageError, output_of, "replay", dive, *options, "--write-calibration", file, "-o", run)

    assert sentence in said
    assert not file.exists()
    assert not run.exists()


def test_no_file_is_overwritten_without_force(dive: Path, tmp_path: Path) -> None:
    file = saved(tmp_path / "next.toml", "mine")

    asked = ("replay", dive, "--calibrate", "scale", "--write-calibration", file, "-o", tmp_path / "r")
    said = f"{file} exists already: choose another file for --write-calibration, or --force"
    assert refusal(UsageError, output_of, *asked) == said
    assert file.read_text(encoding="utf-8") == "mine"


def test_lever_arm_of_the_dvl_and_clocks_are_stated_for_the_next_dive() -> None:
    log = read_log(SAMPLES / "lawnmower_csv")
    lever = ErrorEstimate("dvl_lever_starboard_m", 0.1, 0.02), ErrorEstimate("dvl_lever_forward_m", 2.0, 0.05)
    evidence = (
        SensorErrorEvidence("dvl-lever", 20.0, True, lever),
        SensorErrorEvidence("dvl-clock", 9.0, True, (ErrorEstimate("dvl_clock_s", 0.5, 0.1),)),
        SensorErrorEvidence("compass-clock", 9.0, True, (ErrorEstimate("compass_clock_s", 0.25, 0.1),)),
    )
    parameters = replace(log.parameters, calibrate=("scale",), dvl_lever_m=(0.1, 2.5, -0.3))  # stated 0.5 m ahead
    track = run_filter("adf", timeline(log), parameters)

    written = tomllib.loads(calibrated_configuration(log, Identification(parameters, evidence), track))

    before = tomllib.loads((SAMPLES / "lawnmower_csv" / "usbldr.toml").read_text(encoding="utf-8"))
    assert written["dvl"]["lever_arm_m"] == [0.1, 2.5, -0.3]
    for sensor, late_s in (("dvl", 0.5), ("compass", 0.25)):
        assert written[sensor]["latency_s"] == pytest.approx(before[sensor].get("latency_s", 0.0) + late_s)


def test_a_latency_and_a_lever_arm_that_the_log_cannot_tell_apart_are_stated_by_no_report(dive: Path) -> None:
    log = read_log(dive)
    log = replace(log, parameters=replace(log.parameters, calibrate=("scale", "latency")))
    line, late = timeline(log), ErrorEstimate("usbl_latency_s", 2.0, 0.1)
    ahead = (ErrorEstimate("dvl_lever_starboard_m", 0.0, 0.1), ErrorEstimate("dvl_lever_forward_m", 2.4, 0.1))
    evidence = (SensorErrorEvidence("latency", 9.0, True, (late,)), SensorErrorEvidence("dvl-lever", 9.0, True, ahead))
    rivals = (Explanation(("latency",), 0.0, (late,)), Explanation(("dvl-lever",), -1.0, ahead))
    found = Identification(log.parameters, evidence, explanations=rivals)
    track = run_filter("adf", line, log.parameters)

    report = report_content(Run(log, line, found, ScoredTrack(track, None)))

    assert set(report["calibration"]) == {"dvl_scale"}
    assert set(report["undecided"]) == {"usbl_latency_s", "dvl_lever_starboard_m", "dvl_lever_forward_m"}
    text = calibrated_configuration(log, found, track)
    assert {"scale_error", "lever_arm_m"} & set(tomllib.loads(text)["dvl"]) == {"scale_error"}
    assert "latency_s" not in tomllib.loads(text).get("usbl", {})
    assert "# Left out: either stamps of the fixes are 2.00 ± 0.10 s late" in text
