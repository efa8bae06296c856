"""The sample logs through the real command line: exit codes, files, strict JSON, nothing lost, nothing half-written.

A full disk is one sentence with exit code 3. The logs are small and made by their recipe, and their configurations
give no error of a sensor away.
"""

import errno
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from checkout import ROOT, SAMPLES
from commands import USBLDR, finished, interrupt, report_of
from usbldr.filters.errors import StorageError, UsageError
from usbldr.filters.replay.methods import METHODS
from usbldr.io.reading.read import read_log
from usbldr.io.writing import writing

TURN = SAMPLES / "lawnmower_turn_db3"  # two minutes: quick
TABLES = {"fixes.csv", "track.tum", "truth.tum", "track.geojson", "track.kml", "report.md", "report.json"}
PICTURES = {"track.png", "errors.png", "error_cdf.png", "error_distance.png"}


def _run(words: Sequence[object], stdout: Any = subprocess.PIPE, **how: Any) -> subprocess.CompletedProcess[str]:
    command = [*USBLDR, *map(str, words)]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False, **how)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.long
def test_every_method_leaves_a_whole_run_directory(tmp_path: Path, method: str) -> None:
    particles = ("-N", "50") if METHODS[method].draws else ()
    drawn = method in ("cpf", "dr", "usbl")  # of each kind one, in a process of its own
    plots = () if drawn else ("--plots", "none")
    calibrate = () if drawn or not METHODS[method].is_filter else ("--calibrate", "none")
    words = ("replay", TURN, "-f", method, *particles, *plots, *calibrate, "-o", tmp_path / "run")
    run = _run(words) if drawn else finished(*words)

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
    asked = ("replay", tmp_path / "paper.mcap", "-N", "20000", "-o", tmp_path / "run")

    interrupt(*asked, once=lambda: list(tmp_path.glob(".run.*.part")), after_s=0.5)

    assert [file.name for file in tmp_path.iterdir()] == ["paper.mcap"]


@pytest.mark.long
def test_ctrl_c_leaves_a_baseline_as_it_was_and_exits_130(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "paper.mcap", tmp_path)
    baseline = tmp_path / "baseline.toml"
    text = (
        'schema = 1\n[[row]]\nname = "r"\nlog = "paper.mcap"\nfilter = "cpf"\nparticles = 20000\n'
        "[row.metrics]\nmean_horizontal_m = { rel = 0.1 }\n"
    )
    baseline.write_text(text)

    interrupt("check", baseline, "--update", after_s=3.0)

    assert baseline.read_text() == text
    assert {file.name for file in tmp_path.iterdir()} == {"baseline.toml", "paper.mcap"}


LARGEST = 20_000  # bytes of a file: with them every output below is cut


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST, LARGEST))


def _replay(place: Path, *options: str) -> list[object]:
    return ["replay", TURN, "--filter", "ekf", "--quiet", "--output", place / "run", *options]


needs_limits = pytest.mark.skipif(os.name != "posix", reason="needs a limit on the size of files")


@needs_limits
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(lambda place: _replay(place, "--plots", "none"), id="tables"),
        pytest.param(lambda place: _replay(place, "--mcap", "alone", "--plots", "none"), id="mcap of a run"),
        pytest.param(lambda place: ["simulate", "paper", "--output", place / "dive.mcap"], id="mcap"),
        pytest.param(lambda place: ["simulate", "paper", "--output", place / "dive.bag"], id="bag"),
        pytest.param(lambda place: ["export", TURN, "--output", place / "dive.db3"], id="db3"),
        pytest.param(lambda place: ["export", TURN, "--output", place / "dive"], id="csv"),
    ],
)
def test_a_disk_that_is_full_is_one_sentence_and_leaves_nothing(tmp_path, command):
    done = _run(command(tmp_path), preexec_fn=_limited)

    assert done.returncode == 3, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"usbldr: {tmp_path}")
    assert "cannot be written (" in line
    assert line.endswith("): make room on its disk, or choose another --output")
    assert list(tmp_path.iterdir()) == []


@needs_limits
@pytest.mark.long
def test_a_comparison_that_finds_the_disk_full_keeps_its_whole_files_alone(tmp_path: Path) -> None:
    words = ["compare", TURN, "--filters", "ekf", "--jobs", 1, "--quiet", "--output", tmp_path / "compared"]

    done = _run(words, preexec_fn=_limited)

    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    left = sorted(file.name for file in (tmp_path / "compared").rglob("*"))
    assert not [name for name in left if name.endswith((".png", ".part"))]


