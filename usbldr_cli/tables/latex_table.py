"""Tables of a comparison for a paper: LaTeX with the package booktabs."""

import re
from collections.abc import Sequence

from usbldr.filters.errors import printable
from usbldr.io.reports.report_text import Table
from usbldr_cli.runs.seed_table import ComparisonRow, grouped
from usbldr_cli.tables.compare_table import error_table

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


def latex(rows: Sequence[ComparisonRow]) -> str:
    """Return the errors of each log as a tabular; its lines need no more than \\usepackage{booktabs}."""
    logs = {log: [row for row in group if row.good] for log, group in grouped(rows).items()}
    return (
        "\n\n".join(f"% {printable(log)}\n{tabular(error_table(group))}" for log, group in logs.items() if group) + "\n"
    )


def tabular(table: Table) -> str:
    """Return a table as a LaTeX tabular: labels to the left, numbers to the right."""
    head, *body = ([_escaped(cell) for cell in line] for line in ((table.title, *table.heads), *table.rows))
    lines = [f"\\begin{{tabular}}{{l{'r' * (len(head) - 1)}}}", r"\toprule", f"{' & '.join(head)} \\\\", r"\midrule"]
    lines += [f"{' & '.join(cells)} \\\\" for cells in body]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _escaped(cell: str) -> str:
    return re.sub(r"^-(?=\d)", "$-$", cell.translate(SPECIAL))
