"""Drift and time to re-acquire, on errors whose answers are known by construction."""

import numpy as np
import pytest

from usbldr.filters.evaluation.fault_response import FaultResponse, fault_response

T = np.arange(0.0, 301.0)
USUAL = np.column_stack([np.full(len(T), 0.6), np.full(len(T), 0.8)])  # 1 m long


def response(error_m: np.ndarray, span_s: tuple[float, float] = (100.0, 160.0)) -> FaultResponse | None:
    return fault_response(T, error_m, T, USUAL, span_s)


def test_the_drift_is_the_displacement_of_the_error_and_not_the_change_of_its_length() -> None:
    error = USUAL.copy()
    error[T > 100] = [-0.6, 0.8]  # as long as before, elsewhere

    found = response(error)

    assert found == (pytest.approx(1.2), 0.0)


def test_the_position_is_re_acquired_when_the_mean_of_the_next_ten_seconds_is_small() -> None:
    error = USUAL.copy()
    error[(T > 100) & (T < 200)] = [30.0, 40.0]
    found = response(error)
    assert found is not None
    assert found.drift_m == pytest.approx(np.hypot(29.4, 39.2))
    assert found.reacquired_s == 40.0  # the window 199 to 208 s still has one error of 50 m in it: 5.9 m


def test_an_error_that_crosses_the_truth_for_a_moment_is_not_re_acquired() -> None:
    error = USUAL * np.where(T > 100, 20.0, 1.0)[:, None]
    error[T == 180] = 0.0
    found = response(error)
    assert found is not None
    assert found.reacquired_s is None


def test_an_error_that_is_as_large_without_the_fault_counts_as_re_acquired() -> None:
    usual = USUAL * np.where(T > 160, 8.0, 1.0)[:, None]
    found = fault_response(T, 1.4 * usual, T, usual, (100.0, 160.0))
    assert found is not None
    assert found.reacquired_s == 0.0


def test_a_fault_until_the_end_has_a_drift_and_is_never_re_acquired() -> None:
    error = USUAL + np.clip(T - 100, 0, None)[:, None] * [0.0, 0.1]
    assert response(error, (100.0, 300.0)) == (pytest.approx(20.0), None)
    assert fault_response(T[200:], error[200:], T, USUAL, (100.0, 160.0)) is None
