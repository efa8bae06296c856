"""The files of --json, --markdown, --write-calibration and init: never over an input, and refused before the run."""

import errno
import os
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import logs
import usbldr_cli.compare
import usbldr_cli.runs.one_run
import usbldr_cli.tables.check_verdicts
from checkout import SAMPLES
from commands import output_of, run
from usbldr.filters.errors import StorageError, UsageError
from usbldr_cli.options.output_files import name_of, refuse_file, write_file

ROW = """\
schema = 1
[[row]]
name = "r"
log = "paper.mcap"
filter = "dr"
[row.metrics]
mean_horizontal_m = { rel = 1 }
"""


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    """Return a log beside its configuration, a truth file and a baseline."""
    for file in SAMPLES.glob("paper.*"):
        shutil.copy(file, tmp_path)
    (tmp_path / "truth.csv").write_text("time_ns,east_m,north_m\n1767225600000000000,0,0\n", encoding="utf-8")
    (tmp_path / "baseline.toml").write_text(ROW, encoding="utf-8")
    return tmp_path / "paper.mcap"


@pytest.fixture
def _nothing_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any, **__: Any) -> Any:
        raise AssertionError("a filter was run")

    monkeypatch.setattr(usbldr_cli.runs.one_run, "finish_run", never)
    monkeypatch.setattr(usbldr_cli.compare, "_run", never)
    monkeypatch.setattr(usbldr_cli.tables.check_verdicts, "run_jobs", never)


refusal = partial(logs.refusal, UsageError, output_of)


@pytest.mark.usefixtures("_nothing_runs")
@pytest.mark.parametrize("name", ["paper.mcap", "paper.usbldr.toml", "truth.csv", "baseline.toml"])
def test_no_input_is_overwritten_even_with_force(dive: Path, name: str) -> None:
    here = dive.parent
    asked = ("--truth", here / "truth.csv", "--force", "--json", here / name)
    commands: list[tuple[object, ...]] = [
        ("check", here / "baseline.toml", "--force", "--json", here / name),
        ("check", here / "baseline.toml", "--force", "--markdown", here / name),
    ]
    if name != "baseline.toml":
        commands += [("replay", dive, "-o", here / "run", *asked), ("compare", dive, *asked)]
        option = ("--write-calibration", here / name)
        commands += [("replay", dive, "-o", here / "run", *asked[:3], *option)]
    if name != "paper.usbldr.toml":
        commands += [("init", dive, "--with", here / "baseline.toml", *asked[:3], "-o", here / name)]
    before = {file: file.read_bytes() for file in here.iterdir()}

    for command in commands:
        if name == "truth.csv" and command[0] == "check":
            continue
        said = refusal(*command)
        why = ("is the log:", "is also an input:", "is the baseline:", "--output writes")
        assert said.removeprefix(f"{here / name}").lstrip(": ").startswith((*why, "--write-calibration writes TOML"))

    assert {file: file.read_bytes() for file in here.iterdir()} == before


@pytest.mark.usefixtures("_nothing_runs")
def test_a_file_that_cannot_be_written_is_refused_before_the_run(dive: Path) -> None:
    here = dive.parent
    for place in ("gone/r.json", "truth.csv/r.json"):
        for command in (("replay", dive, "-o", here / "run"), ("compare", dive), ("check", here / "baseline.toml")):
            said = refusal(*command, "--json", here / place)
            folder = (here / place).parent
            assert said == f"{here / place}: there is no folder {folder}: choose another file for --json"
    assert refusal("check", here / "baseline.toml", "--markdown", here / "gone" / "p.md").endswith("for --markdown")
    assert refusal("init", dive, "-o", here / "gone" / "u.toml").endswith("choose another file for --output")


def test_a_folder_without_leave_to_write_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)  # as root, every folder is writable

    with pytest.raises(UsageError, match=r"r\.json: cannot be written \(no permission\): choose another file"):
        refuse_file("--json", tmp_path / "r.json", False, ())


