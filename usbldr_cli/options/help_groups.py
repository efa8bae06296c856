"""Help of a command with many options: titled groups, the common options on one screen, all of them on request."""

from typing import Any, get_args

import click

from usbldr_cli.options.option import Group, Option

SHOW_ALL = "usbldr.help_all"  # key of the context


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
