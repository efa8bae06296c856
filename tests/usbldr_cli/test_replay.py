"""What replay refuses and what it says aside from the table."""

import hashlib
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from checkout import SAMPLES
from commands import finished, output_of, report_of, run
from recordings import saved


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


def test_without_plots_nothing_is_drawn_and_matplotlib_is_not_imported(dive: Path) -> None:
    out = dive.parent / "run"
    words = ["replay", str(dive), "-f", "dr", "-o", str(out), "--plots", "none", "-q"]
    replayed = f"from usbldr_cli.main import cli; cli.main({words!r}, standalone_mode=False)"
    code = f"import sys; {replayed}; sys.exit('matplotlib' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert not list(out.glob("*.png"))
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
