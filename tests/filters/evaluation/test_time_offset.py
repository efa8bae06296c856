"""A truth's clock that is off, tracks of different epochs, a constant shift, and a truth of another place are named."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import constant_shift
from usbldr.filters.evaluation.error_report import ErrorReport
from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.evaluation.summary_sentence import summary_sentence
from usbldr.filters.evaluation.time_offset import time_offset
from usbldr.filters.types import Array, Trajectory, Truth, Vector

SECONDS = np.arange(600.0)
NOISE_M = np.random.default_rng(3).normal(size=(600, 2))


def turning_m(time_s: Vector) -> Array:
    """Return where a vehicle is on its way round curves, (n, 2)."""
    return np.column_stack([90 * np.sin(time_s / 80), 60 * np.cos(time_s / 50) + 0.4 * time_s])


def truth_of(time_s: Vector, position_m: Array, place_unknown: bool = False) -> Truth:
    sd_m = np.full(len(time_s), np.nan)
    return Truth(time_s, position_m, sd_m, "gps", "/gps", place_unknown=place_unknown)


def track_of(position_m: Array, sd_m: float = 1.0, name: str = "adf") -> Trajectory:
    return Trajectory(name, ("x", "y"), SECONDS, position_m, np.tile(sd_m**2 * np.eye(2), (600, 1, 1)))


@settings(max_examples=20)
@given(late_s=st.floats(-50.0, 50.0), east_m=st.floats(-9.0, 9.0))
def test_the_offset_is_found_within_its_sigma_beside_a_shift(late_s: float, east_m: float) -> None:
    truth = truth_of(SECONDS + late_s, turning_m(SECONDS))

    found = time_offset(SECONDS, turning_m(SECONDS) + NOISE_M + np.array([east_m, 0.0]), truth)

    assert abs(found.late_s - late_s) < 5 * found.sd_s < 0.7
    assert found.notable or abs(late_s) < 2.0


@pytest.mark.parametrize("late_s", [-290.0, 150.0, 300.0])
def test_an_offset_of_minutes_is_found_over_the_part_that_both_have(late_s: float) -> None:
    found = time_offset(SECONDS, turning_m(SECONDS) + NOISE_M, truth_of(SECONDS + late_s, turning_m(SECONDS)))

    assert found.notable
    assert found.late_s == pytest.approx(late_s, abs=0.7)


def test_a_mirror_image_has_no_offset() -> None:
    found = time_offset(SECONDS, turning_m(SECONDS) * [-1, 1] + NOISE_M, truth_of(SECONDS, turning_m(SECONDS)))

    assert found is None or not found.notable or abs(found.late_s) < 60


def test_a_clock_of_18_s_is_said_and_proposed_and_a_right_one_is_not() -> None:
    track = track_of(turning_m(SECONDS) + NOISE_M)

    (warning,) = evaluate(track, truth_of(SECONDS + 18, turning_m(SECONDS))).warnings
    assert "stamps of the truth are 1" in warning
    assert "GPS time and UTC are 18 s apart" in warning
    assert float(re.findall(r"state latency_s = ([\d.]+) under \[gps\]", warning)[0]) == pytest.approx(18, abs=0.3)
    assert evaluate(track, truth_of(SECONDS, turning_m(SECONDS))).warnings == ()
    (warning,) = evaluate(track, truth_of(SECONDS - 40, turning_m(SECONDS))).warnings
    assert "the truth is of another vehicle that goes ahead, such as a ship that tows" in warning


def test_a_proposed_clock_counts_from_the_stated_one() -> None:
    truth = dataclasses.replace(truth_of(SECONDS + 8, turning_m(SECONDS)), section="truth", latency_s=10.0)

    (warning,) = evaluate(track_of(turning_m(SECONDS) + NOISE_M), truth).warnings

    assert float(re.findall(r"state latency_s = ([\d.]+) under \[truth\]", warning)[0]) == pytest.approx(18, abs=0.3)


@pytest.mark.parametrize(("ahead_m", "where"), [(3.0, "ahead"), (-3.0, "astern")])
def test_a_truth_of_another_point_is_named_beside_its_clock(ahead_m: float, where: str) -> None:
    heading = np.sin(SECONDS / 60)
    ahead = np.column_stack([np.sin(heading), np.cos(heading)])
    way_m = np.cumsum(1.5 * ahead, axis=0)
    track = track_of(way_m, 0.1)

    warning = evaluate(track, truth_of(SECONDS, way_m + ahead_m * ahead)).warnings[-1]

    arm_m = float(re.findall(rf"a point ([\d.]+) m {where}: lever_arm_m under \[gps\]", warning)[0])
    assert arm_m == pytest.approx(3.0, rel=0.4)  # part of it is a constant shift
    warning = evaluate(track, truth_of(SECONDS + 18, way_m)).warnings[-1]
    assert "lever_arm_m" not in warning  # no vehicle is so long


def test_on_a_straight_course_a_clock_is_named_beside_the_shift() -> None:
    line_m = np.column_stack([1.2 * SECONDS, 1.6 * SECONDS])
    track = track_of(line_m + NOISE_M)

    (warning,) = evaluate(track, truth_of(SECONDS + 6, line_m)).warnings
    assert "stamps of the truth that are 6.0 s late, or stamps of the fixes that are as much early" in warning
    (warning,) = evaluate(track, truth_of(SECONDS, line_m + np.array([16.0, -12.0]))).warnings
    assert "stamps" not in warning


def test_tracks_are_compared_over_the_time_that_both_have() -> None:
    error_m = np.where(SECONDS < 60, 0.5, 4.0)[:, None] * np.column_stack([np.sin(SECONDS), np.cos(SECONDS)])
    truth = truth_of(SECONDS, turning_m(SECONDS))
    track = evaluate(Trajectory("adf", ("x", "y"), SECONDS, turning_m(SECONDS) + error_m, None), truth)

    def beside_fixes(count: int) -> str:
        s = SECONDS[:count]
        off_m = np.column_stack([np.cos(s), np.sin(s)])
        fixes = evaluate(Trajectory("usbl", ("x", "y"), s, turning_m(s) + off_m, None), truth)
        return summary_sentence(track, [fixes])

    assert beside_fixes(50).endswith("3.65 m, 50 % better than raw USBL")
    assert beside_fixes(2).endswith("3.65 m, not comparable with raw USBL (2 common epochs)")


def test_a_truth_of_another_place_gives_no_result_unless_a_shift_is_fitted() -> None:
    track = Trajectory("adf", ("x", "y"), SECONDS, turning_m(SECONDS), None)
    swapped = truth_of(SECONDS, turning_m(SECONDS) + np.array([4e6, -5e6]))

    with pytest.raises(LogError, match="latitude and longitude are exchanged"):
        evaluate(track, swapped)
    assert evaluate(track, swapped, align="shift").horizontal.mean_m == pytest.approx(0.0, abs=1e-6)


def test_a_difference_from_the_raw_fixes_that_chance_explains_is_said_to_be_one() -> None:
    """Of 600 independent errors, 2 % are within a standard error of 4 %, and 40 % are not."""
    rng, truth = np.random.default_rng(3), truth_of(SECONDS, turning_m(SECONDS))

    def errors(name: str, sd_m: float):
        noise_m = sd_m * rng.normal(size=(len(SECONDS), 2))
        return evaluate(Trajectory(name, ("x", "y"), SECONDS, turning_m(SECONDS) + noise_m, None), truth)

    fixes = errors("usbl", 1.0)
    assert summary_sentence(errors("adf", 0.97), [fixes]).endswith(" % better than raw USBL (not significant)")
    assert summary_sentence(errors("adf", 0.6), [fixes]).endswith(" % better than raw USBL")


LINE_M = np.column_stack([SECONDS, -2 * SECONDS])


def report(shift_m: tuple[float, float], unknown: bool = False, align: str = "auto", name: str = "adf") -> ErrorReport:
    """Score a track of white errors of 1 m, and their right covariance, that is shifted as a whole."""
    truth = truth_of(SECONDS, LINE_M, place_unknown=unknown)
    return evaluate(track_of(LINE_M + NOISE_M + np.array(shift_m), name=name), truth, align=align)


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
        truth = truth_of(SECONDS, LINE_M, place_unknown=True)
        track = Trajectory("adf", ("psi", "x", "y"), SECONDS, np.column_stack([0 * SECONDS, LINE_M + 50]), None)
        found = evaluate(track, truth, align=align)
        assert not found.judged
        assert summary_sentence(found).startswith("adf: no verdict: the place of the truth on the map")
    assert summary_sentence(report((90.0, 0.0), unknown=True, align="first")).startswith("adf: mean horizontal error")


def moving(track_m: Array, truth_m: Array, sigma_m: float = 1.0) -> tuple[str, ...]:
    """Return the warnings of a track that states a sigma."""
    warnings = evaluate(track_of(track_m, sigma_m), truth_of(SECONDS, truth_m), align="shift").warnings
    return tuple(text for text in warnings if "move differently" in text)


def test_a_truth_that_moves_differently_is_named_and_one_that_only_lies_off_is_not() -> None:
    legs_m = np.column_stack([60 * np.sin(SECONDS / 30), SECONDS])
    at_anchor_m = np.column_stack([5 * np.sin(SECONDS / 20), 5 * np.cos(SECONDS / 20)])

    assert moving(legs_m, at_anchor_m)  # a ship's receiver
    assert moving(at_anchor_m, legs_m)  # a track that stays where it is
    assert moving(legs_m, legs_m[:, ::-1])  # its mirror image
    assert not moving(legs_m + NOISE_M, legs_m)
    assert not moving(legs_m + 30 * NOISE_M, legs_m)  # large errors, but along the same path
    assert not moving(legs_m + np.array([900.0, 0.0]), legs_m)
    assert not moving(NOISE_M, 0 * NOISE_M)  # a vehicle that lies still, as certain as it says


def test_methods_are_compared_by_what_remains_too() -> None:
    better = report((60.0, 80.0))
    worse = report((60.0, 80.0), name="usbl")
    worse = dataclasses.replace(worse, shift=worse.shift._replace(mean_m=2 * better.shift.mean_m))

    assert summary_sentence(better, [worse]).endswith("50 % better than raw USBL")
