"""The study behind paper.md: its plan, its tables, its verdicts and its scenarios, without the runs themselves."""

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest

from pages import AskedRows
from paper import figures as paper_figures
from paper import goals as paper_goals
from paper import study
from paper import tables as paper_tables
from paper.readings import ROWS
from paper.runs import STATES, Rows, Way, plan, write_sweeps
from usbldr.filters.bounds.dive_bounds import PositionBound
from usbldr.filters.models.calibration import EstimatedError
from usbldr.filters.replay.methods import METHODS
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
