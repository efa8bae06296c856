"""The gate: verdicts by hand, the commands on short simulated dives, a model whole and broken, a first baseline."""

import dataclasses
import hashlib
import json
import os
import shutil
import subprocess
import tomllib
from contextlib import chdir
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from checkout import ROOT, SAMPLES
from commands import findings, finished, report_of, spoil, write_short
from usbldr.filters.estimators import compiled
from usbldr.filters.kernel import Kernel
from usbldr.filters.models.motion import PositionIncrement
from usbldr.io.reports.page import markdown
from usbldr.io.settings.regression_baseline import BaselineRow, Metric, RegressionBaseline
from usbldr_cli.runs.baseline_rows import stated_options
from usbldr_cli.tables.check_verdicts import CheckedRow, MetricChange, compare_metric, page, summary, table

ROWS = """\
schema = 1

# the filter
[[row]]
name = "dive adf"
log = "dive.mcap"
filter = "adf"
calibrate = "none"
[row.metrics]
mean_abs_east_m = { rel = 0.02, abs = 0.002 }
mean_horizontal_m = { rel = 0.02 }
nees_mean = { rel = 0.1 }

[[row]]
name = "dive dr"
log = "dive.mcap"
filter = "dr"
dr_from = "first-truth"
[row.metrics]
final_horizontal_m = { rel = 0.001 }
"""


