"""Completion as a shell asks for it: click's own interface for zsh and fish, and a real bash."""

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from checkout import SAMPLES
from usbldr.filters.replay.methods import METHODS
from usbldr.io.formats import detect
from usbldr_cli.main import cli
from usbldr_cli.options import completion

PROGRAMS = Path(sys.executable).parent
needs_bash = pytest.mark.skipif(
    not (shutil.which("bash") and (PROGRAMS / "usbldr").exists()), reason="needs bash and the command usbldr"
)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copy(SAMPLES / "paper.mcap", tmp_path / "dive.mcap")
    (tmp_path / "dr").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def suggested(*words: str) -> list[str]:
    """Return what is suggested for the last word; "<file>" if the shell is to complete names of files."""
    found = ShellComplete(cli, {}, "usbldr", "_USBLDR_COMPLETE").get_completions(list(words[:-1]), words[-1])
    return ["<file>" if one.type == "file" else str(one.value) for one in found]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("re",), ["replay"]),
        (("replay", ""), ["<file>"]),
        (("replay", "di"), ["<file>"]),
        (("replay", "paper-"), ["paper-drawn", "paper-range"]),
        (("simulate", "lake"), ["lake"]),
        (("replay", "dive.mcap", "--filter", ""), list(METHODS)),
        (("replay", "dive.mcap", "--filter", "dr"), ["dr"]),  # there is a file of this name
        (("replay", "dive.mcap", "--filter=ad"), ["adf"]),
        (("compare", "dive.mcap", "--filters", "dr,ek"), ["dr,ekf"]),
        (("replay", "dive.mcap", "--usbl", ""), ["/usbl/fix", "/gps/fix", "none"]),
        (("replay", "dive.mcap", "--dvl", ""), ["/dvl/data", "none"]),
        (("replay", "--dvl", "/dvl/data", "dive.mcap", "--truth", "/g"), ["/gps/fix"]),
        (("replay", "dive.mcap", "--truth", "di"), ["<file>"]),
        (("info", "dive.mcap", "--compass", "/i"), ["/imu/data"]),
        (("evaluate", "dive.mcap", "-e", "/usbl"), ["/usbl/fix"]),
        (("info", "gone.mcap", "--dvl", ""), ["none"]),
        (("replay", "dr", "--dvl", ""), ["none"]),  # an empty file
        (("replay", "dive.mcap", "--calibrate", "scale,mi"), ["scale,misalignment"]),
        (("replay", "dive.mcap", "--dr-from", "first-g"), ["first-gps"]),
        (("replay", "dive.mcap", "--align", "s"), ["shift"]),
        (("replay", "dive.mcap", "-o", ""), ["<file>"]),
        (("replay", "dive.mcap", "--config", "no"), ["none"]),
        (("drill", "dive.mcap", "--suite", "st"), ["standard"]),
        (("check", ""), ["<file>"]),
    ],
)
def test_what_is_suggested(words: tuple[str, ...], wanted: list[str]) -> None:
    assert suggested(*words) == wanted


@pytest.mark.usefixtures("here")
def test_a_log_that_takes_long_to_list_does_not_keep_the_shell_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(completion, "PATIENCE_S", 0.05)
    monkeypatch.setattr(detect, "open_reader", lambda path: time.sleep(60))

    assert suggested("replay", "dive.mcap", "--dvl", "") == ["none"]


@needs_bash
def test_in_a_real_bash_the_tab_key_completes_files_topics_and_filters(here: Path) -> None:
    environment = {"PATH": f"{PROGRAMS}:{os.environ['PATH']}", "HOME": str(here), "TERM": "dumb", "PS1": "> "}
    source = 'eval "$(_USBLDR_COMPLETE=bash_source usbldr)"; bind "set enable-bracketed-paste off"; echo rea""dy\n'
    typed = ["usbldr replay di\t", "--fil\t", "ad\t", "--usbl /u\t"]

    terminal, end = pty.openpty()
    with subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"], stdin=end, stdout=end, stderr=end, cwd=here, env=environment
    ) as shell:
        os.write(terminal, source.encode())
        _wait_for(terminal, "ready\r\n")
        for text, wanted in zip(typed, ["dive.mcap ", "--filter ", "adf ", "/usbl/fix "], strict=True):
            os.write(terminal, text.encode())
            _wait_for(terminal, wanted)
        shell.kill()
    os.close(terminal)
    os.close(end)


def _wait_for(terminal: int, wanted: str) -> None:
    """Read until the completed word is there; Bash prints the typed letters, then the rest of the word."""
    shown, until = "", time.monotonic() + 60
    while wanted not in shown:
        assert time.monotonic() < until, shown
        if select.select([terminal], [], [], 1.0)[0]:
            shown += os.read(terminal, 1024).decode()
