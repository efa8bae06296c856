"""The study behind paper.md: its plan, its tables, its verdicts and its scenarios, without the runs themselves."""

import math
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest

from pages import AskedRows, table_widths
from paper import figures as paper_figures
from paper import goals as paper_goals
from paper import study
from paper import tables as paper_tables
from paper.bounds import limits
from paper.readings import ROWS
from paper.runs import LATE, SHARES, STATES, UNSEEN, Rows, Way, plan, shared, write_sweeps
from usbldr.filters.bounds.dive_bounds import PositionBound, dive_bounds
from usbldr.filters.models.calibration import EstimatedError
from usbldr.filters.models.noise import Gaussian, Mixture
from usbldr.filters.replay.methods import METHODS
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr_cli.compare import compare
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.job_store import JobResult, JobStore, Trace
from usbldr_cli.runs.seed_table import ComparisonRow

LIMIT, OF_PAPER, OF_RANGE = (
    PositionBound(np.arange(60.0), np.tile(filter_sd_m, (60, 1)), np.tile(smoother_sd_m, (60, 1)))
    for filter_sd_m, smoother_sd_m in (((0.15, 0.15), (0.1, 0.1)), ((0.7, 0.6), (0.5, 0.4)), ((0.3, 0.25), (0.2, 0.05)))
)

TIMES_S = {Way("cpf"): 5.9, Way("adf"): 3.1}


def row(way: Way, values: list[float], log: str = "paper", trace: Path | None = None) -> ComparisonRow:
    """Return a row whose dives have these errors, the same east and north."""
    metrics = [
        {
            "mean_abs_east_m": value,
            "mean_abs_north_m": value,
            "mean_horizontal_m": 1.5 * value,
            "nees_mean": 2.0 + 0.1 * value,
            "independent_errors": 80.0,
        }
        for value in values
    ]
    outcomes = tuple(JobResult(one, trace=trace) for one in metrics)
    return ComparisonRow(
        log, way.label, way.method, tuple(range(len(values))), outcomes, (METHODS | ROWS)[way.method].draws, True
    )


@pytest.fixture
def sweeps(tmp_path: Path) -> Path:
    write_sweeps(tmp_path / "sweeps")
    return tmp_path / "sweeps"


@pytest.fixture
def rows(sweeps: Path, tmp_path: Path) -> Rows:
    """Invent every row of the study."""
    rng = np.random.default_rng(0)
    cov = np.repeat(0.04 * np.eye(2)[None], 60, axis=0)
    trace = Trace(np.arange(60.0), 0.2 * rng.standard_normal((60, 2)), np.zeros((60, 2)), cov)
    kept = JobStore(tmp_path).write("0" * 32, JobResult(), trace).trace
    return {
        (log, way): row(way, rng.uniform(0.2, 0.4, count).tolist(), Path(log).stem, kept)
        for (log, way), count in plan(3, sweeps, unseen=True).items()
    }


def document(rows: Rows, sweeps: Path) -> str:
    goals = paper_goals.goals(rows, LIMIT, TIMES_S)
    return study.document(rows, sweeps, 3, goals, LIMIT, dict.fromkeys(STATES, OF_PAPER), OF_RANGE)


def test_the_document_lacks_no_run_and_leaves_none_unused(rows: Rows, sweeps: Path) -> None:
    asked = AskedRows(rows)

    text = document(asked, sweeps)

    assert "{{" not in text
    assert set(rows) <= asked.looked_at


def test_a_table_has_as_many_cells_in_each_line(rows: Rows, sweeps: Path) -> None:
    widths = table_widths(document(rows, sweeps))

    assert len(widths) == 12
    assert all(len(width) == 1 for width in widths)


def test_every_bound_stands_where_its_scenario_is_told(rows: Rows, sweeps: Path) -> None:
    """The mean |error| of a Gaussian is 0.798 of its sigma."""
    text = document(rows, sweeps)

    assert "(0.239/0.199 m for any filter, 0.160/0.040 m for any smoother)" in text
    assert text.count("| 0.559/0.479 |") == text.count("| 0.399/0.319 |") == len(STATES)
    assert (text.count("| 0.120/0.120 |"), text.count("| 0.080/0.080 |")) == (4, 1)


