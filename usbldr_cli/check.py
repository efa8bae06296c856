"""``usbldr check``: runs the rows of a baseline again and compares each metric with its stored value, for CI."""

import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from usbldr.filters.errors import CheckError, UsageError
from usbldr_cli.options.completion import FILE
from usbldr_cli.options.log_options import inputs, read_request
from usbldr_cli.options.option import GroupedCommand, option, unused_options
from usbldr_cli.options.output_files import folder_option, json_option, refuse_file, write_file, write_json
from usbldr_cli.options.verbosity import progress_option, verbose_option
from usbldr_cli.options.worker_options import WorkerChoices, worker_options
from usbldr_cli.run_output import RunOutputs

if TYPE_CHECKING:
    from usbldr.io.settings.regression_baseline import RegressionBaseline
    from usbldr_cli.runs.workers import Job
    from usbldr_cli.tables.check_verdicts import CheckedRow

KEEP_NONE = Path("none")  # of --output
NAME_LETTERS = 60  # of a row in the name of its folder


@click.command(cls=GroupedCommand)
@click.argument("file", metavar="BASELINE", type=FILE)
@option("--update", is_flag=True, help="Show the differences and store the new values.", group="Baseline")
@worker_options
@folder_option('Folder for the run directories of failed rows; "none" keeps none.  [default: BASELINE-failed]')
@json_option("result")
@option("--junit", type=FILE, metavar="FILE", help="Write the result as JUnit XML, which GitLab and others show.")
@option("--markdown", "markdown_to", type=FILE, metavar="FILE", help="Write the result as a page for a CI run.")
@option(
    "--html",
    "html_to",
    type=FILE,
    metavar="FILE",
    help="Write the result as one page with an interactive figure.",
    rare=True,
)
@option("--force", is_flag=True, help="Replace the files of other options, and kept runs.")
@option("--quiet", "-q", is_flag=True, help="Print only the last line.")
@verbose_option
@progress_option
def check(
    file: str,
    update: bool,
    workers: WorkerChoices,
    output: Path | None,
    json_to: str | None,
    junit: str | None,
    markdown_to: str | None,
    html_to: str | None,
    force: bool,
    quiet: bool,
) -> int:
    """Run the rows of BASELINE again; exit 1 if a metric is missing or worse than its limit allows.

    A missing row or log is a failure. A metric that is better by more than its limit passes, and is reported because
    the baseline is stale. For a row that fails, the doctor's findings on its log are printed, and its run directory
    with figures is kept.

    \b
    $ usbldr baseline dive.mcap --output gate.toml
    $ usbldr check gate.toml
    """
    from usbldr.io.reports.page import markdown
    from usbldr.io.settings.regression_baseline import read_baseline
    from usbldr_cli.runs.baseline_rows import jobs_of_row, options_of_row
    from usbldr_cli.runs.executors import executor
    from usbldr_cli.tables.check_verdicts import as_json, checked_rows, page
    from usbldr_cli.tables.check_verdicts import junit as junit_text

    wanted = read_baseline(Path(file))
    jobs = {row.name: jobs_of_row(wanted.file, row) for row in wanted.rows}
    for row in wanted.rows:
        simulated = any(job.simulated for job in jobs[row.name])
        for text in unused_options(options_of_row(row.options), [row.filter], simulated):
            click.echo(f"usbldr: {wanted.file}: row {row.name!r}: {text}", err=True)
    targets = {"--json": json_to, "--markdown": markdown_to, "--junit": junit, "--html": html_to}
    for name, target in targets.items():
        if target is not None and (name, target) != ("--json", "-"):
            _refuse(name, Path(target), force, wanted, jobs)
    place = None if update or output == KEEP_NONE else _place(output, wanted.file, force)
    with executor(workers) as where:
        checked = checked_rows(wanted, jobs, where)
    if place is not None:
        checked = _explained(checked, jobs, place, force)
    failed = not all(one.passed for one in checked)
    code = max(one.exit_code for one in checked) or (CheckError.exit_code if failed else 0)
    if markdown_to is not None:
        write_file("--markdown", Path(markdown_to), markdown(page(wanted, checked, ())))
    if html_to is not None:
        _write_html(Path(html_to), wanted, checked)
    if junit is not None:
        write_file("--junit", Path(junit), junit_text(wanted.file.name, checked))
    if json_to is not None:
        write_json(json_to, as_json(wanted, checked, code))
    if json_to != "-":
        _print_result(wanted, checked, quiet, update)
    return _update(wanted, checked, show=json_to != "-") if update else code


