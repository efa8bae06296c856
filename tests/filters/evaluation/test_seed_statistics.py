"""Statistics over seeds, and over the blocks of one log."""

import math

import numpy as np
import pytest

from usbldr.filters.evaluation.seed_statistics import (
    average,
    diverged_share,
    mean_difference,
    paired_difference,
    pooled_nees,
    significant_among,
    student_quantile,
    two_sided,
)


def test_a_mean_carries_the_standard_error_of_its_runs() -> None:
    found = average([1.0, 2.0, 3.0, 6.0])

    assert found.mean == 3.0
    assert found.se == pytest.approx((14 / 3 / 4) ** 0.5)  # squares about the mean: 4 + 1 + 0 + 9
    assert found.median == 2.5


def test_a_single_run_has_no_standard_error_and_two_have_no_verdict() -> None:
    found = paired_difference([1.0, 2.0], [9.0, 10.1])

    assert average([0.5]).se is None
    assert paired_difference([0.5], [0.7]).significant is None
    assert (found.se, found.significant) == (pytest.approx(0.05), None)


def test_a_paired_difference_is_judged_by_its_own_scatter_over_the_same_runs() -> None:
    scattered = paired_difference([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    steady = paired_difference([1.0, 20.0, 300.0], [2.0, 21.1, 301.2])

    assert (scattered.mean, scattered.se) == (-2.0, pytest.approx(3**-0.5))
    assert scattered.significant is False  # t = 3.46 where Student's table asks for 4.303
    assert steady.significant is True  # the dives differ by far more than the methods
    with pytest.raises(ValueError, match="2 and 1 runs"):
        paired_difference([1.0, 2.0], [1.0])


@pytest.mark.parametrize(
    ("dof", "printed"), [(1, 12.706), (2, 4.303), (3, 3.182), (4, 2.776), (9, 2.262), (29, 2.045), (100, 1.984)]
)
def test_quantiles_of_student_are_those_of_the_printed_table(dof: int, printed: float) -> None:
    assert student_quantile(0.975, dof) == pytest.approx(printed, rel=2e-3)


def test_runs_over_five_metres_have_diverged() -> None:
    assert diverged_share([0.3, 5.0, 5.1, 40.0]) == 0.5


def test_the_mean_nees_of_independent_runs_has_the_bounds_of_all_their_errors() -> None:
    found = pooled_nees([1.5, 2.5], [25.0, 25.0])

    assert found.mean == 2.0
    assert found.independent_errors == 50
    assert found.low * 50 == pytest.approx(74.222, rel=1e-3)  # printed table, 100 degrees of freedom
    assert found.high * 50 == pytest.approx(129.561, rel=1e-3)


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
