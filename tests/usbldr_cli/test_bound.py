"""`replay --bound`: the least error that any filter could have on a scenario."""

import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import output_of, report_of
from logs import refusal
from usbldr.filters.bounds.dive_bounds import position_bound
from usbldr.filters.errors import UsageError
from usbldr.filters.simulation.simulate import simulate
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

SAMPLE = SAMPLES / "paper.mcap"


@pytest.mark.long
def test_the_bound_is_that_of_the_model_that_the_filters_assume(tmp_path: Path) -> None:
    options = ("--filter", "ekf", "--calibrate", "scale", "--seed", 3, "--bound", "-o", tmp_path / "run")

    said = output_of("replay", "paper", *options)

    paper = find_scenario("paper")
    log = simulated_log(paper, 3)
    want = position_bound(simulate(paper, 3), timeline(log), replace(log.parameters, calibrate=("scale",)))
    bound = report_of(tmp_path / "run")["bound"]
    shown = [line.split()[-3:] for line in said.splitlines() if line.startswith(("bound", "smoother bound"))]
    for k, (name, errors_m) in enumerate((("filter", want.filter_m), ("smoother", want.smoother_m))):
        least = bound[name]
        assert [least["mean_abs_east_m"], least["mean_abs_north_m"]] == pytest.approx(errors_m, rel=1e-12)
        assert shown[k] == [f"{error_m:.3f}" for error_m in (*errors_m, least["rmse_horizontal_m"])]


def test_the_row_of_a_comparison_is_the_mean_of_the_seeds_own_bounds(tmp_path: Path) -> None:
    text = (files("usbldr.io.scenarios") / "paper.toml").read_text(encoding="utf-8")
    dive, out = tmp_path / "short.toml", tmp_path / "compared"
    dive.write_text(re.sub(r"(?m)^duration_s = .*", "duration_s = 20.0", text), encoding="utf-8")
    alone: list[dict[str, float]] = []
    for seed in ("4", "5"):
        run = tmp_path / seed
        output_of("replay", dive, "-f", "ekf", "--seed", seed, "--bound", "-o", run)
        alone.append(report_of(run)["bound"]["filter"])

    output_of("compare", dive, "-f", "dr,ekf,usbl", "--seed", 4, "--seeds", 2, "--bound", "-j", 1, "-o", out)

    reported = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    row = reported["rows"][-1]
    assert row["filter"] == "bound"
    for name in ("mean_abs_east_m", "mean_abs_north_m", "rmse_horizontal_m"):
        assert row[name] == pytest.approx((alone[0][name] + alone[1][name]) / 2, rel=1e-12)
        assert f",{row[name]!r}," in (out / "compare.csv").read_text(encoding="utf-8").splitlines()[-1]
    line = next(line for line in (out / "compare.md").read_text(encoding="utf-8").splitlines() if "| bound |" in line)
    assert line.count(f"{row['mean_abs_east_m']:.3f} ± ") >= 1
    assert "bound is best" not in reported["verdict"]


@pytest.mark.parametrize("command", ["replay", "compare"])
def test_a_recorded_log_has_no_bound(command: str) -> None:
    said = f"--bound: {SAMPLE} is a recorded log; the bound needs the true states of a scenario"
    assert refusal(UsageError, output_of, command, SAMPLE, "--bound") == said
