"""The tables of drills: for the terminal within 100 columns, and as Markdown. Metres and seconds."""

import textwrap
from collections.abc import Sequence

from usbldr.io.reports.page import Labelled, Page, PageSection, Picture, Plot
from usbldr.io.reports.report_text import TextTable
from usbldr.io.reports.run_page import provenance_section
from usbldr.io.reports.run_provenance import RunProvenance
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow, mean_response, overall, worst_first
from usbldr_cli.runs.seed_table import ComparisonRow
from usbldr_cli.tables.compare_table import context, filled, notes
from usbldr_cli.tables.run_table import aligned, pairs, title

NAME = 34  # [columns] of the name of a drill, so that a table stays within a usual terminal
HEADS = ("filter", "error", "ratio", "drift", "back", "NEES", "raw USBL", "named")
LEGEND = (
    "error: mean horizontal error; ratio: error over that without the faults; drift: displacement of the error from "
    "the start of the faults to their end; back: seconds from their end until the error is within 1.5 times that "
    "without them; named: share of the runs in which findings of doctor name every fault."
)


def drill_table(rows: Sequence[DrillRow], name_columns: int | None = NAME) -> TextTable:
    """Return one line for each filter and drill, worst drill first; a long name is cut to ``name_columns``."""
    body: list[tuple[str, ...]] = []
    last = ""
    for row in worst_first(rows):
        name = (
            row.drill.name if name_columns is None else textwrap.shorten(row.drill.name, name_columns, placeholder="…")
        )
        body.append(("" if row.drill.name == last else name, *_cells(row)))
        last = row.drill.name
    return TextTable("faults, m", HEADS, tuple(body))


def _cells(row: DrillRow) -> tuple[str, ...]:
    if not row.runs.good:
        return (row.runs.label, "failed", *[""] * (len(HEADS) - 2))
    response = mean_response(row)
    back_s, share = response["reacquired_s"], response["reacquired_share"]
    back = "" if share is None else "never" if back_s is None else f"{back_s:.0f} s"
    if back_s is not None and share is not None and share < 1:
        back += f" ({100 * share:.0f} %)"
    named = row.named_share
    return (
        row.runs.label,
        number(row.error_m),
        number(row.ratio),
        number(response["drift_m"]),
        back,
        number(row.runs.mean("nees_mean")),
        number(row.raw.mean("mean_horizontal_m")),
        "" if named is None else f"{100 * named:.0f} %",
    )


def number(value: float | None) -> str:
    """Return a number in three digits, "" for none."""
    if value is None:
        return ""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def usual_table(rows: Sequence[ComparisonRow]) -> TextTable:
    """Return the errors without faults."""
    body = tuple((row.label, number(row.mean("mean_horizontal_m")), number(row.mean("nees_mean"))) for row in rows)
    return TextTable("undamaged, m", ("error", "NEES"), body)


def finding_lines(rows: Sequence[DrillRow]) -> list[tuple[str, str]]:
    """Return what the doctor says of each drill that it does not say of the log as it is."""
    lines = {row.drill.name: ", ".join(row.new_codes) or "nothing new" for row in worst_first(rows)}
    return [("doctor", f"{name}: {codes}") for name, codes in lines.items()]


def render(report: DrillReport, colour: bool = False) -> str:
    """Return the text for the terminal, in colour only on a terminal."""
    rows, usual = report.rows, report.usual
    blocks = [title(f"drills on {usual[0].log}", colour), pairs(context(usual)), "", aligned(usual_table(usual)), ""]
    blocks += [aligned(drill_table(rows)), "", pairs(finding_lines(rows))]
    if lines := _failures(rows):
        blocks += ["", pairs(lines)]
    blocks += ["", pairs([("note", LEGEND)]), "", title(filled(overall(rows)), colour)]
    return "\n".join(blocks)


def _failures(rows: Sequence[DrillRow]) -> list[tuple[str, str]]:
    return [("failed", f"{row.drill.name}, {row.runs.label}: {row.runs.fault}") for row in rows if row.runs.fault]


def page(report: DrillReport, figures: Sequence[Picture | Plot], made: RunProvenance) -> Page:
    """Return the page of drills with its figures, and how it was made."""
    rows, usual = report.rows, report.usual
    reported = (*finding_lines(rows), *_failures(rows), *notes(usual))
    sections = (
        PageSection("", (Labelled(tuple(context(usual))),)),
        PageSection("Errors", (usual_table(usual), drill_table(rows, None), LEGEND)),
        PageSection("Findings", (Labelled(reported),)),
        PageSection("Figures", tuple(figures)),
        provenance_section(made),
    )
    return Page(f"Drills on {usual[0].log}", overall(rows), sections)
