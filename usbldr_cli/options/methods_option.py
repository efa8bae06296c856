"""An option whose help lists methods."""

from typing import Any

import click


class MethodsOption(click.Option):
    """``{methods}`` in its help becomes the names of the methods that have a field of Method, once it is read."""

    def __init__(self, *args: Any, having: str, **given: Any) -> None:
        self.having = having
        super().__init__(*args, **given)

    def _with_names(self) -> str:
        from usbldr.filters.replay.methods import methods_that

        return self._text.replace("{methods}", methods_that(lambda m: getattr(m, self.having)))

    def _keep(self, text: str) -> None:
        self._text = text

    help = property(_with_names, _keep)  # pyright: ignore[reportAssignmentType,reportIncompatibleVariableOverride]
