"""docs/ci.md: its workflows are YAML, and every command in it takes the options that it gives."""

import re
import shlex
from typing import Any

import click
import pytest
from ruamel.yaml import YAML

from checkout import ROOT
from usbldr_cli.main import cli

PAGE = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")


def _workflows() -> list[Any]:
    return [YAML(typ="safe").load(block) for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)]


def test_the_workflows_are_yaml_and_keep_what_failed() -> None:
    github, gitlab = _workflows()

    steps = github["jobs"]["gate"]["steps"]
    assert any("GITHUB_STEP_SUMMARY" in step.get("run", "") and step["if"] == "always()" for step in steps)
    (upload,) = [step for step in steps if "upload-artifact" in step.get("uses", "")]
    assert gitlab["gate"]["artifacts"]["reports"]["junit"] == "gate.xml"
    assert upload["with"]["path"] == gitlab["gate"]["artifacts"]["paths"][0]


COMMANDS = re.findall(r"(?:^\$|- run:|    -) usbldr (check|baseline) (.*)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("name", "words"), COMMANDS)
def test_every_command_of_the_page_takes_its_options(name: str, words: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None

    assert command.make_context(name, shlex.split(words)).params


def test_the_page_has_the_checks_of_a_terminal_and_of_both_services() -> None:
    assert [name for name, _ in COMMANDS] == ["baseline", "check", "check", "check"]
