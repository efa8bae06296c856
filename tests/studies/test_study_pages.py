"""The commands of docs/studies, what the scripts of benchmarks change, and that peers solve the same problem.

The paper's simulation, section 3.1, over 20 seeds: the accuracy that cpf and adf are held to.
"""

import math
import re
import shlex
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

from checkout import ROOT
from commands import command
from field.defaults import ABLATIONS, MODULES, SENSITIVITY, constants
from field.moved_truth import moved_onto_fixes
from speed.kalman_peers import filterpy_ekf
from speed.peers import dive, moved
from uncalibrated import dive_without_calibration
from usbldr.filters.evaluation.error_report import Window
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay import prior
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from usbldr.filters.types import Timeline, Truth
from usbldr.io.reading.epochs import timeline
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import simulated_log

PAGES = [page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "studies").glob("*.md")]
COMMANDS = sorted({line for page in PAGES for line in re.findall(r"^\$ (.*)$", page, re.MULTILINE)})


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_of_a_study_is_understood_and_its_files_are_there(line: str) -> None:
    program, *words = shlex.split(line)
    files = [word.split(":")[0] for word in words if word.startswith("benchmarks/")]
    assert all((ROOT / file).is_file() for file in files)
    if program == "usbldr":
        command(words[0]).make_context(words[0], words[1:])


@pytest.fixture(scope="module")
def line() -> Timeline:
    """A minute of fixes, one a second, each 2 s late but for the first, which comes 5 s late."""
    whole = timeline(simulated_log(replace(find_scenario("paper"), duration_s=60.0), 0))
    late = whole.fix_time_s + 2.0
    late[0] += 3.0
    return replace(whole, fix_received_s=late, gps_time_s=whole.gps_time_s[10:], gps_m=whole.gps_m[10:])


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
    for name, change in {**ABLATIONS, **SENSITIVITY}.items():
        changed_line, reported = change.records(line), change.before(given, line)
        asked = any(
            attrgetter(constant)(MODULES) != value
            for constant, value in change.constants.items()
            if not constant.startswith("prior.")
        )
        with constants(change.constants):
            begun = prior.prior(line, given, StateLayout())
        starts = any(not np.array_equal(one, other) for one, other in zip(begun, usual, strict=True))
        assert starts or not name.startswith("start."), name
        assert changed_line is not line or reported != given or asked or starts or change.settings, name


def test_the_ekf_of_filterpy_gives_the_track_of_ours() -> None:
    work = dive(60.0)

    ours = run("ekf", work.line, work.log.parameters, FilterSettings(guard=False)).position_m

    assert np.abs(filterpy_ekf(work, moved) - ours).max() < 1e-6


PAPER = find_scenario("paper")

SEEDS = range(20)


def one(name: str, seed: int) -> dict[str, float]:
    """Run one filter on one realisation with the noise model that the scenario writes beside its log."""
    log = dive_without_calibration(PAPER, seed)
    line = timeline(log)
    track = run(name, line, log.parameters, FilterSettings(particles=100, seed=seed))
    assert log.truth is not None
    report = evaluate(track, log.truth, times_s=line.time_s[line.slow])
    return {name: value for name, value in report.flat().items() if value is not None}


@pytest.fixture(scope="module")
def metrics() -> dict[str, dict[str, np.ndarray]]:
    with ProcessPoolExecutor(2) as pool:
        waiting = {name: [pool.submit(one, name, seed) for seed in SEEDS] for name in ("cpf", "adf")}
        rows = {name: [job.result() for job in jobs] for name, jobs in waiting.items()}
    return {
        name: {key: np.array([row.get(key, np.nan) for row in found]) for key in found[0]}
        for name, found in rows.items()
    }


def test_cpf_is_closer_than_the_papers(metrics) -> None:
    """The paper has 0.31 m east and 0.30 m north."""
    assert metrics["cpf"]["mean_abs_east_m"].mean() <= 0.26
    assert metrics["cpf"]["mean_abs_north_m"].mean() <= 0.28


def test_cpf_knows_how_wrong_it_is(metrics) -> None:
    assert 1.5 <= metrics["cpf"]["nees_mean"].mean() <= 3.0
    for sensor in ("dvl", "compass", "usbl"):
        assert metrics["cpf"][f"nis_mean_{sensor}"].mean() == pytest.approx(1.0, abs=0.05)  # per scalar


def test_cpfs_particles_stay_alive(metrics) -> None:
    assert metrics["cpf"]["ess_mean_ratio"].min() > 0.5
    assert metrics["cpf"]["acceptance_mean"].mean() > 0.9


def test_adf_equals_cpf_within_five_per_cent(metrics) -> None:
    """The posterior is almost Gaussian: the likelihood buys the accuracy, not the particles."""
    for axis in ("east", "north"):
        name = f"mean_abs_{axis}_m"
        assert metrics["adf"][name].mean() == pytest.approx(metrics["cpf"][name].mean(), rel=0.05)
