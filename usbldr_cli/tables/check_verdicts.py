"""Each metric of a baseline: old, new, change, limit, verdict; as text, Markdown and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from usbldr.filters.evaluation.metrics import Direction
from usbldr.io.reports.report_text import Table
from usbldr.io.settings.regression_baseline import BaselineRow, Metric, usual_direction

OK, REGRESSION, STALE, MISSING, UNKNOWN = "ok", "REGRESSION", "better: stale", "MISSING", "NO VALUE"
FAILURES = (REGRESSION, MISSING, UNKNOWN)
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

    @property
    def passed(self) -> bool:
        """Whether the row ran on its whole log and no metric is a failure."""
        return self.fault is None and not self.lost and all(change.verdict not in FAILURES for change in self.changes)


def compare_metric(name: str, metric: Metric, new: float | None) -> MetricChange:
    """Compare one metric: a change beyond its limit is a regression, unless it is better."""
    direction = metric.direction or usual_direction(name)
    verdict = OK
    if new is None:
        verdict = MISSING
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
    """Return why rows were not run, and which parts of their logs could not be read."""
    faults = [(one.row.name, f"not run: {one.fault}") for one in checked if one.fault is not None]
    return faults + [(one.row.name, text) for one in checked for text in one.lost]


def summary(checked: Sequence[CheckedRow]) -> str:
    """Return the last line."""
    every = [c for one in checked for c in one.changes]
    failed = [
        f"{one.row.name}: {c.metric} {c.verdict}" for one in checked for c in one.changes if c.verdict in FAILURES
    ]
    failed += [f"{one.row.name}: not run" for one in checked if one.fault is not None]
    failed += [f"{one.row.name}: log partly unreadable" for one in checked if one.fault is None and one.lost]
    stale = sum(c.verdict == STALE for c in every)
    hint = f"; {stale} better than the baseline by more than the limit: update it with --update" if stale else ""
    if failed:
        more = f" and {len(failed) - 3} more" if len(failed) > 3 else ""
        return f"FAILED: {', '.join(failed[:3])}{more}{hint}"
    good = sum(c.verdict == OK for c in every)
    return f"passed: {good} of {len(every)} metrics in {len(checked)} rows within their limits{hint}"


def as_json(baseline: str, checked: Sequence[CheckedRow], exit_code: int) -> dict[str, Any]:
    """Return the result for JSON."""
    return {
        "baseline": baseline,
        "exit_code": exit_code,
        "summary": summary(checked),
        "rows": [
            {
                "name": one.row.name,
                "log": one.row.log,
                "filter": one.row.filter,
                "seeds": one.row.seeds,
                "passed": one.passed,
                "fault": one.fault,
                "lost": list(one.lost),
                "metrics": [asdict(c) for c in one.changes],
            }
            for one in checked
        ],
    }


def markdown(baseline: str, checked: Sequence[CheckedRow]) -> str:
    """Return the result as a page: the verdict, then failures alone, then everything."""
    parts = [f"# usbldr check {baseline}", f"**{summary(checked)}.**"]
    parts += [f"* **{name}**: {text}" for name, text in notes(checked)]
    lines = ["| row | metric | old | new | change | limit | verdict |", "|---|---|---:|---:|---:|---:|---|"]
    for one in checked:
        for c in one.changes:
            verdict = f"**{c.verdict}**" if c.verdict in FAILURES else c.verdict
            lines.append(f"| {' | '.join((one.row.name.replace('|', '/'), c.metric, *_cells(c)[:-1], verdict))} |")
    return "\n\n".join([*parts, "\n".join(lines)]) + "\n"
