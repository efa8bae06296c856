"""`replay --bound`: the least error that any filter could have on a scenario."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from paper.bounds import limits
from usbldr.io.scenarios.library import find_scenario
from usbldr_cli.main import cli
from usbldr_cli.replay import replay

SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs" / "paper.mcap"


def test_the_bound_is_that_of_the_study(tmp_path: Path) -> None:
    options = ["--filter", "ekf", "--calibrate", "scale", "--seed", "3", "--bound", "-o", str(tmp_path / "run")]

    done = CliRunner().invoke(cli, ["replay", "paper", *options], catch_exceptions=False)

    assert done.exit_code == 0
    want = limits(find_scenario("paper"), ("scale",), (3,))
    bound = json.loads((tmp_path / "run" / "report.json").read_text(encoding="utf-8"))["bound"]
    shown = [line.split()[-2:] for line in done.output.splitlines() if line.startswith(("bound", "smoother bound"))]
    for k, (name, errors_m) in enumerate((("filter", want.filter_m), ("smoother", want.smoother_m))):
        assert list(bound[name].values()) == pytest.approx(errors_m, rel=1e-12)
        assert shown[k] == [f"{error_m:.3f}" for error_m in errors_m]


def test_a_recorded_log_has_no_bound() -> None:
    done = CliRunner().invoke(replay, [str(SAMPLE), "--bound"])

    assert str(done.exception) == f"--bound: {SAMPLE} is a recorded log; the bound needs the true states of a scenario"
