"""The help of commands with many options: one screen of common ones, and every option on request."""

import click
import pytest
from click.testing import CliRunner

from usbldr_cli.baseline import baseline
from usbldr_cli.check import check
from usbldr_cli.compare import compare
from usbldr_cli.drill import drill
from usbldr_cli.evaluate import evaluate
from usbldr_cli.options.option import Option
from usbldr_cli.replay import replay

GROUPED = [replay, compare, drill, evaluate, baseline, check]
every = pytest.mark.parametrize("command", GROUPED, ids=[str(command.name) for command in GROUPED])
both = pytest.mark.parametrize("command", [replay, compare], ids=["replay", "compare"])


def help_text(command: click.Command, option: str) -> str:
    """Return what a terminal of 100 columns shows."""
    done = CliRunner().invoke(command, [option], terminal_width=100)
    assert done.exit_code == 0
    return done.output


@both
def test_the_common_options_and_the_filters_fit_one_screen_in_titled_groups(command: click.Command) -> None:
    lines = help_text(command, "--help").splitlines()

    assert len(lines) <= 52
    titles = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert titles == ["Log:", "Filter:", "Scoring:", "Output:", "Filters:"]
    assert f"{command.name} --help-all lists every option." in lines


@every
def test_help_all_lists_every_option(command: click.Command) -> None:
    reported = help_text(command, "--help-all")

    for option in command.params:
        if isinstance(option, click.Option) and option.name not in ("help", "help_all"):
            assert f"{option.opts[0]} " in reported or f"{option.opts[0]}\n" in reported, option.name
    assert "--help-all lists" not in reported


@every
def test_every_option_is_in_a_group(command: click.Command) -> None:
    plain = [
        param.name for param in command.params if isinstance(param, click.Option) and not isinstance(param, Option)
    ]

    assert plain == ["help_all"]
