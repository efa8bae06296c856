"""The terminal's table of one run: plain text within 100 columns, in metres and seconds."""

import textwrap
from collections.abc import Sequence

from usbldr.filters.replay.methods import METHODS
from usbldr.io.reports.health_text import health_lines
from usbldr.io.reports.report_text import (
    TextTable,
    context,
    error_table,
    leave_one_out_table,
    method_table,
    relative_table,
)
from usbldr.io.reports.run import Run

WIDTH = 100  # [columns] of a usual terminal window
LABEL = 13  # [columns] of the longest label and a gap


def render(run: Run, colour: bool = False) -> str:
    """Return the whole table, in colour only on a terminal."""
    blocks = [title(f"{run.label} on {run.log.path.name}", colour), pairs(context(run))]
    if run.scored.report is not None:
        blocks += ["", aligned(error_table(run.scored.report)), "", aligned(method_table(run))]
    if run.method not in METHODS and run.scored.report is not None and run.scored.report.relative:
        blocks += ["", aligned(relative_table(run.scored.report))]
    if lines := health_lines(run):
        blocks += ["", pairs(lines)]
    if run.without_fixes:
        blocks += ["", aligned(leave_one_out_table(run))]
    if run.warnings:
        blocks += ["", *(wrap_labelled("warning", text) for text in run.warnings)]
    blocks += ["", title(run.verdict, colour)]
    return "\n".join(blocks)


def aligned(table: TextTable) -> str:
    """Return a table as text: labels to the left, numbers to the right."""
    lines = [(table.title, *table.heads), *table.rows]
    label = max(LABEL, *(len(line[0]) + 1 for line in lines))
    widths = [max(len(line[k]) for line in lines) + 2 for k in range(1, len(lines[0]))]
    texts = [
        line[0].ljust(label) + "".join(cell.rjust(width) for cell, width in zip(line[1:], widths, strict=True))
        for line in lines
    ]
    return "\n".join(line.rstrip() for line in texts)


def pairs(lines: Sequence[tuple[str, str]]) -> str:
    """Return labelled sentences, wrapped with a hanging indent."""
    return "\n".join(wrap_labelled(label, text) for label, text in lines)


def wrap_labelled(label: str, text: str) -> str:
    """Return one labelled sentence, wrapped with a hanging indent."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=label.ljust(LABEL - 1) + " ",
        subsequent_indent=" " * LABEL,
        break_long_words=False,
        break_on_hyphens=False,
    )


def title(text: str, colour: bool) -> str:
    """Return a line in bold, if in colour."""
    return f"\x1b[1m{text}\x1b[0m" if colour else text
