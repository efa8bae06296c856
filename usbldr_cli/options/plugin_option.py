"""The option --plugin: filters of a module or file of one's own."""

import os
from collections.abc import Callable
from typing import Any

import click

from usbldr_cli.options.option import filter_option


def plugin_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --plugin, which comes before every option that names filters."""
    return filter_option(
        "--plugin",
        multiple=True,
        is_eager=True,
        expose_value=False,
        callback=_add,
        metavar="MODULE:NAME",
        help="Filter of your own, a usbldr.Method: my_package:MINE or my_filters.py:MINE; see docs/extend.md.",
        rare=True,
    )(command)


def _add(_ctx: click.Context, _option: click.Parameter, given: tuple[str, ...]) -> None:
    """Let this process and those that it starts know the filters."""
    if not given:
        return
    from usbldr.filters.plugins import VARIABLE, asked_for
    from usbldr.filters.replay.methods import add_named

    for text in map(_with_whole_path, given):
        add_named(text)
        os.environ[VARIABLE] = "\n".join(dict.fromkeys([*asked_for(), text]))


def _with_whole_path(text: str) -> str:
    place, colon, name = text.rpartition(":")
    return f"{os.path.abspath(place)}{colon}{name}" if place.endswith(".py") else text
