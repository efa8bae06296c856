"""Finished run directories as rows of a comparison, read from report.json."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.reports.run_directory import REPORT
from usbldr_cli.runs.job_store import JobResult, ScoringContext
from usbldr_cli.runs.seed_table import ComparisonRow, grouped


def is_run(path: Path) -> bool:
    """Return whether a folder is a run directory."""
    return (path / REPORT).is_file()


def read_runs(folders: Sequence[Path]) -> list[ComparisonRow]:
    """Return a row for each run directory; raises LogError for one that is incomplete or has no truth."""
    rows = [_row(folder) for folder in folders]
    rows = [_with_seed_label(row, rows) for row in rows]
    for log, group in grouped(rows).items():
        digests = {row.scored_against.log_sha256 for row in group if row.scored_against}
        if len(digests) > 1:
            raise UsageError(
                f"{log}: the runs read {len(digests)} different logs of that name: compare each log by itself"
            )
    calls = Counter((row.log, row.label) for row in rows)
    labelled = [
        replace(row, label=f"{row.label} ({folder.resolve().name})") if calls[row.log, row.label] > 1 else row
        for row, folder in zip(rows, folders, strict=True)
    ]
    return [row for group in grouped(labelled).values() for row in group]


def _row(folder: Path) -> ComparisonRow:
    from usbldr.filters.replay.methods import METHODS

    file = folder / REPORT
    try:
        report: Any = json.loads(file.read_text(encoding="utf-8"))
        metrics = report["metrics"]
        if metrics is None:
            raise LogError(f"{folder}: this run has no truth, so no errors to compare; --fixes compares its fixes")
        log, truth, window = report["log"], report["truth"], report["window"]
        context = ScoringContext(
            log=log["name"],
            log_format=log["format"],
            log_sha256=log["sha256"],
            configuration=report["configuration"]["file"] or "",
            truth_kind=truth["kind"],
            truth_source=truth["source"],
            window_start_s=window["start_s"],
            window_end_s=window["end_s"],
            align=report["alignment"]["name"],
            aid=tuple((start_s, end_s) for start_s, end_s in report.get("aid", ())),
            order=report["order"],
            lost=tuple(finding["text"] for finding in report["findings"] if finding["lost_data"]),
        )
        numbers = {str(name): float(value) for name, value in metrics.items() if value is not None}
        trace = folder if (folder / "track.tum").is_file() and (folder / "truth.tum").is_file() else None
        time_s = report["timing"]["filter_time_s"]
        outcome = JobResult(
            numbers, tuple(report["warnings"]), scored_against=context, trace=trace, filter_time_s=time_s
        )
        label, method = str(report["filter"]), str(report["method"])
        draws = method in METHODS and METHODS[method].draws
        return ComparisonRow(context.log, label, method, (int(report["seed"]),), (outcome,), draws)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise LogError(f"{file}: is not a complete report of usbldr replay; run replay again") from err


def _with_seed_label(row: ComparisonRow, rows: Sequence[ComparisonRow]) -> ComparisonRow:
    """Add the seed to the name of a simulated log if several dives of one scenario are compared."""
    alike = [r for r in rows if r.log == row.log and r.scored_against and r.scored_against.log_format == "simulated"]
    if len({r.scored_against.log_sha256 for r in alike if r.scored_against}) < 2 or row not in alike:
        return row
    return replace(row, log=f"{row.log} (seed {row.seeds[0]})")
