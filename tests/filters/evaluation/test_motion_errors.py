"""Errors of heading and velocity against a truth that has them."""

import dataclasses

import numpy as np
import pytest

from usbldr.filters.evaluation.evaluation import evaluate
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
