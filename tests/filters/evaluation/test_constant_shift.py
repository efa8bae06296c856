"""A constant shift stands apart from what remains of the errors, and no track is judged against an unknown place."""

import dataclasses

import numpy as np
import pytest

from usbldr.filters.evaluation.constant_shift import constant_shift
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.evaluation.summary_sentence import summary_sentence
from usbldr.filters.types import Array, Trajectory, Truth

SECONDS = np.arange(400.0)
WHITE_M = np.random.default_rng(5).normal(size=(400, 2))
LINE_M = np.column_stack([SECONDS, -2 * SECONDS])


def report(shift_m: tuple[float, float], unknown: bool = False, align: str = "auto", name: str = "adf") -> ErrorReport:
    """Score a track of white errors of 1 m, and their right covariance, that is shifted as a whole."""
    truth = Truth(SECONDS, LINE_M, np.full(400, np.nan), "gps", "/gps", place_unknown=unknown)
    cov_m2 = np.tile(np.eye(2), (400, 1, 1))
    track = Trajectory(name, ("x", "y"), SECONDS, LINE_M + WHITE_M + np.array(shift_m), cov_m2)
    return evaluate(track, truth, align=align)


def test_shift_squared_and_remaining_mean_square_are_the_mean_square_error() -> None:
    found = report((30.0, -40.0))

    assert found.shift.length_m**2 + found.shift.rmse_m**2 == pytest.approx(found.horizontal.rmse_m**2, rel=1e-12)
    assert found.shift.share == pytest.approx(found.shift.length_m**2 / found.horizontal.rmse_m**2, rel=1e-12)


def test_what_remains_does_not_depend_on_the_shift() -> None:
    near, far = report((0.0, 0.0)).shift, report((3e3, -4e3)).shift

    assert (far.mean_m, far.rmse_m, far.nees) == pytest.approx((near.mean_m, near.rmse_m, near.nees), rel=1e-6)
    assert far.nees == pytest.approx(2.0, abs=0.3)


def test_a_shift_that_the_sigmas_explain_does_not_dominate() -> None:
    errors_m = np.tile([0.4, 0.3], (9, 1))

    assert not constant_shift(errors_m, np.tile(np.eye(2), (9, 1, 1))).dominates
    assert constant_shift(errors_m, np.tile(0.01 * np.eye(2), (9, 1, 1))).dominates


def test_a_truth_moved_by_metres_and_one_kilometres_away_are_told_likewise() -> None:
    for shift_m, text in (((5.0, 0.0), "5.0"), ((3000.0, -4000.0), "3000.0")):
        found = report(shift_m)
        assert found.mostly_shift
        (warning,) = found.warnings
        assert f"a constant shift ({text}" in warning
        said = f"without a constant shift of {found.shift.length_m:.2f} m {found.shift.mean_m:.2f} m"
        assert said in summary_sentence(found)
    assert not report((0.2, 0.1)).mostly_shift
    assert report((0.2, 0.1)).warnings == ()


def test_against_a_truth_of_unknown_place_the_shift_is_taken_off_every_number() -> None:
    unknown, known = report((90.0, -60.0), unknown=True), report((0.0, 0.0), align="shift")

    assert unknown.alignment.name == "shift"
    for name, value in known.flat().items():
        assert unknown.flat()[name] == (None if value is None else pytest.approx(value, abs=1e-9)), name
    assert summary_sentence(unknown).startswith("adf: mean horizontal error, constant shift removed, 1.")


def test_no_verdict_is_given_against_a_place_that_nobody_stated() -> None:
    for align in ("none", "body"):
        truth = Truth(SECONDS, LINE_M, np.full(400, np.nan), "gps", "/gps", place_unknown=True)
        track = Trajectory("adf", ("psi", "x", "y"), SECONDS, np.column_stack([0 * SECONDS, LINE_M + 50]), None)
        found = evaluate(track, truth, align=align)
        assert not found.judged
        assert summary_sentence(found).startswith("adf: no verdict: the place of the truth on the map")
    assert summary_sentence(report((90.0, 0.0), unknown=True, align="first")).startswith("adf: mean horizontal error")


def moving(track_m: Array, truth_m: Array, sigma_m: float = 1.0) -> tuple[str, ...]:
    """Return the warnings of a track that states a sigma."""
    truth = Truth(SECONDS, truth_m, np.full(400, np.nan), "gps", "/gps")
    track = Trajectory("adf", ("x", "y"), SECONDS, track_m, np.tile(sigma_m**2 * np.eye(2), (400, 1, 1)))
    return tuple(text for text in evaluate(track, truth, align="shift").warnings if "move differently" in text)


def test_a_truth_that_moves_differently_is_named_and_one_that_only_lies_off_is_not() -> None:
    legs_m = np.column_stack([60 * np.sin(SECONDS / 30), SECONDS])
    at_anchor_m = np.column_stack([5 * np.sin(SECONDS / 20), 5 * np.cos(SECONDS / 20)])

    assert moving(legs_m, at_anchor_m)  # a ship's receiver
    assert moving(at_anchor_m, legs_m)  # a track that stays where it is
    assert moving(legs_m, legs_m[:, ::-1])  # its mirror image
    assert not moving(legs_m + WHITE_M, legs_m)
    assert not moving(legs_m + 30 * WHITE_M, legs_m)  # large errors, but along the same path
    assert not moving(legs_m + np.array([900.0, 0.0]), legs_m)
    assert not moving(WHITE_M, 0 * WHITE_M)  # a vehicle that lies still, as certain as it says


def test_methods_are_compared_by_what_remains_too() -> None:
    better = report((60.0, 80.0))
    worse = report((60.0, 80.0), name="usbl")
    worse = dataclasses.replace(worse, shift=worse.shift._replace(mean_m=2 * better.shift.mean_m))

    assert summary_sentence(better, [worse]).endswith("50 % better than raw USBL")
