"""The command ``usbldr``: the group, which turns each error into a sentence and an exit code."""

import importlib
import os
import re
import sys
from collections.abc import Sequence
from typing import Any

import click

from usbldr.filters.errors import StorageError, UsageError, UsbldrError, did_you_mean
from usbldr.io.writing import STORAGE, write_fault
from usbldr_cli.options.blas_threads import use_one_thread
from usbldr_cli.options.completion import register
from usbldr_cli.options.option import GIVEN, given_command

COMMANDS = {
    "info": "List the topics of LOG and how each sensor is read.",
    "doctor": "Find faults in LOG that matter for navigation, and say what to do.",
    "init": "Write a commented configuration for LOG.",
    "replay": "Run a filter over LOG and report its east and north errors.",
    "evaluate": "Report the errors of a track of a vehicle or another program.",
    "compare": "Run several filters over logs and seeds, side by side.",
    "drill": "Add faults to LOG and report how they change the errors of filters.",
    "export": "Write LOG, or a part of it, in another format.",
    "locate": "Give the position of each photo, ping or sample of a dive.",
    "calibrate-usbl": "Find how a ship's USBL is installed, from a survey of a transponder.",
    "baseline": "Write a first baseline of logs, which check runs again.",
    "check": "Run a baseline again and fail if a metric got worse (for CI).",
    "simulate": "Write a simulated log with its truth.",
}
"""One line per command; its function is in the module of the same name, which is imported when it is called."""
VERBOSE = "usbldr.verbose"


class LazyGroup(click.Group):
    """A group whose commands are imported only when called: `usbldr --help` is as fast as click."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Return the context with the words of the command line."""
        words = tuple(args)  # parsing empties the list
        ctx = super().make_context(info_name, args, parent, **extra)
        ctx.meta[GIVEN] = ("usbldr", *words)
        return ctx

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command's module and return its command."""
        if cmd_name not in COMMANDS:
            return None
        module = cmd_name.replace("-", "_")
        command: click.Command = getattr(importlib.import_module(f"usbldr_cli.{module}"), module)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command and its arguments; raise UsageError for a name that no command has."""
        if args[0] == "check" and "--init" in args:
            click.echo("usbldr: check --init is now: usbldr baseline LOG... --output FILE", err=True)
            args = ["baseline", *(re.sub("^--baseline", "--output", word) for word in args[1:] if word != "--init")]
        if args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            hint = did_you_mean(args[0], [*COMMANDS, "--help", "--version"])
            hint = f"; did you mean usbldr info {args[0]}?" if os.path.exists(args[0]) else hint
            raise UsageError(f"there is no command {args[0]!r}{hint} (commands: {', '.join(COMMANDS)})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by the table, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def print_version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the version, and with -v what the filters run on."""
    if not asked or ctx.resilient_parsing:  # while a shell completes
        return
    from usbldr import __version__

    click.echo(f"usbldr, version {__version__}")
    if ctx.meta.get(VERBOSE):
        from usbldr.filters.kernel import KERNEL  # imports NumPy

        click.echo(f"filters: NumPy; {KERNEL.reason}" if KERNEL.reason else f"filters: compiled kernel, {KERNEL.name}")
    ctx.exit()


def note_verbose(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Keep -v for `print_version`."""
    ctx.meta[VERBOSE] = asked


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("-v", "verbose", is_flag=True, is_eager=True, expose_value=False, callback=note_verbose, hidden=True)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    callback=print_version,
    help="Print the version; with -v also whether the filters run in the compiled kernel.",
)
def cli() -> None:
    """Replay logs of underwater vehicles through navigation filters and compare the tracks with GPS.

    \b
    Exit codes: 0 good, 1 a check failed, 2 wrong usage or configuration,
    3 the log is unreadable, partial or lacks a sensor, or the disk is full,
    130 interrupted.

    \b
    $ usbldr replay dive.mcap --filter cpf
    """
    _load_plugins()


def _load_plugins() -> None:
    """Load the parts of installed packages; say which cannot be used."""
    from usbldr.filters import plugins

    if not plugins.installed():
        return
    from usbldr.filters.replay.methods import add_installed

    add_installed()
    for group in (plugins.FORMATS, plugins.LAYOUTS):
        plugins.offered(group)
    for fault in plugins.FAULTS:
        click.echo(f"usbldr: warning: {fault}", err=True)


def one_line(fault: click.ClickException) -> str:
    """Return click's message on wrong options as one sentence that names the command's --help."""
    text = " ".join(fault.format_message().split())
    text = re.sub(r"is not a valid (?:(integer)|float)(?: range)?", lambda m: f"is no {m[1] or 'number'}", text)
    ctx: click.Context | None = getattr(fault, "ctx", None)
    if ctx is None:
        return text
    options = {option for param in ctx.command.params for option in param.opts if option.startswith("--")}
    single = [f"write -{word}; " for word in given_command(ctx) if f"-{word}" in options and not word.startswith("--")]
    return f"{text.rstrip('.')}; {''.join(single)}see {ctx.command_path} --help"


def _refuse_other_encodings(words: Sequence[str]) -> None:
    """Raise UsageError for a word of the command that is not UTF-8: reports are, and hold the command."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as err:
            raise UsageError(f"{word}: this name is not UTF-8; rename the file, or choose another name") from err


def main() -> None:
    """Run the command; an error of log or options is one line on stderr."""
    use_one_thread()
    if "_USBLDR_COMPLETE" in os.environ:
        register()
    try:
        _refuse_other_encodings(sys.argv[1:])
        code = cli.main(prog_name="usbldr", standalone_mode=False)
        sys.stdout.flush()  # here, where a full disk can still be reported
    except UsbldrError as fault:
        click.echo(f"usbldr: {fault}", err=True)
        sys.exit(fault.exit_code)
    except click.exceptions.NoArgsIsHelpError as fault:
        fault.show()
        sys.exit(fault.exit_code)
    except click.ClickException as fault:
        click.echo(f"usbldr: {one_line(fault)}", err=True)
        sys.exit(fault.exit_code)
    except OSError as fault:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that Python can empty its buffer at exit
        if isinstance(fault, BrokenPipeError):  # head has enough
            sys.exit(0)
        if fault.errno not in STORAGE:
            raise
        click.echo(f"usbldr: {write_fault(fault.filename or 'the output', fault)}", err=True)
        sys.exit(StorageError.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("usbldr: interrupted", err=True)
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)
