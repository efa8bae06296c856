"""The last line of a report: the mean horizontal error, compared with tracks that need no filter."""

from collections.abc import Sequence

from usbldr.filters.evaluation.error_report import ErrorReport

TRACK_LABELS = {"usbl": "raw USBL", "dr": "DR", "nudge": "nudged DR"}


def summary_sentence(report: ErrorReport, others: Sequence[ErrorReport] = ()) -> str:
    """Return a line such as "cpf: mean horizontal error 0.69 m, 31 % better than raw USBL, 70 % better than DR"."""
    own = report.horizontal.mean_m
    parts = [f"{report.label}: mean horizontal error {own:.2f} m"]
    for other in others:
        if other.label == report.label:
            continue
        theirs = other.horizontal.mean_m
        name = TRACK_LABELS.get(other.method, other.label)
        change = 100 * (1 - own / theirs) if theirs > 0 else (0.0 if own == 0 else -float("inf"))
        if abs(change) < 0.5:
            parts.append(f"equal to {name}")
            continue
        word = "better" if change > 0 else "worse"
        size = f"{abs(change):.0f} %" if abs(change) < 200 else f"{own / theirs:.1f} times" if theirs > 0 else "far"
        parts.append(f"{size} {word} than {name}")
    return ", ".join(parts)
