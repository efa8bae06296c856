"""The main job on field logs: the command, its files, and an evaluator that knows nothing of usbldr.

The truth of uib_field is visual SLAM, that of stpere_marina real DGPS with synthetic USBL fixes.
"""

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from checkout import FIELD_CONFIGURATIONS
from commands import output_of

UIB_WINDOW = ["--truth", "csv/graph_vertices_455.txt", "--start", "4", "--end", "1084", "--align", "first"]


def replay(field_logs: Path, folder: Path, name: str, *options: str) -> dict:
    target = folder / "-".join([name, *options]).replace("/", "")[:80]
    log = str(field_logs / name / f"{name}.mcap")
    config = str(FIELD_CONFIGURATIONS / f"{name}.toml")
    output_of("replay", log, "--config", config, "--output", target, *options)
    return json.loads((target / "report.json").read_text()) | {"folder": target}


@pytest.fixture(scope="module")
def evaluator(field_logs: Path) -> ModuleType:
    file = field_logs.parent / "tools" / "evaluate_track.py"
    if not file.is_file():
        pytest.skip(f"no independent evaluator at {file}")
    spec = importlib.util.spec_from_file_location("evaluate_track", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def by_the_evaluator(evaluator: ModuleType, field_logs: Path, report: dict) -> dict:
    track = pd.read_csv(report["folder"] / "track_5hz.csv")
    time_s = track["time_s"].to_numpy() + report["time_base"]["start_ns"] / 1e9
    points = track[["east_m", "north_m"]].to_numpy()
    return evaluator.evaluate(time_s, points, field_logs / "uib_field", cov=evaluator.covariance(track))


def test_the_published_raw_error_of_uib_field_is_met(field_logs: Path, tmp_path: Path) -> None:
    """Definition A of the log's notes: the authors' 1.00 m for modem_raw."""
    report = replay(field_logs, tmp_path, "uib_field", "--usbl", "/modem_raw", "--filter", "usbl", *UIB_WINDOW)
    assert report["metrics"]["mean_horizontal_m"] == pytest.approx(1.000, abs=0.005)


@pytest.mark.long
def test_cpf_with_the_transponder_as_the_vehicle_is_within_seventy_centimetres_on_uib_field(
    field_logs: Path, tmp_path: Path, evaluator: ModuleType
) -> None:
    cpf = replay(field_logs, tmp_path, "uib_field", "--filter", "cpf", *UIB_WINDOW)
    ekf = replay(field_logs, tmp_path, "uib_field", "--filter", "ekf", "--gate", "0.99", *UIB_WINDOW)
    by_a = by_the_evaluator(evaluator, field_logs, cpf)["A"]["mean"]
    gated = by_the_evaluator(evaluator, field_logs, ekf)["A"]["mean"]

    assert by_a <= 0.70
    assert cpf["metrics"]["nees_mean"] <= 3.5
    assert by_a <= gated + 0.03
    assert by_a < cpf["reference_tracks"]["dr"]["metrics"]["mean_horizontal_m"]
    assert by_a == pytest.approx(cpf["metrics"]["mean_horizontal_m"], abs=0.01)  # theirs at 5 Hz, ours at 1 Hz
    assert cpf["reference_tracks"]["usbl"]["metrics"]["mean_horizontal_m"] == pytest.approx(1.416, abs=0.005)


@pytest.mark.long
def test_stpere_marina_is_read_as_expected_and_cpf_takes_two_thirds_off_the_raw_error(field_logs, tmp_path):
    expected = json.loads((field_logs / "stpere_marina" / "expected.json").read_text())
    report = replay(field_logs, tmp_path, "stpere_marina", "--filter", "cpf", "--dr-from", "first-gps")

    raw, reference = report["reference_tracks"]["usbl"]["metrics"], expected["reference"]["usbl_synthetic"]
    for metric, key in (("mean", "mean_m"), ("median", "median_m"), ("rmse", "rms_m"), ("max", "max_m")):
        tolerance = reference["tolerance"][key]
        assert raw[f"{metric}_horizontal_m"] == pytest.approx(reference["error_all"][key], abs=tolerance)
    dr, anchored = (
        report["reference_tracks"]["dr"]["metrics"],
        expected["reference"]["dead_reckoning_mti_anchored_nominal"],
    )
    for metric, key in (("rmse", "rms_m"), ("max", "max_m"), ("final", "end_m")):
        assert dr[f"{metric}_horizontal_m"] == pytest.approx(anchored[key], abs=anchored["tolerance"][key])
    assert report["metrics"]["mean_horizontal_m"] <= raw["mean_horizontal_m"] / 3
    assert report["truth"]["kind"] == "gps"
