"""Help of a command with many options: titled groups, the common options on one screen, all of them on request."""

from typing import Any

import click

from usbldr.io.drills.kinds import KINDS

COMMON = {
    "Baseline": ("update",),
    "Log": ("estimate", "frame", "config", "usbl", "truth", "joined"),
    "Faults": ("suite", *KINDS),
    "Filter": ("method", "filters", "particles", "calibrate", "smooth", "seed", "seeds"),
    "Scoring": ("start", "end", "align"),
    "Output": ("output", "force", "json_to", "quiet", "mcap", "jobs", "junit", "markdown_to"),
}
RARE = {
    "Baseline": (),
    "Log": (
        *("set_keys", "dvl", "compass", "gps", "depth", "fixes", "truth_frame"),
        *("part", "msg_path", "limits", "strict"),
    ),
    "Faults": (),
    "Filter": ("plugin", "noise", "gate", "guard", "order", "aid", "exclude", "fast_hz"),
    "Scoring": ("slow_hz", "dr_from", "leave_one_out", "bound", "verify"),
    "Output": (
        "html",
        "html_to",
        "latex_to",
        "fnv",
        "parquet",
        "write_calibration",
        "plots",
        "plot_format",
        "scheduler",
        "progress",
        "verbose",
    ),
}
"""The parameters of each group, in the order in which help lists them."""
SHOW_ALL = "usbldr.help_all"  # key of the context


class GroupedCommand(click.Command):
    """A command whose ``--help`` shows the common options, ``--help-all`` every option; the filters come last."""

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given, context_settings={"max_content_width": 100})
        self.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all, help="All options."
            )
        )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each group."""
        options = {param.name: param for param in self.get_params(ctx) if isinstance(param, click.Option)}
        for title, names in COMMON.items():
            shown = (*names, *RARE[title]) if SHOW_ALL in ctx.meta else names
            records = [options[name].get_help_record(ctx) for name in shown if name in options]
            if not records:
                continue
            with formatter.section(title):
                formatter.write_dl([record for record in records if record is not None])
        more = "" if SHOW_ALL in ctx.meta else f"\n{ctx.command_path} --help-all lists every option."
        formatter.write(more + "\n" if more else "")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each method's name and description."""
        from usbldr.filters.replay.methods import METHODS

        if not {"method", "filters"} & {param.name for param in self.params}:
            return
        with formatter.section("Filters"):
            formatter.write_dl([(method.name, method.description) for method in METHODS.values()])


def _show_all(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:  # not while a shell completes
        ctx.meta[SHOW_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()
