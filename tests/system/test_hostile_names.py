"""Names in a log that steer a terminal, or hold HTML, links or table breaks: they show as they are, and do nothing."""

import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mcap.writer import Writer

from commands import run
from damage import recorded
from damaged_formats import FORMATS
from recordings import ROS2, SECOND, T0, message, short_dive
from usbldr.filters.errors import MAX_SENTENCE, LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.findings import Finding
from usbldr.io.recordings.mcap_log import McapLog

HOSTILE = '\x1b[2J\x07\n\u202e|<script>alert(1)</script>![x](http://example.com/x.png)`"\\'
SHOWN = r'\x1b[2J\x07\n\u202e|<script>alert(1)</script>![x](http://example.com/x.png)`"' + "\\"


def hostile_dive(file: Path) -> Path:
    """Write a dive whose topics and frames have hostile names."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for time_ns, topic, type_name, values in [*short_dive(), *_fixes()]:
            if topic not in channels:
                text, _ = ROS2.generate_msgdef(type_name, ros_version=2)
                schema = writer.register_schema(type_name, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic + HOSTILE, "cdr", schema)
            named = dict(values) | {"header.frame_id": HOSTILE}
            data = bytes(ROS2.serialize_cdr(message(type_name, named), type_name))
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()
    return file


def _fixes() -> list[tuple[int, str, str, dict[str, float]]]:
    values = {"latitude": 45.0, "longitude": 7.0}
    return [(T0 + k * SECOND, "/gps/fix", "sensor_msgs/msg/NavSatFix", values) for k in range(3)]


def test_names_show_as_they_are_and_do_nothing(tmp_path: Path) -> None:
    file = hostile_dive(tmp_path / "a<b>\x1b[1m.mcap")
    pages: list[str] = []
    for command in (
        ["info", file],
        ["doctor", file],
        ["replay", file, "--filter", "dr", "--output", tmp_path / "run"],
        ["replay", file, "--dvl", "/none"],
    ):
        done = run(*command)
        pages += [done.stdout, done.stderr, str(done.exception or "")]
    report = (tmp_path / "run" / "report.md").read_text(encoding="utf-8")

    for page in [*pages, report]:
        assert all(char.isprintable() or char == "\n" for char in page)
    assert "/dvl" + SHOWN in pages[0]
    for line in report.splitlines():
        outside = "".join(line.split("`")[::2])  # code shows as it is
        assert "<script>" not in outside
        assert "![x](" not in outside
        if line.startswith("| dvl"):
            assert line.replace(r"\|", "").count("|") == 7  # six cells
    for kml in (tmp_path / "run").rglob("*.kml"):
        ElementTree.parse(kml)


@pytest.mark.parametrize("form", FORMATS)
def test_no_text_of_any_format_reaches_the_terminal_as_it_is(form: str) -> None:
    """Each of the names of topics and fields is overwritten, also where a checksum or a length no longer fits."""
    with recorded(form) as (file, path, whole, _):
        for topic, fields in FORMATS[form].wanted.items():
            for name in {*re.split(r"[/.\[\]]", topic), *fields[-1].split(".")} - {""}:
                file.write_bytes(whole.replace(name.encode(), (HOSTILE.encode() * 9)[: len(name)]))
                for command in ("info", "doctor"):
                    done = run(command, path)
                    said = f"{done.stdout}{done.stderr}{done.exception or ''}"
                    assert all(char.isprintable() or char == "\n" for char in said)


def test_init_quotes_the_names_that_it_writes(tmp_path: Path) -> None:
    file = hostile_dive(tmp_path / "a\n[gps].mcap")
    written = tmp_path / "found.toml"

    assert run("init", file, "--output", written).exception is None

    assert tomllib.loads(written.read_text(encoding="utf-8"))["dvl"]["topic"] == "/dvl" + SHOWN
    assert run("replay", file, "--config", written, "--filter", "dr", "--output", tmp_path / "run").exception is None


def test_a_topic_is_chosen_by_the_name_that_is_shown(tmp_path: Path) -> None:
    log = McapLog(hostile_dive(tmp_path / "a.mcap"))

    assert len(read_whole(log, {"/dvl" + SHOWN: ["header.stamp"]})["/dvl" + SHOWN].received_ns) == 11


def test_an_endless_sentence_is_shortened_in_the_middle() -> None:
    for text in (str(LogError("a" * 2_000_000, path="b")), Finding("DAMAGED", "a" * 2_000_000).text):
        assert len(text) < MAX_SENTENCE + 100
        assert "characters left out" in text
