"""What can be wrong with a log: docs/broken_files.md says of each situation what happens, and which tests show it."""

import re
import tracemalloc
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from checkout import ROOT
from logs import refusal
from recordings import FLOAT64, SECOND, T0, short_dive, twist, write_bag, write_mcap, write_payloads
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_log
from usbldr.io.reading.opening import Request
from usbldr.io.reading.read import read_log
from usbldr.io.recordings.mcap_log import McapLog


def test_every_situation_has_a_test_that_shows_it() -> None:
    rows = re.findall(r"^\| (\d+) \|.*$", (ROOT / "docs" / "broken_files.md").read_text(encoding="utf-8"), re.MULTILINE)
    text = (ROOT / "docs" / "broken_files.md").read_text(encoding="utf-8")
    named = re.findall(r"`(test_\w+)\.(test_\w+)`", text)

    assert rows == [str(number) for number in range(1, 33)]
    assert len(named) >= 24
    for file, test in named:
        sources = [source.read_text(encoding="utf-8") for source in (ROOT / "tests").rglob(f"{file}.py")]
        assert any(f"def {test}(" in source for source in sources), f"{file}.{test}"


@pytest.mark.parametrize("folder", [False, True])
def test_what_may_not_be_read_is_named(tmp_path: Path, folder: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "dive"
    if folder:
        log.mkdir()
    else:
        log.write_bytes(b"secret")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir" if folder else "open", refuse)  # a superuser may read all

    assert refusal(LogError, open_log, log) == f"{log}: cannot be read (Permission denied)"


def test_a_recording_under_way_is_read_whatever_its_name(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "a.bag", short_dive())
    running = file.rename(tmp_path / "a.bag.active")

    assert sum(topic.count for topic in open_log(running).topics()) == 33


def test_a_bag_and_an_mcap_file_of_ros_2_are_one_dive(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [twist(T0 + k * SECOND, 1.0, 0.5) for k in range(5)])
    mcap = write_mcap(tmp_path / "b.mcap", [twist(T0 + k * SECOND, 2.0, 0.5) for k in range(5, 8)])

    log = read_log(bag, Request(joined=(str(mcap),)))

    assert log.tables["dvl"]["forward_mps"].tolist() == [1.0] * 5 + [2.0] * 3


def test_memory_goes_by_what_is_wanted_and_not_by_the_file(tmp_path: Path) -> None:
    """Reading beside 64 MB of other messages must not cost 20 MB."""
    peaks: list[float] = []
    for size in (0, 1 << 20):
        text = {"data": "x" * size}
        rows = [
            row
            for k in range(64)
            for row in (twist(T0 + k, 1.0, 0.0), (T0 + k, "/camera", "std_msgs/msg/String", text))
        ]
        file = write_mcap(tmp_path / f"{size}.mcap", rows, CompressionType.NONE, True, 1 << 20)
        del rows, text
        tracemalloc.start()
        read_whole(McapLog(file), {"/dvl": ["twist.linear.x"]})
        peaks.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()

    assert peaks[1] - peaks[0] < 20


def test_a_sensor_without_one_readable_message_is_an_error_with_the_reason(tmp_path: Path) -> None:
    file = write_payloads(tmp_path / "a.mcap", "/compass_hdg", "cdr", FLOAT64, [b"\0\7\0\0" + bytes(8)])

    assert refusal(LogError, read_log, file) == (
        f"{file}: no message of /compass_hdg (compass) could be read: /compass_hdg: 1 messages, the first of "
        "2020-09-13T12:26:40.000Z, do not match their definition in the file: they are in XCDR2, not plain CDR"
    )