def test_results_on_a_full_stdout_are_one_sentence() -> None:
    if not os.path.exists("/dev/full"):
        pytest.skip("needs /dev/full")
    with open("/dev/full", "w") as full:
        done = _run(["simulate", "--list"], stdout=full)
    why = "No space left on device"
    said = f"usbldr: the output: cannot be written ({why}): make room on its disk, or choose another place\n"
    assert (done.returncode, done.stderr) == (3, said)


def test_a_reader_that_has_enough_of_stdout_is_no_fault() -> None:
    reading, writing_end = os.pipe()
    os.close(reading)
    done = _run(["simulate", "--list"], stdout=writing_end)
    os.close(writing_end)

    assert done.stderr == ""
    assert done.returncode in (0, 1)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG])
def test_faults_of_the_disk_are_told_from_a_wrong_place(number: int) -> None:
    with pytest.raises(StorageError, match=r"^run: cannot be written \(.+\): make room on its disk, or choose"):
        _fail(number)
    with pytest.raises(UsageError, match=r"^run: cannot be written \(Permission denied\): choose another place$"):
        _fail(errno.EACCES)


def _fail(number: int) -> None:
    with writing("run"):
        raise OSError(number, os.strerror(number))


LOGS = ("paper.mcap", "lawnmower.mcap", "lawnmower.bag", "lawnmower_csv", "lawnmower_turn_db3")
# positions are stored as degrees, too: the last bit of a latitude of 45 degrees is .8e-9 m, and the sines and
# cosines of different processors differ in it (1.04e-9 m was seen)
LAST_BITS_M = 1e-8
WRITTEN = (".bag", ".csv", ".db3", ".mcap", ".yaml", ".toml")


@pytest.fixture(scope="module")
def made_again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the Makefile's own recipe into another folder."""
    folder = tmp_path_factory.mktemp("samples")
    usbldr = f"{sys.executable} -c 'from usbldr_cli.main import main; main()'"
    recipe = ["make", "-o", ".venv/installed", "sample_logs", f"USBLDR={usbldr}", f"SAMPLES={folder}"]
    subprocess.run(recipe, cwd=ROOT, check=True, capture_output=True)
    return folder


def _files(folder: Path) -> list[Path]:
    every = (file.relative_to(folder) for file in folder.rglob("*") if file.suffix in WRITTEN)
    return sorted(file for file in every if file.name != "baseline.toml")


def test_the_samples_are_small() -> None:
    sizes = {file: (SAMPLES / file).stat().st_size for file in _files(SAMPLES)}

    assert max(sizes.values()) < 600_000
    assert sum(sizes.values()) < 10_000_000


def test_the_recipe_makes_the_files_that_are_shipped_and_no_others(made_again: Path) -> None:
    assert _files(made_again) == _files(SAMPLES)
    for file in _files(SAMPLES):
        if file.suffix == ".toml":
            assert (made_again / file).read_text() == (SAMPLES / file).read_text()


@pytest.mark.parametrize("name", LOGS)
def test_the_recipe_makes_the_same_bytes_or_where_libraries_differ_the_same_records(made_again, name):
    parts = [file for file in _files(SAMPLES) if file.parts[0] == name]
    if parts and all((made_again / file).read_bytes() == (SAMPLES / file).read_bytes() for file in parts):
        return
    shipped, made = read_log(SAMPLES / name), read_log(made_again / name)
    assert (shipped.start_ns, shipped.parameters) == (made.start_ns, made.parameters)
    assert shipped.tables.keys() == made.tables.keys()
    for sensor, table in shipped.tables.items():
        pd.testing.assert_frame_equal(made.tables[sensor], table, rtol=0, atol=LAST_BITS_M)


@pytest.mark.parametrize("name", LOGS)
def test_every_sample_reads_whole_with_its_configuration_and_truth(name: str) -> None:
    log = read_log(SAMPLES / name)

    assert set(log.tables) == {"dvl", "compass", "usbl", "gps"}
    assert log.configuration is not None
    assert not any(finding.lost_data for finding in log.findings)
    assert log.truth.kind == "simulated"
