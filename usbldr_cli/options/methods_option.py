"""An option whose help lists methods."""

from typing import Any

import click


class MethodsOption(click.Option):
    """``{methods}`` in its help becomes the names of the methods that have a field of Method."""

    def __init__(self, *args: Any, having: str, **given: Any) -> None:
        super().__init__(*args, **given)
        self.having = having

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Return the option and its help."""
        from usbldr.filters.replay.methods import methods_that

        record = super().get_help_record(ctx)
        return record and (record[0], record[1].replace("{methods}", methods_that(lambda m: getattr(m, self.having))))
