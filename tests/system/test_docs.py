"""README and tutorial are held to the commands: each runs, in order, in one folder, and prints what the page shows."""

import doctest
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from checkout import ROOT
from usbldr_cli.main import COMMANDS, cli

README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMAND = re.compile(r"^\$ usbldr (.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)


def commands(text: str) -> list[tuple[str, str]]:
    """Return each `$ usbldr ...` of the console blocks with the output that is shown under it."""
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [found for block in blocks for found in COMMAND.findall(block)]


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md", "docs/real_log.md"])
@pytest.mark.long
def test_every_command_of_a_page_prints_what_the_page_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(ROOT / "docs" / "real_log", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    if page == "README.md":
        assert runner.invoke(cli, ["simulate", "paper", "-o", "dive.mcap"]).exit_code == 0  # the reader's own log
    shown = commands((ROOT / page).read_text(encoding="utf-8"))
    assert len(shown) >= 6
    for line, want in shown:
        done = runner.invoke(cli, line.split())
        assert done.exit_code == 0, f"usbldr {line}\n{done.output}"
        flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        assert not want or doctest.OutputChecker().check_output(want, done.output, flags), f"{line}\n{done.output}"


def test_the_readme_names_targets_that_the_makefile_has() -> None:
    targets = set(re.findall(r"^([a-z_]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"^make ([a-z_]+)$", README, re.MULTILINE))
    assert {"demo", "test"} <= named <= targets


def test_every_file_that_the_readme_links_to_is_there() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).is_file(), target


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself_and_ends_in_a_line_to_paste(name: str) -> None:
    done = CliRunner().invoke(cli, [name, "--help"])
    assert done.exit_code == 0
    assert re.search(rf"^\s+\$ usbldr {name} .+$", done.output, re.MULTILINE), done.output
    assert "\\b" not in done.output


def test_the_help_lists_every_command_and_the_exit_codes() -> None:
    done = CliRunner().invoke(cli, ["--help"])
    for name in COMMANDS:
        assert re.search(rf"^\s+{name}\s", done.output, re.MULTILINE)
    for code in ("0 good", "1 a check failed", "2 wrong usage", "3 the log is unreadable", "130 interrupted"):
        assert code in done.output
