"""Names in a log that steer a terminal, or hold HTML, links or table breaks: they show as they are, and do nothing."""

import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

from commands import output_of, run
from damage import recorded
from damaged_formats import FORMATS
from recordings import FIX, SECOND, T0, short_dive, write_mcap
from usbldr.filters.errors import MAX_SENTENCE, LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.findings import Finding
from usbldr.io.recordings.mcap_log import McapLog

HOSTILE = '\x1b[2J\x07\n\u202e|<script>alert(1)</script>![x](http://example.com/x.png)`"\\'
SHOWN = r'\x1b[2J\x07\n\u202e|<script>alert(1)</script>![x](http://example.com/x.png)`"' + "\\"


def hostile_dive(file: Path) -> Path:
    """Write a dive whose topics and frames have hostile names."""
    places = [(T0 + k * SECOND, "/gps/fix", FIX, {"latitude": 45.0, "longitude": 7.0}) for k in range(3)]
    hostile = {"header.frame_id": HOSTILE}
    rows = [(t, topic + HOSTILE, kind, {**v, **hostile}) for t, topic, kind, v in [*short_dive(), *places]]
    return write_mcap(file, rows)


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

    output_of("init", file, "--output", written)

    assert tomllib.loads(written.read_text(encoding="utf-8"))["dvl"]["topic"] == "/dvl" + SHOWN
    output_of("replay", file, "--config", written, "--filter", "dr", "--output", tmp_path / "run")


def test_a_topic_is_chosen_by_the_name_that_is_shown(tmp_path: Path) -> None:
    log = McapLog(hostile_dive(tmp_path / "a.mcap"))

    assert len(read_whole(log, {"/dvl" + SHOWN: ["header.stamp"]})["/dvl" + SHOWN].received_ns) == 11


def test_an_endless_sentence_is_shortened_in_the_middle() -> None:
    for text in (str(LogError("a" * 2_000_000, path="b")), Finding("DAMAGED", "a" * 2_000_000).text):
        assert len(text) < MAX_SENTENCE + 100
        assert "characters left out" in text
