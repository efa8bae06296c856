"""``usbldr compare``: every filter on every log over seeds, side by side; or finished runs side by side."""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import LogError, UsageError
from usbldr_cli.options.completion import LOG
from usbldr_cli.options.log_options import read_request, selection_options
from usbldr_cli.options.option import GroupedCommand, log_option, option, scoring_option, warn_of_unused_options
from usbldr_cli.options.output_files import (
    folder_option,
    html_option,
    json_option,
    plot_format_option,
    plots_option,
    refuse_file,
    refuse_inputs,
    write_file,
    write_json,
)
from usbldr_cli.options.run_options import (
    RunChoices,
    filter_list,
    filters_option,
    refuse_repeats,
    run_options,
    seeds_option,
)
from usbldr_cli.options.verbosity import progress_option, verbose_option
from usbldr_cli.options.worker_options import WorkerChoices, worker_options
from usbldr_cli.result_files import ResultFiles, refuse_empty

if TYPE_CHECKING:
    from usbldr_cli.figures.drawing import Picture
    from usbldr_cli.runs.seed_table import ComparisonRow
    from usbldr_cli.runs.workers import Job


@click.command(cls=GroupedCommand)
@click.argument("logs", metavar="LOG...", type=LOG, nargs=-1, required=True)
@selection_options
@filters_option("Methods, see Filters below.  [default: dr,usbl,ekf,adf,cpf]")
@seeds_option(5)
@run_options
@log_option(
    "--fixes", is_flag=True, help="Of run directories: how good the fixes of each dive were, without truth.", rare=True
)
@scoring_option(
    "--bound", is_flag=True, help="Of scenarios: add the least error that any filter could have.", rare=True
)
@folder_option("Folder for tables, figures and finished runs.")
@option("--force", is_flag=True, help="Replace the tables of another comparison in this folder.")
@plots_option("of the comparison, and of each log if there are few, or with all", ("auto", "all", "none"))
@json_option("table")
@option(
    "--latex",
    "latex_to",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Also write the errors as LaTeX (booktabs).",
    rare=True,
)
@plot_format_option
@html_option
@option("--quiet", "-q", is_flag=True, help="Print only the last line.")
@worker_options
@verbose_option
@progress_option
def compare(
    logs: tuple[str, ...],
    filters: str | None,
    seeds: int,
    workers: WorkerChoices,
    choices: RunChoices,
    fixes: bool,
    bound: bool,
    output: Path | None,
    force: bool,
    plots: str,
    json_to: str | None,
    latex_to: Path | None,
    plot_format: str,
    quiet: bool,
    **selection: Any,
) -> int:
    """Run several filters over each LOG and tabulate their errors, with standard errors over seeds.

    LOG is a file, a folder, a scenario (each seed is a dive of its own) or a run directory of replay. Repeat an
    interrupted command with the same --output, and it continues.

    \b
    $ usbldr compare paper --filters dr,ckf,adf,cpf --seeds 20 --jobs 2 --output compared
    """
    from usbldr.io.session import is_simulated, open_log, require_scenario
    from usbldr_cli.result_files import UNITS, prepare
    from usbldr_cli.runs.finished_runs import is_run
    from usbldr_cli.tables.compare_table import latex

    refuse_inputs(logs, selection, output, json_to, force)
    refuse_repeats("LOG", logs)
    refuse_file("--latex", latex_to, force, [Path(log) for log in logs], output)
    asked = {"--filters": filters is not None, "--bound": bound}
    if fixes:
        _print_fixes(logs, asked | {"--output": output is not None}, json_to)
        return 0
    if any(is_run(Path(log)) for log in logs):
        request: dict[str, Any] = {"runs": logs}
        rows = _finished(logs, asked)
        if output is not None:
            prepare(output, request, force)
    else:
        methods = filter_list("dr,usbl,ekf,adf,cpf" if filters is None else filters, choices)
        request = {"logs": logs, "filters": methods, "seeds": seeds, "options": asdict(choices), "selection": selection}
        request |= {"bound": True} if bound else {}
        warn_of_unused_options(methods, any(map(is_simulated, logs)))
        for log in logs:
            if bound:
                require_scenario(log)
            if is_simulated(log):
                open_log(log, read_request(**selection))  # reports a misspelt name before hours of work
        if output is not None:
            prepare(output, request, force)
        store = None if output is None else output / UNITS
        rows = _run(logs, methods, seeds, workers, choices, selection, store, bound)
        refuse_empty(rows)
    results = _results(rows, request)
    if output is not None:
        results.write(output, _pictures(rows, plots), plot_format)
    if latex_to is not None:
        write_file("--latex", latex_to, latex(rows))
    results.print(output, json_to, quiet)
    codes = [outcome.exit_code for row in rows for outcome in row.outcomes]
    lost = any(row.scored_against is not None and row.scored_against.lost for row in rows)
    return max([*codes, LogError.exit_code if lost else 0])


