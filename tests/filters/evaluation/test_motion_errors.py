"""Errors of heading and velocity against a truth that has them; drift in percent of ways that one can count."""

import dataclasses

import numpy as np
import pytest

from usbldr.filters.evaluation.evaluation import evaluate
from usbldr.filters.evaluation.metrics import distance_m, relative_errors
from usbldr.filters.types import Array, Trajectory, Truth, Vector

SECONDS = np.arange(100.0)
WAY_M = np.column_stack([SECONDS, SECONDS**2 / 50])
YAW_RAD = np.radians(SECONDS * 9)  # two and a half turns
VELOCITY_MPS = np.column_stack([0.1 * np.sin(SECONDS), 1 + 0 * SECONDS])
TRUTH = Truth(SECONDS, WAY_M, np.full(100, np.nan), "slam", "/slam", yaw_rad=YAW_RAD, velocity_mps=VELOCITY_MPS)


def track(yaw_rad: Vector, velocity_mps: Array, position_m: Array = WAY_M) -> Trajectory:
    state = np.column_stack([yaw_rad, velocity_mps, position_m])
    return Trajectory("adf", ("psi", "u", "v", "x", "y"), SECONDS, state, None)


def test_a_constant_error_is_the_mean_clockwise_and_whole_turns_do_not_count() -> None:
    found = evaluate(track(YAW_RAD - np.radians(3) + 4 * np.pi, VELOCITY_MPS), TRUTH).heading

    assert found is not None
    assert tuple(found) == pytest.approx((3.0, 3.0, 3.0))


def test_white_errors_have_their_root_mean_square() -> None:
    rng = np.random.default_rng(4)
    error_deg, error_mps = rng.normal(0, 2, 100), rng.normal(0, (0.1, 0.3), (100, 2))

    found = evaluate(track(YAW_RAD + np.radians(error_deg), VELOCITY_MPS + error_mps), TRUTH).flat()

    rmse_mps = np.sqrt(np.mean(error_mps**2, axis=0))
    assert found["rmse_heading_deg"] == pytest.approx(np.sqrt(np.mean(error_deg**2)))
    assert found["max_abs_heading_deg"] == pytest.approx(np.abs(error_deg).max())
    assert found["bias_heading_deg"] == pytest.approx(-error_deg.mean())
    assert [found["rmse_starboard_mps"], found["rmse_forward_mps"]] == pytest.approx(rmse_mps)
    assert found["bias_forward_mps"] == pytest.approx(error_mps[:, 1].mean())


def test_a_track_that_is_turned_onto_the_truth_is_turned_with_its_heading() -> None:
    angle = np.radians(20)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    found = evaluate(track(YAW_RAD + angle, VELOCITY_MPS, WAY_M @ turn.T), TRUTH, align="rigid").heading

    assert found.max_abs_deg < 1e-6


def test_without_headings_of_track_or_truth_there_is_no_error() -> None:
    raw = Trajectory("usbl", ("x", "y"), SECONDS, WAY_M, None)
    bare = dataclasses.replace(TRUTH, yaw_rad=None, velocity_mps=None)

    for report in (evaluate(raw, TRUTH), evaluate(track(YAW_RAD, VELOCITY_MPS), bare)):
        assert (report.heading, report.velocity) == (None, None)
        assert report.flat()["rmse_heading_deg"] is None


LONG_S = np.arange(1001.0)
EAST_M = np.column_stack([LONG_S, 0 * LONG_S])  # 1 m/s


def by_length(error_m: np.ndarray, time_s: np.ndarray = LONG_S, truth_m: np.ndarray = EAST_M) -> dict[float, float]:
    return {one.length_m: one.mean_percent for one in relative_errors(time_s, error_m, truth_m, 30.0)}


def test_a_scale_error_of_two_percent_is_two_percent_over_every_length() -> None:
    found = relative_errors(LONG_S, 0.02 * EAST_M, EAST_M, 30.0)

    assert [one.length_m for one in found] == [10, 20, 50, 100, 200, 500]
    for one in found:
        assert (one.mean_percent, one.rms_percent, one.p95_percent) == pytest.approx((2.0, 2.0, 2.0))
        assert one.segments == 1001 - one.length_m


def test_a_constant_shift_is_no_drift() -> None:
    error_m = 0.01 * EAST_M
    assert by_length(error_m + np.array([900.0, -40.0])) == pytest.approx(by_length(error_m))


def test_a_wrong_heading_is_drift_and_is_not_turned_away() -> None:
    turned = EAST_M @ np.array([[np.cos(0.05), np.sin(0.05)], [-np.sin(0.05), np.cos(0.05)]])
    assert by_length(turned - EAST_M)[200.0] == pytest.approx(100 * 2 * np.sin(0.025))


def test_the_noise_of_a_truth_at_rest_is_no_way() -> None:
    noise_m = np.random.default_rng(3).normal(0.0, 0.3, (1001, 2))
    assert distance_m(noise_m)[-1] == 0.0
    assert distance_m(EAST_M + noise_m)[-1] == pytest.approx(1000.0, rel=0.03)


def test_no_segment_crosses_a_gap_of_the_truth() -> None:
    late_s = LONG_S + np.where(LONG_S > 500, 100.0, 0.0)
    jump_m = np.column_stack([np.where(LONG_S > 500, 50.0, 0.0), 0 * LONG_S])
    assert by_length(jump_m, late_s) == dict.fromkeys((10, 20, 50, 100, 200), 0.0) | {500: 0.0}
