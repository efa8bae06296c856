"""The shipped logs: small, made by their recipe, with configurations that give no error of a sensor away."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from checkout import ROOT
from usbldr.io.reading.read import read_log

SAMPLES = ROOT / "sample_logs"
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
