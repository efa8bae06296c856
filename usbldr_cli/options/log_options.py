"""The options of every command that reads a log: configuration, topics, truth."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from usbldr.io.log import Log
    from usbldr.io.opening import Request

ROLE_HELP = {
    "dvl": "Topic of the DVL.",
    "compass": "Topic of the compass.",
    "usbl": "Topic of the USBL.",
    "gps": "Topic of the GPS.",
    "depth": 'Topic of the depth; "none" leaves a sensor out.',
}


def selection_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --config, one option for each sensor, --truth, --with and --msg-path."""
    options = (
        click.option("--config", metavar="FILE", help='Configuration file; "none" ignores the one beside LOG.'),
        *(click.option(f"--{role}", metavar="TOPIC", help=text) for role, text in ROLE_HELP.items()),
        click.option("--truth", metavar="FILE|TOPIC", help='Reference track; "none" for no scoring.'),
        click.option("--with", "joined", metavar="FILE", multiple=True, help="Additional file of the same dive."),
        click.option("--msg-path", metavar="DIR", multiple=True, help="Folder of .msg definitions that LOG lacks."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def format_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --format: the format in which a log is written."""
    forms = click.Choice(["mcap", "bag", "rosbag2", "db3", "csv"])
    return click.option("--format", "form", type=forms, help="Format of OUTPUT.  [default: by its name]")(command)


def log_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the argument LOG and the options that say how to read it; `open_log` takes them all."""
    return click.argument("log", metavar="LOG")(selection_options(command))


def read_request(
    config: str | None = None,
    truth: str | None = None,
    joined: tuple[str, ...] = (),
    msg_path: tuple[str, ...] = (),
    **topics: str | None,
) -> "Request":
    """Return the selection options as a request."""
    from usbldr.io.opening import Request

    return Request(
        config, {role: topic for role, topic in topics.items() if topic is not None}, truth, joined, msg_path
    )


def open_log(log: str, seed: int = 0, **selection: Any) -> "Log":
    """Read LOG, a file or folder or else a scenario; ``selection`` are the values of selection_options."""
    from usbldr.io import session

    return session.open_log(log, read_request(**selection), seed)


def inputs(log: str, **selection: Any) -> tuple[Path, ...]:
    """Return the files that open_log reads, LOG first: none may be overwritten. A shipped scenario has none."""
    from usbldr.io.inputs import input_files
    from usbldr.io.session import is_simulated

    if not is_simulated(log):
        return input_files(Path(log), read_request(**selection))
    return (Path(log),) if Path(log).exists() else ()