def test_every_picture_of_the_document_is_drawn(
    rows: Rows, sweeps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scale = EstimatedError("dvl_scale", "", np.linspace(0.0, 0.01, 60), np.full(60, 0.001))
    monkeypatch.setattr(paper_figures, "scale_over_time", lambda seed: (np.arange(60.0), scale))

    paper_figures.write_figures(tmp_path / "paper", rows, sweeps, 2, {"paper-drawn": LIMIT, "paper": LIMIT})

    named = study.re.findall(r"\]\(paper/(\w+\.png)\)", study.TEXT.read_text(encoding="utf-8"))
    assert sorted(named) == sorted(file.name for file in (tmp_path / "paper").iterdir())


def test_every_command_under_a_table_asks_for_what_was_run(sweeps: Path) -> None:
    for (log, way), count in plan(2, sweeps, unseen=True).items():
        program, verb, *words = paper_tables.command(log, way, count).split()

        given = compare.make_context("compare", words).params
        assert (program, verb) == ("usbldr", "compare")
        assert (given["filters"], given["seeds"]) == (way.method, count)
        assert {field.name: given[field.name] for field in fields(RunChoices)} == asdict(way.choices(0))


@pytest.mark.parametrize(
    ("values", "met", "said"),
    [
        ([0.20, 0.21, 0.22], True, "met"),
        ([0.22, 0.24, 0.25], True, "met, by less than 2 standard errors"),
        ([0.23, 0.25, 0.26], False, "**not met**, by less than 2 standard errors"),
        ([0.30, 0.31, 0.32], False, "**not met**"),
    ],
)
def test_a_goal_is_met_when_the_mean_over_dives_lies_within_it(values: list[float], met: bool, said: str) -> None:
    """0.24/0.27 is the goal; the means are .21, .237, .247 and .31, their standard errors .006 to .009."""
    found = paper_goals.goals(invented(values), LIMIT, TIMES_S)[0]

    assert (found.met, found.verdict) == (met, said)


def test_a_single_bad_dive_breaks_the_goal_that_none_is_bad() -> None:
    assert paper_goals.goals(invented([0.1, 0.1, 0.19]), LIMIT, TIMES_S)[2].met
    assert not paper_goals.goals(invented([0.1, 0.1, 0.21]), LIMIT, TIMES_S)[2].met


def invented(values: list[float]) -> Rows:
    """Return the rows of the goals, all with these errors."""
    return {cell: row(cell[1], values) for cell in plan(2, Path("sweeps"), unseen=False)}


def test_a_filter_is_fast_enough_when_its_time_is_within_what_was_asked() -> None:
    *_, cpf, adf = paper_goals.goals(invented([0.1, 0.1, 0.19]), LIMIT, TIMES_S)

    assert cpf.met  # 5.9 of 6 s
    assert not adf.met  # 3.1 of 3 s


def test_errors_over_the_bound_are_those_of_hand_computation() -> None:
    mean, se = paper_tables.over(row(Way("adf"), [0.1, 0.2, 0.3]), "mean_abs_east_m", 0.1)

    assert mean == pytest.approx(2.0)
    assert se == pytest.approx(1.0 / math.sqrt(3))


def test_lost_dives_are_told_by_the_median_and_their_share() -> None:
    text = paper_tables.errors(row(Way("pf"), [0.3, 0.4, 900.0]))

    assert text == "median 0.400/0.400 (mean 300.2/300.2, 33 % lost)"


def test_the_other_shares_of_outliers_differ_from_the_paper_in_nothing_else(sweeps: Path) -> None:
    base = find_scenario("paper")
    for share in SHARES:
        found = find_scenario(shared(sweeps, share))
        noise = Mixture(share) if share else Gaussian()

        assert found.usbl.noise == found.dvl.noise == found.compass.noise == noise
        same = {
            sensor: replace(getattr(found, sensor), noise=getattr(base, sensor).noise)
            for sensor in ("dvl", "compass", "usbl")
        }
        assert replace(found, name=base.name, about=base.about, **same) == base


def test_the_late_stamps_are_late_by_a_second_and_nothing_else() -> None:
    base, found = find_scenario("paper"), find_scenario(LATE)

    assert found.usbl.timing.latency_s == 1.0
    usbl = replace(found.usbl, timing=base.usbl.timing)
    assert replace(found, name=base.name, about=base.about, usbl=usbl) == base


def test_the_unseen_dive_is_told_to_filters_otherwise_than_it_is() -> None:
    found = find_scenario(UNSEEN)

    assert found.start is None
    assert found.dvl.assumed_noise != found.dvl.noise
    assert found.usbl.assumed_noise != found.usbl.noise


def test_limits_of_one_dive_are_its_bounds_at_the_epochs_of_the_errors() -> None:
    short = replace(find_scenario("paper-drawn"), duration_s=20.0)
    log = simulated_log(short, 1)
    line = timeline(log)
    bounds = dive_bounds(simulate(short, 1), line, replace(log.parameters, calibrate=("scale",)))

    found = limits(short, ("scale",), (1,))

    assert found.time_s.tolist() == list(range(21))
    east_sd = np.sqrt(bounds.smoothed[::5, 4, 4])
    np.testing.assert_allclose(found.smoother_sd_m[:, 0], east_sd)
    assert found.smoother_m[0] == pytest.approx(math.sqrt(2 / math.pi) * east_sd.mean())


def test_nees_over_time_is_the_mean_of_the_squared_errors_in_sigmas(tmp_path: Path) -> None:
    errors = np.array([[3.0, 0.0], [0.0, 4.0]])  # two epochs, sigmas 2 m: 9/4 and 16/4
    cov = np.repeat(4.0 * np.eye(2)[None], 2, axis=0)
    store = JobStore(tmp_path)
    outcomes = tuple(
        store.write(f"{k:032x}", JobResult(), Trace(np.arange(2.0), k * errors, np.zeros((2, 2)), cov)) for k in (0, 1)
    )

    time_s, value = paper_figures.nees_over_time(ComparisonRow("paper", "adf", "adf", (0, 1), outcomes, dives=True), 2)

    assert time_s.tolist() == [0.0, 1.0]
    assert value.tolist() == pytest.approx([9 / 8, 16 / 8])


def test_text_and_parts_have_to_fit_each_other() -> None:
    assert study.filled("a {{b}} c", {"b": "d"}) == "a d c"
    for parts in ({}, {"b": "d", "e": "f"}):
        with pytest.raises(KeyError):
            study.filled("a {{b}} c", parts)
