"""The tables of a comparison: for the terminal within 100 columns, as Markdown, LaTeX, CSV rows. Metres and seconds."""

import re
import textwrap
from collections.abc import Sequence

from usbldr.filters.errors import printable
from usbldr.filters.evaluation.error_report import Window
from usbldr.io.reports.page import Block, Page, PageSection, Picture, Plot, labelled
from usbldr.io.reports.report_text import ORDERS, TRUTHS, TextTable, aid_text, window_text
from usbldr.io.reports.run_page import provenance_section
from usbldr.io.reports.run_provenance import RunProvenance
from usbldr_cli.runs.seed_table import (
    BOUND,
    ComparisonRow,
    best_method_sentence,
    difference,
    grouped,
    keys_without_effect,
    many_logs,
    overall,
    row_consistency,
    row_metrics,
)
from usbldr_cli.tables.run_table import WIDTH, aligned, pairs, title

NAME_LETTERS = 40  # of a log in a line of many
HUGE = 1e5  # shown in scientific notation
LEGEND = (
    "± is a standard error, * marks a significant difference (95 %): of several seeds, paired by seed (Student's t, at "
    "least 3 seeds); of single runs that --output keeps, paired by epoch (moving-block bootstrap, Holm's correction "
    "for several filters); diverged: share of seeds with a mean horizontal error above 5 m."
)
NO_EFFECT = (
    "all values of --set {} give the same errors: estimates from the log replace it (--calibrate none uses the stated "
    "values), or nothing here depends on it"
)
SPECIAL = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "|": "$|$",
        "±": r"$\pm$",
    }
)


def error_table(rows: Sequence[ComparisonRow]) -> TextTable:
    """Return the errors of a log's rows, each with its difference to the first."""
    first = rows[0]
    columns = {"|east|": "mean_abs_east_m", "|north|": "mean_abs_north_m", "horizontal": "mean_horizontal_m"}
    if any(row.method == BOUND for row in rows):
        columns["rmse"] = "rmse_horizontal_m"
    heads = (*columns, "CEP95", f"minus {first.label}")
    body = tuple(
        (
            row.label,
            *(_mean_se(row, metric) for metric in columns.values()),
            _number(row, "p95_horizontal_m"),
            "" if row is first else _against(row, first, rows),
        )
        for row in rows
        if row.good
    )
    return TextTable("mean error, m", heads, body)


def health_table(rows: Sequence[ComparisonRow]) -> TextTable:
    """Return runs, medians, divergence, consistency and cost of a log's rows; empty columns are left out."""
    heads = ("runs", "median horiz.", "diverged", "ESS", "NEES", "sigmas", "time")
    body: list[tuple[str, ...]] = []
    for row in rows:
        if not row.good or row.method == BOUND:
            continue
        metrics = row_metrics(row)
        share, ess = metrics.get("diverged_share"), metrics["ess_mean_ratio"]
        times_s = [one.filter_time_s for one in row.good.values() if one.filter_time_s is not None]
        body.append(
            (
                row.label,
                str(len(row.good)),
                f"{metrics['mean_horizontal_m_seed_median']:.3f}" if row.sampled and len(row.seeds) > 1 else "",
                f"{100 * share:.0f} %" if share is not None else "",
                f"{100 * ess:.0f} %" if ess is not None else "",
                _number(row, "nees_mean", 2),
                row_consistency(row).removeprefix("sigmas "),
                f"{sum(times_s) / len(times_s):.1f} s" if times_s else "",
            )
        )
    columns = [k for k in range(len(heads) + 1) if k == 0 or any(line[k] for line in body)]
    rows_shown = tuple(tuple(line[k] for k in columns) for line in body)
    return TextTable("per run", tuple(heads[k - 1] for k in columns[1:]), rows_shown)


