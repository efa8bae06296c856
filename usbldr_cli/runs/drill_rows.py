"""Drills: every method with and without the faults, on the same dives, what the doctor finds, and a row for each.

``mean_horizontal_m`` and ``nees_mean`` are those of report.json; the other names are explained in docs/drills.md.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from usbldr.filters.evaluation.fault_response import FaultResponse, fault_response
from usbldr.filters.replay.methods import METHODS, track_name
from usbldr.filters.windows import TimeWindow
from usbldr.io.drills.drill import UNDAMAGED, Drill, damaged, is_named, log_length_s
from usbldr.io.reading.remote import local_log
from usbldr.io.session import is_simulated, open_log
from usbldr_cli.options.log_options import read_request
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.job_store import JobResult, read_trace
from usbldr_cli.runs.jobs import run_jobs
from usbldr_cli.runs.seed_table import ComparisonRow, row_metrics, row_nees
from usbldr_cli.runs.workers import Executor, Job

RAW = "usbl"  # the method whose errors are those of the raw fixes
ERROR = "mean_horizontal_m"
LISTS = ("faults", "findings", "warnings")  # of a row


@dataclass(frozen=True, slots=True)
class DrillPlan:
    """What is to be run: methods on a log, under each of the drills, over seeds."""

    log: str  # a file, a folder, or else a scenario
    drills: tuple[Drill, ...]
    methods: Sequence[str]
    seeds: int
    choices: RunChoices  # with the first seed
    selection: Mapping[str, Any]  # values of options.selection_options

    @property
    def request(self) -> dict[str, Any]:
        """The plan as drill.json states it."""
        drills = {drill.name: [fault.text for fault in drill.faults] for drill in self.drills}
        options = {"options": asdict(self.choices), "selection": dict(self.selection)}
        return {"log": self.log, "filters": list(self.methods), "seeds": self.seeds, "drills": drills, **options}

    def length_s(self) -> float:
        """Return the length of the log, seconds; raise LogError or UsageError if a fault cannot be put into it."""
        request = read_request(**self.selection)
        with local_log(self.log, request) as path:
            log = open_log(path, request, self.choices.seed)
        for drill in self.drills:
            damaged(log, drill, self.choices.seed)
        return log_length_s(log)

    def seeds_of(self, drill: Drill, draws: bool) -> range:
        """Return the seeds of a cell: one if nothing in it depends on the seed."""
        count = self.seeds if draws or drill.draws or is_simulated(self.log) else 1
        return range(self.choices.seed, self.choices.seed + count)

    def job(self, drill: Drill, method: str | None, seed: int) -> Job:
        """Return one run of a method; None: let the doctor examine the log."""
        choices = replace(self.choices, seed=seed)
        return Job(self.log, method or RAW, choices, self.selection, drill=drill, examine=method is None)


@dataclass(frozen=True, slots=True)
class DrillRow:
    """One filter under one drill, a run for each seed."""

    drill: Drill
    runs: ComparisonRow
    usual: ComparisonRow  # the same filter without the faults
    raw: ComparisonRow  # the raw fixes with the faults
    examined: tuple[JobResult, ...]  # findings with the faults, by seed
    examined_usual: tuple[JobResult, ...]
    spans_s: tuple[TimeWindow, ...]  # of the faults, seconds

    @property
    def error_m(self) -> float | None:
        """Mean horizontal error over seeds."""
        return self.runs.mean(ERROR)

    @property
    def ratio(self) -> float | None:
        """Error with the faults over error without them."""
        error_m, usual_m = self.error_m, self.usual.mean(ERROR)
        return error_m / usual_m if error_m is not None and usual_m else None

    @property
    def responses(self) -> list[FaultResponse]:
        """Drift and time to re-acquire of each seed; none if every fault lasts for the whole log."""
        found: list[FaultResponse] = []
        if not self.spans_s:
            return found
        whole = self.spans_s[0][0], max(end_s for _, end_s in self.spans_s)
        usual = self.usual.good
        for seed, outcome in self.runs.good.items():
            other = usual.get(seed) or next(iter(usual.values()), None)
            if other is None or outcome.trace is None or other.trace is None:
                continue
            mine, theirs = read_trace(outcome.trace), read_trace(other.trace)
            one = fault_response(mine.time_s, mine.error_m, theirs.time_s, theirs.error_m, whole)
            found += [] if one is None else [one]
        return found

    @property
    def codes(self) -> list[tuple[frozenset[str], frozenset[str]]]:
        """The codes of the findings of each damaged log, and of the same log as it is."""
        usual = self.examined_usual if len(self.examined_usual) > 1 else self.examined_usual * len(self.examined)
        pairs = zip(self.examined, usual, strict=False)
        return [(frozenset(found.findings), frozenset(clean.findings)) for found, clean in pairs]

    @property
    def new_codes(self) -> tuple[str, ...]:
        """The findings that are new in at least half of the damaged logs."""
        new = Counter(code for found, clean in self.codes for code in found - clean)
        return tuple(sorted(code for code, count in new.items() if 2 * count >= len(self.codes)))

    @property
    def named_share(self) -> float | None:
        """Share of the seeds in which findings name every fault; None if none of them can tell."""
        reported = [one for pair in self.codes if (one := is_named(self.drill, *pair)) is not None]
        return float(np.mean(reported)) if reported else None


@dataclass(frozen=True, slots=True)
class DrillReport:
    """Every method without faults, raw fixes last, and every row under faults."""

    usual: tuple[ComparisonRow, ...]
    rows: tuple[DrillRow, ...]


def run_drills(plan: DrillPlan, length_s: float, where: Executor, store: Path) -> DrillReport:
    """Run a plan on a log of a length, and let the doctor examine every log.

    Finished runs are kept in ``store``, an existing folder.
    """
    methods = tuple(dict.fromkeys((*plan.methods, RAW)))
    cells = {
        (drill, method): plan.seeds_of(drill, method is not None and METHODS[method].draws)
        for drill in (UNDAMAGED, *plan.drills)
        for method in (None, *methods)
    }
    # seed by seed, so that a dive is simulated once
    places = sorted(((seed, k) for k, seeds in enumerate(cells.values()) for seed in seeds), key=lambda at: at[0])
    keys = list(cells)
    results = run_jobs([plan.job(*keys[k], seed) for seed, k in places], where, store)
    found: defaultdict[tuple[Drill, str | None], list[JobResult]] = defaultdict(list)
    for (_, k), result in zip(places, results, strict=True):
        found[keys[k]].append(result)

    def runs(drill: Drill, method: str) -> ComparisonRow:
        draws, dives = METHODS[method].draws, is_simulated(plan.log)
        label, seeds = track_name(method, plan.choices.smooth), tuple(cells[drill, method])
        return ComparisonRow(Path(plan.log).name, label, method, seeds, tuple(found[drill, method]), draws, dives)

    examined = {drill: tuple(found[drill, None]) for drill in (UNDAMAGED, *plan.drills)}
    usual = {method: runs(UNDAMAGED, method) for method in methods}
    rows: list[DrillRow] = []
    for drill in plan.drills:
        of_drill = runs(drill, RAW), examined[drill], examined[UNDAMAGED], drill.spans_s(length_s)
        rows += [DrillRow(drill, runs(drill, method), usual[method], *of_drill) for method in plan.methods]
    return DrillReport(tuple(usual.values()), tuple(rows))


def worst_first(rows: Sequence[DrillRow]) -> list[DrillRow]:
    """Return the rows drill by drill, the drill with the largest ratio first; a failed run is worst of all."""

    def worst(drill: str) -> float:
        ratios = [row.ratio for row in rows if row.drill.name == drill]
        return max((float("inf") if ratio is None else ratio for ratio in ratios), default=0.0)

    names = list(dict.fromkeys(row.drill.name for row in rows))
    order = sorted(names, key=lambda name: -worst(name))
    return sorted(rows, key=lambda row: order.index(row.drill.name))


def mean_response(row: DrillRow) -> Mapping[str, float | None]:
    """Return drift and time to re-acquire over the seeds, and the share of the seeds that did re-acquire."""
    found = row.responses
    back = [one.reacquired_s for one in found if one.reacquired_s is not None]
    return {
        "drift_m": float(np.mean([one.drift_m for one in found])) if found else None,
        "reacquired_s": float(np.mean(back)) if back else None,
        "reacquired_share": len(back) / len(found) if found else None,
    }


def row_content(row: DrillRow) -> dict[str, Any]:
    """Return a row for drill.json and drill.csv."""
    metrics = row_metrics(row.runs)
    nees = row_nees(row.runs)
    return {
        "drill": row.drill.name,
        "faults": [fault.text for fault in row.drill.faults],
        "filter": row.runs.label,
        "seeds": len(row.runs.good),
        "failure": row.runs.fault,
        ERROR: row.error_m,
        f"{ERROR}_se": metrics.get(f"{ERROR}_se"),
        "undamaged_m": row.usual.mean(ERROR),
        "ratio": row.ratio,
        **mean_response(row),
        "nees_mean": nees.mean if nees is not None else None,
        "raw_usbl_m": row.raw.mean(ERROR),
        "findings": list(row.new_codes),
        "named_share": row.named_share,
        "warnings": list(dict.fromkeys(text for one in row.runs.good.values() for text in one.warnings)),
    }


def content(report: DrillReport) -> dict[str, Any]:
    """Return the numbers of drill.json: the rows, worst drill first, and the metrics without faults."""
    usual = [{"filter": row.label, "seeds": len(row.good), **row_metrics(row)} for row in report.usual]
    return {"undamaged": usual, "rows": [row_content(row) for row in worst_first(report.rows)]}


def records(report: DrillReport) -> list[dict[str, Any]]:
    """Return the rows of drill.csv."""
    rows = content(report)["rows"]
    return [row | {name: "; ".join(row[name]) for name in LISTS} for row in rows]


def overall(rows: Sequence[DrillRow]) -> str:
    """Return the last line: each filter's worst drill, and the median of its ratios."""
    texts: list[str] = []
    for label in dict.fromkeys(row.runs.label for row in rows):
        mine = [(row, row.ratio) for row in rows if row.runs.label == label and row.ratio is not None]
        failed = sum(row.ratio is None for row in rows if row.runs.label == label)
        if mine:
            worst, ratio = max(mine, key=lambda item: item[1])
            text = f"{label}: {ratio:.3g} times its undamaged error under {worst.drill.name!r}"
            if len(mine) > 1:
                text += f", median {np.median([r for _, r in mine]):.3g} of {len(mine)} drills"
            texts.append(text + (f", {failed} failed" if failed else ""))
    return "; ".join(texts) or "no run succeeded"
