"""The runs of the study: every way under every drill, merged into one report for each log."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drills.ways import DrilledLog, label
from paper.runs import Way
from usbldr.io.drills.drill import Drill
from usbldr_cli.runs.drill_rows import DrillReport
from usbldr_cli.runs.drill_runs import DrillPlan, run_drills
from usbldr_cli.runs.workers import Executor


def run_log(
    log: DrilledLog, ways: Sequence[Way], drills: tuple[Drill, ...], where: Executor, store: Path
) -> DrillReport:
    """Run what is not there yet; the first way's report holds what the doctor says, once for all."""
    first: DrillReport | None = None
    usual, rows = [], []
    for way in ways:
        plan = DrillPlan(log.path, drills, [way.method], log.seeds, log.choices(way), log.selection)
        report = run_drills(plan, where, store, examine=first is None)
        first = first or report
        usual += [replace(report.usual[0], label=label(way))]
        for row, examined in zip(report.rows, first.rows, strict=True):
            runs = replace(row.runs, label=label(way))
            rows.append(replace(row, runs=runs, examined=examined.examined, examined_usual=examined.examined_usual))
    assert first is not None
    return DrillReport((*usual, first.usual[-1]), tuple(rows))
