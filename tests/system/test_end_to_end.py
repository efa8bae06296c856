"""The sample logs through the real command line: exit codes, files, strict JSON, nothing lost, nothing half-written."""

import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from checkout import SAMPLES
from commands import USBLDR, interrupt, report_of
from usbldr.filters.replay.methods import METHODS

TURN = SAMPLES / "lawnmower_turn_db3"  # two minutes: quick
TABLES = {"fixes.csv", "track.tum", "truth.tum", "track.geojson", "track.kml", "report.md", "report.json"}
PICTURES = {"track.png", "errors.png", "error_cdf.png", "error_distance.png"}


def _usbldr(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*USBLDR, *map(str, arguments)], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.long
def test_every_method_leaves_a_whole_run_directory(tmp_path: Path, method: str) -> None:
    particles = ("-N", "50") if METHODS[method].draws else ()
    drawn = method in ("cpf", "dr", "usbl")  # of each kind one
    plots = () if drawn else ("--plots", "none")
    run = _usbldr("replay", TURN, "-f", method, *particles, *plots, "-o", tmp_path / "run")

    assert (run.returncode, run.stderr) == (0, "")
    assert [file.name for file in tmp_path.iterdir()] == ["run"]
    names = {file.name for file in (tmp_path / "run").iterdir()}
    grids = ("track_fixes.csv", "errors_fixes.csv") if method == "usbl" else ("track_5hz.csv", "errors_1hz.csv")
    assert names >= TABLES | (PICTURES if drawn else set()) | set(grids)
    report = report_of(tmp_path / "run")
    assert {*report["files"], "report.json"} == names
    assert report["filter"] == method
    errors = pd.read_csv(tmp_path / "run" / grids[1])
    assert len(errors) == report["metrics"]["matched"] == (60 if method == "usbl" else 121)
    assert report["metrics"]["mean_abs_east_m"] == pytest.approx(errors["error_east_m"].abs().mean(), abs=1e-4)
    assert report["verdict"] in run.stdout


@pytest.mark.long
def test_ctrl_c_leaves_nothing_of_a_replay_and_exits_130(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "paper.mcap", tmp_path)
    asked = ("replay", tmp_path / "paper.mcap", "-N", "5000", "-o", tmp_path / "run")

    interrupt(*asked, once=lambda: list(tmp_path.glob(".run.*.part")), after_s=0.5)

    assert [file.name for file in tmp_path.iterdir()] == ["paper.mcap"]


@pytest.mark.long
def test_ctrl_c_leaves_a_baseline_as_it_was_and_exits_130(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "paper.mcap", tmp_path)
    baseline = tmp_path / "baseline.toml"
    text = (
        'schema = 1\n[[row]]\nname = "r"\nlog = "paper.mcap"\nfilter = "cpf"\nparticles = 5000\n'
        "[row.metrics]\nmean_horizontal_m = { rel = 0.1 }\n"
    )
    baseline.write_text(text)

    interrupt("check", baseline, "--update", after_s=3.0)

    assert baseline.read_text() == text
    assert {file.name for file in tmp_path.iterdir()} == {"baseline.toml", "paper.mcap"}
