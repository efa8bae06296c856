"""usbldr drill on a short dive: what it reports, writes, keeps and refuses."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from commands import output_of, report_of, run, write_short
from usbldr.filters.errors import LogError
from usbldr_cli.tables.run_table import WIDTH

SUITE = """
[[drill]]
name = "fixes 20 m off"
faults = ["cluster usbl:20m@30:60"]

[[drill]]
name = "no fixes"
faults = ["drop usbl@30:60", "thin usbl:0.5Hz"]

[[drill]]
name = "no DVL at all"
faults = ["drop dvl@0:"]
"""


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short(tmp_path_factory.mktemp("logs") / "dive", "square", 100.0, 1)


@pytest.fixture(scope="module")
def drilled(dive: Path) -> Path:
    out, suite = dive.parent / "drilled", dive.parent / "suite.toml"
    suite.write_text(SUITE)
    done = run("drill", dive, "--suite", suite, "--filters", "ekf,usbl", "--seeds", 2, "-j", 1, "-o", out)
    assert done.exception is None
    assert done.return_value == LogError.exit_code  # one drill leaves nothing to navigate by
    (out / "printed.txt").write_text(done.stdout)
    return out


content = partial(report_of, name="drill.json")


def row(out: Path, drill: str, method: str) -> Any:
    return next(one for one in content(out)["rows"] if (one["drill"], one["filter"]) == (drill, method))


def test_the_worst_drill_comes_first_and_a_failed_one_before_all(drilled: Path) -> None:
    names = list(dict.fromkeys(one["drill"] for one in content(drilled)["rows"]))
    assert names == ["no DVL at all", "fixes 20 m off", "no fixes"]
    printed = (drilled / "printed.txt").read_text()
    assert [printed.index(f"\n{name} ") for name in names] == sorted(printed.index(f"\n{name} ") for name in names)
    assert max(len(line) for line in printed.splitlines() if not line.startswith("written")) <= WIDTH


def test_a_row_has_the_error_with_and_without_the_fault_and_what_doctor_says(drilled: Path) -> None:
    off, usual = row(drilled, "fixes 20 m off", "usbl"), content(drilled)["undamaged"]
    clean_m = next(one["mean_horizontal_m"] for one in usual if one["filter"] == "usbl")
    assert off["undamaged_m"] == clean_m
    assert off["raw_usbl_m"] == off["mean_horizontal_m"]
    assert off["mean_horizontal_m"] == pytest.approx(clean_m + 0.3 * 20, rel=0.1)  # 30 of 101 fixes
    assert off["ratio"] == pytest.approx(off["mean_horizontal_m"] / clean_m)
    assert off["findings"] == ["FALSE-FIXES", "USBL-OUTLIERS"]
    assert off["named_share"] == 1.0
    assert off["seeds"] == 2  # the direction of the cluster is drawn
    gap = row(drilled, "no fixes", "ekf")
    assert gap["seeds"] == 1  # nothing is drawn
    assert gap["drift_m"] < 2
    assert gap["findings"] == ["OUTAGE"]
    assert gap["named_share"] == 1.0
    lost = row(drilled, "no DVL at all", "ekf")
    assert lost["mean_horizontal_m"] is None
    assert "no dvl data" in lost["failure"]


def test_the_folder_has_table_page_and_figures(drilled: Path) -> None:
    table = pd.read_csv(drilled / "drill.csv")
    assert table["drill"].tolist() == [one["drill"] for one in content(drilled)["rows"]]
    assert table["faults"].iloc[-1] == "drop usbl@30:60; thin usbl:0.5Hz"
    page = (drilled / "drill.md").read_text()
    for picture in sorted(drilled.glob("*.png")):
        assert f"]({picture.name})" in page
    assert len(list(drilled.glob("*.png"))) == 3  # the overview, and two drills that did not fail


@pytest.mark.long
def test_the_same_drills_again_use_the_finished_runs_and_others_are_refused(dive: Path, drilled: Path) -> None:
    (drilled / "printed.txt").rename(drilled.parent / "printed.txt")
    before = content(drilled)["rows"]
    stamps = {file: file.stat().st_mtime_ns for file in (drilled / "units").iterdir()}
    same = ("drill", dive, "--suite", drilled.parent / "suite.toml", "--filters", "ekf,usbl", "-j", 1, "-o", drilled)

    run(*same, "--seeds", 2)

    assert content(drilled)["rows"] == before
    assert {file: file.stat().st_mtime_ns for file in (drilled / "units").iterdir()} == stamps
    refused = run("drill", dive, "--drop", "usbl@30:60", "-o", drilled).exception
    assert "holds another comparison" in str(refused)


def test_other_drills_in_the_same_folder_leave_no_figure_of_the_earlier_ones(dive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for fault in (("--drop", "usbl@30:60"), ("--thin", "usbl:0.5Hz")):
        run("drill", dive, *fault, "--filters", "ekf", "--seeds", 1, "-j", 1, "-o", out, "--force")

    assert {file.name for file in out.glob("*.png")} == {*content(out)["figures"]}


def test_the_faults_of_the_options_are_one_drill_and_nothing_is_written_to_the_log(dive: Path) -> None:
    before = {file: file.read_bytes() for file in dive.iterdir()}

    faults = ("--drop", "usbl@30:60", "--spike", "dvl:3m/s@0.02", "--sd", "usbl:2")
    said = output_of("drill", dive, *faults, "--filters", "ekf", "--seeds", 1, "-j", 1, "--json")

    (one,) = json.loads(said)["rows"]
    assert set(one["faults"]) == {"drop usbl@30:60", "spike dvl:3m/s@0.02", "sd usbl:2"}
    assert {file: file.read_bytes() for file in dive.iterdir()} == before
