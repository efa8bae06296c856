"""The options of every command that reads a log: configuration, topics, truth."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from usbldr_cli.options.completion import FILE, LOG, TRUTH, Suggested, topics, words
from usbldr_cli.options.option import given_command, log_option, with_options

if TYPE_CHECKING:
    from usbldr.io.reading.inputs import InputFile
    from usbldr.io.reading.opening import Request
    from usbldr.io.reports.run_provenance import RunProvenance

JOINED = "joined"
ROLE_HELP = {
    "dvl": "Topic of the DVL.",
    "compass": "Topic of the compass.",
    "usbl": "Topic of the USBL.",
    "gps": "Topic of the GPS.",
    "depth": 'Topic of the depth; "none" leaves a sensor out.',
}


def _raise_limits(_ctx: click.Context, _option: click.Parameter, factor: str | None) -> None:
    """Keep the factor where readers look for it, those of other processes, too."""
    if factor is not None:
        os.environ["USBLDR_LIMITS"] = factor


selection_options = with_options(
    (
        log_option(
            "--config",
            metavar="FILE",
            type=words("none", files=True),
            help='Configuration file; "none" ignores the one beside LOG.',
        ),
        log_option(
            "--set",
            "set_keys",
            metavar="KEY=VALUE",
            multiple=True,
            help="A key of the configuration, such as usbl.sd_m=2; compare takes several values: usbl.sd_m=1,2,4.",
            rare=True,
        ),
        *(
            log_option(f"--{role}", metavar="TOPIC", type=Suggested(topics(role)), help=text, rare=role != "usbl")
            for role, text in ROLE_HELP.items()
        ),
        log_option(
            "--truth",
            metavar="FILE|TOPIC",
            type=TRUTH,
            help='Reference track; "none" for no scoring.  [default: the GPS of LOG]',
        ),
        log_option(
            "--truth-frame",
            type=click.Choice(["ENU", "NED", "latlon"]),
            help="Frame of the truth.  [default: by its type, else by the fixes]",
            rare=True,
        ),
        log_option(
            "--part",
            metavar="N",
            type=words(JOINED),
            help=f'Part of a log whose clock goes back, 1, 2, ...; "{JOINED}" continues it.',
            rare=True,
        ),
        log_option(
            "--with", "joined", metavar="FILE", type=FILE, multiple=True, help="Additional file of the same dive."
        ),
        log_option(
            "--msg-path",
            metavar="DIR",
            type=FILE,
            multiple=True,
            help="Folder of .msg definitions that LOG lacks.",
            rare=True,
        ),
        log_option(
            "--limits",
            metavar="FACTOR",
            callback=_raise_limits,
            expose_value=False,
            help="Multiply the limits of memory and time for reading LOG.  [default: 1]",
            rare=True,
        ),
    )
)
"""Add --config, --set, one option for each sensor, --truth, --with, --msg-path and --limits."""


def format_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --format: the format in which a log is written."""
    forms = click.Choice(["mcap", "bag", "rosbag2", "db3", "csv"])
    return click.option("--format", "form", type=forms, help="Format of OUTPUT.  [default: by its name]")(command)


def log_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the argument LOG and the options that say how to read it."""
    return click.argument("log", metavar="LOG", type=LOG)(selection_options(command))


def read_request(
    config: str | None = None,
    truth: str | None = None,
    joined: tuple[str, ...] = (),
    msg_path: tuple[str, ...] = (),
    truth_frame: Literal["ENU", "NED", "latlon"] | None = None,
    part: str | None = None,
    set_keys: tuple[str, ...] = (),
    **topics: str | None,
) -> "Request":
    """Return the values of selection_options as a request."""
    from usbldr.io.reading.opening import Request

    chosen = {role: topic for role, topic in topics.items() if topic is not None}
    return Request(config, chosen, truth, joined, msg_path, truth_frame, part, set_keys)


def labelled_inputs(log: str, request: "Request") -> "tuple[InputFile, ...]":
    """Return the files that are read, LOG first, each with what it is for. A shipped scenario and a URL have none."""
    from usbldr.io.reading.inputs import InputFile, input_files
    from usbldr.io.reading.remote import is_url
    from usbldr.io.session import is_simulated

    if is_url(log):
        return ()
    if not is_simulated(log):
        return input_files(Path(log), request)
    return (InputFile("log", Path(log)),) if Path(log).exists() else ()


def inputs(log: str, request: "Request") -> tuple[Path, ...]:
    """Return the files that are read, LOG first: none may be overwritten. A shipped scenario and a URL have none."""
    return tuple(one.path for one in labelled_inputs(log, request))


def configured_request(log: str, selection: Mapping[str, Any]) -> "Request":
    """Return the values of selection_options as a request, the configuration read if LOG has one."""
    from usbldr.io.reading.opening import with_configuration
    from usbldr.io.session import is_simulated

    asked = read_request(**selection)
    return asked if is_simulated(log) else with_configuration(Path(log), asked)


def request_and_inputs(log: str, **selection: Any) -> tuple["Request", tuple[Path, ...]]:
    """Return the request, its configuration read if LOG has one, and the files that are read."""
    request = configured_request(log, selection)
    return request, inputs(log, request)


def request_provenance(request: Mapping[str, Any]) -> "RunProvenance":
    """Return how a table was made; ``request`` names logs and selection_options, or run directories."""
    from usbldr.io.reports.run_provenance import RunProvenance, read_files

    logs = request.get("logs") or [name for name in [request.get("log")] if name]
    asked = read_request(**request.get("selection", {}))
    read = [one for log in logs for one in labelled_inputs(log, asked)]
    return RunProvenance(given_command(), read_files(read))