def _print_fixes(folders: Sequence[str], asked: dict[str, bool], json_to: str | None) -> None:
    """Print a row for each run directory, and which got worse."""
    from usbldr_cli.runs.finished_runs import is_run
    from usbldr_cli.tables.fleet_table import fleet_table, read_dives, worse
    from usbldr_cli.tables.run_table import aligned

    if other := next((folder for folder in folders if not is_run(Path(folder))), None):
        raise UsageError(f"--fixes compares run directories, and {other} is none: run usbldr replay {other} -o FOLDER")
    if given := next((option for option, is_given in asked.items() if is_given), None):
        raise UsageError(f"--fixes reads finished runs: leave {given} out (--json FILE keeps the numbers)")
    dives = read_dives([Path(folder) for folder in folders])
    if json_to is not None:
        write_json(json_to, {"dives": [dive._asdict() for dive in dives], "worse": worse(dives)})
    if json_to != "-":
        click.echo(aligned(fleet_table(dives)))
        click.echo("\n" + ("\n".join(worse(dives)) or "no dive has notably more noise than the others"))


def _finished(folders: Sequence[str], asked: dict[str, bool]) -> "list[ComparisonRow]":
    from usbldr_cli.runs.finished_runs import is_run, read_runs
    from usbldr_cli.runs.seed_table import require_comparable

    if not all(is_run(Path(folder)) for folder in folders):
        raise UsageError("run directories and logs cannot be mixed: compare one kind or the other")
    if given := next((option for option, is_given in asked.items() if is_given), None):
        raise UsageError(f"run directories are compared as they are: leave {given} out")
    rows = read_runs([Path(folder) for folder in folders])
    require_comparable(rows)
    return rows


def _run(
    logs: Sequence[str],
    methods: Sequence[str],
    seeds: int,
    workers: WorkerChoices,
    choices: RunChoices,
    selection: dict[str, Any],
    store: Path | None,
    bound: bool,
) -> "list[ComparisonRow]":
    """Run everything; a deterministic method runs once on a file, and once on each dive of a scenario.

    The bound is that for the states that the first filter estimates.
    """
    from usbldr.filters.replay.methods import METHODS, track_name
    from usbldr.io.reports.report_text import BOUND_NAMES
    from usbldr.io.settings.configuration import sweep
    from usbldr_cli.runs.executors import executor
    from usbldr_cli.runs.jobs import run_jobs
    from usbldr_cli.runs.seed_table import BOUND, ComparisonRow

    settings = sweep(selection["set_keys"])
    cells: dict[tuple[str, str, tuple[str, ...]], dict[int, Job]] = {}
    for log in logs:
        for method, stated in itertools.product(methods, settings):
            cells[log, method, stated] = _cell(log, method, seeds, choices, selection | {"set_keys": stated})
        if bound:
            first = next((method for method in methods if METHODS[method].is_filter), methods[0])
            for stated in settings:
                jobs = cells[log, first, stated]
                cells[log, BOUND, stated] = {seed: replace(job, bound=True) for seed, job in jobs.items()}
    seed_major = sorted(
        ((*cell, seed) for cell, jobs in cells.items() for seed in jobs),
        key=lambda at: (logs.index(at[0]), settings.index(at[2]), at[3]),  # a dive that is read once for all its jobs
    )
    with executor(workers) as where:
        outcomes = run_jobs([cells[at[:3]][at[3]] for at in seed_major], where, store)
    by_place = dict(zip(seed_major, outcomes, strict=True))
    reused = sum(outcome.reused for outcome in outcomes)
    if reused:
        click.echo(f"{reused} of {len(outcomes)} runs were finished already, in {store}", err=True)
    names = [Path(log).name for log in logs]
    rows: list[ComparisonRow] = []
    for (log, method, stated), jobs in cells.items():
        name = Path(log).name if names.count(Path(log).name) == 1 else log
        found = tuple(by_place[log, method, stated, seed] for seed in jobs)
        dives = next(iter(jobs.values())).simulated
        label = BOUND_NAMES[choices.smooth] if method == BOUND else track_name(method, choices.smooth)
        varied = [text for k, text in enumerate(stated) if len({other[k] for other in settings}) > 1]
        label = " ".join([label, *(text.replace('"', "") for text in varied)])
        draws = method != BOUND and METHODS[method].draws
        rows.append(ComparisonRow(name, label, method, tuple(jobs), found, draws, dives, tuple(varied)))
    return rows


def _cell(log: str, method: str, seeds: int, choices: RunChoices, selection: dict[str, Any]) -> "dict[int, Job]":
    from usbldr.filters.replay.methods import METHODS
    from usbldr.io.session import is_simulated
    from usbldr_cli.runs.workers import Job

    once = not is_simulated(log) and not METHODS[method].draws
    wanted = range(choices.seed, choices.seed + (1 if once else seeds))
    return {seed: Job(log, method, replace(choices, seed=seed), selection) for seed in wanted}


def _results(rows: "Sequence[ComparisonRow]", request: dict[str, Any]) -> ResultFiles:
    from usbldr_cli.runs.seed_table import overall, records, seed_records
    from usbldr_cli.tables.compare_table import page, render

    contents = records(rows)
    shown = partial(page, rows), partial(render, rows), overall(rows)
    return ResultFiles("compare", request, {"rows": contents}, contents, *shown, seed_records(rows))


def _pictures(rows: "Sequence[ComparisonRow]", plots: str) -> "Sequence[Picture] | None":
    if plots == "none":
        return None
    from usbldr_cli.figures.compare import compare_pictures  # imports matplotlib
    from usbldr_cli.runs.seed_table import many_logs

    return compare_pictures(rows, plots == "all" or not many_logs(rows))
