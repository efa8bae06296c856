"""Names in a log that steer a terminal, or hold HTML, links or table breaks: they show as they are, and do nothing.

Wrong uses of the command line, as a new user types them: one sentence each, with the documented exit code.
"""

import os
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from checkout import SAMPLES
from commands import output_of, run
from damage import recorded
from damaged_formats import FORMATS
from recordings import FIX, SECOND, T0, short_dive, write_mcap
from usbldr.filters.errors import MAX_SENTENCE, LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.doctor import cross_check
from usbldr.io.findings import Finding
from usbldr.io.recordings.mcap_log import McapLog
from usbldr_cli import main as program

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
def test_no_text_of_any_format_reaches_the_terminal_as_it_is(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the names of topics and fields is overwritten, also where a checksum or a length no longer fits."""
    monkeypatch.setattr(cross_check, "_identified", lambda *_: None)  # takes a second, and names the same topics
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


Answer = tuple[int, str]


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    shutil.copytree(SAMPLES / "lawnmower_turn_db3", tmp_path / "dive_db3")
    shutil.copy(SAMPLES / "lawnmower_turn_db3" / "lawnmower_turn_db3.db3", tmp_path / 'it\'s "mine".db3')
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "notes.txt").write_text("hello\n", encoding="utf-8")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    (tmp_path / "bad.toml").write_text("[dvl", encoding="utf-8")
    monkeypatch.chdir(tmp_path)

    def answer(*words: str) -> Answer:
        monkeypatch.setattr("sys.argv", ["usbldr", *words])
        with pytest.raises(SystemExit) as ended:
            program.main()
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.count("\n") == 1, said.err
        return int(ended.value.code or 0), said.err.strip()

    return answer


@pytest.mark.parametrize(
    ("line", "code", "wanted"),
    [
        ("replay", 2, "Missing argument 'LOG'; see usbldr replay --help"),
        ("dive_db3", 2, "there is no command 'dive_db3'; did you mean usbldr info dive_db3? (commands: info, "),
        ("help replay", 2, "there is no command 'help'; did you mean --help? (commands: "),
        ("repaly dive_db3", 2, "there is no command 'repaly'; did you mean replay?"),
        ("replay dive_db3 ekf", 2, "Got unexpected extra argument (ekf); see usbldr replay --help"),
        ("replay -filter ekf dive_db3", 2, "Got unexpected extra argument (dive_db3); write --filter; see usbldr"),
        ("replay dive_db3 --fliter ekf", 2, "No such option '--fliter'"),
        ("compare dive_db3 --filters ", 2, "--filters names no filter (filters: ekf, "),
        ("compare dive_db3 --filters ekf,ekf", 2, "--filters names ekf twice"),
        ("compare dive_db3 dive_db3", 2, "LOG names dive_db3 twice"),
        ("replay empty.mcap", 3, "empty.mcap: the file is empty"),
        ("replay notes.txt", 3, "notes.txt: unknown format (starts with b'hello"),
        ("replay dvie_db3", 3, "dvie_db3: no such file, folder or scenario; did you mean dive_db3? (scenarios: "),
        ("replay https://host/dive.mcap", 3, "https:/host/dive.mcap: no such file or folder; a URL is read by"),
        ("replay dive_db3 -o notes.txt", 2, "notes.txt: --output names a folder for all results: leave .txt out"),
        ("replay dive_db3 -o full", 2, "{here}/full exists already: choose another --output, or --force to replace"),
        ("replay dive_db3 -o full --force", 2, "{here}/full holds thesis.tex, which usbldr did not write"),
        ("replay dive_db3 -o .", 2, ". contains the input dive_db3: choose another --output"),
        ("replay dive_db3 --seed 1.5", 2, "Invalid value for '--seed': '1.5' is no integer; see usbldr replay --help"),
        ("replay dive_db3 --fast-hz fast", 2, "Invalid value for '--fast-hz': 'fast' is no number; see"),
        ("replay dive_db3 --particles 1", 2, "Invalid value for '--particles' / '-N': 1 is not in the range x>=2"),
        ("replay dive_db3 --calibrate scael", 2, "unknown sensor error 'scael' to calibrate; did you mean scale?"),
        ("replay dive_db3 --aid gps", 2, "--aid gps: write gps@FROM:TO,FROM:TO with seconds of the log"),
        ("replay dive_db3 --config bad.toml", 2, "bad.toml: is not valid TOML (Expected ']'"),
        ("replay dive_db3 --usbl /usbl/fxi", 3, "dive_db3: no topic /usbl/fxi for the usbl; did you mean /usbl/fix"),
        ("replay dive_db3 --truth /gps/fxi", 3, "dive_db3: truth /gps/fxi is neither a file, here or beside the"),
        ("check notes.txt", 2, "notes.txt: is no baseline, NAME.toml; usbldr baseline notes.txt writes a first"),
        ("init dive_db3 -o dive.yaml", 2, "dive.yaml: --output writes TOML: choose NAME.toml"),
        ("simulate papr -o d.mcap", 2, "there is no scenario 'papr'; did you mean paper? (scenarios: "),
        ("drill dive_db3 --suite stnadard", 2, "there is no suite stnadard; did you mean standard? (a file"),
        ("replay dive_db3 --fast-hz 1e9", 2, "1e+09 Hz over "),
        ("replay dive_db3 --fast-hz 0", 2, "rates must be between 0.001 and 1e+09 Hz (fast 0, slow 1)"),
        ("replay dive_db3 --dr-from 91,0", 2, "--dr-from 91,0 is not a position"),
        ("replay dive_db3 --start 5 --end 4", 2, "--start 5 is not before --end 4"),
        ("replay dive_db3 --start noon", 2, "--start noon is neither seconds nor ISO time"),
        ("replay dive_db3 --filter efk", 2, "there is no filter 'efk'; did you mean ekf? (filters: ekf, ckf,"),
        ("replay dive_db3 --filter CPF", 2, "there is no filter 'CPF'; did you mean cpf?"),
        ("replay dive_db3 --write-calibration dive.yaml", 2, "dive.yaml: --write-calibration writes TOML: choose"),
        ("replay dive_db3 --usbl /gps/fix --gps /gps/fix", 2, "dive_db3: /gps/fix cannot be the usbl and the truth"),
        ("replay dive_db3 --filter dr --aid gps@0:60", 2, "--aid needs a filter, and dr is not one"),
        ("replay paper --dvl /dvl", 2, "paper: a scenario takes no --truth, --with, --set or topics, and no"),
        ("compare dive_db3 --filters dr,usbl --aid gps@0:60", 2, "--aid is for filters, none of which is compared"),
        ("compare paper --filters cpf,dr --gate 0.99", 2, "--gate is for ekf, ckf, ukf"),
        ("compare paper --calibrate speed", 2, "unknown sensor error 'speed' to calibrate (known: scale,"),
        ("baseline dive_db3 --smooth", 2, "--smooth is a flag, which the row of a baseline cannot hold"),
        ("baseline dive_db3 dive_db3", 2, "LOG"),
        ("drill dive_db3 --drop usbl@1:2 -o .", 2, ". contains the input dive_db3"),
        ("init dive_db3 --config any.toml -o a.toml", 2, "any.toml: no such configuration file"),
    ],
)
def test_a_wrong_use_is_answered_in_one_sentence(ask, tmp_path, line, code, wanted):
    before = sorted(tmp_path.rglob("*"))

    found, said = ask(*line.split(" "))

    assert said.startswith("usbldr: " + wanted.replace("{here}", str(tmp_path))), said
    assert found == code
    assert sorted(tmp_path.rglob("*")) == before


def test_quotes_and_control_characters_in_a_name_reach_no_terminal(ask: Callable[..., Answer], tmp_path: Path) -> None:
    (tmp_path / "a\nb\x1b[31m.mcap").write_text("a", encoding="utf-8")

    assert ask("info", 'it\'s "mine".db4')[1].startswith(
        'usbldr: it\'s "mine".db4: no such file, folder or scenario; did'
    )
    assert ask("info", "a\nb\x1b[31m.mcap")[1].startswith("usbldr: a\\nb\\x1b[31m.mcap: unknown format")


@pytest.mark.parametrize("words", ["info {}", "replay {} -o run", "compare dive_db3 -o {}", "init dive_db3 -o {}.toml"])
def test_a_name_that_is_not_utf_8_is_refused(words: str, ask: Callable[..., Answer], tmp_path: Path) -> None:
    name = os.fsdecode(b"m\xe5ling")
    shutil.copytree(tmp_path / "dive_db3", tmp_path / name)

    code, said = ask(*(word.format(name) for word in words.split()))

    assert (code, said[: len("usbldr: m\\udce5ling")]) == (2, "usbldr: m\\udce5ling")
    assert "this name is not UTF-8; rename the file, or choose another name" in said


def test_so_is_one_within_a_folder(ask: Callable[..., Answer], tmp_path: Path) -> None:
    (tmp_path / "dive").mkdir()
    (tmp_path / "dive" / os.fsdecode(b"dvl_m\xe5ling.csv")).write_text("time_s,forward_mps,starboard_mps\n1,2,3\n")

    assert ask("info", "dive") == (3, "usbldr: dive/dvl_m\\udce5ling.csv: its name is not UTF-8; rename it")
