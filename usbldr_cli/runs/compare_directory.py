"""The folder of a comparison or a drill: made first, so that finished runs are kept; its tables are written last.

units/             one JSON and one .npz for each finished run
compare.json       every row and every number; drill.json likewise, and so on
compare.csv        the same rows
compare_seeds.csv  a row for each log, filter and seed
compare.md         the tables and figures
*.png              the figures
report.html        all of it as one page with interactive figures
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from usbldr.filters.errors import UsageError
from usbldr.io.writing import writing

UNITS, TABLES = "units", "compare.json"
OWN = re.compile(
    r"(compare|drill)\.(json|csv|md)|compare_seeds\.csv|report\.html|\.?(track|errors|error_cdf|by_filter|by_log|drill)[\w.-]*\.(png|svg|pdf)|\..*\.part"
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
        as_stored = json.loads(json.dumps(request))  # tuples become lists
        if (folder / tables).exists() and not force and _stated(folder / tables).get("request") != as_stored:
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


def listed_figures(tables: Path) -> set[str]:
    """Return the names of the figures that a JSON lists, if they are names of such figures."""
    names = _stated(tables).get("figures")
    listed = cast("list[Any]", names) if isinstance(names, list) else []
    return {name for name in listed if isinstance(name, str) and OWN.fullmatch(name)}


def _stated(tables: Path) -> dict[str, Any]:
    try:
        content = json.loads(tables.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return cast("dict[str, Any]", content) if isinstance(content, dict) else {}
