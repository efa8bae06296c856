"""An option that changes nothing for the chosen methods is said: the tracks themselves are the oracle."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from commands import run
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import StudentT
from usbldr.filters.replay.methods import METHODS
from usbldr.io.log import Log
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.files import write_scenario
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log
from usbldr.io.session import RunSettings, replay
from usbldr_cli.compare import compare
from usbldr_cli.options.option import Option
from usbldr_cli.options.unused_options import unused_options

SHORT = dataclasses.replace(find_scenario("paper"), duration_s=20.0)
OTHER: dict[str, Any] = {  # by option: another value than the default
    "particles": 30,
    "seed": 5,
    "calibrate": ("scale",),
    "noise": {"usbl": StudentT(2.5)},
    "order": "arrival",
    "guard": True,
}
OPTIONS = {str(param.name): param for param in compare.params if isinstance(param, Option)}


@pytest.fixture(scope="module")
def log() -> Log:
    made = simulated_log(SHORT, 0)
    fixes = made.tables["usbl"]
    late = fixes.assign(received_s=fixes["time_s"] + 1.5)  # so that their order matters
    return dataclasses.replace(made, tables={**made.tables, "usbl": late})


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
