"""Each metric of a baseline: old, new, change, limit, verdict; as text, Markdown and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from usbldr.filters.errors import listed
from usbldr.filters.evaluation.metrics import Direction
from usbldr.io.reports.page import Page, Plot, Section, labelled
from usbldr.io.reports.report_text import Table
from usbldr.io.reports.run_page import provenance_section
from usbldr.io.reports.run_provenance import RunProvenance, provenance_content
from usbldr.io.settings.regression_baseline import BaselineRow, Metric, RegressionBaseline, usual_direction
from usbldr_cli.options.command_line import given_command

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


def table(checked: Sequence[CheckedRow]) -> Table:
    """Return every metric under the name of its row."""
    rows: list[tuple[str, ...]] = []
    for one in checked:
        rows.append((one.row.name, *("" for _ in HEADS)))
        rows += [(f"  {c.metric}", *_cells(c)) for c in one.changes]
    return Table("row, metric", HEADS, tuple(rows))


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
        Section("", (*reported, *labelled(notes(checked)))),
        Section("Failures", (_flat(failed),) if failed else ()),
        Section("Figures", tuple(figures)),
        Section("Metrics", (_flat(every),)),
        provenance_section(RunProvenance(given_command())),
    )
    return Page(f"usbldr check {baseline.file.name}", summary(checked), sections)


def _flat(changes: Sequence[tuple[str, MetricChange]]) -> Table:
    """Return metrics with the names of their rows."""
    return Table("metric", ("row", *HEADS), tuple((c.metric, name, *_cells(c)) for name, c in changes))
