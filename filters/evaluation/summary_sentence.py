"""The last line of a report: the mean horizontal error, compared with tracks that need no filter."""

from collections.abc import Sequence

import numpy as np

from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.seed_statistics import mean_difference
from usbldr.filters.types import Mask

FEW_COMMON = 5  # [epochs] with fewer, means of two tracks do not compare
NEAR_S = 1.0  # [s] an epoch so near to one of the other track is common to both: the usual grid of errors
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
    by_total = _compared(report, others, shifted=False)
    matching = report.matching
    percent = 100 * matching.matched / max(matching.asked, 1)
    few = f", in the {percent:.0f} % of the epochs that have a truth" if matching.low else ""
    if report.alignment.name == "shift":
        return f"{report.label}: mean horizontal error, constant shift removed, {by_total}{few}"
    if report.mostly_shift:
        apart = f"; without a constant shift of {report.shift.length_m:.2f} m {{}}"
        by_total += apart.format(_compared(report, others, shifted=True))
    return f"{report.label}: mean horizontal error {by_total}{few}"


def _compared(report: ErrorReport, others: Sequence[ErrorReport], shifted: bool) -> str:
    """Return the mean error in metres, and how much better or worse it is than that of each other track.

    Both means are over the time that both tracks have errors in; ``shifted`` errors are without their constant shift.
    """
    parts = [f"{report.shift.mean_m if shifted else report.horizontal.mean_m:.2f} m"]
    for other in others:
        name = TRACK_LABELS.get(other.method, other.label)
        mine, common = _common(report, other), _common(other, report)
        if min(mine.sum(), common.sum()) < FEW_COMMON:
            count = int(min(mine.sum(), common.sum()))
            parts.append(f"not comparable with {name} ({count or 'no'} common epoch{'' if count == 1 else 's'})")
            continue
        own, theirs = (_mean_m(one, rows, shifted) for one, rows in ((report, mine), (other, common)))
        change = 100 * (1 - own / theirs) if theirs > 0 else (0.0 if own == 0 else -float("inf"))
        if abs(change) < 0.5:
            parts.append(f"equal to {name}")
            continue
        word = "better" if change > 0 else "worse"
        size = f"{abs(change):.0f} %" if abs(change) < 200 else f"{own / theirs:.1f} times" if theirs > 0 else "far"
        chance = other.method == "usbl" and _by_chance(report, other, common, shifted)
        parts.append(f"{size} {word} than {name}{' (not significant)' if chance else ''}")
    return ", ".join(parts)


def _by_chance(report: ErrorReport, other: ErrorReport, common: Mask, shifted: bool) -> bool:
    """Return whether errors at the other track's epochs differ no more than chance explains; False if too few.

    Dead reckoning drifts, so that its difference from a filter is no stationary series.
    """
    nearest = np.rint(np.interp(other.time_s[common], report.time_s, np.arange(len(report.time_s)))).astype(np.intp)
    mine_m, theirs_m = (one.error_m - (one.error_m.mean(axis=0) if shifted else 0.0) for one in (report, other))
    return mean_difference(np.hypot(*mine_m[nearest].T) - np.hypot(*theirs_m[common].T)).significant is False


def _common(report: ErrorReport, other: ErrorReport) -> Mask:
    """Return which epochs of a report, (M,), lie near one of the other's, by the other's usual interval."""
    near_s = max(NEAR_S, float(np.median(np.diff(other.time_s)))) if len(other.time_s) > 1 else NEAR_S
    after = np.searchsorted(other.time_s, report.time_s).clip(1, max(len(other.time_s) - 1, 1))
    pairs_s = np.stack([other.time_s.take(after, mode="clip"), other.time_s[after - 1]])
    return np.min(np.abs(pairs_s - report.time_s), axis=0) <= near_s


def _mean_m(report: ErrorReport, rows: Mask, shifted: bool) -> float:
    if rows.all():
        return report.shift.mean_m if shifted else report.horizontal.mean_m
    error_m = report.error_m[rows] - (report.error_m.mean(axis=0) if shifted else 0.0)
    return float(np.hypot(*error_m.T).mean())
