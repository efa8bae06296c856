"""Runs side by side: one row for each method on each log, its numbers averaged over the seeds.

The names are those of report.json; ``<metric>_se`` is the standard error of a mean over seeds, ``<metric>_seed_median``
the median over seeds. The first row of a log is what the others of that log are compared with.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.evaluation.consistency import Nees, consistency_text
from usbldr.filters.evaluation.error_report import METRICS
from usbldr.filters.evaluation.metrics import by_name, declared
from usbldr.filters.evaluation.seed_statistics import (
    DIVERGED_SHARE,
    PairedDifference,
    average,
    diverged_share,
    mean_difference,
    paired_difference,
    pooled_nees,
    significant_among,
)
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.windows import windows_text
from usbldr_cli.runs.job_store import JobResult, ScoringContext, read_trace

BOUND = "bound"  # stands for a method in the row of the least error that any filter could have
DIVERGED_LIMIT = 0.5  # fixed: share of diverged runs from which the mean is not that of usual runs
ROUNDED_S = 1e-3  # fixed: times of TUM files, as seconds since 1970, are exact to less
MOST_NAMED = 20  # fixed: logs that the last line lists by name
MOST_SHOWN = 8  # [logs] whose tables and figures a person reads one by one
ALIKE = 5e-4  # fixed: half of the last digit that the table shows of an error; of a NEES, less than that
COMPARED = ("mean_abs_east_m", "mean_abs_north_m", "mean_horizontal_m")
"""The metrics whose difference to the first row is reported."""


@dataclass(frozen=True, slots=True)
class ComparisonRow:
    """One method on one log, a run for each seed."""

    log: str
    label: str  # the method, with more if two rows would have the same label
    method: str
    seeds: tuple[int, ...]
    outcomes: tuple[JobResult, ...]
    sampled: bool = False  # the method draws random numbers
    dives: bool = False  # each seed is a dive of its own
    varied: tuple[str, ...] = ()  # KEY=VALUE of --set for each key with several values

    @property
    def good(self) -> dict[int, JobResult]:
        """The outcomes that have numbers, by seed."""
        pairs = zip(self.seeds, self.outcomes, strict=True)
        return {seed: outcome for seed, outcome in pairs if outcome.fault is None}

    @property
    def fault(self) -> str | None:
        """The first sentence on why runs are missing."""
        return next((outcome.fault for outcome in self.outcomes if outcome.fault is not None), None)

    @property
    def scored_against(self) -> ScoringContext | None:
        """What the runs were measured against."""
        return next((outcome.scored_against for outcome in self.good.values()), None)

    def values(self, metric: str) -> dict[int, float]:
        """Return a metric by seed, without the runs to which it does not apply."""
        return {seed: o.metrics[metric] for seed, o in self.good.items() if metric in o.metrics}

    def mean(self, metric: str) -> float | None:
        """Return the mean over seeds."""
        values = list(self.values(metric).values())
        return average(values).mean if values else None


def difference(
    row: ComparisonRow, other: ComparisonRow, metric: str = "mean_horizontal_m", rows: Sequence[ComparisonRow] = ()
) -> PairedDifference | None:
    """Return row minus other over the seeds that both have; None if there are none.

    A deterministic method ran once on a file: that run is used for every seed. The difference of two single runs is
    that over their epochs if these are stored; it is significant among those of ``rows``, all against the other.
    """
    found = _over_epochs(row, other, metric)
    if found is None:
        return _over_seeds(row, other, metric)
    every = [_over_epochs(one, other, metric) for one in rows or (row,) if one is not other]
    known = [one.probability for one in every if one is not None and one.probability is not None]
    judged = None if found.probability is None else significant_among(found.probability, known)
    return found._replace(significant=judged)


def _over_epochs(row: ComparisonRow, other: ComparisonRow, metric: str) -> PairedDifference | None:
    """Return the difference over the epochs of a single run of each; None without traces, or if these are too short."""
    traces = [[one.trace for one in both.good.values()] for both in (row, other)]
    if metric not in COMPARED or any(len(one) != 1 for one in traces) or row.dives:
        return None
    ((mine,), (theirs,)) = traces
    if mine is None or theirs is None or (values := (row.values(metric), other.values(metric))) == ({}, {}):
        return None
    found = _trace_difference(mine, theirs, COMPARED.index(metric))
    means = [next(iter(one.values()), math.nan) for one in values]
    if found.se is None or not abs(found.mean - (means[0] - means[1])) <= found.se:  # of other parts of the dive
        return None
    return found._replace(mean=means[0] - means[1])


@cache
def _trace_difference(mine: Path, theirs: Path, axis: int) -> PairedDifference:
    """Return the difference of |east|, |north| or the horizontal error over the epochs that both traces have.

    Raw fixes have times of their own: each epoch of the shorter trace is paired with the nearest one of the other.
    """
    one, other = read_trace(mine), read_trace(theirs)
    sizes = [trace.horizontal_m if axis == 2 else np.abs(trace.error_m[:, axis]) for trace in (one, other)]
    short = int(len(one.time_s) > len(other.time_s))
    few_s, many_s = (one, other)[short].time_s, (other, one)[short].time_s
    nearest = np.rint(np.interp(few_s, many_s, np.arange(len(many_s)))).astype(np.intp)
    step_s = float(np.median(np.diff(many_s))) if len(many_s) > 1 else 0.0
    near = np.abs(many_s[nearest] - few_s) <= step_s / 2 + ROUNDED_S
    sizes[short], sizes[1 - short] = sizes[short][near], sizes[1 - short][nearest[near]]
    return mean_difference(sizes[0] - sizes[1])


def _over_seeds(row: ComparisonRow, other: ComparisonRow, metric: str) -> PairedDifference | None:
    mine, theirs = row.values(metric), other.values(metric)
    if not (row.dives or other.dives):
        seeds = sorted(set(mine) | set(theirs))
        mine, theirs = (_for_all(values, one.sampled, seeds) for values, one in ((mine, row), (theirs, other)))
    both = sorted(set(mine) & set(theirs))
    if not both:
        return None
    found = paired_difference([mine[seed] for seed in both], [theirs[seed] for seed in both])
    return found._replace(significant=None) if diverged(row) or diverged(other) else found


def diverged(row: ComparisonRow) -> bool:
    """Return whether half of several runs of a filter or more diverged, so that their mean says nothing."""
    values = list(row.values("mean_horizontal_m").values())
    filtered = row.method in METHODS and METHODS[row.method].is_filter  # dead reckoning drifts, and has not diverged
    return (row.sampled or (row.dives and filtered)) and len(values) > 1 and diverged_share(values) >= DIVERGED_LIMIT


def _for_all(values: dict[int, float], sampled: bool, seeds: list[int]) -> dict[int, float]:
    if sampled or len(values) != 1:
        return values
    return dict.fromkeys(seeds, next(iter(values.values())))


def row_metrics(row: ComparisonRow) -> dict[str, float | None]:
    """Return every metric of a row over its seeds; null if it does not apply."""
    reported = (name for outcome in row.good.values() for name in outcome.metrics)
    names = dict.fromkeys((*(metric.name for metric in METRICS), *reported))
    found: dict[str, float | None] = {}
    for name in names:
        values = list(row.values(name).values())
        if not values:
            found[name] = None
            continue
        mean, se, median = average(values)
        found[name] = mean
        if len(row.seeds) > 1:
            found[f"{name}_se"], found[f"{name}_seed_median"] = se, median
    if row.dives and (nees := row_nees(row)) is not None:
        found |= by_name(Nees, "", nees)
    if row.sampled and row.good:
        found[DIVERGED_SHARE.name] = diverged_share(list(row.values("mean_horizontal_m").values()))
    return found


def row_nees(row: ComparisonRow) -> Nees | None:
    """Return the mean NEES over the seeds: of dives with the bounds of all of them together; None if none has one."""
    reported = [list(row.values(metric.name).values()) for metric in declared(Nees, "").values()]
    if not all(reported):
        return None
    mean, _, _, independent = reported
    return pooled_nees(mean, independent) if row.dives else Nees(*(average(values).mean for values in reported))


def row_consistency(row: ComparisonRow) -> str:
    """Return whether the row is consistent, over- or under-confident."""
    judged = row.scored_against
    return consistency_text(row_nees(row), shift_removed=judged is not None and judged.align == "shift")


def records(rows: Sequence[ComparisonRow]) -> list[dict[str, Any]]:
    """Return each row with every number; differences are to the first row of its log that has numbers."""
    contents: list[dict[str, Any]] = []
    for group in grouped(rows).values():
        first = next((row for row in group if row.good), group[0])
        contents += [row_content(row, first, group) for row in group]
    return contents


def seed_records(rows: Sequence[ComparisonRow]) -> list[dict[str, Any]]:
    """Return each run with its metrics: a row for each log, filter and seed."""
    return [
        {"log": row.log, "filter": row.label, "seed": seed, "fault": run.fault, **run.metrics}
        for row in rows
        for seed, run in zip(row.seeds, row.outcomes, strict=True)
    ]


def row_content(row: ComparisonRow, first: ComparisonRow, rows: Sequence[ComparisonRow] = ()) -> dict[str, Any]:
    """Return a row for compare.json and compare.csv."""
    content: dict[str, Any] = {"log": row.log, "filter": row.label, "seeds": len(row.good), "fault": row.fault}
    content |= row_metrics(row) | {"consistency": row_consistency(row) or None}
    if row is first:
        return content
    content["difference_to"] = first.label
    for metric in COMPARED:
        found = difference(row, first, metric, rows)
        content[f"{metric}_difference"] = found and found.mean
        content[f"{metric}_difference_se"] = found and found.se
        content[f"{metric}_difference_significant"] = found and found.significant
    return content


def grouped(rows: Sequence[ComparisonRow]) -> dict[str, list[ComparisonRow]]:
    """Return the rows of each log."""
    groups: dict[str, list[ComparisonRow]] = {}
    for row in rows:
        groups.setdefault(row.log, []).append(row)
    return groups


def keys_without_effect(rows: Sequence[ComparisonRow]) -> list[str]:
    """Return the keys of --set whose values give every method of a log the same errors and the same NEES."""
    good = [row for row in rows if row.good]
    found: list[str] = []
    for k, text in enumerate(good[0].varied if good else ()):
        alike: dict[tuple[str, ...], list[list[float]]] = {}
        for row in good:
            others = (row.method, *row.varied[:k], *row.varied[k + 1 :])
            alike.setdefault(others, []).append([row.mean(name) or 0.0 for name in (*COMPARED, "nees_mean")])
        if all(len(means) > 1 and np.max(np.ptp(means, axis=0)) < ALIKE for means in alike.values()):
            found.append(text.partition("=")[0])
    return found


def many_logs(rows: Sequence[ComparisonRow]) -> bool:
    """Return whether a comparison is shown as a whole, in a line for each log, instead of log by log."""
    return len(grouped(rows)) > MOST_SHOWN


def require_comparable(rows: Sequence[ComparisonRow]) -> None:
    """Raise UsageError if rows of one log were scored against different truths, windows, alignments or aids."""
    for log, group in grouped(rows).items():
        contexts = [(row.label, *_measure(row.scored_against)) for row in group if row.scored_against is not None]
        for label, *measure in contexts[1:]:
            for what, one, other in zip(("truth", "window", "alignment", "aid"), contexts[0][1:], measure, strict=True):
                if one != other:
                    raise UsageError(
                        f"{log}: the runs cannot be compared: {contexts[0][0]} has {what} {one}, {label} has {other}; "
                        "run them with the same --truth, --start, --end, --align and --aid"
                    )


def _measure(judged: ScoringContext) -> tuple[str, str, str, str]:
    start = "start" if judged.window_start_s is None else f"{judged.window_start_s:g} s"
    end = "end" if judged.window_end_s is None else f"{judged.window_end_s:g} s"
    return (
        f"{judged.truth_kind} {judged.truth_source}",
        f"{start} to {end}",
        judged.align,
        windows_text(judged.aid) if judged.aid else "none",
    )


def _ranked(rows: Sequence[ComparisonRow]) -> list[ComparisonRow]:
    """Return the methods, the lowest mean first and those that diverged last."""
    methods = [row for row in rows if row.good and row.method != BOUND]
    return sorted(methods, key=lambda row: (diverged(row), row.mean("mean_horizontal_m") or 0.0))


def best_method_sentence(rows: Sequence[ComparisonRow]) -> str:
    """Return which row of a log has the lowest mean, and by how much."""
    ranked = _ranked(rows)
    if not ranked:
        return f"{rows[0].log}: no run succeeded"
    best, *others = ranked
    own = best.mean("mean_horizontal_m") or 0.0
    over = f" over {len(best.seeds)} {'dives' if best.dives else 'seeds'}" if len(best.seeds) > 1 else ""
    if not others:
        return f"{best.log}: mean horizontal error of {best.label} {own:.2f} m{over}"
    kinds: dict[str, list[str]] = {}
    for row in others:
        kinds.setdefault(_compared_with_best(row, best, own, ranked), []).append(row.label)
    parts = [text.format(_listed(labels)) for text, labels in kinds.items()]
    return f"{best.log}: lowest mean horizontal error: {best.label}, {own:.2f} m{over}; {'; '.join(parts)}"


def _compared_with_best(row: ComparisonRow, best: ComparisonRow, own_m: float, rows: Sequence[ComparisonRow]) -> str:
    """Return how a row compares with the best one of ``rows``, with a place for its label."""
    drifts = row.method == "dr"  # over one dive: epochs of a drift say nothing about another dive
    found = _over_seeds(row, best, "mean_horizontal_m") if drifts else difference(row, best, rows=rows)
    if diverged(row):
        return "{} diverged"
    if found is not None and found.se is not None and found.significant is not True:
        return "difference to {} not significant" if found.significant is False else "too few runs to judge {}"
    theirs_m = row.mean("mean_horizontal_m") or 0.0
    percent = 100 * (1 - own_m / theirs_m) if theirs_m > 0 else 0.0
    return f"{percent:.0f} % below {{}}" if percent >= 0.5 else "equal to {}"


def _listed(labels: Sequence[str]) -> str:
    return labels[0] if len(labels) == 1 else f"{', '.join(labels[:-1])} and {labels[-1]}"


def overall(rows: Sequence[ComparisonRow]) -> str:
    """Return the last line: the best method on one log, or on how many logs each was best."""
    groups = grouped(rows)
    if len(groups) == 1:
        return best_method_sentence(rows)
    best: dict[str, list[str]] = {}
    for log, group in groups.items():
        for winner in _ranked(group)[:1]:
            best.setdefault(winner.label, []).append(log)
    order = sorted(best.items(), key=lambda item: -len(item[1]))
    texts = [
        f"{label} on {len(logs)} of {len(groups)} logs" + (f" ({', '.join(logs)})" if len(groups) <= MOST_NAMED else "")
        for label, logs in order
    ]
    return f"lowest mean horizontal error: {'; '.join(texts)}" if texts else "no run succeeded"
