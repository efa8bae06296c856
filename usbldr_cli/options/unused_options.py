"""Options that were given but change nothing for the methods that run: a warning says so."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from usbldr.filters.replay.methods import Method

USERS: Mapping[str, Callable[["Method"], object]] = {
    "particles": lambda method: method.draws,
    "seed": lambda method: method.draws,
    "seeds": lambda method: method.draws,
    "calibrate": lambda method: method.estimates,
    "noise": lambda method: method.is_filter,
    "order": lambda method: method.is_filter,
    "guard": lambda method: method.multiple_hypotheses,
}
"""By option: whether it changes the track of a method. The others matter to all, or are refused if they do not fit."""


def unused_options(given: Iterable[str], names: Sequence[str], drawn: bool) -> list[str]:
    """Return a sentence for each option that changes nothing for any of the methods; ``drawn``: the log has a seed."""
    from usbldr.filters.replay.methods import METHODS, methods_that

    found: list[str] = []
    for option in given:
        uses = USERS.get(option)
        used = uses is None or any(uses(METHODS[name]) for name in names) or (drawn and option in ("seed", "seeds"))
        if uses is not None and not used:
            found.append(f"{option} has no effect on {', '.join(names)} (it is for {methods_that(uses)})")
    return found


def warn_of_unused_options(names: Sequence[str], drawn: bool) -> None:
    """Print these sentences for the options of the command line."""
    ctx = click.get_current_context()
    given = [name for name in USERS if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE]
    for text in unused_options(given, names, drawn):
        click.echo(f"usbldr: --{text}", err=True)
