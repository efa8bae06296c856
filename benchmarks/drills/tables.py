"""The tables of docs/studies/drills.md. Metres."""

from collections.abc import Mapping, Sequence

import numpy as np

from usbldr.io.reports.markdown_report import markdown_table
from usbldr.io.reports.report_text import Table
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow, mean_response, worst_first
from usbldr_cli.tables.drill_table import number

BAD_RATIO = 1.5  # times the best other way: the goal for the default


def drills_by_filter(report: DrillReport) -> str:
    """Return filters x drills: the error of each way in metres, the worst drill on top, without faults last."""
    labels = [row.label for row in report.usual[:-1]]
    body: list[tuple[str, ...]] = []
    for rows in _by_drill(worst_first(report.rows)):
        cells = {row.runs.label: _error(row) for row in rows}
        named = rows[0].named_share
        last = (number(rows[0].raw.mean("mean_horizontal_m")), "" if named is None else f"{100 * named:.0f} %")
        body.append((rows[0].drill.name, *(cells[label] for label in labels), *last, ", ".join(rows[0].new_codes)))
    usual = [number(row.mean("mean_horizontal_m")) for row in report.usual]
    body.append(("no fault", *usual, "", ""))
    return markdown_table(Table("drill", (*labels, "raw USBL", "named", "new findings"), tuple(body)))


def _error(row: DrillRow) -> str:
    return "failed" if row.error_m is None else f"{number(row.error_m)} ({number(row.ratio)})"


def outages(report: DrillReport) -> str:
    """Return drift and time to re-acquire of the drills whose faults end."""
    labels = [row.label for row in report.usual[:-1]]
    body: list[tuple[str, ...]] = []
    for rows in _by_drill(worst_first(report.rows)):
        found = {row.runs.label: mean_response(row) for row in rows}
        if any(one["drift_m"] is not None for one in found.values()):
            body.append((rows[0].drill.name, *(_response(found[label]) for label in labels)))
    return markdown_table(Table("drill", tuple(labels), tuple(body)))


def _response(response: Mapping[str, float | None]) -> str:
    if response["drift_m"] is None:
        return ""
    back = "never" if response["reacquired_s"] is None else f"{response['reacquired_s']:.0f} s"
    share = response["reacquired_share"]
    return f"{number(response['drift_m'])}, {back}" + (f" ({100 * share:.0f} %)" if share and share < 1 else "")


def consistency(report: DrillReport) -> str:
    """Return the NEES of each way under each drill."""
    labels = [row.label for row in report.usual[:-1]]
    body: list[tuple[str, ...]] = []
    for rows in _by_drill(worst_first(report.rows)):
        cells = {row.runs.label: number(row.runs.mean("nees_mean")) for row in rows}
        body.append((rows[0].drill.name, *(cells[label] for label in labels)))
    body.append(("no fault", *(number(row.mean("nees_mean")) for row in report.usual[:-1])))
    return markdown_table(Table("NEES", tuple(labels), tuple(body)))


def summary(report: DrillReport, default: str) -> str:
    """Return how each way fares over all drills: its ratios, and against the best of the other ways."""
    body: list[tuple[str, ...]] = []
    groups = _by_drill(report.rows)
    for label in [row.label for row in report.usual[:-1]]:
        mine = {row.drill.name: row for row in report.rows if row.runs.label == label}
        ratios = [row.ratio for row in mine.values() if row.ratio is not None]
        against = [a for rows in groups if (a := _against_best(rows, label)) is not None]
        failed = sum(row.ratio is None for row in mine.values())
        body.append(
            (
                f"{label} (default)" if label == default else label,
                f"{np.median(ratios):.2f}" if ratios else "",
                f"{max(ratios):.2f}" if ratios else "",
                f"{np.median(against):.2f}" if against else "",
                f"{max(against):.2f}" if against else "",
                f"{sum(a > BAD_RATIO for a in against)} of {len(against)}",
                str(failed),
            )
        )
    heads = ("median ratio", "worst ratio", "median / best", "worst / best", f"over {BAD_RATIO:g}", "failed")
    return markdown_table(Table("way", heads, tuple(body)))


def _against_best(rows: Sequence[DrillRow], label: str) -> float | None:
    """Return the error of a way over that of the best other one."""
    errors = {row.runs.label: row.error_m for row in rows}
    own = errors.pop(label, None)
    others = [error for error in errors.values() if error]
    return own / min(others) if own is not None and others else None


def named(report: DrillReport) -> str:
    """Return in how many drills findings name every fault, and what is found on the log as it is."""
    firsts = [rows[0] for rows in _by_drill(report.rows)]
    shares = [row.named_share for row in firsts if row.named_share is not None]
    usual = sorted({code for one in firsts[0].examined_usual for code in one.findings})
    clean = ", ".join(f"`{code}`" for code in usual) or "nothing"
    half = sum(share >= 0.5 for share in shares)
    return f"Findings name every fault in {half} of {len(shares)} drills; without faults the doctor reports {clean}."


def _by_drill(rows: Sequence[DrillRow]) -> list[list[DrillRow]]:
    names = dict.fromkeys(row.drill.name for row in rows)
    return [[row for row in rows if row.drill.name == name] for name in names]
