"""``usbldr baseline``: writes a first baseline of some logs, which ``usbldr check`` runs again in CI."""

from pathlib import Path
from typing import Any

import click

from usbldr_cli.options.completion import FILE
from usbldr_cli.options.log_options import inputs, read_request, selection_options
from usbldr_cli.options.option import GroupedCommand, option
from usbldr_cli.options.output_files import refuse_file, toml_option, write_file
from usbldr_cli.options.run_options import RunChoices, filter_list, filters_option, refuse_repeats, run_options
from usbldr_cli.options.verbosity import progress_option, verbose_option
from usbldr_cli.options.worker_options import WorkerChoices, worker_options

DEFAULT_FILTERS = "usbl,dr,cpf"  # readers and conventions, dead reckoning, and a filter on top


@click.command(cls=GroupedCommand)
@click.argument("logs", metavar="LOG...", type=FILE, nargs=-1, required=True)
@selection_options
@filters_option("A row for each of these methods.", DEFAULT_FILTERS)
@run_options
@toml_option("--output", "-o", help="File to write, NAME.toml.", default="baseline.toml")
@option("--force", is_flag=True, help="Replace an existing file.")
@worker_options
@verbose_option
@progress_option
def baseline(
    logs: tuple[str, ...],
    filters: str,
    choices: RunChoices,
    workers: WorkerChoices,
    output: Path,
    force: bool,
    **selection: Any,
) -> None:
    """Write a baseline for each LOG: a row for each method, with the metrics of its run and their limits.

    Options of replay that have a value (--start 4 --config dive.toml) are written into the rows. You can add
    rows, options and metrics.

    \b
    $ usbldr baseline dive.mcap --output gate.toml
    $ usbldr check gate.toml
    """
    from usbldr_cli.runs.baseline_rows import first_baseline, given_options
    from usbldr_cli.runs.executors import executor
    from usbldr_cli.runs.workers import Job

    refuse_repeats("LOG", logs)
    given, methods = given_options(), filter_list(filters, choices)
    for log in logs:
        refuse_file("--output", output, force, inputs(log, read_request(**selection)))
    jobs = [Job(log, "", choices, selection) for log in logs]
    with executor(workers) as where:
        text, left_out = first_baseline(output, jobs, methods, given, where)
    for sentence in left_out:
        click.echo(f"usbldr: {sentence}", err=True)
    write_file("--output", output, text)
    click.echo(f"{output}: written, {text.count('[[row]]')} rows; run them again with: usbldr check {output}")
