"""A full disk is one sentence with exit code 3, and nothing half-written is left."""

import errno
import os
import resource
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from checkout import SAMPLES
from commands import USBLDR
from usbldr.filters.errors import StorageError, UsageError
from usbldr.io.writing import writing

DIVE = SAMPLES / "lawnmower_turn_db3"
LARGEST = 20_000  # bytes of a file: with them every output below is cut


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST, LARGEST))


def _replay(place: Path, *options: str) -> list[object]:
    return ["replay", DIVE, "--filter", "ekf", "--quiet", "--output", place / "run", *options]


def _run(words: Sequence[object], stdout: Any = subprocess.PIPE, **how: Any) -> subprocess.CompletedProcess[str]:
    command = [*USBLDR, *map(str, words)]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False, **how)


needs_limits = pytest.mark.skipif(os.name != "posix", reason="needs a limit on the size of files")


@needs_limits
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(lambda place: _replay(place, "--plots", "none"), id="tables"),
        pytest.param(lambda place: _replay(place, "--mcap", "alone", "--plots", "none"), id="mcap of a run"),
        pytest.param(lambda place: ["simulate", "paper", "--output", place / "dive.mcap"], id="mcap"),
        pytest.param(lambda place: ["simulate", "paper", "--output", place / "dive.bag"], id="bag"),
        pytest.param(lambda place: ["export", DIVE, "--output", place / "dive.db3"], id="db3"),
        pytest.param(lambda place: ["export", DIVE, "--output", place / "dive"], id="csv"),
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
    words = ["compare", DIVE, "--filters", "ekf", "--jobs", 1, "--quiet", "--output", tmp_path / "compared"]

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
