"""Covariances that messages state, and matrices that are none."""

from pathlib import Path

import numpy as np
import pytest

from logs import codes, covariance, logged, places
from recordings import POSE_COVARIANCE, SECOND, T0, Row


def stated(k: int, ee_m2: float, en_m2: float, nn_m2: float) -> Row:
    matrix = np.zeros(36)
    matrix[[0, 1, 6, 7]] = ee_m2, en_m2, en_m2, nn_m2
    values = {"pose.pose.position.x": 10.0 * k, "pose.covariance": matrix}
    return T0 + k * SECOND, "/usbl", POSE_COVARIANCE, values | {"header.stamp": T0 + k * SECOND}


@pytest.mark.parametrize("matrix", [(-1.0, 0.0, 1.0), (-4.0, 0.0, -4.0)])
def test_a_fix_of_negative_variance_is_invalid_beside_others(
    tmp_path: Path, matrix: tuple[float, float, float]
) -> None:
    log = logged(tmp_path, [stated(0, *matrix), stated(1, 4.0, 1.0, 9.0)])

    assert places(log).tolist() == [[10, 0]]
    assert "1 of 2 records are invalid and left out (1 of negative variance)" in codes(log)["USBL-INVALID"]


def test_a_matrix_that_is_no_covariance_counts_as_unknown_and_the_fix_is_used(tmp_path: Path) -> None:
    log = logged(tmp_path, [stated(0, 1.0, 2.0, 1.0), stated(1, 4.0, 1.0, 9.0)])

    assert covariance(log) == pytest.approx(np.eye(2))  # the sigma of a fix that states none is 1 m
    assert places(log).tolist() == [[0, 0], [10, 0]]
    assert "1 of 2 covariances are negative or not positive semidefinite" in codes(log)["COVARIANCE-INVALID"]


@pytest.mark.parametrize("matrix", [(-1.0, 0.0, -1.0), (0.0, 0.0, 0.0), (1.0, 3.0, 9.0)])
def test_unknown_covariances_and_those_of_a_line_are_no_fault(
    tmp_path: Path, matrix: tuple[float, float, float]
) -> None:
    assert "COVARIANCE-INVALID" not in codes(logged(tmp_path, [stated(0, *matrix), stated(1, *matrix)]))
