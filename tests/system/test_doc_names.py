"""Pages of the documentation name commands, options, filters, findings and keys that exist."""

import re
import shlex
from typing import Any

import pytest
from ruamel.yaml import YAML

from checkout import ROOT
from commands import command, options_of
from usbldr.filters.replay.methods import METHODS
from usbldr_cli.main import COMMANDS

PAGES = {
    name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("features", "troubleshooting", "ci", "findings", "configuration")
}


def found(pattern: str, page: str) -> list[Any]:
    return sorted(set(re.findall(pattern, PAGES[page])))


@pytest.mark.parametrize("line", found(r"`usbldr ([^`]+)`", "features"))
def test_every_command_among_the_features_has_its_options(line: str) -> None:
    name, *words = line.split()
    assert {word for word in words if re.fullmatch(r"--?[a-z][a-z-]*", word)} <= options_of(name)


@pytest.mark.parametrize("option", found(r"`(--[a-z-]+)", "features"))
def test_every_option_among_the_features_is_one_of_a_command(option: str) -> None:
    assert any(option in options_of(name) for name in COMMANDS)


def test_every_filter_is_among_the_features() -> None:
    row = next(line for line in PAGES["features"].splitlines() if "`--filter dr`" in line)
    listed = set(re.findall(r"`(?:--filter )?([a-z]+)`", row.split("|")[2]))
    elsewhere = {"aekf", "afukf", "pf-wekf"}
    assert listed == set(METHODS) - elsewhere


def test_every_code_of_the_symptoms_is_one_of_a_finding() -> None:
    codes = set(found(r"`([A-Z]+(?:-[A-Z]+)+|[A-Z]{5,})`", "troubleshooting"))
    assert len(codes) > 15
    assert codes <= set(found(r"`([A-Z-]+)`", "findings"))


@pytest.mark.parametrize("option", found(r"`(--[a-z-]+)", "troubleshooting"))
def test_every_option_of_the_symptoms_is_one_of_replay(option: str) -> None:
    assert option in options_of("replay")


FILTERS = {"adf", "cpf"}
REPORTED = {"heading", "calibrated", "recovery", "noise", "whiteness", "evidence", "provenance", "diverged", "compare"}
"""Lines of a report and words of tables."""


@pytest.mark.parametrize("key", found(r"`([a-z]+(?:_[a-z]+)*)(?: = [^`]*)?`", "troubleshooting"))
def test_every_key_of_the_symptoms_is_explained(key: str) -> None:
    assert key in FILTERS | REPORTED or re.search(rf"`{key}\b", PAGES["configuration"])


def test_the_workflows_for_ci_are_yaml_and_keep_what_failed() -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", PAGES["ci"], re.DOTALL)
    github, gitlab = (YAML(typ="safe").load(block) for block in blocks)

    steps = github["jobs"]["gate"]["steps"]
    assert any("GITHUB_STEP_SUMMARY" in step.get("run", "") and step["if"] == "always()" for step in steps)
    (upload,) = [step for step in steps if "upload-artifact" in step.get("uses", "")]
    assert gitlab["gate"]["artifacts"]["reports"]["junit"] == "gate.xml"
    assert upload["with"]["path"] == gitlab["gate"]["artifacts"]["paths"][0]


def test_the_checks_of_a_terminal_and_of_both_services_take_their_options() -> None:
    lines = re.findall(r"(?:^\$|- run:|    -) usbldr (check|baseline) (.*)$", PAGES["ci"], re.MULTILINE)

    assert [name for name, _ in lines] == ["baseline", "check", "check", "check"]
    for name, words in lines:
        assert command(name).make_context(name, shlex.split(words)).params
