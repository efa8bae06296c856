"""The options --verbose and --progress: what a command does, for people and for scripts, on stderr."""

import json
import logging
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import click

from usbldr.io.stages import LOGGER
from usbldr_cli.options.option import option

EVERY_S = 0.5  # [s] between two JSON lines of progress: often enough to watch, rare enough to store
PROGRESS = "usbldr.progress"  # key of the context


class Lines(logging.Handler):
    """Print each record that ``text`` gives a line for."""

    def __init__(self, text: Callable[[logging.LogRecord], str | None]) -> None:
        super().__init__(logging.INFO)
        self.text = text

    def emit(self, record: logging.LogRecord) -> None:
        """Print the line of a record."""
        if (line := self.text(record)) is not None:
            click.echo(line, err=True)


def verbose_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --verbose."""
    text = "Print to stderr what is read, what is chosen and why, and the time of each stage."
    return option("--verbose", "-v", is_flag=True, expose_value=False, callback=_verbose, help=text, rare=True)(command)


def progress_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --progress."""
    text = "Progress on stderr: a bar if it is a terminal, JSON lines for scripts, or none."
    kinds = click.Choice(["bar", "json", "none"])
    return option(
        "--progress", type=kinds, default="bar", expose_value=False, callback=_progress, help=text, rare=True
    )(command)


@contextmanager
def progress(name: str, total: int) -> Generator[Callable[[int], None]]:
    """Give a function that shows how many of ``total`` are done, by the option --progress."""
    ctx = click.get_current_context(silent=True)
    kind = "bar" if ctx is None else ctx.meta.get(PROGRESS, "bar")
    if kind == "json":
        yield _json_progress(name, total)
        return
    hidden = kind == "none" or not sys.stderr.isatty()
    with click.progressbar(length=total, label=name, file=sys.stderr, hidden=hidden, show_pos=True) as bar:
        bar.update(0)
        yield lambda done: bar.update(done - bar.pos)


def _json_progress(name: str, total: int) -> Callable[[int], None]:
    began_s, shown_s, shown = time.perf_counter(), -EVERY_S, -1

    def advance(done: int) -> None:
        nonlocal shown_s, shown
        now_s = time.perf_counter() - began_s
        if done == shown or (done < total and now_s - shown_s < EVERY_S):
            return
        shown_s, shown = now_s, done
        content = {"event": "progress", "stage": name, "done": done, "total": total, "seconds": round(now_s, 3)}
        click.echo(json.dumps(content), err=True)

    return advance


def _verbose(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        _listen(ctx, Lines(_sentence))


def _progress(ctx: click.Context, _: click.Parameter, kind: str) -> None:
    ctx.meta[PROGRESS] = kind
    if kind == "json" and not ctx.resilient_parsing:
        _listen(ctx, Lines(_json))


def _listen(ctx: click.Context, handler: logging.Handler) -> None:
    """Let a handler have the records until the command ends."""
    before = LOGGER.level
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)

    def stop() -> None:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(before)

    ctx.call_on_close(stop)


def _sentence(record: logging.LogRecord) -> str | None:
    return None if getattr(record, "state", "") == "begin" else f"usbldr: {record.getMessage()}"


def _json(record: logging.LogRecord) -> str | None:
    if not hasattr(record, "stage"):
        return None
    kept = {key: getattr(record, key) for key in ("stage", "state", "seconds") if hasattr(record, key)}
    return json.dumps({"event": "stage", **kept})
