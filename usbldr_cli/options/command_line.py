"""The command line as given, which reports repeat."""

from collections.abc import Sequence

import click

GIVEN = "usbldr.command"  # key of the context


def keep_command(ctx: click.Context, words: Sequence[str]) -> None:
    """Keep the words after ``usbldr`` for `given_command`."""
    ctx.meta[GIVEN] = ("usbldr", *words)


def given_command(ctx: click.Context | None = None) -> tuple[str, ...]:
    """Return the words of a command, or of the one that runs; none outside the command line."""
    ctx = ctx or click.get_current_context(silent=True)
    return () if ctx is None else ctx.meta.get(GIVEN, ())
