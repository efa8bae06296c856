"""The option --html: the report as one file with interactive figures."""

from collections.abc import Callable
from typing import Any

from usbldr_cli.options.completion import FILE
from usbldr_cli.options.option import option


def html_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Accept --html, which has no effect: the page is always written."""
    text = "Without effect: the page is always written with the figures."
    return option("--html", is_flag=True, expose_value=False, help=text, rare=True)(command)


def html_file_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --html FILE to a command that has no folder for its results."""
    text = "Write the result as one page with an interactive figure."
    return option("--html", "html_to", type=FILE, metavar="FILE", help=text, rare=True)(command)
