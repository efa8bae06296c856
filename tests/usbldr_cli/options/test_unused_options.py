"""An option that changes nothing is said: the tracks are the oracle; what --verbose and --progress say, on stderr."""

import dataclasses
import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from checkout import SAMPLES
from commands import options_of, run
from logs import with_table
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import StudentT
from usbldr.filters.replay.methods import METHODS
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log, write_scenario
from usbldr.io.session import RunSettings, replay
from usbldr_cli.compare import compare
from usbldr_cli.main import COMMANDS
from usbldr_cli.options.option import Option, unused_options

SHORT = dataclasses.replace(find_scenario("paper"), duration_s=20.0)
OTHER: dict[str, Any] = {  # by option: another value than the default
    "particles": 30, "seed": 5, "calibrate": ("scale",), "noise": {"usbl": StudentT(2.5)}, "order": "arrival",
    "guard": True,
}  # fmt: skip
OPTIONS = {str(param.name): param for param in compare.params if isinstance(param, Option)}


@pytest.fixture(scope="module")
def log() -> Log:
    made = simulated_log(SHORT, 0)
    fixes = made.tables["usbl"]
    return with_table(made, "usbl", fixes.assign(received_s=fixes["time_s"] + 1.5))  # so that their order matters


def track(log: Log, method: str, **settings: Any) -> np.ndarray:
    return replay(log, timeline(log), method, RunSettings(**{"calibrate": (), **settings})).mean[:, 1:]


def test_every_option_with_a_user_has_another_value_here() -> None:
    assert set(OTHER) | {"seeds"} == {name for name, option in OPTIONS.items() if option.used_by}


@pytest.mark.parametrize("option", OTHER)
@pytest.mark.parametrize("method", ["ekf", "aekf", "cpf", "pf", "nudge", "dr", "usbl"])
def test_an_option_is_unused_exactly_if_the_track_stays_the_same(log: Log, option: str, method: str) -> None:
    usual = track(log, method)
    try:
        other = track(log, method, **{option: OTHER[option]})
    except UsageError:  # refused, so nothing needs to be said
        return

    same = usual.shape == other.shape and np.array_equal(usual, other)

    if option == "guard" and METHODS[method].multiple_hypotheses:
        return  # hypotheses begin with fixes that contradict the track, and here there are none
    assert bool(unused_options([OPTIONS[option]], [method], drawn=False)) == same, (option, method)


def test_the_sentence_names_the_methods_that_use_the_option() -> None:
    assert unused_options([OPTIONS["particles"], OPTIONS["align"]], ["ekf", "dr"], drawn=False) == [
        "particles has no effect on ekf, dr (it is for cpf, upf, pf, pf-wekf)"
    ]
    assert unused_options([OPTIONS["particles"], OPTIONS["seed"]], ["ekf", "cpf"], drawn=False) == []
    each_seed_a_dive = unused_options([OPTIONS["seed"], OPTIONS["seeds"]], ["ekf"], drawn=True)
    assert each_seed_a_dive == []


@pytest.mark.long
def test_replay_compare_drill_and_check_say_it_in_one_line_and_go_on(tmp_path: Path) -> None:
    file = tmp_path / "dive.mcap"
    write_scenario(SHORT, 0, file)
    (tmp_path / "gate.toml").write_text(
        'schema = 1\n[[row]]\nname = "r"\nlog = "dive.mcap"\nfilter = "dr"\nparticles = 20\n'
        "[row.metrics]\nmean_horizontal_m = { rel = 1 }\n",
        encoding="utf-8",
    )
    said = "particles has no effect on dr (it is for cpf, upf, pf, pf-wekf)"
    one = ("--jobs", 1, "--quiet")

    replayed = run("replay", file, "-f", "dr", "-N", 20, "-o", tmp_path / "run", "--plots", "none", "-q")
    compared = run("compare", file, "-f", "dr", "--particles", 20, *one)
    drilled = run("drill", file, "-f", "dr", "--particles", 20, "--drop", "dvl@5:6", *one)
    checked = run("check", tmp_path / "gate.toml", "-o", "none", *one)

    for done in (replayed, compared, drilled):
        assert done.stderr.splitlines()[0] == f"usbldr: --{said}"
        assert done.return_value == 0
    assert checked.stderr.splitlines()[0] == f"usbldr: {tmp_path / 'gate.toml'}: row 'r': {said}"
    assert "no effect" not in run("compare", file, "-f", "dr,cpf", "--particles", 20, *one).stderr


DIVE = SAMPLES / "lawnmower_turn_db3"


def replayed(tmp_path: Path, *options: str) -> tuple[str, list[str]]:
    done = run("replay", DIVE, "-f", "ekf", "-o", tmp_path / "run", "--force", "--plots", "none", "-q", *options)
    assert done.return_value == 0
    return done.stdout, done.stderr.splitlines()


def test_verbose_and_progress_say_what_is_read_chosen_and_why_and_the_time_and_place_of_each_stage(tmp_path):
    usual, quiet = replayed(tmp_path)
    (result, said), (same, lines) = (replayed(tmp_path, *words) for words in (["--verbose"], ["--progress", "json"]))

    assert result == same == usual
    assert not [line for line in quiet if "read the log" in line]
    for wanted in ("log: ", "configuration: ", "dvl: /dvl/data (", "  axes FRD (configuration)", "truth: "):
        assert any(line.startswith(f"usbldr: {wanted}") for line in said), (wanted, said)
    timed = [line.rpartition(": ") for line in said if line.endswith(" s") and not line.startswith("usbldr:  ")]
    took_s = {name.removeprefix("usbldr: "): float(seconds[:-2]) for name, _, seconds in timed}
    assert {"open the log", "read the log", "run ekf", "write the results"} <= set(took_s)
    assert all(seconds >= 0 for seconds in took_s.values())
    assert not logging.getLogger("usbldr").handlers  # the next command in this process is silent again

    events = [json.loads(line) for line in lines if line.startswith("{")]
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
