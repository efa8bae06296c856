"""``usbldr replay --verify``: what is the same to the bit, what is rounding, and where a run first differs."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import Result

from commands import output_of, run, spoil, write_short
from logs import refusal
from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.runs.repeat_run import Difference, Verification


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log and the run directory of its first minute."""
    folder = tmp_path_factory.mktemp("verify")
    write_short(folder / "paper.mcap", "paper", 100.0)
    options = ("-f", "ekf", "--gate", "0.99", "--end", "60", "--noise", "usbl=student-t:4", "--plots", "none")
    output_of("replay", folder / "paper.mcap", *options, "-o", folder / "run")
    return folder


@pytest.fixture
def report(made: Path, tmp_path: Path) -> Path:
    """Return the report of a copy that a test may spoil."""
    shutil.copytree(made / "run", tmp_path / "run")
    return tmp_path / "run" / "report.json"


def _verify(report: Path, *more: object) -> Result:
    return run("replay", *more, "--verify", report)


@pytest.mark.long
def test_a_run_is_repeated_with_all_its_options_to_the_bit(report: Path) -> None:
    done = _verify(report)

    assert done.return_value == 0
    assert done.output.startswith(f"{report}: bit-identical (")
    assert len(done.output.splitlines()) == 1
    assert _verify(report.parent).output == done.output


@pytest.mark.long
def test_the_log_may_lie_elsewhere(made: Path, report: Path, tmp_path: Path) -> None:
    spoil(report, str(made / "paper.mcap"), "gone/paper.mcap")

    said = refusal(LogError, output_of, "replay", "--verify", report)
    assert "gone/paper.mcap: no such log; name it: usbldr replay LOG --verify" in said
    assert _verify(report, made / "paper.mcap").return_value == 0
    for file in made.glob("paper.*"):
        shutil.copy(file, tmp_path)  # beside the run directory
    assert _verify(report).return_value == 0


def test_a_number_that_differs_is_named_with_both_values(report: Path) -> None:
    was = json.loads(report.read_text())["metrics"]["mean_abs_north_m"]
    spoil(report, f'"mean_abs_north_m": {was!r}', '"mean_abs_north_m": 9.5')

    done = _verify(report)

    assert done.return_value == 1
    assert done.output == (
        f"{report}: differs first in metrics.mean_abs_north_m: 9.5 before, {was!r} now; "
        f"1 of {done.output.split(' values differ')[0].split()[-1]} values differ\n"
    )


def test_another_log_is_the_first_difference_and_not_its_errors(report: Path) -> None:
    content = json.loads(report.read_text())
    content["metrics"]["mean_abs_north_m"], content["log"]["sha256"] = 9.5, "0" * 64
    report.write_text(json.dumps(content))

    assert "differs first in log.sha256: 0000" in _verify(report).output


def test_a_track_that_differs_is_shown_at_its_first_epoch(report: Path) -> None:
    spoil(report, json.loads(report.read_text())["track"]["sha256"], "0" * 64)
    lines = (report.parent / "track_5hz.csv").read_text().splitlines()
    time_s, east_m, *rest = lines[8].split(",")
    lines[8] = ",".join([time_s, str(float(east_m) + 0.25), *rest])
    (report.parent / "track_5hz.csv").write_text("\n".join(lines) + "\n")

    done = _verify(report)

    assert done.return_value == 1
    assert f"differs first in the track at {time_s} s, east_m: {float(east_m) + 0.25}" in done.output


def test_rounding_passes_on_another_machine_alone(tmp_path: Path) -> None:
    rounded = Difference("metrics.rmse_east_m", 0.25, 0.25 + 1e-12)
    moved = Difference("metrics.rmse_east_m", 0.25, 0.2501)
    elsewhere = (Difference("kernel", "avx2", "numpy"),)

    assert Verification(tmp_path, 9, (rounded,), elsewhere).passed
    assert "equal within 1e-09, but not to the bit" in Verification(tmp_path, 9, (rounded,), elsewhere).verdict
    assert not Verification(tmp_path, 9, (rounded,), ()).passed
    assert not Verification(tmp_path, 9, (rounded, moved), elsewhere).passed
    assert Verification(tmp_path, 9, (rounded, moved), elsewhere).environment_text == (
        "the report was made with kernel avx2, now numpy"
    )


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("no JSON", "is no report.json of usbldr replay"),
        ('{"tool": {"name": "usbldr"}, "schema": 4, "request": {"logs": []}}', "was not written by usbldr replay"),
        (
            '{"tool": {"name": "usbldr"}, "schema": 3, "request": {"filter": "ekf"}}',
            "has schema 3, this version writes 4",
        ),
    ],
)
def test_what_is_no_report_of_replay_is_refused(tmp_path: Path, content: str, sentence: str) -> None:
    (tmp_path / "report.json").write_text(content)

    assert sentence in refusal(UsageError, output_of, "replay", "--verify", tmp_path / "report.json")


def test_options_beside_verify_are_refused(report: Path) -> None:
    said = refusal(UsageError, output_of, "replay", "--gate", "0.9", "--verify", report)
    assert "--verify repeats the run of its report as it was: leave --gate out" in said
