"""The command that writes a first baseline: it passes, its rows state their options, and files are found beside it."""

import os
import shutil
import tomllib
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import finished, write_short


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dive of 200 s with one turn in it."""
    return write_short(tmp_path_factory.mktemp("made") / "dive.mcap", "lawnmower", 200.0)


@pytest.mark.long
def test_a_first_baseline_passes_and_its_log_is_named_from_its_folder(dive: Path, tmp_path: Path) -> None:
    target = tmp_path / "gate.toml"

    first = finished("baseline", dive, "--output", target, "--filters", "usbl,adf")

    assert (first.returncode, first.stderr) == (0, "")
    assert tomllib.loads(target.read_text())["row"][0]["log"] == Path(os.path.relpath(dive, tmp_path)).as_posix()
    run = finished("check", target, "-q", "--output", "none")
    assert (run.returncode, run.stdout) == (0, "passed: 12 of 12 metrics in 2 rows within their limits\n")
    again = finished("baseline", dive, "--output", target)
    assert again.returncode == 2
    assert again.stderr == f"usbldr: {target} exists already: choose another file for --output, or --force\n"


@pytest.mark.long
def test_options_of_a_first_baseline_are_written_into_its_rows_and_hold_there(dive: Path, tmp_path: Path) -> None:
    target, config = tmp_path / "gate.toml", tmp_path / "own.toml"
    config.write_text("schema = 1\n[usbl]\nsd_m = 2.0\n")

    options = ["--start", 20, "--end", 120.5, "--particles", 20, "--noise", "usbl=gaussian", "--config", config]
    first = finished("baseline", dive, "--output", target, "--filters", "usbl,adf", *options)

    assert (first.returncode, first.stderr) == (0, "")
    raw, adf = tomllib.loads(target.read_text())["row"]
    window = {"start": "20", "end": "120.5", "config": "own.toml"}
    for row, stated in ((raw, window), (adf, window | {"noise": ["usbl=gaussian"]})):
        assert {key: row[key] for key in row.keys() & {*window, "particles", "noise"}} == stated
    assert adf["metrics"]["matched"]["value"] == 101
    run = finished("check", target, "-q", "--output", "none")
    assert (run.returncode, run.stdout) == (0, "passed: 12 of 12 metrics in 2 rows within their limits\n")


def test_a_first_baseline_leaves_out_what_a_log_has_no_sensor_for(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    for name in ("usbl", "gps"):
        shutil.copy(SAMPLES / "lawnmower_csv" / f"{name}.csv", tmp_path / "d")

    done = finished("baseline", tmp_path / "d", "--output", tmp_path / "b.toml", "--filters", "usbl,dr")

    assert done.returncode == 0
    assert done.stderr.startswith("usbldr: dr is left out: ")
    assert "no dvl data" in done.stderr
    assert (tmp_path / "b.toml").read_text().count("[[row]]") == 1


def test_one_log_that_is_not_there_leaves_no_baseline_of_the_others(dive: Path, tmp_path: Path) -> None:
    done = finished("baseline", dive, tmp_path / "gone.bag", "--output", tmp_path / "b.toml", "-f", "usbl,dr")

    assert (done.returncode, list(tmp_path.iterdir())) == (3, [])
    assert done.stderr.startswith(f"usbldr: {tmp_path / 'gone.bag'}: no such file, folder or scenario")
    assert len(done.stderr.splitlines()) == 1


def test_the_command_of_before_is_read_and_says_what_it_is_now(dive: Path, tmp_path: Path) -> None:
    target = tmp_path / "gate.toml"

    first = finished("check", "--init", dive, "--baseline", target, "--filters", "usbl")

    assert (first.returncode, target.is_file()) == (0, True)
    assert first.stderr == "usbldr: check --init is now: usbldr baseline LOG... --output FILE\n"
