"""The confidence of one dive's mean difference: series whose mean is known, and probabilities by hand."""

import math

import numpy as np
import pytest

from usbldr.filters.evaluation.block_bootstrap import mean_difference, significant_among, two_sided


def ar1(a: float, count: int, rng: np.random.Generator) -> np.ndarray:
    noise = rng.normal(size=count + 300)
    series = np.zeros(count + 300)
    for k in range(1, len(series)):
        series[k] = a * series[k - 1] + noise[k]
    return series[300:]


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_intervals_of_correlated_errors_cover_the_known_mean_in_95_of_100_dives(a: float) -> None:
    """Of 300 dives 285 ± 3.8 are expected; that without the correlation is some 30 % of them for a = 0.9."""
    rng = np.random.default_rng(5)
    found = [mean_difference(ar1(a, 900, rng)) for _ in range(300)]

    assert 0.91 <= np.mean([not one.significant for one in found]) <= 0.98
    usual_se = 1 / (1 - a) / math.sqrt(900)  # of the mean of an AR(1) series of unit innovations
    assert np.median([one.se for one in found if one.se is not None]) == pytest.approx(usual_se, rel=0.2)


def test_a_difference_of_four_standard_errors_is_found() -> None:
    rng = np.random.default_rng(6)
    shift = 4 * 10 / math.sqrt(3000)

    assert np.mean([bool(mean_difference(shift + ar1(0.9, 3000, rng)).significant) for _ in range(50)]) > 0.9


def test_holm_steps_down_from_the_least_probability() -> None:
    several = [0.001, 0.02, 0.04, 0.03]  # limits 0.0125, 0.0167, 0.025, 0.05: the second fails, and all after it

    assert [significant_among(one, several) for one in several] == [True, False, False, False]
    assert [significant_among(one, [0.001, 0.012, 0.024, 0.04]) for one in (0.001, 0.012, 0.024, 0.04)] == [True] * 4


def test_probabilities_are_those_of_student_in_tables() -> None:
    assert two_sided(4.303, 2) == pytest.approx(0.05, rel=1e-3)
    assert two_sided(2.228, 10) == pytest.approx(0.05, rel=5e-3)
    assert mean_difference(np.zeros(900)).significant is None
