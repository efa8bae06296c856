"""A truth that moves faster than any vehicle: named with the place, the count and what to do."""

import numpy as np
import pytest

from usbldr.filters.types import Array, Truth, Vector
from usbldr.io.conventions.sanity import truth_jump_findings

SECONDS = np.arange(60.0)
STRAIGHT_M = np.column_stack([1.5 * SECONDS, np.zeros(60)])


def said(position_m: Array, time_s: Vector = SECONDS) -> list[str]:
    truth = Truth(time_s, position_m, np.full(len(time_s), np.nan), "slam", "slam.txt")
    return [finding.text for finding in truth_jump_findings(truth)]


def moved(*jumps: tuple[slice | list[int], float]) -> Array:
    position_m = STRAIGHT_M.copy()
    for rows, metres in jumps:
        position_m[rows, 1] += metres
    return position_m


@pytest.mark.parametrize(
    ("position_m", "text"),
    [
        (moved((slice(2), 61.0)), "the truth jumps by 61 m between 1.0 and 2.0 s, faster than any vehicle (20 m/s): "
         "score what follows with --start 2"),
        (moved((slice(50, None), 61.0)), "the truth jumps by 61 m between 49.0 and 50.0 s, faster than any vehicle "
         "(20 m/s): score what comes before with --end 49"),
        (moved(([20, 45], 61.0), ([40], 100.0)), "3 single truth rows lie off both neighbours, at most by 100 m at "
         "40.0 s, faster than any vehicle (20 m/s): errors near there are the truth's; leave these rows out of it"),
        (moved((slice(20, 50), 200.0), ([10], 100.0)), "the truth jumps 2 times, at most by 200 m between 19.0 and "
         "20.0 s and 1 single truth row lies off both neighbours, at most by 100 m at 10.0 s, faster than any vehicle "
         "(20 m/s): errors near there are the truth's; leave these rows out of it"),
    ],
    ids=["a jump at first", "a jump at last", "outliers", "jumps and an outlier"],
)  # fmt: skip
def test_jumps_and_outliers_are_one_finding_that_says_what_to_do(position_m: Array, text: str) -> None:
    assert said(position_m) == [f"slam.txt: {text}"]


@pytest.mark.parametrize("scatter_m", [0.02, 3.0])
def test_noise_of_a_fast_receiver_is_no_jump(scatter_m: float) -> None:
    time_s = np.arange(0, 60, 0.05)
    position_m = np.random.default_rng(1).normal(0, scatter_m, (len(time_s), 2)) + np.outer(time_s, [1.5, 0])

    assert said(position_m, time_s) == []


def test_a_position_that_is_held_and_then_moves_on_is_no_jump() -> None:
    held_s = np.arange(0, 60, 0.1)

    assert said(np.column_stack([5 * np.floor(held_s), 0 * held_s]), held_s) == []


def test_gaps_and_short_truths_are_no_jumps() -> None:
    dived = np.concatenate([SECONDS[:30], SECONDS[30:] + 600])

    assert said(moved((slice(30, None), 900.0)), dived) == []
    for rows in range(3):
        assert said(STRAIGHT_M[:rows], SECONDS[:rows]) == []
    assert said(np.zeros((60, 2))) == []
