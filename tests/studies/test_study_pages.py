"""The commands of docs/studies, what the scripts of benchmarks change, and that peers solve the same problem."""

import math
import re
import shlex
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
from usbldr.filters.evaluation.error_report import Window
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
