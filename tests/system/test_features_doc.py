"""The page of features names commands and options that exist, and runs its commands' lines past the parser."""

import re

import click
import pytest

from checkout import ROOT
from usbldr.filters.replay.methods import METHODS
from usbldr_cli.main import cli

PAGE = (ROOT / "docs" / "features.md").read_text(encoding="utf-8")


def options_of(command: str) -> set[str]:
    found = cli.get_command(click.Context(cli), command)
    assert found is not None, command
    return {name for one in found.params for name in (*one.opts, *one.secondary_opts)}


@pytest.mark.parametrize("line", sorted(set(re.findall(r"`usbldr ([^`]+)`", PAGE))))
def test_every_command_has_its_options(line: str) -> None:
    command, *words = line.split()
    given = {word for word in words if re.fullmatch(r"--?[a-z][a-z-]*", word)}
    assert given <= options_of(command)


@pytest.mark.parametrize("option", sorted(set(re.findall(r"`(--[a-z-]+)", PAGE))))
def test_every_option_exists(option: str) -> None:
    assert any(option in options_of(command) for command in cli.list_commands(click.Context(cli)))


def test_every_filter_of_the_list_exists_and_none_is_missing() -> None:
    row = next(line for line in PAGE.splitlines() if "`--filter dr`" in line)
    listed = set(re.findall(r"`(?:--filter )?([a-z]+)`", row.split("|")[2]))
    elsewhere = {"aekf", "afukf", "pf-wekf"}
    assert listed == set(METHODS) - elsewhere
