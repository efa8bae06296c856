"""What replay refuses and says aside from the table; ``--verify``: the same bits, rounding, the first difference.

A filter of one's own is one row of METHODS: every command then knows it.
"""

import hashlib
import json
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from checkout import SAMPLES
from commands import finished, output_of, report_of, run, spoil, write_short
from logs import refusal
from recordings import saved
from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step
from usbldr.filters.models.states import POSITION
from usbldr.filters.replay.methods import METHODS, Method
from usbldr_cli.figures.run_figures import run_pictures
from usbldr_cli.figures.style import colour
from usbldr_cli.runs.repeat_run import Difference, Verification


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    for file in SAMPLES.glob("paper.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "paper.mcap"


def replay(dive: Path, *options: str) -> Result:
    return run("replay", dive, "-o", dive.parent / "run", *options)


def test_lost_data_is_said_on_stderr_and_ends_in_exit_3_and_without_a_run_if_it_is_strict(dive):
    dive.write_bytes(dive.read_bytes()[:200_000])

    strict = finished("replay", dive, "--strict", "-o", dive.parent / "run")
    assert not (dive.parent / "run").exists()
    done = finished("replay", dive, "-f", "dr", "-q", "-o", dive.parent / "run")

    assert (strict.returncode, done.returncode) == (3, 3)
    assert "truncated or damaged" in strict.stderr
    assert done.stderr.startswith("usbldr: paper.mcap: the file is truncated or damaged")
    assert done.stderr.endswith("[TRUNCATED]\n")
    assert (dive.parent / "run" / "report.json").is_file()


def test_numbers_on_almost_nothing_are_called_that(dive: Path) -> None:
    done = replay(dive, "--filter", "dr", "--start", "500", "--end", "501")

    assert done.return_value == 0
    assert "these numbers rest on 2 of the track's epochs alone" in " ".join(done.stdout.split())


def test_a_quiet_run_still_warns(tmp_path: Path) -> None:
    """Of gross fixes and of the compass's bias the sigmas know nothing."""
    target = tmp_path / "run"
    options = ["-f", "adf", "--calibrate", "none", "--noise", "usbl=gaussian", "-q", "-o", target]

    done = run("replay", SAMPLES / "lawnmower_csv", *options)

    warnings = report_of(target)["warnings"]
    assert any("is far over-confident" in text for text in warnings)
    assert all(f"usbldr: {text}\n" in done.stderr for text in warnings)
    assert done.stdout.count("\n") == 1


def test_remarks_are_left_out_of_a_quiet_run(tmp_path: Path) -> None:
    rows = "".join(f"{1.6e9 + k / 5},1.5,0.1,{k / 5}\n" for k in range(100))
    names = "Time [s],DVL Forward [m/s],DVL Starboard [m/s],Heading [deg]\n"
    log = saved(tmp_path / "dive.csv", names, rows)

    usual, quiet = (run("replay", log, "-f", "dr", *more, "-o", tmp_path / "run") for more in ([], ["-q", "--force"]))

    assert ("[COLUMNS-BY-NAME]" in usual.stderr, "[COLUMNS-BY-NAME]" in quiet.stderr) == (True, False)


@pytest.mark.parametrize("command", ["replay", "export"])
def test_the_configuration_is_parsed_once(dive: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    parse, texts = tomllib.loads, list[str]()
    monkeypatch.setattr(tomllib, "loads", lambda text: texts.append(text) or parse(text))

    output_of(command, dive, "-o", dive.parent / "out", *(["-f", "dr"] if command == "replay" else []))
    assert texts == [(dive.parent / "paper.usbldr.toml").read_text(encoding="utf-8")]


@pytest.mark.parametrize(("calibrate", "knows_later"), [("auto", True), ("none", False)])
@pytest.mark.long
def test_a_run_by_arrival_says_if_it_was_identified_from_the_whole_log(dive, calibrate, knows_later):
    said = replay(dive, "-f", "ekf", "--end", "120", "--calibrate", calibrate, "--order", "arrival").output

    report = (dive.parent / "run" / "report.md").read_text()
    assert ("later fixes included" in " ".join(said.split())) == ("later fixes included" in report) == knows_later


def test_without_plots_nothing_is_drawn_there_is_no_page_and_matplotlib_is_not_imported(dive: Path) -> None:
    out = dive.parent / "run"
    words = ["replay", str(dive), "-f", "dr", "-o", str(out), "--plots", "none", "-q"]
    replayed = f"from usbldr_cli.main import cli; cli.main({words!r}, standalone_mode=False)"
    code = f"import sys; {replayed}; sys.exit('matplotlib' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert not [*out.glob("*.png"), *out.glob("report.html")]
    assert "## Figures" not in (out / "report.md").read_text()


def test_a_report_says_how_it_was_made(dive: Path) -> None:
    truth, out = dive.parent / "truth.csv", dive.parent / "run"
    truth.write_text("time_ns,east_m,north_m\n1767225600000000000,0,0\n1767225601000000000,1,1\n", encoding="utf-8")
    inputs = {"log": dive, "configuration": dive.parent / "paper.usbldr.toml", "truth": truth}
    words = tuple(map(str, ("replay", dive, "-f", "usbl", "--truth", truth, "--plots", "none", "-o", out)))
    assert run(*words).exit_code == 0

    report = report_of(out)

    made = report["provenance"]
    assert made["command"] == ["usbldr", *words]
    assert {one["role"]: (one["file"], one["sha256"]) for one in made["inputs"]} == {
        role: (file.name, hashlib.sha256(file.read_bytes()).hexdigest()) for role, file in inputs.items()
    }
    assert made["python"] == ".".join(map(str, sys.version_info[:3]))
    assert made["libraries"]["numpy"] == np.__version__
    assert made["kernel"] in ("numpy", "portable", "avx2", "avx512")
    assert (report["request"]["filter"], report["request"]["selection"]["truth"]) == ("usbl", str(truth))


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


PAPER = str(SAMPLES / "paper.mcap")


@dataclass(frozen=True)
class LastFix:
    def start(self, prior: Prior) -> Prior:
        return prior

    def step(self, belief: Prior, step: Step, make_rng: MakeRng) -> Prior:
        mean = belief.mean.copy()
        for measurement in step.measurements:
            if measurement.sensor == "usbl":
                mean[POSITION] = measurement.z
        return Prior(mean, belief.cov)

    def estimate(self, belief: Prior) -> Estimate:
        return Estimate(belief.mean, belief.cov, (), 1.0, float("nan"))


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    row = Method("last-fix", "the last fix, held", lambda *_: LastFix(), draws=True, takes_gate=True, colour="#123456")
    monkeypatch.setitem(METHODS, row.name, row)


@pytest.mark.usefixtures("own")
def test_replay_runs_a_filter_that_is_one_row_and_draws_it_in_its_colour(tmp_path, monkeypatch):
    monkeypatch.setattr("usbldr_cli.figures.run_figures.run_pictures", run_pictures)
    done = run("replay", PAPER, "-f", "last-fix", "--calibrate", "none", "-o", str(tmp_path / "run"))

    report = report_of(tmp_path / "run")
    raw_m = report["reference_tracks"]["usbl"]["metrics"]["mean_horizontal_m"]
    assert done.exit_code == 0, done.output
    assert report["filter"] == "last-fix"
    assert report["metrics"]["mean_horizontal_m"] == pytest.approx(raw_m)  # the log has a fix at each second
    assert (tmp_path / "run" / "track.png").stat().st_size > 10_000
    assert colour("last-fix") == "#123456"


@pytest.mark.usefixtures("own")
def test_help_and_refusals_know_a_filter_that_is_one_row() -> None:
    reported = run("replay", "--help").output

    assert "the last fix, held" in reported
    assert " ".join(reported.split()).count("pf-wekf, last-fix") == 1  # those that draw
    refused = partial(refusal, UsageError, output_of, "replay", PAPER, "--calibrate", "none")
    assert "last-fix is too far from a Gaussian" in refused("-f", "last-fix", "--smooth")
    assert "ukf, last-fix" in refused("-f", "cpf", "--gate", "0.9")


@pytest.mark.usefixtures("own")
def test_compare_runs_a_filter_that_is_one_row_once_a_seed() -> None:
    done = run("compare", PAPER, "--filters", "dr,last-fix", "--seeds", "2", "--calibrate", "none", "--json")

    rows = json.loads(done.output)["rows"]
    assert [(row["filter"], row["seeds"]) for row in rows] == [("dr", 1), ("last-fix", 2)]
