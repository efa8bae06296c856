"""The folder of a drill: as that of a comparison, with drill.json, drill.csv, drill.md and its figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from usbldr.io.reports.run_directory import json_text, write_atomically
from usbldr.io.reports.run_provenance import made_by, provenance_content
from usbldr_cli.options.log_options import request_provenance
from usbldr_cli.runs.drill_rows import DrillReport, overall, row_content, worst_first
from usbldr_cli.runs.seed_table import row_metrics

TABLES = "drill.json"
LISTS = ("faults", "findings", "warnings")  # of a row


def content(report: DrillReport, request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of drill.json: the rows, worst drill first, and the metrics without faults."""
    return {
        **made_by(),
        "request": request,
        "undamaged": [{"filter": row.label, "seeds": len(row.good), **row_metrics(row)} for row in report.usual],
        "rows": [row_content(row) for row in worst_first(report.rows)],
        "verdict": overall(report.rows),
        "provenance": provenance_content(request_provenance(request)),
    }


def write_report(folder: Path, report: DrillReport, request: Mapping[str, Any], markdown: str) -> None:
    """Write drill.csv, drill.md and, last, drill.json, each atomically."""
    import pandas as pd

    rows = [row_content(row) for row in worst_first(report.rows)]
    reported = [row | {name: "; ".join(row[name]) for name in LISTS} for row in rows]
    write_atomically(folder / "drill.csv", pd.DataFrame(reported).to_csv(index=False, lineterminator="\n").encode())
    write_atomically(folder / "drill.md", markdown.encode())
    write_atomically(folder / TABLES, (json_text(content(report, request)) + "\n").encode())
