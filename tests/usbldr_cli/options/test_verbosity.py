"""--verbose and --progress: what a command does, on stderr, and stdout as without them."""

import json
import logging
import math
from pathlib import Path

import pytest

from checkout import SAMPLES
from commands import options_of, run
from usbldr_cli.main import COMMANDS

DIVE = SAMPLES / "lawnmower_turn_db3"


def replay(tmp_path: Path, *options: str) -> tuple[str, list[str]]:
    done = run("replay", DIVE, "-f", "ekf", "-o", tmp_path / "run", "--force", "--plots", "none", "-q", *options)
    assert done.return_value == 0
    return done.stdout, done.stderr.splitlines()


def test_verbose_says_what_is_read_chosen_and_why_and_the_time_of_each_stage(tmp_path: Path) -> None:
    usual, quiet = replay(tmp_path)
    result, said = replay(tmp_path, "--verbose")

    assert result == usual
    assert not [line for line in quiet if "read the log" in line]
    for wanted in ("log: ", "configuration: ", "dvl: /dvl/data (", "  axes FRD (configuration)", "truth: "):
        assert any(line.startswith(f"usbldr: {wanted}") for line in said), (wanted, said)
    timed = [line.rpartition(": ") for line in said if line.endswith(" s") and not line.startswith("usbldr:  ")]
    stages = {name.removeprefix("usbldr: "): float(seconds[:-2]) for name, _, seconds in timed}
    assert {"open the log", "read the log", "run ekf", "write the results"} <= set(stages)
    assert all(seconds >= 0 for seconds in stages.values())
    assert not logging.getLogger("usbldr").handlers  # the next command in this process is silent again


def test_progress_as_json_is_a_line_for_each_step_that_a_script_can_read(tmp_path: Path) -> None:
    usual, _ = replay(tmp_path)
    result, said = replay(tmp_path, "--progress", "json")

    events = [json.loads(line) for line in said if line.startswith("{")]
    assert result == usual
    stages = [(one["stage"], one["state"]) for one in events if one["event"] == "stage"]
    for name in ("open the log", "read the log", "run ekf", "write the results"):
        assert stages.index((name, "begin")) < stages.index((name, "end"))
    ticks = [one for one in events if one["event"] == "progress"]
    assert {one["stage"] for one in ticks} == {"run ekf"}
    assert [one["done"] for one in ticks] == sorted({one["done"] for one in ticks})
    assert ticks[-1]["done"] == ticks[-1]["total"] > 0
    assert all(math.isfinite(one["seconds"]) for one in ticks)


def test_runs_are_counted_one_by_one_and_named_with_verbose() -> None:
    done = run("compare", DIVE, "-f", "usbl,dr", "--jobs", 1, "-q", "--progress", "json", "-v")

    lines = done.stderr.splitlines()
    ticks = [json.loads(line) for line in lines if line.startswith('{"event": "progress"')]
    assert [(one["stage"], one["done"], one["total"]) for one in ticks][-1] == ("runs", 2, 2)
    for method in ("usbl", "dr"):
        assert any(line.startswith(f"usbldr: {method} on {DIVE}, seed 0: mean horizontal error ") for line in lines)


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_takes_verbose_and_the_long_ones_progress(name: str) -> None:
    options = options_of(name)
    assert {"-v", "--verbose"} <= options
    assert ("--progress" in options) == (name in ("replay", "compare", "drill", "check", "baseline"))
