"""How the runs of field.md are made: on any executor, and each is kept when it is done.

A run is judged by each of its log's definitions.
"""

import functools
import hashlib
import math
import pickle
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

from field.changes import CHANGES, constants
from field.logs import CASES, Case, Dive, dive, truth_for
from field.plan import Cell, Plan, Rows
from paper.runs import Way
from usbldr.filters.errors import UsbldrError
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.calibration import STATES, estimated_errors
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Timeline, Trajectory
from usbldr.io.session import replay, resolve
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.job_store import JobResult, JobStore, ScoringContext, Trace
from usbldr_cli.runs.jobs import FinishedJob, relevant_choices
from usbldr_cli.runs.seed_table import ComparisonRow
from usbldr_cli.runs.workers import Executor

Task: TypeAlias = tuple[Cell, int, Path]  # what runs, its seed, and the folder of the logs


def run_plan(wanted: Plan, where: Executor, store: Path, folder: Path) -> Rows:
    """Run what is not there yet and return every row. A fault of a run is a sentence in its row and stops no other."""
    tasks = [(cell, seed, folder.absolute()) for cell, count in wanted.items() for seed in range(count)]
    tasks.sort(key=lambda task: (task[0].case, task[1]))  # runs on one dive follow each other and read it once
    kept = JobStore(store)
    stored = kept.read_all()
    results: dict[tuple[Cell, int], list[JobResult]] = {}
    for done, (place, found) in enumerate(where.finished(run_task, tasks, frozenset(stored)), 1):
        results[tasks[place][:2]] = [
            stored[str(one.key)] if one.outcome is None else _written(kept, one.outcome, one) for one in found
        ]
        if done % 50 == 0:
            print(f"{done} of {len(tasks)} runs", flush=True)
    rows: dict[tuple[str, Way, str], ComparisonRow] = {}
    for cell, group in groupby(sorted(results, key=lambda task: (repr(task[0]), task[1])), key=lambda task: task[0]):
        seeds = [seed for _, seed in group]
        case, method = CASES[cell.case], cell.way.method
        for k, name in enumerate(case.scored):
            outcomes = tuple(results[cell, seed][k] for seed in seeds)
            row = ComparisonRow(
                name, cell.way.label, method, tuple(seeds), outcomes, METHODS[method].draws, not case.folder
            )
            rows[name, cell.way, cell.change] = row
    return rows


def _written(kept: JobStore, outcome: JobResult, one: FinishedJob) -> JobResult:
    return outcome if one.key is None else kept.write(one.key, outcome, one.trace)


def run_task(task: Task, stored: frozenset[str]) -> list[FinishedJob]:
    """Make one run, unless its results are among those stored; one result for each definition of the case."""
    cell, seed, folder = task
    case = CASES[cell.case]
    try:
        given = dive(cell.case, seed, folder)
        key = _key(given, cell, seed)
        names = [f"{key}{definition.name}" for definition in case.definitions]
        if stored.issuperset(names):
            return [FinishedJob(None, key=name) for name in names]
        line, found = resolved_input(cell, seed, given, folder)
        with constants(CHANGES[cell.change].constants):
            made = replay(given.log, line, cell.way.method, _choices(cell, seed).settings(), found)
        return [FinishedJob(*_judged(case, k, made, given, line, found), name) for k, name in enumerate(names)]
    except UsbldrError as fault:
        return [FinishedJob(JobResult(fault=str(fault), exit_code=fault.exit_code))] * len(case.definitions)


def resolved_input(cell: Cell, seed: int, given: Dive, folder: Path) -> tuple[Timeline, Identification]:
    """Return records and identification of a cell: those of the log with the cell's change."""
    change = CHANGES[cell.change]
    line = change.records(given.line)
    found = identified_once(cell.case, cell.change, cell.way.calibrate, seed, folder)
    return line, replace(found, parameters=change.after(found.parameters, line))


@functools.lru_cache(maxsize=8)
def identified_once(name: str, changed: str, calibrate: str, seed: int, folder: Path) -> Identification:
    """Identify once for all filters: what a log has evidence for does not depend on the filter that is run."""
    given, change = dive(name, seed, folder), CHANGES[changed]
    line = change.records(given.line)
    before = replace(given.log, parameters=change.before(given.log.parameters, line))
    way = Way("adf", calibrate)
    with constants(change.constants):
        return resolve(before, line, way.method, _choices(Cell(name, way, changed), seed).settings())


def _choices(cell: Cell, seed: int) -> RunChoices:
    options = {"calibrate": cell.way.calibrate, **CHANGES[cell.change].options}
    return replace(relevant_choices(cell.way.method, cell.way.choices(seed)), **options)


def _judged(
    case: Case, k: int, made: Trajectory, given: Dive, line: Timeline, found: Identification
) -> tuple[JobResult, Trace]:
    definition = case.definitions[k]
    times_s = None if made.method == "usbl" else line.time_s[line.slow]
    report = evaluate(made, truth_for(definition, given), definition.window, definition.align, times_s)
    metrics = report.flat() | refusals(made)
    for one in estimated_errors(made):
        metrics |= {f"found_{one.name}": float(one.value[-1]), f"found_sd_{one.name}": float(one.sd[-1])}
    for evidence in found.evidence:
        metrics[f"log_odds_{evidence.key}"] = evidence.log_odds
        if evidence.key not in STATES:  # a settled number of the run
            for one in evidence.estimates:
                metrics |= {f"found_{one.name}": one.value, f"found_sd_{one.name}": one.sd}
    judged = ScoringContext(
        log=given.log.path.name,
        log_format=given.log.format,
        log_sha256=given.log.sha256,
        configuration=given.log.configuration.name if given.log.configuration else "",
        truth_kind=report.truth_kind,
        truth_source=report.truth_source,
        window_start_s=None,
        window_end_s=None,
        align=report.alignment.name,
    )
    finite = {name: value for name, value in metrics.items() if value is not None and math.isfinite(value)}
    trace = Trace(report.time_s, report.estimate_m, report.truth_m, report.cov_m2)
    return JobResult(finite, made.warnings, scored_against=judged), trace


def refusals(made: Trajectory) -> dict[str, float]:
    """Return the longest row of fixes that the filter did not take for good, and the one in which the log ends."""
    outcomes = {update.row: update.outcome for update in made.updates if update.sensor == "usbl"}
    if not outcomes:
        return {}
    good = [outcomes[row] == "used" for row in sorted(outcomes)]
    rows = [0 if taken else len(list(group)) for taken, group in groupby(good)]
    return {"refused_in_a_row": float(max(rows)), "refused_at_the_end": float(rows[-1])}


def _key(given: Dive, cell: Cell, seed: int) -> str:
    """Return the digest of all that a result depends on: log and truth, what is run, and the code."""
    parts = (given.line, given.truth, given.log.parameters, cell, _choices(cell, seed))
    return hashlib.sha256(pickle.dumps(parts) + _code()).hexdigest()[:32]


@functools.cache
def _code() -> bytes:
    """Return the digest of the code as this process loaded it."""
    import usbldr.filters

    files = [
        *sorted(Path(str(usbldr.filters.__file__)).parent.rglob("*.py")),
        *sorted(Path(__file__).parent.glob("[clr]*.py")),
    ]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()