def _check(*arguments: object) -> subprocess.CompletedProcess[str]:
    with chdir(ROOT / "docs"):
        return finished("check", "--jobs", 1, *([] if "--output" in arguments else ["--output", "none"]), *arguments)


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dive of 200 s with one turn in it."""
    return write_short(tmp_path_factory.mktemp("made") / "dive.mcap", "lawnmower", 200.0)


@pytest.fixture(scope="module")
def made(dive: Path) -> Path:
    """Return its folder, with a baseline whose values are those of today."""
    dive.with_name("baseline.toml").write_text(ROWS)
    run = _check(dive.with_name("baseline.toml"), "--update")
    assert (run.returncode, run.stderr) == (0, "")
    return dive.parent


@pytest.fixture
def gate(made: Path, tmp_path: Path) -> Path:
    """Return the baseline of a copy that a test may spoil."""
    shutil.copytree(made, tmp_path / "gate")
    return tmp_path / "gate" / "baseline.toml"


def _moved(baseline: Path, metric: str, factor: float) -> None:
    head, rest = baseline.read_text().split(f"{metric} = {{ value = ")
    value, tail = rest.split(",", 1)
    baseline.write_text(f"{head}{metric} = {{ value = {float(value) * factor},{tail}")


@pytest.mark.parametrize(
    ("direction", "new", "verdict"),
    [
        ("lower", 11.0, "ok"),
        ("lower", 9.0, "ok"),
        ("lower", 11.1, "REGRESSION"),
        ("lower", 8.9, "better: stale"),
        ("higher", 11.1, "better: stale"),
        ("higher", 8.9, "REGRESSION"),
        ("both", 11.1, "REGRESSION"),
        ("both", 8.9, "REGRESSION"),
        ("lower", None, "MISSING"),
    ],
)
def test_a_metric_beyond_its_limit_is_a_regression_unless_that_is_better(direction, new, verdict):
    metric = Metric(value=10.0, abs=0.5, rel=0.05, direction=direction)  # pyright: ignore[reportArgumentType]

    assert compare_metric("anything", metric, new).verdict == verdict
    assert compare_metric("anything", Metric(rel=0.1), new or 1.0).verdict == "NO VALUE"


def test_the_change_is_the_difference_of_the_values_as_printed() -> None:
    change = compare_metric("mean_horizontal_m", Metric(value=1.31286, abs=0.005), 1.31284)

    old, new, moved = table([CheckedRow(BaselineRow("dive", "dive.mcap", "ekf", 1, {}, {}), (change,))]).rows[1][1:4]

    assert float(moved) == round(float(new) - float(old), 6)


def test_the_summary_counts_and_names_failures_and_stale_values() -> None:
    row = BaselineRow("dive", "dive.mcap", "adf", 1, {}, {})
    good = MetricChange("a_m", 1.0, 1.0, 0.1, "lower", "ok")
    better = dataclasses.replace(good, new=0.5, verdict="better: stale")
    worse = dataclasses.replace(good, new=2.0, verdict="REGRESSION")

    hint = "; 1 better than the baseline by more than the limit: update it with --update"
    assert summary([CheckedRow(row, (good, better))]) == f"passed: 1 of 2 metrics in 1 rows within their limits{hint}"
    assert summary([CheckedRow(row, (good, worse))]) == "FAILED: dive: a_m REGRESSION"
    assert summary([CheckedRow(row, (), "no such log", 1)]) == "FAILED: dive: not run"
    assert summary([CheckedRow(row, (good,), lost=("cut",))]) == "FAILED: dive: log partly unreadable"
    text = markdown(page(RegressionBaseline(Path("baseline.toml"), "", ()), [CheckedRow(row, (good, worse))], ()))
    failures, metrics = text.partition("## Metrics")[::2]
    assert failures.count("| a_m | dive | 1.00 | 2.00 | +1.00 | 0.10 | REGRESSION |") == 1
    assert metrics.count("| a_m | dive |") == 2


@pytest.mark.long
def test_what_was_stored_by_an_update_passes_and_a_second_update_changes_nothing(gate: Path) -> None:
    before = gate.read_text()
    assert "# the filter\n" in before
    assert before.count("value = ") == 4

    run, again = _check(gate), _check(gate, "--update")

    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.endswith("\npassed: 4 of 4 metrics in 2 rows within their limits\n")
    assert all(len(line) <= 100 for line in run.stdout.splitlines())
    assert again.returncode == 0
    assert again.stdout.endswith(f"{gate}: is up to date\n")
    assert gate.read_text() == before


def test_a_metric_that_got_worse_exits_1_and_says_so_in_table_page_and_json(gate: Path, tmp_path: Path) -> None:
    _moved(gate, "mean_horizontal_m", 0.9)

    run = _check(gate, "--markdown", tmp_path / "page.md", "--json", tmp_path / "result.json")

    assert run.returncode == 1
    assert run.stdout.endswith("\nFAILED: dive adf: mean_horizontal_m REGRESSION\n")
    (line,) = [line for line in run.stdout.splitlines() if "mean_horizontal_m" in line and "FAILED" not in line]
    assert line.endswith("REGRESSION")
    assert "## Failures" in (tmp_path / "page.md").read_text()
    reported = json.loads((tmp_path / "result.json").read_text())
    assert (reported["exit_code"], [row["passed"] for row in reported["rows"]]) == (1, [False, True])
    (worse,) = [metric for metric in reported["rows"][0]["metrics"] if metric["verdict"] != "ok"]
    assert worse["metric"] == "mean_horizontal_m"
    assert worse["new"] == pytest.approx(worse["old"] / 0.9, rel=1e-4)


@pytest.mark.long
def test_a_missing_log_and_a_missing_metric_fail_and_the_other_rows_are_run(gate: Path) -> None:
    spoil(gate, "nees_mean", "nees_median")
    gate.write_text(gate.read_text() + ROWS.split("# the filter\n")[1].replace("dive", "gone", 2))
    spoil(gate, 'name = "dive dr"\nlog = "dive.mcap"', 'name = "third"\nlog = "dive.mcap"')
    before = gate.read_text()

    run, update = _check(gate, "--json"), _check(gate, "--update")

    reported = json.loads(run.stdout)
    assert run.returncode == 1
    by_name = {row["name"]: row for row in reported["rows"]}
    assert by_name["gone adf"]["fault"].endswith("gone.mcap: no such log or scenario")
    assert [m["verdict"] for m in by_name["dive adf"]["metrics"]] == ["ok", "ok", "MISSING"]
    assert by_name["third"]["passed"]
    assert update.returncode == 1
    assert update.stderr == f"usbldr: {gate}: unchanged, because a metric is missing in dive adf, gone adf\n"
    assert gate.read_text() == before


@pytest.mark.long
def test_a_log_that_cannot_be_read_exits_3_with_its_sentence(gate: Path) -> None:
    whole = gate.with_name("dive.mcap").read_bytes()
    gate.with_name("dive.mcap").write_bytes(b"not a log at all" * 10)

    garbage = _check(gate)
    gate.with_name("dive.mcap").write_bytes(whole[: len(whole) * 6 // 10])
    cut = _check(gate)

    for run in (garbage, cut):
        assert run.returncode == 3
        assert "Traceback" not in run.stdout + run.stderr
        assert "FAILED: dive adf: " in run.stdout
    assert "not run: " in " ".join(garbage.stdout.split())
    assert "log partly unreadable" in " ".join(cut.stdout.split())


@pytest.mark.parametrize(
    ("filter_or_more", "sentence"),
    [
        ('"kalman"', "there is no filter 'kalman' (filters: ekf"),
        ('"adf"\nparticles = 1', "Invalid value for '--particles'"),
        ('"adf"\nfolter = 1', "No such option"),
        ('"adf"\nseed = "x"', "Invalid value for '--seed'"),
    ],
)
def test_a_wrong_baseline_exits_2_and_names_row_and_key(gate: Path, filter_or_more: str, sentence: str) -> None:
    spoil(gate, '"adf"', filter_or_more)

    run = _check(gate)

    assert run.returncode == 2
    assert run.stderr.startswith(f"usbldr: {gate}: row 'dive adf': {sentence}")
    assert len(run.stderr.splitlines()) == 1


@pytest.mark.long
def test_another_log_under_the_same_name_is_no_regression(gate: Path) -> None:
    digest = hashlib.sha256(gate.with_name("dive.mcap").read_bytes()).hexdigest()
    assert gate.read_text().count(f'log_sha256 = "{digest}"') == 2
    _moved(gate, "mean_horizontal_m", 0.9)
    spoil(gate, digest, "0" * 64)

    run, reported = _check(gate), json.loads(_check(gate, "--json").stdout)

    assert run.returncode == 1
    assert run.stdout.endswith("\nFAILED: dive adf: the log is another one\n")
    told_apart = f"the log is another one (sha256 {digest[:12]}..., the values are of 000000000000...)"
    assert told_apart in " ".join(run.stdout.split())
    assert "REGRESSION" not in run.stdout
    assert [row["another_log"] for row in reported["rows"]] == [True, False]
    assert {metric["verdict"] for metric in reported["rows"][0]["metrics"]} == {"another log"}
    assert _check(gate, "--update").returncode == 0
    assert _check(gate, "-q").returncode == 0


@pytest.mark.long
def test_a_failed_row_keeps_its_run_and_says_what_the_doctor_finds(gate: Path, tmp_path: Path) -> None:
    _moved(gate, "mean_horizontal_m", 0.9)
    place = tmp_path / "failed runs"

    run = _check(gate, "--output", place, "--junit", tmp_path / "junit.xml")

    assert run.returncode == 1
    (kept,) = place.iterdir()  # the other row passed
    assert kept.name == "01-dive_adf"
    assert {"report.json", "errors_1hz.csv", "track_5hz.csv"} <= {file.name for file in kept.iterdir()}
    assert f"run kept in {kept}" in " ".join(run.stdout.split())
    report = report_of(kept)
    assert report["filter"] == "adf"
    assert report["provenance"]["command"][:2] == ["usbldr", "check"]
    warned = [code for code, one in findings(gate.with_name("dive.mcap")).items() if one["level"] != "info"]
    assert warned
    assert all(f"[{code}]" in run.stdout for code in warned)

    again = _check(gate, "--output", place)

    why = "is not empty: choose another --output, or --force to replace the runs in it"
    assert (again.returncode, again.stderr) == (2, f"usbldr: {place} {why}\n")


def test_without_an_output_the_runs_of_failed_rows_get_a_folder_of_their_own(gate, monkeypatch):
    monkeypatch.chdir(gate.parent)
    _moved(gate, "final_horizontal_m", 0.9)
    (gate.parent / "baseline-failed").mkdir()

    assert finished("check", gate.name, "--jobs", 1).returncode == 1
    assert (gate.parent / "baseline-failed-2" / "02-dive_dr" / "report.json").is_file()
    assert not list((gate.parent / "baseline-failed").iterdir())


def test_the_junit_file_has_a_suite_for_each_row_and_a_case_for_each_metric(gate: Path, tmp_path: Path) -> None:
    _moved(gate, "mean_horizontal_m", 0.9)
    gate.write_text(gate.read_text() + "[[row]]\n" + ROWS.split("[[row]]\n")[1].replace("dive", "gone", 2))
    spoil(gate, 'name = "gone adf"', 'name = "g<o>ne & \\u0007"')

    assert _check(gate, "--junit", tmp_path / "junit.xml").returncode == 1

    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert (root.tag, root.get("tests"), root.get("failures"), root.get("errors")) == ("testsuites", "5", "1", "1")
    first, second, gone = root
    assert [suite.get("name") for suite in root] == ["dive adf", "dive dr", "g<o>ne & \\x07"]
    assert [case.get("name") for case in first] == ["mean_abs_east_m", "mean_horizontal_m", "nees_mean"]
    failed = {str(case.get("name")): failure for case in first for failure in case}
    assert list(failed) == ["mean_horizontal_m"]
    assert str(failed["mean_horizontal_m"].get("message")).startswith("REGRESSION: ")
    assert not [failure for case in second for failure in case]
    assert "no such log or scenario" in str(gone[0][0].get("message"))


def test_a_scenario_with_seeds_has_standard_errors(tmp_path: Path) -> None:
    (tmp_path / "b.toml").write_text(
        'schema = 1\n[[row]]\nname = "r"\nlog = "lawnmower"\nfilter = "usbl"\nseeds = 3\n'
        "[row.metrics]\nmean_horizontal_m = { rel = 0.1 }\nmean_horizontal_m_se = { rel = 0.1 }\n"
    )

    reported = json.loads(_check(tmp_path / "b.toml", "--json").stdout)

    mean, se = (metric["new"] for metric in reported["rows"][0]["metrics"])
    assert 0 < se < mean


@pytest.mark.parametrize("key", ["msg_path", "msg-path"])
def test_an_option_may_be_spelt_as_on_the_command_line_and_still_name_what_lies_beside(tmp_path, key):
    (tmp_path / "msgs").mkdir()

    stated = stated_options(tmp_path, {key: ["msgs", "gone"], "dvl": "msgs"})

    assert stated == [(key, str(tmp_path / "msgs")), (key, "gone"), ("dvl", "msgs")]


def test_a_broken_sign_in_a_model_turns_the_gate_red(gate: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: PositionIncrement, x: np.ndarray) -> np.ndarray:
        psi, u, v = x[self.nonlinear[0]], x[self.linear[0]], x[self.linear[1]]
        c, s = np.cos(psi) * self.dt_s, np.sin(psi) * self.dt_s
        return np.array([u * c + v * s, u * s + v * c])

    monkeypatch.setattr(compiled, "KERNEL", Kernel("numpy", "the kernel has the model in C"))
    whole = _check(gate)
    monkeypatch.setattr(PositionIncrement, "predict", broken)

    run = _check(gate)

    assert whole.returncode == 0, whole.stdout + whole.stderr
    assert run.returncode == 1
    assert "FAILED: dive adf: mean_abs_east_m REGRESSION" in run.stdout
    assert "dive dr" not in run.stdout.split("FAILED")[1]  # dead reckoning does without the motion model


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
