"""The runs of drills: every method with and without the faults, on the same dives, and what the doctor finds."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from usbldr.filters.replay.methods import METHODS, track_name
from usbldr.io.drills.drill import UNDAMAGED, Drill, damaged, log_length_s
from usbldr.io.log import Log
from usbldr.io.reading.remote import local_log
from usbldr.io.session import is_simulated, open_log
from usbldr_cli.options.log_options import read_request
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.drill_rows import DrillReport, DrillRow
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.run_jobs import run_jobs
from usbldr_cli.runs.seed_table import ComparisonRow
from usbldr_cli.runs.workers import Executor, Job

RAW = "usbl"  # the method whose errors are those of the raw fixes


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

    def require_fitting(self) -> None:
        """Raise LogError or UsageError for a fault that cannot be put into the log, before any run."""
        log = self._opened()
        for drill in self.drills:
            damaged(log, drill, self.choices.seed)

    def _opened(self) -> Log:
        request = read_request(**self.selection)
        with local_log(self.log, request) as path:
            return open_log(path, request, self.choices.seed)

    def length_s(self) -> float:
        """Return the length of the log, seconds."""
        return log_length_s(self._opened())

    def seeds_of(self, drill: Drill, draws: bool) -> range:
        """Return the seeds of a cell: one if nothing in it depends on the seed."""
        count = self.seeds if draws or drill.draws or is_simulated(self.log) else 1
        return range(self.choices.seed, self.choices.seed + count)

    def job(self, drill: Drill, method: str | None, seed: int) -> Job:
        """Return one run of a method; None: let the doctor examine the log."""
        choices = replace(self.choices, seed=seed)
        return Job(self.log, method or RAW, choices, self.selection, drill=drill, examine=method is None)


def run_drills(plan: DrillPlan, where: Executor, store: Path) -> DrillReport:
    """Run a plan, and let the doctor examine every log; finished runs are kept in ``store``, an existing folder."""
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

    length_s, examined = plan.length_s(), {drill: tuple(found[drill, None]) for drill in (UNDAMAGED, *plan.drills)}
    usual = {method: runs(UNDAMAGED, method) for method in methods}
    rows: list[DrillRow] = []
    for drill in plan.drills:
        of_drill = runs(drill, RAW), examined[drill], examined[UNDAMAGED], drill.spans_s(length_s)
        rows += [DrillRow(drill, runs(drill, method), usual[method], *of_drill) for method in plan.methods]
    return DrillReport(tuple(usual.values()), tuple(rows))
