"""The one sentence that a table ends in: how good, and how much better than doing without."""

from collections.abc import Sequence

from usbldr.filters.evaluation.error_report import ErrorReport

TRACK_LABELS = {"usbl": "the raw USBL", "dr": "DR", "nudge": "the nudged DR"}


def summary_sentence(report: ErrorReport, others: Sequence[ErrorReport] = ()) -> str:
    """Say the mean horizontal error and compare it: "cpf 0.69 m: 31 % better than the raw USBL, 70 % than DR"."""
    own = report.horizontal.mean_m
    said = f"{report.label} {own:.2f} m"
    parts: list[str] = []
    word_before = ""
    for other in others:
        if other.label == report.label:
            continue
        theirs = other.horizontal.mean_m
        name = TRACK_LABELS.get(other.method, other.label)
        change = 100 * (1 - own / theirs) if theirs > 0 else (0.0 if own == 0 else -float("inf"))
        if abs(change) < 0.5:
            parts.append(f"equal to {name}")
            word_before = ""
            continue
        word = "better" if change > 0 else "worse"
        size = f"{abs(change):.0f} %" if abs(change) < 200 else f"{own / theirs:.1f} times" if theirs > 0 else "far"
        parts.append(f"{size} than {name}" if word == word_before else f"{size} {word} than {name}")
        word_before = word
    return f"{said}: {', '.join(parts)}" if parts else f"{said} mean horizontal error"
