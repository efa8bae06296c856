"""The option --html: the report as one file with interactive figures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.completion import FILE


def html_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --html, which is refused if its packages are missing."""
    text = "Write report.html, too: one file with interactive figures."
    return click.option("--html", is_flag=True, callback=_checked, help=text)(command)


def html_file_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --html FILE to a command that has no folder for its results."""
    text = "Write the result as one page with an interactive figure."
    return click.option("--html", "html_to", type=FILE, metavar="FILE", callback=_checked, help=text)(command)


def _checked(_: click.Context, __: click.Parameter, asked: Any) -> Any:
    if asked:
        require_html()
    return asked


def require_html() -> None:
    """Raise UsageError if the packages of the extra ``html`` are not installed."""
    from importlib.util import find_spec

    if find_spec("bokeh") is None:
        raise UsageError("--html needs Bokeh: install it with pip install 'usbldr[html]'")


def require_output(html: bool, output: Path | None) -> None:
    """Raise UsageError for a report without a folder to write it into."""
    if html and output is None:
        raise UsageError("--html writes report.html into the folder of --output: name one")
