"""The single files that a command writes, as --json FILE: checked before the run, written atomically."""

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr.io.reports.run_directory import check_free, json_text, write_atomically
from usbldr.io.writing import has_ending, writing
from usbldr_cli.options.completion import FILE
from usbldr_cli.options.log_options import inputs, read_request
from usbldr_cli.options.option import option

FILE_ENDINGS = (
    *(".bag", ".csv", ".db3", ".fnv", ".geojson", ".html", ".json", ".kml", ".mcap"),
    *(".md", ".pdf", ".png", ".svg", ".toml", ".tum", ".txt", ".xml", ".zip"),
)
"""Endings of the files that usbldr reads or writes: a folder with one of them would be taken for a file."""


def json_option(what: str) -> Callable[[Any], Any]:
    """Add --json, which writes this as JSON."""
    text = f"Write the {what} as JSON, to a file or to stdout."
    return option("--json", "json_to", is_flag=False, flag_value="-", type=FILE, metavar="[FILE]", help=text)


def folder_option(what: str) -> Callable[[Any], Any]:
    """Add --output, the folder of the results; a name with the ending of a file is refused."""

    def checked(_: click.Context, __: click.Parameter, folder: Path | None) -> Path | None:
        if folder is not None and folder.suffix.lower() in FILE_ENDINGS:
            raise UsageError(f"{folder}: --output names a folder for all results: leave {folder.suffix} out")
        return folder

    place = click.Path(path_type=Path)
    return option("--output", "-o", type=place, metavar="DIR", callback=checked, help=what)


def toml_option(*names: str, **given: Any) -> Callable[[Any], Any]:
    """Add an option that names a file of TOML to write; another ending is refused."""

    def checked(_: click.Context, __: click.Parameter, file: Path | None) -> Path | None:
        if file is not None and has_ending(file) and file.suffix.lower() != ".toml":
            raise UsageError(f"{file}: {names[0]} writes TOML: choose NAME.toml")
        return file

    return option(*names, type=click.Path(path_type=Path), callback=checked, metavar="FILE", **given)


def plots_option(what: str, kinds: Sequence[str] = ("all", "none")) -> Callable[[Any], Any]:
    """Add --plots, which says whether figures are drawn; ``what`` they are; the first kind is the default."""
    return option("--plots", type=click.Choice(kinds), default=kinds[0], help=f"Figures {what}.", rare=True)


def plot_format_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --plot-format; the command gets it as ``plot_format``."""
    forms = click.Choice(["png", "svg", "pdf"])
    text = "Format of the figures; svg and pdf scale without loss."
    return option("--plot-format", type=forms, default="png", help=text, rare=True)(command)


def html_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Accept --html, which has no effect: the page is always written."""
    text = "Without effect: the page is always written with the figures."
    return option("--html", is_flag=True, expose_value=False, help=text, rare=True)(command)


def write_json(target: str, content: object) -> None:
    """Write the content to the file of --json, or to stdout for "-"."""
    if target == "-":
        click.echo(json_text(content))
    else:
        write_file("--json", Path(target), json_text(content) + "\n")


def print_result(text: Callable[[bool], str], verdict: str, output: Path | None, quiet: bool) -> None:
    """Print a text, in colour on a terminal, and where it is written; or only its last line."""
    if quiet:
        click.echo(verdict)
        return
    click.echo(text(sys.stdout.isatty()))
    if output is not None:
        click.echo(f"\nwritten to {output}")


def refuse_file(
    option: str, target: Path | str | None, force: bool, read: Iterable[Path], made: Path | None = None
) -> None:
    """Raise UsageError for a file of an option that is an input, is not empty, or cannot be written.

    It may not be in a folder that is read, unless it is a configuration. ``made`` is a folder that the run will make.
    Nothing is refused for None, without the option, and "-", stdout.
    """
    from usbldr.io.reading.inputs import output_conflict

    if target in (None, "-"):
        return
    file = Path(str(target))
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


def name_of(log: Path) -> str:
    """Return the name of a log with which that of its results begins; of a folder, also if it is the current one."""
    if not log.is_dir():
        return log.stem
    return log.resolve().name if log.name in ("", "..") else log.name


def require_free(folder: Path, read: Iterable[Path], force: bool) -> None:
    """Raise UsageError for a run directory that is or contains an input, or that may not be replaced."""
    from usbldr.io.reading.inputs import output_conflict

    if what := output_conflict(folder, read, inside=False):
        raise UsageError(f"{folder} {what}: choose another --output")
    check_free(folder.expanduser().resolve(), force)


def refuse_inputs(
    logs: Iterable[str], selection: Mapping[str, Any], output: Path | None, json_to: str | None, force: bool
) -> None:
    """Raise UsageError for a folder, or a file of --json, that is an input of one of the logs, or cannot be written."""
    from usbldr.io.reading.inputs import output_conflict

    for log in logs:
        read = inputs(log, read_request(**selection))
        if output is not None and (what := output_conflict(output, read, inside=False)):
            raise UsageError(f"{output} {what}: choose another --output")
        refuse_file("--json", json_to, force, read, output)


def write_file(option: str, file: Path, text: str) -> None:
    """Write a file of an option; raise UsageError if it cannot be written, StorageError if the disk is full."""
    with writing(file, f"choose another file for {option}"):
        if _special(file):
            file.write_text(text, encoding="utf-8")
        else:
            write_atomically(file.resolve(), text.encode())  # a link stays a link


def _special(file: Path) -> bool:
    """Return whether this is a device that no file can replace: a pipe, a terminal."""
    return os.path.exists(file) and not os.path.isfile(file)
