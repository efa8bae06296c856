"""The study behind docs/studies/field.md: its records, changes, verdicts and tables, without the runs themselves."""

import math
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from field import study as field_study
from field.agreement import Likeness
from field.changes import CHANGES, MODULES, constants
from field.figures import draw_consistency
from field.logs import CASES, Case, moved_onto_fixes
from field.plan import FEW_DIVES, Rows, plan
from pages import AskedRows
from paper.runs import Way
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.identification.linearisation import KEYS
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay import prior
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Timeline, Truth
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.seed_table import ComparisonRow


@pytest.fixture(scope="module")
def line() -> Timeline:
    """A minute of fixes, one a second, each 2 s late but for the first, which comes 5 s late."""
    whole = timeline(simulated_log(replace(find_scenario("paper"), duration_s=60.0), 0))
    late = whole.fix_time_s + 2.0
    late[0] += 3.0
    return replace(whole, fix_received_s=late, gps_time_s=whole.gps_time_s[10:], gps_m=whole.gps_m[10:])


def invented(case: Case, way: Way, change: str, trace: Path) -> list[ComparisonRow]:
    """Return a row for each definition; each change costs a little more."""
    error = 0.5 + 0.001 * list(CHANGES).index(change)
    metrics = {"mean_abs_east_m": error / 2, "mean_abs_north_m": error / 2, "mean_horizontal_m": error}
    metrics |= {"nees_mean": 2.5, "nees_low": 1.0, "nees_high": 3.0, "refused_in_a_row": 3.0, "refused_at_the_end": 1.0}
    metrics |= {f"inside_{k}_sigma": share for k, share in ((1, 0.6), (2, 0.9), (3, 1.0))}
    metrics |= {f"log_odds_{key}": 4.2 if key in ("scale", "dvl-clock") else -3.1 for key in KEYS}
    metrics |= {"found_dvl_scale": 0.01, "found_sd_dvl_scale": 0.001, "found_dvl_clock_s": 0.5}
    metrics |= {"found_sd_dvl_clock_s": 0.1}
    seeds = tuple(range(min(case.dives, FEW_DIVES)))
    outcomes = tuple(JobResult(metrics, trace=trace) for _ in seeds)
    return [
        ComparisonRow(name, way.label, way.method, seeds, outcomes, METHODS[way.method].draws, True)
        for name in case.scored
    ]


@pytest.fixture
def rows(tmp_path: Path) -> AskedRows:
    trace = tmp_path / "trace.npz"
    cov = np.repeat(np.eye(2)[None], 5, axis=0)
    np.savez(trace, time_s=np.arange(5.0), estimate_m=np.ones((5, 2)), truth_m=np.zeros((5, 2)), cov_m2=cov)
    found: dict[tuple[str, Way, str], ComparisonRow] = {}
    for cell in plan(list(CASES.values())):
        for row in invented(CASES[cell.case], cell.way, cell.change, trace):
            found[row.log, cell.way, cell.change] = row
    return AskedRows(found)


def document(cases: list[Case], rows: Rows) -> str:
    files = {case.name: [f"{case.name}_{what}.png" for what in field_study.CAPTIONS] for case in cases}
    alike = Likeness(0.5, 0.2, 1.0, 0.5)
    agreed = {case.name: {"fixes": alike, "truth": alike} for case in cases}
    return field_study.document(cases, rows, files | {"stpere_marina cut": ["stpere_marina_cut_errors.png"]}, agreed)


def test_the_document_lacks_no_run_and_leaves_none_unused(rows: AskedRows) -> None:
    text = document(list(CASES.values()), rows)

    assert "{{" not in text
    by_last_definition = {case.scored[-1] for case in CASES.values()}
    assert {key for key in rows if key[0] in by_last_definition} <= rows.looked_at
    assert {key for key in rows if key[2] == ""} <= rows.looked_at | {key for key in rows if key[1].method == "ckf"}


def test_a_truth_moved_onto_the_fixes_lies_on_them_whatever_its_frame(line: Timeline) -> None:
    t = np.arange(61.0)
    path = np.column_stack([t, 10 * np.sin(t / 10)])
    turn = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    fixes = path.copy()
    fixes[::9] += 40.0  # gross ones
    truth = Truth(t, path @ turn.T + [5.0, -7.0], np.full(61, np.nan), "slam", "made up")

    moved = moved_onto_fixes(truth, replace(line, fix_m=fixes), Window(-1.0, 100.0))

    np.testing.assert_allclose(moved.position_m, path, atol=1e-9)


def test_no_change_leaves_a_run_as_it_is(line: Timeline) -> None:
    """Each change has to do something on a log that uses everything, or it would show a robustness that is none."""
    given = Parameters(calibrate=tuple(STATES))
    usual = prior.prior(line, given, StateLayout())
    for name, change in CHANGES.items():
        if name in ("", "without guard"):
            continue
        changed_line = change.records(line) if name != "cut" else None
        reported = change.after(change.before(given, line), line)
        asked = any(
            attrgetter(constant)(MODULES) != value
            for constant, value in change.constants.items()
            if not constant.startswith("prior.")
        )
        with constants(change.constants):
            begun = prior.prior(line, given, StateLayout())
        starts = any(not np.array_equal(one, other) for one, other in zip(begun, usual, strict=True))
        assert starts or not name.startswith("start."), name
        assert changed_line is not line or reported != given or asked or starts, name


def test_the_consistency_of_a_log_is_drawn(rows: AskedRows, tmp_path: Path) -> None:
    file = draw_consistency(CASES["stpere_marina"], rows, tmp_path)

    assert file == "stpere_marina_consistency.png"
    assert 10_000 < (tmp_path / file).stat().st_size < 150_000
