"""The options --filters and --seeds of commands that run several methods."""

from collections.abc import Callable, Sequence
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr_cli.options.completion import FILTERS
from usbldr_cli.options.option import filter_option
from usbldr_cli.options.run_options import RunChoices


def filters_option(what: str, default: str | None = None) -> Callable[[Any], Any]:
    """Add --filters; ``what`` they are."""
    return filter_option("--filters", "-f", type=FILTERS, metavar="LIST", default=default, help=what)


def seeds_option(default: int) -> Callable[[Any], Any]:
    """Add --seeds."""
    several = click.IntRange(min=1)
    text = "Runs of each method."
    return filter_option("--seeds", type=several, default=default, metavar="N", help=text, used_by="draws")


def filter_list(filters: str, choices: RunChoices) -> list[str]:
    """Return the names in a list of filters; refuse options that none of them takes."""
    from usbldr.filters.replay.methods import METHODS, method_named, methods_that

    choices.settings()  # refuses wrong values
    names = [name.strip() for name in filters.split(",") if name.strip()]
    if not names:
        raise UsageError(f"--filters names no filter (filters: {', '.join(METHODS)})")
    methods = [method_named(name) for name in names]
    refuse_repeats("--filters", names)
    if choices.gate is not None and not any(method.takes_gate for method in methods):
        raise UsageError(f"--gate is for {methods_that(lambda m: m.takes_gate)}, none of which is compared")
    if choices.aid is not None and not any(method.is_filter for method in methods):
        raise UsageError("--aid is for filters, none of which is compared")
    return names


def refuse_repeats(what: str, names: Sequence[str]) -> None:
    """Raise UsageError if an option or argument names something twice."""
    repeated = [name for k, name in enumerate(names) if name in names[:k]]
    if repeated:
        raise UsageError(f"{what} names {repeated[0]} twice")
