"""report.md: the report of a run with tables, conventions, findings and figures."""

from collections.abc import Sequence
from pathlib import Path

from usbldr.filters.errors import printable
from usbldr.filters.replay.methods import METHODS
from usbldr.io.provenance import convention_text
from usbldr.io.reader import utc
from usbldr.io.reports.report_json import Run
from usbldr.io.reports.report_text import (
    INFLUENCE,
    LEAVE_ONE_OUT_NOTE,
    RELATIVE,
    Table,
    context,
    error_table,
    health_lines,
    influence_table,
    leave_one_out_table,
    method_table,
    order_text,
    relative_table,
)

Picture = tuple[str, str]  # file name, caption


def write_markdown(folder: Path, run: Run, pictures: Sequence[Picture]) -> None:
    """Write report.md, which links to the figures beside it."""
    parts = [
        f"# {plain(run.label)} on {plain(run.log.path.name)}",
        f"**{run.verdict}.**",
        labelled(context(run)),
    ]
    if run.scored.report is not None:
        parts += ["## Errors", markdown_table(error_table(run.scored.report)), markdown_table(method_table(run))]
    if run.scored.report is not None and run.scored.report.relative:
        parts += ["## Relative errors", RELATIVE, markdown_table(relative_table(run.scored.report))]
    if lines := health_lines(run):
        parts += ["## Health", labelled(lines)]
    if len((fixes := influence_table(run)).rows):
        parts += ["## Influential fixes", INFLUENCE, markdown_table(fixes)]
    if run.without_fixes:
        parts += ["## Fixes left out", LEAVE_ONE_OUT_NOTE, markdown_table(leave_one_out_table(run))]
    if run.warnings:
        parts += ["## Warnings", _bullets([plain(warning) for warning in run.warnings])]
    if pictures:
        parts += ["## Figures", *(f"{caption}:\n\n![{caption}]({name})" for name, caption in pictures)]
    parts += ["## How the log was read", _sensors(run)]
    if run.log.findings:
        parts += ["## Findings", _bullets([f"`{finding.code}` {plain(finding.text)}" for finding in run.log.findings])]
    parts += ["## How to read this", _bullets(_definitions(run))]
    (folder / "report.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _sensors(run: Run) -> str:
    rows = tuple(
        (
            role,
            f"`{p.topic.replace('`', '')}`",
            p.type,
            f"{p.used} of {p.messages}",
            p.chosen_by,
            "; ".join(map(convention_text, p.conventions)),
        )
        for role, p in run.log.provenance.items()
    )
    heads = ("topic", "type", "records used", "chosen by", "conventions")
    origin = run.log.origin
    place = "unknown, so there are no latitudes and longitudes"
    if origin is not None:
        place = f"{origin.lat_deg:.9f} N, {origin.lon_deg:.9f} E ({origin.source})"
    facts = [("start", utc(run.log.start_ns)), ("origin", place), ("sha256", run.log.sha256)]
    return f"{markdown_table(Table('sensor', heads, rows), numbers=False)}\n\n{labelled(facts)}"


def _definitions(run: Run) -> list[str]:
    lines = [
        "Errors are estimate minus truth; truth is interpolated linearly to the times of the track, but not across "
        "its long gaps.",
        "Mean, median, std, min, max and p95 of east and north are of the absolute error; bias is the mean signed "
        "error. CEP50 and CEP95 are the median and the 95th percentile of the horizontal error.",
        "NEES is the squared error normalised by the filter's covariance (plus that of the truth, if known). Its "
        "bounds use the effective number of independent errors, because successive errors are correlated.",
        "`track_*.csv` is the track as the filter estimated it; `errors_*.csv`, `track.tum` and `truth.tum` are what "
        "was scored, after the alignment.",
        "Every number here is in `report.json` under its own name.",
    ]
    if run.method not in METHODS:
        lines.append("The track was computed elsewhere; usbldr only judges it.")
    elif run.order == "validity":
        lines.append("Fixes were used at their time of validity, as in post-processing; a vehicle receives them later.")
    else:
        lines.append(f"Fixes were {order_text(run)}.")
    return lines


def markdown_table(table: Table, numbers: bool = True) -> str:
    """Return a table as Markdown, with columns of numbers to the right."""
    rows = [(table.title, *table.heads), *table.rows]
    lines = [[plain(cell).replace("|", r"\|").replace("*", r"\*") for cell in row] for row in rows]
    lines.insert(1, ["---", *("---:" if numbers else "---" for _ in table.heads)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def plain(text: str) -> str:
    """Return a text that shows as it is: names in a log may hold HTML, links, or characters that steer a terminal."""
    return printable(text).replace("<", "&lt;").replace("](", r"]\(")


def labelled(lines: Sequence[tuple[str, str]]) -> str:
    """Return labelled sentences as a list."""
    return _bullets([f"**{label}**: {plain(text)}" for label, text in lines])


def _bullets(lines: Sequence[str]) -> str:
    return "\n".join(f"* {line}" for line in lines)
