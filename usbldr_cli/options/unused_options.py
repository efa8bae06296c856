"""Options that were given but change nothing for the methods that run: a warning says so."""

from collections.abc import Iterable, Sequence

import click

from usbldr_cli.options.option import Option, methods_with

DRAWING = ("seed", "seeds")  # options that also choose the random numbers of a scenario or fault


def unused_options(given: Iterable[click.Parameter], names: Sequence[str], drawn: bool) -> list[str]:
    """Return a sentence for each option that changes nothing for any of the methods; ``drawn``: the log has a seed."""
    from usbldr.filters.replay.methods import METHODS

    found: list[str] = []
    for option in given:
        uses = option.used_by if isinstance(option, Option) else ""
        used = not uses or any(getattr(METHODS[name], uses) for name in names) or (drawn and option.name in DRAWING)
        if not used:
            found.append(f"{option.name} has no effect on {', '.join(names)} (it is for {methods_with(uses)})")
    return found


def warn_of_unused_options(names: Sequence[str], drawn: bool) -> None:
    """Print these sentences for the options of the command line."""
    ctx, stated = click.get_current_context(), click.core.ParameterSource.COMMANDLINE
    given = [param for param in ctx.command.params if ctx.get_parameter_source(str(param.name)) is stated]
    for text in unused_options(given, names, drawn):
        click.echo(f"usbldr: --{text}", err=True)