def context(rows: Sequence[ComparisonRow]) -> list[tuple[str, str]]:
    """Return what the numbers of a log depend on."""
    judged = next((row.scored_against for row in rows if row.scored_against is not None), None)
    if judged is None:
        return []
    lines = [("log", f"{judged.log} ({judged.log_format})")]
    if judged.configuration:
        lines.append(("settings", judged.configuration))
    lines.append(("truth", f"{TRUTHS.get(judged.truth_kind, judged.truth_kind)}: {judged.truth_source}"))
    if judged.window != Window():
        lines.append(("window", window_text(judged.window)))
    if judged.aid:
        lines.append(("aid", aid_text(judged.aid)))
    orders = {row.label: ORDERS[row.scored_against.order] for row in rows if row.scored_against is not None}
    alike = len(set(orders.values())) == 1
    lines.append(("fixes", ORDERS[judged.order] if alike else "; ".join(f"{k}: {v}" for k, v in orders.items())))
    lines.append(("alignment", judged.align))
    if any(row.dives for row in rows):
        lines.append(("seeds", "each seed simulates its own dive and seeds the filter"))
    elif any(len(row.seeds) > 1 for row in rows):
        lines.append(("seeds", "the same dive for each seed: ± is the scatter of the particle filter only"))
    covered = {f"{100 * share:.0f} %" for row in rows if (share := row.mean("coverage")) is not None}
    lines.append(("compared", f"{' or '.join(sorted(covered))} of the epochs have truth"))
    return lines


def notes(rows: Sequence[ComparisonRow]) -> list[tuple[str, str]]:
    """Return faults and warnings, each once for a filter: of runs that differ in numbers alone, the first one's."""
    lines: list[tuple[str, str]] = []
    for row in rows:
        lost = len(row.seeds) - len(row.good)
        if row.fault is not None:
            share = f"{lost} of {len(row.seeds)} runs failed: " if len(row.seeds) > 1 else "failed: "
            lines.append((row.label, share + row.fault))
        if row.scored_against is not None:
            lines += [("lost", text) for text in row.scored_against.lost]
        texts = [text for outcome in row.good.values() for text in outcome.warnings]
        alike: dict[str, list[str]] = {}
        for text in texts:
            alike.setdefault(re.sub(r"[-+]?\d+(\.\d+)?", "#", text), []).append(text)
        for text, *others in alike.values():
            more = ", numbers of the first" if any(other != text for other in others) else ""
            count = f" ({1 + len(others)} of {len(row.seeds)} runs{more})" if len(row.seeds) > 1 else ""
            of_row = text if row.label in text else f"{row.label}: {text.removeprefix(f'{row.method}: ')}"
            lines.append(("warning", of_row + count))
    lines += [("warning", NO_EFFECT.format(key)) for key in keys_without_effect(rows)]
    return list(dict.fromkeys(lines))


def render(rows: Sequence[ComparisonRow], colour: bool = False) -> str:
    """Return the text for the terminal, in colour only on a terminal."""
    if many_logs(rows):
        lines = short_notes(rows)
        more = [pairs(lines), ""] if lines else []
        return "\n".join([aligned(short_table(rows)), "", *more, title(filled(overall(rows)), colour)])
    blocks: list[str] = []
    groups = grouped(rows)
    for log, group in groups.items():
        blocks += [title(log, colour), pairs(context(group))] if context(group) else [title(log, colour)]
        if any(row.good for row in group):
            blocks += ["", aligned(error_table(_shown(group))), "", aligned(health_table(group))]
        if lines := notes(group):
            blocks += ["", pairs(lines)]
        blocks += ["", *([filled(best_method_sentence(group)), ""] if len(groups) > 1 else [])]
    return "\n".join([*blocks, pairs([("note", LEGEND)]), "", title(filled(overall(rows)), colour)])


def short_table(rows: Sequence[ComparisonRow]) -> TextTable:
    """Return the mean horizontal error of each method on each log, a line for each log."""
    labels = tuple(dict.fromkeys(row.label for row in rows))
    body: list[tuple[str, ...]] = []
    for log, group in grouped(rows).items():
        cells = {row.label: _number(row, "mean_horizontal_m") if row.good else "failed" for row in group}
        name = log if len(log) <= NAME_LETTERS else f"…{log[1 - NAME_LETTERS :]}"
        body.append((name, *(cells.get(label, "") for label in labels)))
    return TextTable("mean horizontal error, m", labels, tuple(body))


