"""A filter of one's own is one row of METHODS: every command then knows it."""

import json
from dataclasses import dataclass

import pytest

import commands
from checkout import SAMPLES
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step
from usbldr.filters.models.states import POSITION
from usbldr.filters.replay.methods import METHODS, Method
from usbldr_cli.figures.run_figures import run_pictures
from usbldr_cli.figures.style import colour

DIVE = str(SAMPLES / "paper.mcap")


@dataclass(frozen=True)
class LastFix:
    def start(self, prior: Prior) -> Prior:
        return prior

    def step(self, belief: Prior, step: Step, make_rng: MakeRng) -> Prior:
        mean = belief.mean.copy()
        for measurement in step.measurements:
            if measurement.sensor == "usbl":
                mean[POSITION] = measurement.z
        return Prior(mean, belief.cov)

    def estimate(self, belief: Prior) -> Estimate:
        return Estimate(belief.mean, belief.cov, (), 1.0, float("nan"))


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    row = Method("last-fix", "the last fix, held", lambda *_: LastFix(), draws=True, takes_gate=True, colour="#123456")
    monkeypatch.setitem(METHODS, row.name, row)


@pytest.mark.usefixtures("own")
def test_replay_runs_a_filter_that_is_one_row_and_draws_it_in_its_colour(tmp_path, monkeypatch):
    monkeypatch.setattr("usbldr_cli.figures.run_figures.run_pictures", run_pictures)
    done = commands.run("replay", DIVE, "-f", "last-fix", "--calibrate", "none", "-o", str(tmp_path / "run"))

    report = commands.report_of(tmp_path / "run")
    raw_m = report["reference_tracks"]["usbl"]["metrics"]["mean_horizontal_m"]
    assert done.exit_code == 0, done.output
    assert report["filter"] == "last-fix"
    assert report["metrics"]["mean_horizontal_m"] == pytest.approx(raw_m)  # the log has a fix at each second
    assert (tmp_path / "run" / "track.png").stat().st_size > 10_000
    assert colour("last-fix") == "#123456"


@pytest.mark.usefixtures("own")
def test_help_and_refusals_know_a_filter_that_is_one_row() -> None:
    reported = commands.run("replay", "--help").output

    assert "the last fix, held" in reported
    assert " ".join(reported.split()).count("pf-wekf, last-fix") == 1  # those that draw
    refused = commands.run("replay", DIVE, "-f", "last-fix", "--smooth")
    assert "last-fix is too far from a Gaussian" in str(refused.exception)
    assert "ukf, last-fix" in str(commands.run("replay", DIVE, "-f", "cpf", "--gate", "0.9").exception)


@pytest.mark.usefixtures("own")
def test_compare_runs_a_filter_that_is_one_row_once_a_seed() -> None:
    done = commands.run("compare", DIVE, "--filters", "dr,last-fix", "--seeds", "2", "--calibrate", "none", "--json")

    rows = json.loads(done.output)["rows"]
    assert [(row["filter"], row["seeds"]) for row in rows] == [("dr", 1), ("last-fix", 2)]
