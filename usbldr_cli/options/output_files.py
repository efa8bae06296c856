"""The single files that a command writes, as --json FILE: checked before the run, written atomically."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr.io.reports.run_directory import json_text, write_atomically


def json_option(what: str) -> Callable[[Any], Any]:
    """Add --json, which writes this as JSON."""
    text = f"Write the {what} as JSON, to a file or to stdout."
    return click.option("--json", "json_to", is_flag=False, flag_value="-", metavar="[FILE]", help=text)


def plots_option(what: str) -> Callable[[Any], Any]:
    """Add --plots, which says whether figures are drawn; ``what`` they are, and what they cost."""
    kinds = click.Choice(["all", "none"])
    return click.option("--plots", type=kinds, default="all", show_default=True, help=f"Figures {what}.")


def plot_format_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --plot-format; the command gets it as ``plot_format``."""
    forms = click.Choice(["png", "svg", "pdf"])
    text = "Format of the figures; svg and pdf scale without loss."
    return click.option("--plot-format", type=forms, default="png", show_default=True, help=text)(command)


def write_json(target: str, content: object) -> None:
    """Write the content to the file of --json, or to stdout for "-"."""
    if target == "-":
        click.echo(json_text(content))
    else:
        write_file("--json", Path(target), json_text(content) + "\n")


def refuse_file(option: str, file: Path, force: bool, read: Iterable[Path], made: Path | None = None) -> None:
    """Raise UsageError for a file of an option that is an input, is not empty, or cannot be written.

    It may not be in a folder that is read, unless it is a configuration. ``made`` is a folder that the run will make.
    """
    from usbldr.io.inputs import output_conflict

    what = output_conflict(file, read, inside=file.suffix != ".toml")
    if os.path.isdir(file) or file == made:
        what = "is a folder"
    if what:
        raise UsageError(f"{file} {what}: choose another file for {option}")
    if os.path.isfile(file) and os.path.getsize(file) > 0 and not force:
        raise UsageError(f"{file} exists already: choose another file for {option}, or --force")
    if made is not None and made in file.parents:
        return
    if not os.path.isdir(file.parent):
        raise UsageError(f"{file}: there is no folder {file.parent}: choose another file for {option}")
    if not os.access(file if _special(file) else file.resolve().parent, os.W_OK):
        raise UsageError(f"{file}: cannot be written (no permission): choose another file for {option}")


def write_file(option: str, file: Path, text: str) -> None:
    """Write a file of an option; raise UsageError if that fails."""
    try:
        if _special(file):
            file.write_text(text, encoding="utf-8")
        else:
            write_atomically(file.resolve(), text.encode())  # a link stays a link
    except OSError as err:
        why = err.strerror or err
        raise UsageError(f"{file}: cannot be written ({why}): choose another file for {option}") from err


def _special(file: Path) -> bool:
    """Return whether this is a device that no file can replace: a pipe, a terminal."""
    return os.path.exists(file) and not os.path.isfile(file)
