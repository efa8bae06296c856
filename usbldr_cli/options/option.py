"""One option of a command: its group in help, whether only --help-all lists it, and which methods it matters to."""

import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Literal, TypeAlias

import click

Group: TypeAlias = Literal["Baseline", "Log", "Faults", "Filter", "Scoring", "Output"]
Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]


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