def _write_html(file: Path, baseline: "RegressionBaseline", checked: "Sequence[CheckedRow]") -> None:
    from usbldr_cli.figures.drawing import described
    from usbldr_cli.pages.check_figure import change_picture  # imports matplotlib
    from usbldr_cli.pages.html_page import html, plots_of
    from usbldr_cli.tables.check_verdicts import page

    blocks, plots = plots_of(described([change_picture(checked)]))
    write_file("--html", file, html(page(baseline, checked, blocks), plots))


def _refuse(
    name: str, file: Path, force: bool, baseline: "RegressionBaseline", jobs: "Mapping[str, Sequence[Job]]"
) -> None:
    """Refuse a file that is the baseline or an input of a row, or that is not empty."""
    if file.resolve() == baseline.file.resolve():
        raise UsageError(f"{file} is the baseline: choose another file for {name}")
    for job in {job.log: job for cell in jobs.values() for job in cell}.values():
        refuse_file(name, file, force, inputs(job.log, read_request(**job.selection)))
    refuse_file(name, file, force, ())


def _place(output: Path | None, baseline: Path, force: bool) -> Path:
    """Return the folder of kept runs; the default one gets a number if it exists, an explicit one must be new."""
    if output is None:
        place, number = Path(f"{baseline.stem}-failed"), 1
        while place.exists() and not force:
            number += 1
            place = Path(f"{baseline.stem}-failed-{number}")
        return place
    if output.exists() and not output.is_dir():
        raise UsageError(f"{output} is a file: --output takes the name of a new folder")
    if output.exists() and os.listdir(output) and not force:
        raise UsageError(f"{output} is not empty: choose another --output, or --force to replace the runs in it")
    return output


def _explained(
    checked: "Sequence[CheckedRow]", jobs: "Mapping[str, Sequence[Job]]", place: Path, force: bool
) -> "list[CheckedRow]":
    """Run the failed rows again: keep their run directories, and let the doctor examine their logs."""
    explained: list[CheckedRow] = []
    for number, one in enumerate(checked, start=1):
        job = next((job for job in jobs[one.row.name] if job.choices.seed == one.worst_seed), None)
        if one.passed or job is None:
            explained.append(one)
            continue
        name = re.sub(r"[^\w.-]+", "_", one.row.name).strip("._")[:NAME_LETTERS]
        explained.append(_kept(one, job, place / f"{number:02d}-{name}", force))
    return explained


def _kept(one: "CheckedRow", job: "Job", target: Path, force: bool) -> "CheckedRow":
    """Keep the run of a failed row, that of its worst seed, with what the doctor finds in its log."""
    from usbldr.io.doctor.doctor import examine_log
    from usbldr.io.reports.run_directory import run_directory
    from usbldr_cli.run_output import write_run
    from usbldr_cli.runs.jobs import relevant_choices
    from usbldr_cli.runs.one_run import RunPlan, run_again

    run = run_again(RunPlan(job.log, job.method, relevant_choices(job.method, job.choices), job.selection))
    with run_directory(target, force) as folder:
        write_run(folder, run, RunOutputs())
    findings = [f for f in examine_log(run.log).findings if f.level != "info"]
    return replace(one, findings=tuple(f"{f.text} [{f.code}]" for f in findings), kept=target)


def _print_result(baseline: "RegressionBaseline", checked: "Sequence[CheckedRow]", quiet: bool, update: bool) -> None:
    """Print the table and the last line, which is left out if the values are about to be replaced."""
    from usbldr_cli.tables.check_verdicts import notes, summary, table, values_text
    from usbldr_cli.tables.run_table import WIDTH, aligned, pairs

    if not quiet:
        click.echo(aligned(table(checked)) + "\n")
        if lines := notes(checked):
            click.echo(pairs(lines) + "\n")
        if text := values_text(baseline):
            click.echo(text)
    if not update:
        click.echo(textwrap.fill(summary(checked), WIDTH, break_long_words=False, break_on_hyphens=False))


def _update(baseline: "RegressionBaseline", checked: "Sequence[CheckedRow]", show: bool) -> int:
    from usbldr.io.settings.regression_baseline import with_new_values
    from usbldr_cli.runs.baseline_rows import today, tool_text
    from usbldr_cli.tables.check_verdicts import MISSING

    absent = [
        one.row.name for one in checked if one.fault or one.lost or any(c.verdict == MISSING for c in one.changes)
    ]
    if absent:
        codes = [one.exit_code for one in checked]
        click.echo(f"usbldr: {baseline.file}: unchanged, because a metric is missing in {', '.join(absent)}", err=True)
        return max(*codes, CheckError.exit_code)
    values = [({c.metric: c.new for c in one.changes if c.new is not None}, one.log_sha256) for one in checked]
    text = with_new_values(baseline, values, tool_text(), today())
    if text != baseline.text:
        write_file("--update", baseline.file, text)
    if show:
        click.echo(f"{baseline.file}: {'updated' if text != baseline.text else 'is up to date'}")
    return 0
