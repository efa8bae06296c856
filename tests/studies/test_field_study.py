"""The study behind docs/studies/field.md: its records, changes, verdicts and tables, without the runs themselves."""

import math
import subprocess
import sys
from dataclasses import fields, replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from field import goals as field_goals
from field import study as field_study
from field import tables as field_tables
from field.agreement import Likeness, likeness
from field.changes import ABLATIONS, CHANGES, MODULES, SENSITIVITY, constants
from field.figures import draw_consistency
from field.logs import CASES, Case, cut, moved_onto_fixes, stamped_at_arrival, thinned
from field.plan import BEST, FEW_DIVES, GATED, ONLINE, Cell, Rows, online, plan
from field.runs import identified_once, refusals, run_task
from pages import AskedRows, table_widths
from paper.runs import Way
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.identification import evidence
from usbldr.filters.identification.identification import Identification
from usbldr.filters.identification.linearisation import KEYS
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.parameters import Parameters, ProcessNoise
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay import prior
from usbldr.filters.replay.dead_reckoning import displacement_m
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.types import Timeline, Trajectory, Truth, Update
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.runs.job_store import JobResult
from usbldr_cli.runs.seed_table import ComparisonRow
from weaving import Faults, weaving_dive

SHOWN = [case for case in CASES.values() if not case.held_back]


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


def test_held_back_logs_are_neither_run_nor_shown_by_default(rows: AskedRows) -> None:
    text = document(SHOWN, rows)

    held_back = {case.name for case in CASES.values() if case.held_back}
    assert len(held_back) == 3
    assert not {name for name, _, _ in rows.looked_at} & held_back
    assert "runs the held-back logs" in text
    assert not {cell.case for cell in plan(SHOWN)} & held_back


def test_each_log_has_its_kind_of_truth_beside_its_numbers(rows: AskedRows) -> None:
    text = document(SHOWN, rows)

    for case in SHOWN:
        assert text.count(case.truth) >= 1
        assert f"| {case.scored[0]} | {case.truth} |" in text


def test_a_table_has_as_many_cells_in_each_line(rows: AskedRows) -> None:
    widths = table_widths(document(list(CASES.values()), rows))

    assert len(widths) > 15
    assert all(len(width) == 1 for width in widths)


def test_the_table_of_errors_says_which_exist_and_with_what_odds(rows: AskedRows) -> None:
    text = document(SHOWN, rows)

    assert text.count("| 0.01 ± 0.001 (log odds +4.2) ") == len(SHOWN)
    assert text.count("| 0.5 ± 0.1 s (log odds +4.2) ") == len(SHOWN)
    assert text.count("| does not exist (log odds -3.1) ") == (len(KEYS) - 2) * len(SHOWN)


def test_thinned_fixes_are_the_first_of_each_stretch(line: Timeline) -> None:
    few = thinned(line, 10.0)

    assert few.fix_time_s.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    assert np.array_equal(few.fix_m, line.fix_m[::10])
    assert len(line.fix_time_s) == 61


def test_a_cut_counts_from_the_first_gps_fix(line: Timeline) -> None:
    left = cut(line, ((5.0, 8.0), (20.0, 100.0)))

    assert left.fix_time_s.tolist() == [t for t in range(61) if not (15 <= t <= 18 or t >= 30)]


def test_fixes_stamped_at_arrival_come_in_the_order_in_which_they_came(line: Timeline) -> None:
    late = stamped_at_arrival(line)

    assert np.all(np.diff(late.fix_time_s) >= 0)
    assert np.array_equal(late.fix_time_s, late.fix_received_s)
    assert np.array_equal(
        late.fix_m[:4], line.fix_m[[1, 2, 0, 3]]
    )  # the first came 5 s late, at the time of the fourth


def test_a_truth_moved_onto_the_fixes_lies_on_them_whatever_its_frame(line: Timeline) -> None:
    t = np.arange(61.0)
    path = np.column_stack([t, 10 * np.sin(t / 10)])
    turn = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    fixes = path.copy()
    fixes[::9] += 40.0  # gross ones
    truth = Truth(t, path @ turn.T + [5.0, -7.0], np.full(61, np.nan), "slam", "made up")

    moved = moved_onto_fixes(truth, replace(line, fix_m=fixes), Window(-1.0, 100.0))

    np.testing.assert_allclose(moved.position_m, path, atol=1e-9)


