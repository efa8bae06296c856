"""The folder of a comparison: made first, so that finished runs are kept; its tables are written last.

units/          one JSON and one .npz for each finished run
compare.json    every row and every number
compare.csv     the same rows
compare.md      the tables and figures
*.png           the figures
report.html     all of it as one page with interactive figures
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from usbldr.filters.errors import UsageError
from usbldr.io.reports.run_directory import json_text, write_atomically
from usbldr.io.reports.run_provenance import made_by, provenance_content
from usbldr.io.writing import writing
from usbldr_cli.options.log_options import request_provenance
from usbldr_cli.runs.seed_table import ComparisonRow, grouped, overall, row_content

UNITS, TABLES = "units", "compare.json"
OWN = re.compile(
    r"(compare|drill)\.(json|csv|md)|report\.html|\.?(track|errors|error_cdf|by_filter|by_log|drill)[\w.-]*\.(png|svg|pdf)|\..*\.part"
)
OWN_UNIT = re.compile(r"[0-9a-f]{32}\.(json|npz)|\..*\.part")


def prepare(folder: Path, request: Mapping[str, Any], force: bool, tables: str = TABLES) -> None:
    """Make the folder, or continue the same comparison in it; ``tables`` is the name of its JSON.

    Raises UsageError for a folder with other files, or, without ``force``, with the tables of another comparison.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file: --output takes the name of a new folder")
    with writing(folder, "choose another --output"):
        foreign = _foreign(folder) if folder.exists() else None
        if foreign is not None:
            raise UsageError(f"{folder} holds {foreign}, which is not of a comparison: choose another --output")
        if (folder / tables).exists() and not force and _request(folder / tables) != _plain(request):
            raise UsageError(
                f"{folder} holds another comparison: choose another --output, or --force to replace its tables "
                "(finished runs are kept)"
            )
        folder.mkdir(parents=True, exist_ok=True)
        if "runs" not in request:
            (folder / UNITS).mkdir(exist_ok=True)


def _foreign(folder: Path) -> str | None:
    for path in sorted(folder.iterdir()):
        if path.name == UNITS and path.is_dir():
            inner = [p.name for p in sorted(path.iterdir()) if not OWN_UNIT.fullmatch(p.name)]
            if inner:
                return f"{UNITS}/{inner[0]}"
        elif path.is_dir() or not OWN.fullmatch(path.name):
            return path.name
    return None


def _request(tables: Path) -> Any:
    try:
        return json.loads(tables.read_text(encoding="utf-8"))["request"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _plain(request: Mapping[str, Any]) -> Any:
    """Return a request as JSON stores it: tuples become lists."""
    return json.loads(json.dumps(request))


def content(rows: Sequence[ComparisonRow], request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of compare.json."""
    return {
        **made_by(),
        "request": request,
        "rows": records(rows),
        "verdict": overall(rows),
        "provenance": provenance_content(request_provenance(request)),
    }


def records(rows: Sequence[ComparisonRow]) -> list[dict[str, Any]]:
    """Return each row with every number; differences are to the first row of its log that has numbers."""
    contents: list[dict[str, Any]] = []
    for group in grouped(rows).values():
        first = next((row for row in group if row.good), group[0])
        contents += [row_content(row, first, group) for row in group]
    return contents


def write_tables(folder: Path, rows: Sequence[ComparisonRow], request: Mapping[str, Any], markdown: str) -> None:
    """Write compare.csv, compare.md and, last, compare.json, each atomically."""
    import pandas as pd

    table = pd.DataFrame(records(rows)).to_csv(index=False, lineterminator="\n")
    write_atomically(folder / "compare.csv", table.encode())
    write_atomically(folder / "compare.md", markdown.encode())
    write_atomically(folder / TABLES, (json_text(content(rows, request)) + "\n").encode())