def short_notes(rows: Sequence[ComparisonRow]) -> list[tuple[str, str]]:
    """Return each fault with the logs that it concerns, and how many warnings there are."""
    faults: dict[str, list[str]] = {}
    for row in rows:
        if row.fault is not None:
            faults.setdefault(f"{row.label}: {row.fault}", []).append(row.log)
    lines = [("failed", f"{text} ({len(logs)} logs)" if len(logs) > 1 else text) for text, logs in faults.items()]
    warned = [
        log for log, group in grouped(rows).items() if any(label in ("warning", "lost") for label, _ in notes(group))
    ]
    if warned:
        lines.append(("note", f"{len(warned)} logs have warnings: compare.md of --output has them all"))
    return lines


def page(rows: Sequence[ComparisonRow], figures: Sequence[Picture | Plot], made: RunProvenance) -> Page:
    """Return the page of a comparison with its figures, and how it was made."""
    sections: list[PageSection] = []
    groups = grouped(rows)
    for log, group in groups.items():
        blocks: list[Block] = [*labelled(context(group))]
        if any(row.good for row in group):
            blocks += [error_table(_shown(group)), health_table(group)]
        blocks += labelled(notes(group))
        if len(groups) > 1:
            blocks.append(f"{best_method_sentence(group)}.")
        sections.append(PageSection(log, tuple(blocks)))
    sections.append(PageSection("Figures", tuple(figures)))
    sections.append(provenance_section(made))
    sections.append(
        PageSection("How to read this", (LEGEND, "Every number is in `compare.json` under its name in `report.json`."))
    )
    return Page("Comparison", overall(rows), tuple(sections))


def _shown(rows: Sequence[ComparisonRow]) -> list[ComparisonRow]:
    """Return the rows that have numbers; the others are compared with the first of them."""
    return [row for row in rows if row.good]


def _mean_se(row: ComparisonRow, metric: str) -> str:
    metrics = row_metrics(row)
    mean, se = metrics[metric], metrics.get(f"{metric}_se")
    if mean is None:
        return ""
    return f"{mean:.3f}" if se is None else f"{mean:.3f} ± {se:.3f}"


def _against(row: ComparisonRow, first: ComparisonRow, rows: Sequence[ComparisonRow]) -> str:
    found = difference(row, first, rows=rows)
    if found is None:
        return ""
    if found.se is None:
        return f"{found.mean:+z.3f}"
    return f"{found.mean:+z.3f} ± {found.se:.3f}{'*' if found.significant else ' '}"


def _number(row: ComparisonRow, metric: str, digits: int = 3) -> str:
    value = row.mean(metric)
    if value is None:
        return ""
    return f"{value:.{digits}f}" if abs(value) < HUGE else f"{value:.1e}"


def filled(text: str) -> str:
    """Wrap a sentence without separating numbers from units."""
    tied = re.sub(r"(?<=\d) (?=%|m\b)", "\xa0", text)
    return textwrap.fill(tied, WIDTH, break_long_words=False, break_on_hyphens=False).replace("\xa0", " ")


def latex(rows: Sequence[ComparisonRow]) -> str:
    """Return the errors of each log as a tabular; its lines need no more than \\usepackage{booktabs}."""
    logs = {log: [row for row in group if row.good] for log, group in grouped(rows).items()}
    return (
        "\n\n".join(f"% {printable(log)}\n{tabular(error_table(group))}" for log, group in logs.items() if group) + "\n"
    )


def tabular(table: TextTable) -> str:
    """Return a table as a LaTeX tabular: labels to the left, numbers to the right."""
    head, *body = ([_escaped(cell) for cell in line] for line in ((table.title, *table.heads), *table.rows))
    lines = [f"\\begin{{tabular}}{{l{'r' * (len(head) - 1)}}}", r"\toprule", f"{' & '.join(head)} \\\\", r"\midrule"]
    lines += [f"{' & '.join(cells)} \\\\" for cells in body]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _escaped(cell: str) -> str:
    return re.sub(r"^-(?=\d)", "$-$", cell.translate(SPECIAL))
