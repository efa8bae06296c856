"""The rows of a baseline as jobs: the options that a row states are those of the command line."""

import datetime
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click

from usbldr.filters.errors import UsageError
from usbldr.filters.replay.methods import method_named
from usbldr.io.reading.remote import is_url
from usbldr.io.scenarios.shipped import scenario_names
from usbldr.io.settings.regression_baseline import BaselineRow, Option
from usbldr_cli.options.log_options import selection_options
from usbldr_cli.options.run_options import RunChoices, run_options
from usbldr_cli.runs.workers import Job

FILES = ("config", "truth", "with", "msg_path")  # options whose value may be a file or folder beside the baseline


def jobs_of_row(file: Path, row: BaselineRow) -> list[Job]:
    """Return a job for each seed of a row; none if there is no such log. Raise UsageError for a wrong row."""
    try:
        method_named(row.filter)
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err
    choices, selection = _choices(file, row)
    beside = file.parent / row.log
    if not (beside.exists() or is_url(row.log) or row.log in scenario_names()):
        return []
    log = str(beside) if beside.exists() else row.log
    seeds = range(choices.seed, choices.seed + row.seeds)
    return [Job(log, row.filter, replace(choices, seed=seed), selection) for seed in seeds]


def _choices(file: Path, row: BaselineRow) -> tuple[RunChoices, Mapping[str, Any]]:
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in stated_options(file.parent, row.options)]
    try:
        return _run_of_a_row.main(arguments, prog_name="row", standalone_mode=False)
    except click.ClickException as err:
        raise UsageError(f"{file}: row {row.name!r}: {err.format_message()}") from err
    except UsageError as err:
        raise UsageError(f"{file}: row {row.name!r}: {err}") from err


def stated_options(folder: Path, options: Mapping[str, Option]) -> list[tuple[str, Option]]:
    """Return each option and value; a file is sought beside the baseline."""
    found: list[tuple[str, Option]] = []
    for name, stated in options.items():
        for value in stated if isinstance(stated, list) else [stated]:
            beside = folder / str(value)
            found.append((name, str(beside) if name.replace("-", "_") in FILES and beside.exists() else value))
    return found


def options_of_row(keys: Iterable[str]) -> list[click.Parameter]:
    """Return the options that a row states by these keys."""
    wanted = {f"--{key.replace('_', '-')}" for key in keys}
    return [param for param in _run_of_a_row.params if wanted & set(param.opts)]


def given_options() -> dict[str, Option]:
    """Return the options of a row that the command line states, as a row states them.

    Raises UsageError for a flag, which a row cannot hold.
    """
    ctx, found = click.get_current_context(), dict[str, Option]()
    for option in (param for param in _run_of_a_row.params if isinstance(param, click.Option)):
        name = str(option.name)
        if name not in ctx.params or ctx.get_parameter_source(name) is not click.core.ParameterSource.COMMANDLINE:
            continue
        key = option.opts[0].lstrip("-").replace("-", "_")
        if option.is_flag:
            raise UsageError(f"--{key} is a flag, which the row of a baseline cannot hold")
        value: Any = ctx.params[name]
        found[key] = list(value) if option.multiple else value
    return found


def tool_text() -> str:
    """Return who makes the values of a baseline."""
    return f"usbldr {version('usbldr')}"


def today() -> datetime.date:
    """Return the date in UTC."""
    return datetime.datetime.now(datetime.UTC).date()


@click.command(add_help_option=False)
@selection_options
@run_options
def _run_of_a_row(choices: RunChoices, **selection: Any) -> tuple[RunChoices, Mapping[str, Any]]:
    return choices, selection
