"""Each metric of a baseline run again: old, new, change, limit, verdict; as text, Markdown, JSON and JUnit XML."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from usbldr.filters.errors import CheckError, LogError, listed, printable
from usbldr.filters.evaluation.metrics import Direction
from usbldr.filters.replay.methods import METHODS
from usbldr.io.reports.page import Page, PageSection, Plot, labelled
from usbldr.io.reports.report_text import TextTable
from usbldr.io.reports.run_page import provenance_section
from usbldr.io.reports.run_provenance import RunProvenance, provenance_content
from usbldr.io.settings.regression_baseline import BaselineRow, Metric, RegressionBaseline, usual_direction
from usbldr_cli.options.option import given_command
from usbldr_cli.runs import seed_table
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.jobs import run_jobs
from usbldr_cli.runs.workers import Executor, Job

OK, REGRESSION, STALE, MISSING, UNKNOWN = "ok", "REGRESSION", "better: stale", "MISSING", "NO VALUE"
ANOTHER_LOG = "another log"  # of which the stored values are
FAILURES = (REGRESSION, MISSING, UNKNOWN, ANOTHER_LOG)
SHORT_DIGEST = 12  # [characters] of a SHA-256 that a person compares
HEADS = ("old", "new", "change", "limit", "verdict")


@dataclass(frozen=True, slots=True)
class MetricChange:
    """One metric of one row."""

    metric: str
    old: float | None  # None: the baseline has no value yet
    new: float | None  # None: the run gave no such metric
    limit: float
    direction: Direction
    verdict: str


@dataclass(frozen=True, slots=True)
class CheckedRow:
    """One row: what changed, or the sentence that says why it could not be run."""

    row: BaselineRow
    changes: tuple[MetricChange, ...]
    fault: str | None = None
    exit_code: int = 0  # of the fault
    lost: tuple[str, ...] = ()  # sentences on parts of the log that could not be read
    log_sha256: str = ""  # of the log that was read; "" if it was not run
    worst_seed: int | None = None  # with the largest mean error
    findings: tuple[str, ...] = ()  # sentences of the doctor on the log of a row that failed
    kept: Path | None = None  # the run directory of a row that failed

    @property
    def another_log(self) -> bool:
        """Whether the stored values are of another log."""
        return bool(self.row.log_sha256 and self.log_sha256) and self.row.log_sha256 != self.log_sha256

    @property
    def passed(self) -> bool:
        """Whether the row ran on its whole log and no metric is a failure."""
        return self.fault is None and not self.lost and all(change.verdict not in FAILURES for change in self.changes)


def compare_metric(name: str, metric: Metric, new: float | None, another_log: bool = False) -> MetricChange:
    """Compare one metric: a change beyond its limit is a regression, unless it is better, or of another log."""
    direction = metric.direction or usual_direction(name)
    verdict = OK
    if new is None:
        verdict = MISSING
    elif another_log:
        verdict = ANOTHER_LOG
    elif metric.value is None:
        verdict = UNKNOWN
    elif abs(new - metric.value) > metric.limit:
        better = {"lower": new < metric.value, "higher": new > metric.value, "both": False}[direction]
        verdict = STALE if better else REGRESSION
    return MetricChange(name, metric.value, new, metric.limit, direction, verdict)


def table(checked: Sequence[CheckedRow]) -> TextTable:
    """Return every metric under the name of its row."""
    rows: list[tuple[str, ...]] = []
    for one in checked:
        rows.append((one.row.name, *("" for _ in HEADS)))
        rows += [(f"  {c.metric}", *_cells(c)) for c in one.changes]
    return TextTable("row, metric", HEADS, tuple(rows))


def _cells(c: MetricChange) -> tuple[str, ...]:
    digits = _digits(c.limit)
    old, new = ("none" if value is None else _number(value, digits) for value in (c.old, c.new))
    moved = "" if c.old is None or c.new is None else _number(float(new) - float(old), digits, "+z")  # as printed
    return old, new, moved, "" if c.old is None else _number(c.limit, digits), c.verdict


def _number(value: float, digits: int | None, sign: str = "") -> str:
    return f"{value:{sign}.6g}" if digits is None else f"{value:{sign}.{digits}f}"


def _digits(limit: float) -> int | None:
    """Return how many decimals show a tenth of the limit; None without a limit."""
    return next((digits for digits in range(2, 9) if limit >= 10.0 ** (1 - digits)), None)


def notes(checked: Sequence[CheckedRow]) -> list[tuple[str, str]]:
    """Return why rows failed aside from their numbers: what could not be read, another log, findings of the doctor."""
    lines: list[tuple[str, str]] = []
    for one in checked:
        found = [f"not run: {one.fault}"] if one.fault is not None else []
        if one.another_log:
            was, now = one.row.log_sha256[:SHORT_DIGEST], one.log_sha256[:SHORT_DIGEST]
            found.append(
                f"the log is another one (sha256 {now}..., the values are of {was}...); --update takes it over"
            )
        found += [*one.lost, *(f"doctor: {text}" for text in one.findings)]
        found += [f"run kept in {one.kept}"] if one.kept is not None else []
        lines += [(one.row.name, text) for text in found]
    return lines


def summary(checked: Sequence[CheckedRow]) -> str:
    """Return the last line."""
    every = [c for one in checked for c in one.changes]
    failed: list[str] = []
    for one in checked:
        if one.another_log:
            failed.append(f"{one.row.name}: the log is another one")
        else:
            failed += [f"{one.row.name}: {c.metric} {c.verdict}" for c in one.changes if c.verdict in FAILURES]
    failed += [f"{one.row.name}: not run" for one in checked if one.fault is not None]
    failed += [f"{one.row.name}: log partly unreadable" for one in checked if one.fault is None and one.lost]
    stale = sum(c.verdict == STALE for c in every)
    hint = f"; {stale} better than the baseline by more than the limit: update it with --update" if stale else ""
    if failed:
        return f"FAILED: {listed(failed, 3)}{hint}"
    good = sum(c.verdict == OK for c in every)
    return f"passed: {good} of {len(every)} metrics in {len(checked)} rows within their limits{hint}"


def values_text(baseline: RegressionBaseline) -> str:
    """Return who made the values of a baseline when; empty if it does not say so."""
    day = f" on {baseline.date.isoformat()}" if baseline.date is not None else ""
    return f"values of {baseline.file.name} by {baseline.tool}{day}" if baseline.tool else ""


def as_json(baseline: RegressionBaseline, checked: Sequence[CheckedRow], exit_code: int) -> dict[str, Any]:
    """Return the result for JSON."""
    return {
        "baseline": {
            "file": baseline.file.name,
            "tool": baseline.tool or None,
            "date": baseline.date and str(baseline.date),
        },
        "exit_code": exit_code,
        "verdict": summary(checked),
        "rows": [
            {
                "name": one.row.name,
                "log": one.row.log,
                "log_sha256": one.log_sha256 or None,
                "another_log": one.another_log,
                "filter": one.row.filter,
                "seeds": one.row.seeds,
                "passed": one.passed,
                "fault": one.fault,
                "lost": list(one.lost),
                "findings": list(one.findings),
                "run": None if one.kept is None else str(one.kept),
                "metrics": [asdict(c) for c in one.changes],
            }
            for one in checked
        ],
        "provenance": provenance_content(RunProvenance(given_command())),
    }


def page(baseline: RegressionBaseline, checked: Sequence[CheckedRow], figures: Sequence[Plot]) -> Page:
    """Return the result as a page: the verdict, why rows failed, failures alone, then every metric."""
    every = [(one.row.name, c) for one in checked for c in one.changes]
    failed = [(name, c) for name, c in every if c.verdict in FAILURES]
    reported = (f"{text}.",) if (text := values_text(baseline)) else ()
    sections = (
        PageSection("", (*reported, *labelled(notes(checked)))),
        PageSection("Failures", (_flat(failed),) if failed else ()),
        PageSection("Figures", tuple(figures)),
        PageSection("Metrics", (_flat(every),)),
        provenance_section(RunProvenance(given_command())),
    )
    return Page(f"usbldr check {baseline.file.name}", summary(checked), sections)


def _flat(changes: Sequence[tuple[str, MetricChange]]) -> TextTable:
    """Return metrics with the names of their rows."""
    return TextTable("metric", ("row", *HEADS), tuple((c.metric, name, *_cells(c)) for name, c in changes))


def checked_rows(baseline: RegressionBaseline, jobs: Mapping[str, Sequence[Job]], where: Executor) -> list[CheckedRow]:
    """Run every row, ``jobs`` by row name, and compare its metrics with the stored ones."""
    outcomes = iter(run_jobs([job for cell in jobs.values() for job in cell], where))
    by_row = {name: [next(outcomes) for _ in cell] for name, cell in jobs.items()}
    return [_compared(baseline.file, row, jobs[row.name], by_row[row.name]) for row in baseline.rows]


def _compared(file: Path, row: BaselineRow, jobs: Sequence[Job], outcomes: Sequence[JobResult]) -> CheckedRow:
    if not jobs:
        return CheckedRow(row, (), f"{file.parent / row.log}: no such log or scenario", CheckError.exit_code)
    bad = [outcome for outcome in outcomes if outcome.fault is not None]
    if bad:
        return CheckedRow(row, (), bad[0].fault, max(outcome.exit_code for outcome in bad))
    seeds = tuple(job.choices.seed for job in jobs)
    dives = jobs[0].simulated
    run = seed_table.ComparisonRow(
        row.log, row.filter, row.filter, seeds, tuple(outcomes), METHODS[row.filter].draws, dives
    )
    found = seed_table.row_metrics(run)
    judged = outcomes[0].scored_against
    digest, lost = ("", ()) if judged is None else (judged.log_sha256, judged.lost)
    digest = "" if dives else digest  # the last bits of a simulated log depend on the machine
    other = bool(row.log_sha256 and digest) and row.log_sha256 != digest
    changes = tuple(compare_metric(name, metric, found.get(name), other) for name, metric in row.metrics.items())
    worst = max(range(len(seeds)), key=lambda k: outcomes[k].metrics.get("mean_horizontal_m", 0.0))
    return CheckedRow(row, changes, None, LogError.exit_code if lost else 0, lost, digest, worst_seed=seeds[worst])


def junit(baseline: str, checked: Sequence[CheckedRow]) -> str:
    """Return the JUnit XML, a suite for each row; a row that could not be run, or not on its whole log, is an error.

    There is no standard; these are the elements of Ant's JUnit task that GitLab, Jenkins and others read: testsuites,
    testsuite, testcase, failure, error, system-out.
    """
    root = ElementTree.Element("testsuites", name=f"usbldr check {printable(baseline)}")
    for one in checked:
        suite = ElementTree.SubElement(root, "testsuite", name=printable(one.row.name))
        name = f"{baseline}: {one.row.name}"
        for change in one.changes:
            _case(suite, name, change)
        broken = [one.fault] if one.fault is not None else list(one.lost)
        if broken:
            case = ElementTree.SubElement(suite, "testcase", classname=printable(name), name="run")
            ElementTree.SubElement(case, "error", message=printable(broken[0])).text = printable("; ".join(broken))
        failures = sum(change.verdict in FAILURES for change in one.changes)
        suite.set("tests", str(len(suite)))
        suite.set("failures", str(failures))
        suite.set("errors", str(len(broken[:1])))
        said = [printable(text) for _, text in notes([one])]
        if said:
            ElementTree.SubElement(suite, "system-out").text = "\n".join(said)
    for count in ("tests", "failures", "errors"):
        root.set(count, str(sum(int(suite.get(count, "0")) for suite in root)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _case(suite: ElementTree.Element, row: str, change: MetricChange) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname=printable(row), name=printable(change.metric))
    if change.verdict in FAILURES:
        old, new = ("none" if value is None else f"{value:.6g}" for value in (change.old, change.new))
        text = f"{change.verdict}: {old} before, {new} now, limit {change.limit:.3g}"
        ElementTree.SubElement(case, "failure", message=text).text = text
