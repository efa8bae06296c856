"""Drift in percent of the distance travelled, against ways that one can count."""

import numpy as np
import pytest

from usbldr.filters.evaluation.relative_error import distance_m, relative_errors

SECONDS = np.arange(1001.0)
EAST_M = np.column_stack([SECONDS, 0 * SECONDS])  # 1 m/s


def by_length(error_m: np.ndarray, time_s: np.ndarray = SECONDS, truth_m: np.ndarray = EAST_M) -> dict[float, float]:
    return {one.length_m: one.mean_percent for one in relative_errors(time_s, error_m, truth_m, 30.0)}


def test_a_scale_error_of_two_percent_is_two_percent_over_every_length() -> None:
    found = relative_errors(SECONDS, 0.02 * EAST_M, EAST_M, 30.0)

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
    late_s = SECONDS + np.where(SECONDS > 500, 100.0, 0.0)
    jump_m = np.column_stack([np.where(SECONDS > 500, 50.0, 0.0), 0 * SECONDS])
    assert by_length(jump_m, late_s) == dict.fromkeys((10, 20, 50, 100, 200), 0.0) | {500: 0.0}
