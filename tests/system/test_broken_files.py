"""Any file may be cut or damaged anywhere: a log that is partial and says so, or one sentence; never a traceback."""

from collections.abc import Callable
from pathlib import Path

import pytest

from commands import run
from recordings import short_dive, write_bag, write_csv, write_mcap, write_rosbag2
from usbldr.filters.errors import LogError

HEADER = "time_ns,starboard_mps,forward_mps\n"
WRITERS: dict[str, Callable[[Path], Path]] = {
    "MCAP": lambda folder: write_mcap(folder / "a.mcap", short_dive() * 10, chunk_size=4096),
    "ROS 1 bag": lambda folder: write_bag(folder / "a.bag", short_dive() * 10, "lz4", 4096),
    "rosbag2": lambda folder: write_rosbag2(folder / "a", short_dive() * 10) / "a.db3",
    "CSV": lambda folder: write_csv(folder / "a", dvl=HEADER + "1,2,3\n" * 300) / "dvl.csv",
}


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("content", [b"", b"\0\1\2\3 no log at all"])
def test_an_empty_or_foreign_file_is_exit_3_and_one_sentence(tmp_path: Path, kind: str, content: bytes) -> None:
    file = WRITERS[kind](tmp_path)
    file.write_bytes(content)
    before = sorted(tmp_path.rglob("*"))

    for command in (["info", str(file)], ["export", str(file), "-o", str(tmp_path / "new.bag")]):
        done = run(*command)

        assert isinstance(done.exception, LogError)
        assert str(done.exception).startswith(f"{file}: ")
        assert "\n" not in str(done.exception)
    assert sorted(tmp_path.rglob("*")) == before