def test_a_source_that_is_ahead_too_short_and_turned_is_found_so(line: Timeline) -> None:
    t = np.arange(0.0, 400.0, 0.2)
    speed, yaw = np.column_stack([np.zeros_like(t), np.ones_like(t)]), 0.8 * np.sin(t / 15)
    curved = replace(line, time_s=t, dr_mps=speed, dr_yaw_rad=yaw)
    stamps = np.arange(5.0, 390.0, 2.0)
    clockwise = np.radians(7.0)
    turn = np.array([[np.cos(clockwise), np.sin(clockwise)], [-np.sin(clockwise), np.cos(clockwise)]])
    ahead = np.column_stack([np.interp(stamps + 1.5, t, column) for column in displacement_m(curved).T])
    source = 0.95 * ahead @ turn.T + [100.0, -50.0]
    source[[10, 90]] += 60.0  # gross ones

    found = likeness(curved, stamps, source)

    assert found == pytest.approx((1.5, 1.5, 0.95, 7.0), abs=1e-6)


def test_a_straight_track_at_constant_speed_tells_no_lead(line: Timeline) -> None:
    t = np.arange(0.0, 400.0, 0.2)
    straight = replace(line, time_s=t, dr_mps=np.tile([1.0, 1.0], (len(t), 1)), dr_yaw_rad=np.zeros_like(t))
    stamps = np.arange(5.0, 390.0, 2.0)
    noise = 0.1 * np.random.default_rng(0).standard_normal((len(stamps), 2))

    found = likeness(straight, stamps, 0.99 * stamps[:, None] + noise)

    assert math.isnan(found.lead_s)
    assert found.ratio == pytest.approx(0.99, abs=0.001)


def test_every_default_is_halved_and_doubled() -> None:
    for name in (one.name for one in fields(ProcessNoise) if getattr(ProcessNoise(), one.name)):
        for label, factor in (("half", 0.5), ("twice", 2.0)):
            changed = SENSITIVITY[f"process.{name} {label}"].before(Parameters(), None)  # type: ignore[arg-type]
            expected = replace(ProcessNoise(), **{name: factor * getattr(ProcessNoise(), name)})
            assert changed == replace(Parameters(), process=expected)


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


def identified(line: Timeline, change: str) -> Identification:
    """Return what is identified with an ablation."""
    given = ABLATIONS[change].before(Parameters(), line)
    with constants(ABLATIONS[change].constants):
        return evidence.identify(line, given)


@pytest.mark.long
def test_a_log_is_identified_whatever_is_taken_away() -> None:
    line = weaving_dive(Faults(), seconds=60)
    for change in ABLATIONS:
        assert identified(line, change).evidence, change


def test_noise_that_is_not_estimated_from_the_log_is_that_stated() -> None:
    line = weaving_dive(Faults(), seconds=100)
    overstated = replace(line, dvl_sd_mps=line.dvl_sd_mps / 5, fix_cov_m2=line.fix_cov_m2 / 25)

    assert identified(overstated, "noise not estimated from the log").noise_changes == ()
    changed = {one.name for one in identified(overstated, "DVL noise not estimated").noise_changes}
    assert "usbl_sd_scale" in changed
    assert not changed & {"dvl_sd_scale", "velocity_walk_mps"}


def test_with_rare_fixes_the_noise_of_the_dvls_records_keeps_the_track(tmp_path: Path) -> None:
    """A dive of the paper by one fix in 60 s; with the DVL's stated sigma inliers are rejected."""
    cell = Cell("paper", BEST, "one fix in 60 s")

    def run() -> JobResult:
        ((outcome, _, _),) = run_task((cell, 3, tmp_path), frozenset())
        assert outcome is not None
        return outcome

    estimated = run()
    identified_once.cache_clear()
    with constants(ABLATIONS["DVL noise not estimated"].constants):
        stated = run()
    identified_once.cache_clear()

    assert estimated.metrics["mean_horizontal_m"] < 0.3 * stated.metrics["mean_horizontal_m"]
    assert estimated.metrics["refused_in_a_row"] <= 2
    assert stated.metrics["refused_in_a_row"] > 10


def test_a_constant_is_another_only_for_a_while() -> None:
    before = evidence.SCALE_SD
    with constants({"evidence.SCALE_SD": 0.1}):
        during = evidence.SCALE_SD
    with pytest.raises(RuntimeError), constants({"evidence.SCALE_SD": 0.1}):
        raise RuntimeError

    assert during == 0.1
    assert before == evidence.SCALE_SD


def test_an_error_that_is_taken_away_is_part_of_no_explanation() -> None:
    line = weaving_dive(Faults(dvl_scale=0.03), seconds=200)

    without, every = (identified(line, name) for name in ("without scale", "all errors estimated"))

    assert not any(one.exists for one in without.evidence if one.key == "scale")
    assert all(one.exists for one in every.evidence)
    assert set(every.parameters.calibrate) == {"scale", "heading", "deviation", "latency", "usbl-bias"}


