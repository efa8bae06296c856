"""The page of symptoms names findings, keys and options that exist."""

import re

import click
import pytest

from checkout import ROOT
from usbldr_cli.main import cli

PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
FINDINGS = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")
KEYS = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")

WORDS = {
    "heading",
    "calibrated",
    "recovery",
    "noise",
    "whiteness",
    "evidence",
    "adf",
    "cpf",
    "provenance",
    "diverged",
    "compare",
}
"""Lines of a report, filters, words of tables."""


def test_every_code_is_one_of_a_finding() -> None:
    codes = set(re.findall(r"`([A-Z]+(?:-[A-Z]+)+|[A-Z]{5,})`", PAGE))
    assert len(codes) > 15
    assert codes <= set(re.findall(r"`([A-Z-]+)`", FINDINGS))


@pytest.mark.parametrize("option", sorted(set(re.findall(r"`(--[a-z-]+)", PAGE))))
def test_every_option_is_one_of_replay(option: str) -> None:
    replay = cli.get_command(click.Context(cli), "replay")
    assert replay is not None
    assert option in {name for one in replay.params for name in (*one.opts, *one.secondary_opts)}


@pytest.mark.parametrize("key", sorted(set(re.findall(r"`([a-z]+(?:_[a-z]+)*)(?: = [^`]*)?`", PAGE))))
def test_every_key_is_explained(key: str) -> None:
    assert key in WORDS or re.search(rf"`{key}\b", KEYS)
