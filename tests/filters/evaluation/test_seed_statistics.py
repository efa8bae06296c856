import pytest

from usbldr.filters.evaluation.seed_statistics import (
    average,
    diverged_share,
    paired_difference,
    pooled_nees,
    student_quantile,
)


def test_a_mean_carries_the_standard_error_of_its_runs() -> None:
    found = average([1.0, 2.0, 3.0, 6.0])

    assert found.mean == 3.0
    assert found.se == pytest.approx((14 / 3 / 4) ** 0.5)  # squares about the mean: 4 + 1 + 0 + 9
    assert found.median == 2.5


def test_a_single_run_has_no_standard_error() -> None:
    assert average([0.5]).se is None
    assert paired_difference([0.5], [0.7]).significant is None


def test_two_runs_have_a_standard_error_but_no_verdict() -> None:
    found = paired_difference([1.0, 2.0], [9.0, 10.1])

    assert found.se == pytest.approx(0.05)
    assert found.significant is None


def test_a_paired_difference_is_judged_by_its_own_scatter() -> None:
    scattered = paired_difference([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    steady = paired_difference([1.0, 20.0, 300.0], [2.0, 21.1, 301.2])

    assert scattered.mean == -2.0
    assert scattered.se == pytest.approx(3**-0.5)
    assert scattered.significant is False  # t = 3.46 where Student's table asks for 4.303
    assert steady.significant is True  # the dives differ by far more than the methods


def test_runs_that_are_not_the_same_cannot_be_paired() -> None:
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