def test_refused_fixes_are_counted_in_a_row_and_at_the_end() -> None:
    fates = ["used", "rejected", "down-weighted", "rejected", "used", "rejected"]
    updates = tuple(
        Update("usbl", "position", row, float(row), (0.0, 0.0), (1.0, 1.0), 2.0, 2, fate, 1.0)
        for row, fate in enumerate(fates)
    )
    made = Trajectory("adf", ("x", "y"), np.arange(6.0), np.zeros((6, 2)), None, updates)

    assert refusals(made) == {"refused_in_a_row": 3.0, "refused_at_the_end": 1.0}


def one_dive(error: float, **metrics: float) -> ComparisonRow:
    """Return the row of a single dive."""
    return ComparisonRow("paper", "adf", "adf", (0,), (JobResult({"mean_horizontal_m": error, **metrics}),), dives=True)


@pytest.mark.parametrize(
    ("error", "nees", "refused", "met"),
    [(1.0, 3.9, 0, True), (5.1, 3.0, 0, False), (1.0, 4.1, 0, False), (1.0, 3.0, 5, False)],
)
def test_rare_fixes_need_an_error_below_dr_an_honest_sigma_and_no_lock_out(
    error: float, nees: float, refused: float, met: bool
) -> None:
    case = CASES["uib_simulation"]
    thinned_row = one_dive(error, nees_mean=nees, refused_at_the_end=refused)
    rows = {(case.name, ONLINE, name): thinned_row for name in ("one fix in 10 s", "one fix in 60 s")}
    rows[case.name, Way("dr"), ""] = one_dive(5.0)

    assert [goal.met for goal in field_goals.thinned_goals(case, rows)] == [met, met]


@pytest.mark.parametrize(("cpf", "met"), [(1.0, (True, True)), (1.04, (True, False)), (1.06, (False, False))])
def test_cpf_is_held_to_the_gated_ekf_and_to_adf(cpf: float, met: tuple[bool, bool]) -> None:
    case = CASES["stpere_marina"]
    gated = replace(GATED, calibrate="auto", order=online(case))
    errors = {gated: 1.0, ONLINE: 1.0, replace(ONLINE, method="cpf"): cpf}
    rows = {(case.name, way, ""): one_dive(error) for way, error in errors.items()}

    assert tuple(goal.met for goal in field_goals.particle_goals(case, rows)) == met


def test_a_run_that_failed_meets_no_goal() -> None:
    failed = ComparisonRow("paper", "adf", "adf", (0,), (JobResult(fault="no fix"),))
    rows = {("paper", BEST, name): failed for name in ("", "one fix in 10 s", "one fix in 60 s")}
    rows["paper", Way("dr"), ""] = one_dive(5.0)

    assert not any(goal.met for goal in field_goals.thinned_goals(CASES["paper"], rows))


def test_the_consistency_of_a_log_is_drawn(rows: AskedRows, tmp_path: Path) -> None:
    file = draw_consistency(CASES["stpere_marina"], rows, tmp_path)

    assert file == "stpere_marina_consistency.png"
    assert 10_000 < (tmp_path / file).stat().st_size < 150_000


def test_a_change_without_effect_is_a_dot_and_not_a_number() -> None:
    whole, less = one_dive(0.3), one_dive(0.35)
    rows = {("paper", BEST, ""): whole, ("paper", BEST, "x half"): whole, ("paper", BEST, "x twice"): less}

    assert field_tables.lost(whole, whole) == field_tables.NO_CHANGE
    assert field_tables.lost(less, whole) == "+0.050 m, NEES "
    assert field_tables.percent(CASES["paper"], "x half", rows) == 0
    assert field_tables.percent(CASES["paper"], "x twice", rows) == pytest.approx(100 * 0.05 / 0.3)


def test_without_the_logs_the_command_says_so_in_a_sentence(tmp_path: Path) -> None:
    script = Path(field_study.__file__)
    done = subprocess.run(
        [sys.executable, str(script), "--runs", str(tmp_path), "--output", str(tmp_path / "docs")],
        env={"USBLDR_FIELD_LOGS": str(tmp_path / "absent"), "PATH": ""},
        capture_output=True,
        text=True,
    )

    assert done.returncode == 3
    assert done.stderr.count("\n") == 1
    assert "USBLDR_FIELD_LOGS" in done.stderr
    assert not (tmp_path / "docs").exists()
