"""Options of a command and their help in groups: which ones --help lists, and to which methods each matters."""

import functools
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from typing import Any, Literal, TypeAlias, get_args

import click

Group: TypeAlias = Literal["Baseline", "Log", "Faults", "Filter", "Scoring", "Output"]
Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]
DRAWING = ("seed", "seeds")  # options that also choose the random numbers of a scenario or fault
SHOW_ALL = "usbldr.help_all"  # key of the context
GIVEN = "usbldr.command"  # key of the context: the words of the command line, which main.py keeps


class Option(click.Option):
    """An option of a command with many of them.

    ``used_by`` is the field of Method that is true if the option matters to it; "" if it matters to all. A field in
    braces in ``help`` becomes the names of the methods that have it, once the help is read.
    """

    def __init__(
        self, *args: Any, group: Group = "Output", rare: bool = False, used_by: str = "", **given: Any
    ) -> None:
        self.group, self.rare, self.used_by = group, rare, used_by
        super().__init__(*args, **given)

    def _with_names(self) -> str | None:
        return None if self._text is None else re.sub(r"\{(\w+)\}", lambda field: methods_with(field[1]), self._text)

    def _keep(self, text: str | None) -> None:
        self._text = text

    help = property(_with_names, _keep)  # pyright: ignore[reportAssignmentType,reportIncompatibleVariableOverride]


option = functools.partial(click.option, cls=Option)
log_option = functools.partial(option, group="Log")
fault_option = functools.partial(option, group="Faults")
filter_option = functools.partial(option, group="Filter")
scoring_option = functools.partial(option, group="Scoring")


def methods_with(field: str) -> str:
    """Return the names of the methods of which this field of Method is true."""
    from usbldr.filters.replay.methods import methods_that

    return methods_that(lambda method: getattr(method, field))


def with_options(options: Sequence[Decorator]) -> Decorator:
    """Return a decorator that adds options, listed in this order."""
    return lambda command: functools.reduce(lambda done, add: add(done), reversed(options), command)


def packed_options(kind: type[Any], name: str, options: Sequence[Decorator]) -> Decorator:
    """Return a decorator that adds options; the command gets those that are fields of ``kind`` as one, ``name``."""
    names = [field.name for field in fields(kind)]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def packed(**given: Any) -> Any:
            return command(**{name: kind(**{field: given.pop(field) for field in names})}, **given)

        return with_options(options)(packed)

    return decorate


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


class GroupedCommand(click.Command):
    """A command whose ``--help`` shows the common options, ``--help-all`` every option; the filters come last."""

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given, context_settings={"max_content_width": 100, "show_default": True})
        self.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, help="All options."
            )
        )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each group."""
        every = SHOW_ALL in ctx.meta
        options = [param for param in self.get_params(ctx) if isinstance(param, Option) and (every or not param.rare)]
        for title in get_args(Group):
            shown = sorted((option for option in options if option.group == title), key=lambda option: option.rare)
            records = [option.get_help_record(ctx) for option in shown]
            if not records:
                continue
            with formatter.section(title):
                formatter.write_dl([record for record in records if record is not None])
        if not every:
            formatter.write(f"\n{ctx.command_path} --help-all lists every option.\n")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each method's name, and its description if one is chosen or every option is listed."""
        from usbldr.filters.replay.methods import METHODS

        chosen = {"method", "filters"} & {param.name for param in self.params}
        if not chosen:
            return
        with formatter.section("Filters"):
            if "filters" in chosen and SHOW_ALL not in ctx.meta:
                formatter.write_text(", ".join(METHODS))
                return
            formatter.write_dl([(method.name, method.description) for method in METHODS.values()])


def _show_all(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:  # not while a shell completes
        ctx.meta[SHOW_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()


def given_command(ctx: click.Context | None = None) -> tuple[str, ...]:
    """Return the words of a command, or of the one that runs; none outside the command line."""
    ctx = ctx or click.get_current_context(silent=True)
    return () if ctx is None else ctx.meta.get(GIVEN, ())
