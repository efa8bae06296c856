"""Logs behind a URL, in fsspec's memory and file systems."""

import sys
from pathlib import Path

import pytest

from commands import write_short
from usbldr.filters.errors import LogError, UsageError
from usbldr.io.drills.drill import Drill
from usbldr.io.reading.opening import DEFAULT_REQUEST
from usbldr.io.reading.remote import is_url, local_log
from usbldr.io.session import is_simulated
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.drill_rows import DrillPlan
from usbldr_cli.runs.jobs import run_job
from usbldr_cli.runs.workers import Job

fsspec = pytest.importorskip("fsspec")


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    """A log with a configuration that names a truth file, beside one that nobody names."""
    file = tmp_path / "logs" / "dive.mcap"
    file.parent.mkdir()
    write_short(file, "paper", 20.0)
    configuration = file.with_suffix(".usbldr.toml")
    configuration.write_text('schema = 1\n[truth]\nfile = "more/track.tum"\n')
    (file.parent / "more").mkdir()
    (file.parent / "more" / "track.tum").write_text("1767225600.0 1 2 0 0 0 0 1\n")
    (file.parent / "other.mcap").write_bytes(b"not copied")
    return file


@pytest.fixture
def bucket(dive: Path) -> str:
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    for file in dive.parent.rglob("*.*"):
        memory.pipe(f"/bucket/{file.relative_to(dive.parent)}", file.read_bytes())
    return "memory://bucket"


def test_a_log_and_what_its_configuration_names_are_copied_as_long_as_they_are_read(bucket: str, dive: Path) -> None:
    with local_log(f"{bucket}/dive.mcap", DEFAULT_REQUEST) as copy:
        found = sorted(str(path.relative_to(copy.parent)) for path in copy.parent.rglob("*") if path.is_file())
        assert copy.read_bytes() == dive.read_bytes()

    assert found == ["dive.mcap", "dive.usbldr.toml", "more/track.tum"]
    assert not copy.parent.exists()


def test_a_path_is_itself_and_no_copy(dive: Path) -> None:
    with local_log(str(dive), DEFAULT_REQUEST) as same:
        assert same == dive
    assert not is_url(dive)


def test_a_file_outside_of_the_logs_folder_is_not_copied(bucket: str) -> None:
    memory = fsspec.filesystem("memory")
    memory.pipe("/bucket/deep/dive.mcap", memory.cat("/bucket/dive.mcap"))
    memory.pipe("/bucket/deep/dive.usbldr.toml", b'schema = 1\n[truth]\nfile = "../more/track.tum"\n')

    with local_log(f"{bucket}/deep/dive.mcap", DEFAULT_REQUEST) as copy:
        assert not (copy.parent.parent / "more").exists()


@pytest.mark.parametrize(
    ("url", "fault", "said"),
    [
        ("memory://bucket/absent.mcap", LogError, "(no such file|is not the URL)"),
        ("memory://bucket/..", LogError, "(no such file|is not the URL)"),
        ("memory://bucket/dive.mcap", LogError, "no records$"),
        ("s3://bucket/dive.mcap", UsageError, r".*install 'usbldr\[s3\]'"),
    ],
)
def test_a_fault_names_the_url_and_not_the_copy(bucket, url, fault, said, monkeypatch):
    monkeypatch.setitem(sys.modules, "s3fs", None)

    with pytest.raises(fault, match=rf"^{url}: {said}"), local_log(url, DEFAULT_REQUEST) as copy:
        raise LogError("no records", path=copy)


def test_runs_and_drills_take_a_url_and_give_the_numbers_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "dive.mcap"
    write_short(file, "paper", 20.0)
    choices = RunChoices(20, None, 0, None, None, "none", "start", 5.0, 1.0, "none")
    drill = Drill("none", ())

    here, there = (run_job(Job(log, "ekf", choices)) for log in (str(file), f"file://{file}"))

    assert here.outcome.metrics == there.outcome.metrics
    assert here.key == there.key
    assert DrillPlan(f"file://{file}", (drill,), ["ekf"], 1, choices, {}).length_s() == pytest.approx(20.0)
    assert not is_simulated(f"file://{file}")
