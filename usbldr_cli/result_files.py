"""The results of a comparison or a drill in every form in which they are given out: files, page, terminal.

The folder is made first, so that finished runs are kept; its tables are written last.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from usbldr.filters.errors import UsageError
from usbldr.io.reports.page import Page, Picture, Plot
from usbldr.io.reports.run_directory import json_text, write_atomically
from usbldr.io.reports.run_provenance import RunProvenance, made_by, provenance_content
from usbldr.io.writing import writing
from usbldr_cli.options.log_options import request_provenance
from usbldr_cli.options.output_files import print_result, write_json
from usbldr_cli.runs.job_store import common_fault

if TYPE_CHECKING:
    from usbldr_cli.figures import drawing  # imports matplotlib
    from usbldr_cli.runs.seed_table import ComparisonRow

UNITS, TABLES = "units", "compare.json"
OWN = re.compile(
    r"(compare|drill)\.(json|csv|md)|compare_seeds\.csv|report\.html|\.?(track|errors|error_cdf|by_filter|by_log|drill)[\w.-]*\.(png|svg|pdf)|\..*\.part"
)
OWN_UNIT = re.compile(r"[0-9a-f]{32}\.(json|npz)|\..*\.part")


@dataclass(frozen=True, slots=True)
class ResultFiles:
    """The rows of a table, and how they are shown."""

    name: str  # of the files
    request: Mapping[str, Any]
    content: Mapping[str, Any]  # of the JSON: the rows with every number
    records: Sequence[Mapping[str, Any]]  # of the CSV
    page: Callable[[Sequence[Picture | Plot], RunProvenance], Page]
    text: Callable[[bool], str]  # for a terminal, with or without colour
    verdict: str
    seeds: Sequence[Mapping[str, Any]] = ()  # of a CSV of its own: a row for each run

    def json(self) -> dict[str, Any]:
        """Return the content of the JSON file, with how it was made."""
        made = {"verdict": self.verdict, "provenance": provenance_content(request_provenance(self.request))}
        return {**made_by(), "request": self.request, **self.content, **made}

    def write(self, folder: Path, pictures: "Sequence[drawing.Picture] | None", plot_format: str = "png") -> None:
        """Write figures and page, unless there are none, then CSV, Markdown and, last, JSON, each atomically.

        Figures that the JSON of an earlier run lists, and this run does not have, are deleted.
        """
        import pandas as pd

        from usbldr.io.reports.page import markdown

        with writing(folder, "choose another --output"):
            made, shown = request_provenance(self.request), list[Picture]()
            if pictures is not None:
                from usbldr_cli.pages.html_page import draw_page

                shown = draw_page(folder, pictures, lambda blocks: self.page(blocks, made), plot_format)
            tables = {"_seeds.csv": self.seeds, ".csv": self.records}
            csv = {end: pd.DataFrame(of).to_csv(index=False, lineterminator="\n") for end, of in tables.items() if of}
            figures = [picture.name for picture in shown]
            for earlier in listed_figures(folder / f"{self.name}.json") - {*figures}:
                (folder / earlier).unlink(missing_ok=True)
            content = json_text({**self.json(), "figures": figures}) + "\n"
            texts = csv | {".md": markdown(self.page(shown, made)), ".json": content}
            for ending, text in texts.items():
                write_atomically(folder / f"{self.name}{ending}", text.encode())

    def print(self, output: Path | None, json_to: str | None, quiet: bool) -> None:
        """Print the tables, or their last line, or the rows as JSON."""
        if json_to is not None:
            write_json(json_to, self.json())
        if json_to != "-":
            print_result(self.text, self.verdict, output, quiet)


def refuse_empty(rows: "Sequence[ComparisonRow]") -> None:
    """Raise the errors of the rows if none of them has a result."""
    if any(row.good for row in rows):
        return
    raise common_fault([row.fault for row in rows], max(one.exit_code for row in rows for one in row.outcomes))


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
