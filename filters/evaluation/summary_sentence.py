"""The last line of a report: the mean horizontal error, compared with tracks that need no filter."""

from collections.abc import Callable, Sequence

from usbldr.filters.evaluation.error_report import ErrorReport

TRACK_LABELS = {"usbl": "raw USBL", "dr": "DR", "nudge": "nudged DR"}


def summary_sentence(report: ErrorReport, others: Sequence[ErrorReport] = ()) -> str:
    """Return a line such as "cpf: mean horizontal error 0.69 m, 31 % better than raw USBL, 70 % better than DR".

    A constant shift that makes up most of the error stands apart; no track is judged against a place that is unknown.
    If few epochs have a truth, the line says how many.
    """
    if not report.judged:
        return (
            f"{report.label}: no verdict: the place of the truth on the map of the fixes is not stated; state "
            "origin_lat_deg and origin_lon_deg under [map], or use --align shift"
        )
    others = [other for other in others if other.label != report.label]
    by_total = _compared(report, others, lambda one: one.horizontal.mean_m)
    matching = report.matching
    percent = 100 * matching.matched / max(matching.asked, 1)
    few = f", in the {percent:.0f} % of the epochs that have a truth" if matching.low else ""
    if report.alignment.name == "shift":
        return f"{report.label}: mean horizontal error, constant shift removed, {by_total}{few}"
    if report.mostly_shift:
        apart = f"; without a constant shift of {report.shift.length_m:.2f} m {{}}"
        by_total += apart.format(_compared(report, others, lambda one: one.shift.mean_m))
    return f"{report.label}: mean horizontal error {by_total}{few}"


def _compared(report: ErrorReport, others: Sequence[ErrorReport], error: Callable[[ErrorReport], float]) -> str:
    """Return an error of the report in metres, and how much better or worse it is than that of each other track."""
    own = error(report)
    parts = [f"{own:.2f} m"]
    for other in others:
        theirs = error(other)
        name = TRACK_LABELS.get(other.method, other.label)
        change = 100 * (1 - own / theirs) if theirs > 0 else (0.0 if own == 0 else -float("inf"))
        if abs(change) < 0.5:
            parts.append(f"equal to {name}")
            continue
        word = "better" if change > 0 else "worse"
        size = f"{abs(change):.0f} %" if abs(change) < 200 else f"{own / theirs:.1f} times" if theirs > 0 else "far"
        parts.append(f"{size} {word} than {name}")
    return ", ".join(parts)