@pytest.mark.usefixtures("_nothing_runs")
@pytest.mark.parametrize("command", ["replay", "compare"])
def test_a_run_never_replaces_a_folder_that_it_reads(dive: Path, command: str) -> None:
    run = dive.parent / "run"
    run.mkdir()
    shutil.move(dive.parent / "paper.usbldr.toml", run / "compare.csv")
    (run / "report.json").write_text('{"tool": {"name": "usbldr"}, "files": ["compare.csv"]}', encoding="utf-8")
    if command == "compare":
        (run / "report.json").unlink()

    said = refusal(command, dive, "--config", run / "compare.csv", "--force", "-o", run)

    assert said == f"{run} contains the input {run / 'compare.csv'}: choose another --output"
    assert (run / "compare.csv").is_file()


@pytest.mark.usefixtures("_nothing_runs")
@pytest.mark.long
def test_nothing_is_written_into_the_folder_of_a_log_but_its_configuration(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    shutil.copytree(SAMPLES / "lawnmower_csv", folder)

    said = refusal("replay", folder, "-o", tmp_path / "run", "--json", folder / "dvl.csv", "--force")
    done = run("init", folder, "--force")

    assert said == f"{folder / 'dvl.csv'} is inside the input {folder}: choose another file for --json"
    assert done.exception is None
    assert "usbldr init" in (folder / "usbldr.toml").read_text(encoding="utf-8")


def test_a_scenario_is_not_overwritten_by_the_configuration_of_its_log(tmp_path: Path) -> None:
    mine = tmp_path / "mine.usbldr.toml"
    mine.write_text('schema = 1\nlike = "paper"\nabout = "mine"\nduration_s = 20.0\n', encoding="utf-8")

    for command in ("simulate", "export"):
        said = refusal(command, mine, "-o", tmp_path / "mine.mcap", "--force")
        assert said == f"{mine}: is the log; choose another name"
    assert mine.read_text(encoding="utf-8").startswith("schema")


def test_a_fault_of_writing_is_a_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    long = tmp_path / ("r" * 300)

    with pytest.raises(UsageError, match=r"cannot be written \(File name too long\): choose another file for --json"):
        write_file("--json", long, "{}")

    assert list(tmp_path.iterdir()) == []


def test_a_file_that_was_there_is_as_it_was_where_writing_fails_half_way(tmp_path, monkeypatch):
    def fail(part: Path, content: bytes | str, **_: str) -> None:
        with part.open("wb") as stream:
            stream.write(content.encode()[:3] if isinstance(content, str) else content[:3])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    file = tmp_path / "r.json"
    file.write_text("old", encoding="utf-8")
    monkeypatch.setattr(Path, "write_bytes", fail)
    monkeypatch.setattr(Path, "write_text", fail)

    with pytest.raises(StorageError, match="No space left on device"):
        write_file("--json", file, "{}\n")

    assert [(left, left.read_text()) for left in tmp_path.iterdir()] == [(file, "old")]


def test_a_link_stays_a_link_and_a_pipe_is_written_to(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "real")
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)

    for name in ("link", "pipe"):
        refuse_file("--json", tmp_path / name, False, ())
        write_file("--json", tmp_path / name, "{}\n")

    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text(encoding="utf-8") == os.read(reader, 100).decode() == "{}\n"
    os.close(reader)


@pytest.mark.parametrize(
    ("log", "name"), [(".", "day.1"), ("..", "cruise"), ("../day.1", "day.1"), ("dive.mcap", "dive")]
)
def test_results_are_named_after_the_log_also_if_it_is_the_current_folder(tmp_path, monkeypatch, log, name):
    folder = tmp_path / "cruise" / "day.1"
    folder.mkdir(parents=True)
    (folder / "dive.mcap").touch()
    monkeypatch.chdir(folder)

    assert name_of(Path(log)) == name
