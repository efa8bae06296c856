"""The reference numbers that the collectors of the field logs measured, met by our own.

No error of a log that is held back is measured here.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from field.logs import CASES
from survey.errors import anchored, euler, fitted, fix_offsets, statistics
from survey.expected import EXPLAINED, Number, compared, expected, last_digit, leaves, tolerance_of
from survey.measured import measured
from usbldr.filters.errors import LogError
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Truth
from usbldr.io.log import Log

NAMES = [case.name for case in CASES.values() if case.folder]


@pytest.fixture(scope="module", params=NAMES)
def numbers(request: pytest.FixtureRequest, field_logs: Path) -> Sequence[Number]:
    case = CASES[request.param]
    ours = measured(field_logs, case.name, errors=not case.held_back)
    return compared(case.name, expected(field_logs / case.folder, case.name), ours)


def test_every_number_of_the_collectors_is_met_or_its_difference_explained(numbers: Sequence[Number]) -> None:
    missed = {(one.log, one.key) for one in numbers if not one.met and not one.held_back}

    assert missed == {known for known in EXPLAINED if known[0] == numbers[0].log}


def test_errors_against_gps_of_logs_that_judge_the_defaults_are_all_that_is_not_measured(
    numbers: Sequence[Number],
) -> None:
    case = CASES[numbers[0].log]

    unmeasured = {one.key for one in numbers if one.ours is None}

    assert bool(unmeasured) == case.held_back
    assert unmeasured == {one.key for one in numbers if one.held_back}
    assert all("error" in key or "dead_reckoning" in key for key in unmeasured)
    assert len(numbers) > 80


DOCUMENT = {
    "origin": {"lat_deg": 1.0, "tolerance_m": 111.0},
    "dvl": {"path_m": 5.0, "n": 3, "path_tolerance_m": 2.0},
    "range_m": {"min": 1.25, "tolerance": 0.5},
    "usbl_error_x": {"mean_m": 1.0, "p95_m": 2.0, "n": 7, "tolerance": {"mean_m": 0.1, "n": 2}},
    "usbl_synthetic": {"fixes": 4, "error_all": {"mean_m": 1.0, "max_m": 3.0}, "tolerance": {"mean_m": 0.3}},
    "depth_m": {"min": 0.121},
}


@pytest.mark.parametrize(
    ("way", "tolerance"),
    [
        ("origin.lat_deg", 0.001),
        ("dvl.path_m", 2.0),
        ("dvl.n", 0.0),
        ("range_m.min", 0.5),
        ("usbl_error_x.mean_m", 0.1),
        ("usbl_error_x.p95_m", None),
        ("usbl_error_x.n", 2),
        ("usbl_synthetic.fixes", 0.0),
        ("usbl_synthetic.error_all.mean_m", 0.3),
        ("usbl_synthetic.error_all.max_m", None),
        ("depth_m.min", 0.001),
    ],
)
def test_a_tolerance_is_the_one_that_is_stated_nearest(way: str, tolerance: float | None) -> None:
    theirs = {".".join(steps): value for steps, value in leaves(DOCUMENT)}

    assert set(theirs) >= {way}
    assert tolerance_of(DOCUMENT, tuple(way.split(".")), theirs[way]) == (
        None if tolerance is None else pytest.approx(tolerance)
    )


@pytest.mark.parametrize(("number", "unit"), [(1.25, 0.01), (-0.5, 0.1), (339.0, 0.1), (5e-06, 1e-6), (1.9e-05, 1e-6)])
def test_a_number_is_known_to_the_last_digit_that_is_written(number: float, unit: float) -> None:
    assert last_digit(number) == pytest.approx(unit)


@pytest.mark.parametrize(
    ("ours", "met"), [(1.1, True), (1.11, False), (0.9, True), (None, False), ("1.0", False), (float("nan"), False)]
)
def test_a_number_is_met_within_its_tolerance(ours: float | str | None, met: bool) -> None:
    assert Number("log", "mean_m", 1.0, ours, 0.1).met is met


@pytest.fixture
def log() -> Log:
    """East for 10 s at 1 m/s, from 4 to 8 s without bottom lock; the truth lies elsewhere and is turned."""
    t = np.arange(11.0)
    speed = {"time_s": t, "starboard_mps": np.ones(11), "forward_mps": np.zeros(11), "valid": (t < 4) | (t > 8)}
    compass = {"time_s": t, "heading_deg": np.zeros(11)}
    truth = Truth(
        np.arange(-2.0, 13.0), np.column_stack([np.full(15, 7.0), np.arange(-2.0, 13.0)]), np.zeros(15), "", ""
    )
    usbl = {"time_s": [-5.0, 2.0, 4.5], "east_m": [0.0, 7.0, 10.0], "north_m": [0.0, 2.0, 8.5]}
    tables = {"dvl": pd.DataFrame(speed), "compass": pd.DataFrame(compass), "usbl": pd.DataFrame(usbl)}
    return Log(Path("made-up"), "", "simulated", 0, tables, {}, Parameters(), truth=truth)


def test_a_record_holds_until_the_next_but_no_longer_than_it_may(log: Log) -> None:
    _, held = euler(log)
    _, stopped = euler(log, 2.0)

    np.testing.assert_allclose(held[-1], [10.0, 0.0])
    np.testing.assert_allclose(stopped[-1], [10.0 - (9.0 - 3.0 - 2.0), 0.0])


def test_a_fit_finds_the_turn_and_leaves_nothing_and_an_anchor_keeps_the_first_row(log: Log) -> None:
    assert log.truth is not None

    errors, found = fitted(log.truth, euler(log))

    assert len(errors) == 11  # rows outside the track are left out
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)
    assert np.degrees(found.rotation_rad) == pytest.approx(90.0)  # anticlockwise: from east to north
    np.testing.assert_allclose(anchored(log.truth, euler(log), -90.0), 0.0, atol=1e-9)
    assert anchored(log.truth, euler(log), 0.0)[-1] == pytest.approx(10.0 * np.sqrt(2))


def test_fixes_are_held_against_the_truth_at_their_own_times(log: Log) -> None:
    np.testing.assert_allclose(fix_offsets(log), [[0.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(fix_offsets(log, np.array([True, False, True])), [[3.0, 4.0]])
    assert statistics(np.array([3.0, 4.0]))["rms_m"] == pytest.approx(np.sqrt(12.5))


def test_a_log_without_truth_has_no_errors(log: Log) -> None:
    with pytest.raises(LogError, match="no truth"):
        fix_offsets(replace(log, truth=None))
