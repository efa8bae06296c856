"""``usbldr drill``: filters on a log as it is and with faults put into its records, side by side."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import UsageError
from usbldr.io.drills.kinds import KINDS
from usbldr_cli.options.completion import words
from usbldr_cli.options.log_options import log_options
from usbldr_cli.options.option import GroupedCommand, fault_option, option, warn_of_unused_options
from usbldr_cli.options.output_files import folder_option, html_option, json_option, refuse_inputs
from usbldr_cli.options.run_options import RunChoices, filter_list, filters_option, run_options, seeds_option
from usbldr_cli.options.verbosity import progress_option, verbose_option
from usbldr_cli.options.worker_options import WorkerChoices, worker_options
from usbldr_cli.result_files import ResultFiles, refuse_empty

if TYPE_CHECKING:
    from usbldr.io.drills.drill import Drill
    from usbldr_cli.runs.drill_rows import DrillReport

DEFAULT_FILTERS = "adf,cpf"
USUAL = ("bias", "spike", "outlier", "drop", "latency")  # the faults of any dive; --help-all lists every kind


def fault_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --suite, and one option for each kind of fault; the command gets them under the names of the kinds."""
    for kind in reversed(list(KINDS)):
        declared = KINDS[kind]
        help_text = f"{declared.meaning}  [{declared.example}]"
        rare = kind not in USUAL
        command = fault_option(f"--{kind}", multiple=True, metavar="FAULT", help=help_text, rare=rare)(command)
    help_text = 'Drills of a TOML file; "standard" is the suite that is shipped.  [default without faults: standard]'
    return fault_option("--suite", type=words("standard", files=True), metavar="FILE", help=help_text)(command)


def chosen_drills(suite: str | None, given: Mapping[str, tuple[str, ...]]) -> "tuple[Drill, ...]":
    """Return the drills of the suite and one of the faults of the options, which happen together."""
    from usbldr.io.drills.drill import Drill
    from usbldr.io.drills.fault_text import fault_of
    from usbldr.io.drills.suite import STANDARD, read_suite

    faults: list[Any] = []
    for kind, texts in given.items():
        for text in texts:
            try:
                faults.append(fault_of(kind, text))
            except UsageError as err:
                raise UsageError(f"--{err}") from err
    own = (Drill(", ".join(fault.text for fault in faults), tuple(faults)),) if faults else ()
    named = read_suite(suite or STANDARD) if suite is not None or not faults else ()
    return (*own, *named)


@click.command(cls=GroupedCommand)
@log_options
@fault_options
@filters_option(f"Methods, see Filters below.  [default: {DEFAULT_FILTERS}]")
@seeds_option(3)
@run_options
@folder_option("Folder for tables, figures and finished runs.")
@option("--force", is_flag=True, help="Replace the tables of other drills in this folder.")
@json_option("table")
@html_option
@option("--quiet", "-q", is_flag=True, help="Print only the last line.")
@worker_options
@verbose_option
@progress_option
def drill(
    log: str,
    suite: str | None,
    filters: str | None,
    seeds: int,
    workers: WorkerChoices,
    choices: RunChoices,
    output: Path | None,
    force: bool,
    json_to: str | None,
    quiet: bool,
    **others: Any,
) -> int:
    """Add faults to the records of LOG and report how they change the error of each filter.

    The faults of the options happen together; those of --suite one drill after the other. A fault is
    SENSOR[:AMOUNT][@WHERE]: where is a share of the records, "one" record, or spans FROM:TO in seconds or per cent of
    LOG (300:600, 40%:+60). Nothing is written to LOG.

    \b
    $ usbldr drill dive.mcap --drop usbl@300:600 --spike compass:120deg@0.02
    """
    from usbldr.io.session import is_simulated
    from usbldr_cli.figures.drill import drill_pictures  # imports matplotlib
    from usbldr_cli.result_files import UNITS, prepare
    from usbldr_cli.runs.drill_rows import DrillPlan, run_drills
    from usbldr_cli.runs.executors import executor

    drills = chosen_drills(suite, {kind: others.pop(kind) for kind in KINDS})
    refuse_inputs([log], others, output, json_to, force)
    methods = filter_list(DEFAULT_FILTERS if filters is None else filters, choices)
    plan = DrillPlan(log, drills, methods, seeds, choices, others)
    length_s = plan.length_s()  # refuses wrong faults before any run
    warn_of_unused_options(plan.methods, is_simulated(log) or any(drill.draws for drill in drills))
    if output is not None:
        prepare(output, plan.request, force, "drill.json")
    kept = TemporaryDirectory(prefix="usbldr-drill-") if output is None else nullcontext(output / UNITS)
    with kept as store:  # also without --output: the rows need the errors over time
        with executor(workers) as where:
            report = run_drills(plan, length_s, where, Path(store))
        refuse_empty([row.usual for row in report.rows])
        results = _results(report, plan.request)
        if output is not None:
            results.write(output, drill_pictures(report))
        results.print(output, json_to, quiet)
    return max(outcome.exit_code for row in report.rows for outcome in row.runs.outcomes)


def _results(report: "DrillReport", request: dict[str, Any]) -> ResultFiles:
    from usbldr_cli.runs.drill_rows import content, overall, records
    from usbldr_cli.tables.drill_table import page, render

    numbers, table = content(report), records(report)
    shown = partial(page, report), partial(render, report)
    return ResultFiles("drill", request, numbers, table, *shown, overall(report.rows))
