"""Noise modes against closed forms."""

import math

import numpy as np
import pytest

from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT, chi_square_quantile, robust_sd

R = np.array([[2.0, 0.5], [0.5, 1.0]])


def test_shares_add_to_one_and_mode_0_is_nominal() -> None:
    for family in (Gaussian(), Mixture(), Contamination()):
        noise = family.modes(R)
        assert noise.probabilities.sum() == pytest.approx(1)
        np.testing.assert_array_equal(noise.cov[0], R)
    assert StudentT().modes(R).probabilities.sum() == pytest.approx(1)


def test_the_papers_mixture_is_3_7_times_its_nominal_covariance_and_contamination_adds_a_round_gross_error() -> None:
    np.testing.assert_allclose(Mixture(0.30, 10.0).modes(R).mixture_cov, 3.7 * R)
    np.testing.assert_allclose(Contamination(0.05, 10.0).modes(R).cov[1], R + 100 * np.eye(2))


@pytest.mark.parametrize("dof", [2.0, 2.5, 4.0, 10.0, 30.0, 1000.0])
def test_nine_modes_have_the_density_and_the_score_of_student_t(dof: float) -> None:
    r = 2.5
    noise = StudentT(dof).modes(np.array([[r]]))
    e = np.linspace(0, 15, 31)[:, None] * math.sqrt(r)
    scale = math.exp(math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2)) / math.sqrt(dof * math.pi * r)
    want = scale * (1 + e**2 / r / dof) ** (-(dof + 1) / 2)

    v = noise.cov[:, 0, 0]
    each = noise.probabilities * np.exp(-0.5 * e**2 / v) / np.sqrt(2 * np.pi * v)

    np.testing.assert_allclose(each.sum(axis=1), want[:, 0], rtol=0.07)
    score = (each * e / v).sum(axis=1) / each.sum(axis=1)
    np.testing.assert_allclose(score, ((dof + 1) * e / (dof * r + e**2))[:, 0], rtol=0.08)


def test_a_reading_of_20_sigma_pulls_as_little_as_student_t_says() -> None:
    """The score of four degrees of freedom is 5 e / (4 + e^2): .248 at 20 sigma."""
    noise = StudentT(4.0).modes(np.eye(1))
    v = noise.cov[:, 0, 0]
    weight = noise.probabilities * np.exp(-0.5 * 400 / v) / np.sqrt(v)

    assert (weight / v).sum() * 20 / weight.sum() == pytest.approx(0.248, rel=0.1)


PRINTED = [(0.95, 1, 3.841), (0.99, 1, 6.635), (0.95, 2, 5.991), (0.99, 2, 9.210)]
PRINTED += [(0.025, 10, 3.247), (0.975, 10, 20.483), (0.95, 100, 124.342)]


@pytest.mark.parametrize(("probability", "dof", "printed"), PRINTED)
def test_chi_square_quantiles_agree_with_the_printed_table(probability: float, dof: float, printed: float) -> None:
    assert chi_square_quantile(probability, dof) == pytest.approx(printed, rel=0.025)


def test_robust_sd_sees_the_noise_and_not_the_jumps() -> None:
    rng = np.random.default_rng(0)
    series = 0.2 * rng.normal(size=20_000) + np.repeat(rng.normal(size=20), 1000)

    assert robust_sd(np.diff(series)) == pytest.approx(0.2, rel=0.03)
    assert math.isnan(robust_sd([]))


def test_outliers_of_students_t_lie_beyond_about_three_sigma() -> None:
    """Of Student-t with 4 degrees of freedom 4 in 100 values lie beyond 3 sigma."""
    noise = StudentT(4.0).modes(np.eye(1))

    def nominal(x: float) -> float:
        weight = noise.probabilities * np.exp(-0.5 * x**2 / noise.cov[:, 0, 0]) / np.sqrt(noise.cov[:, 0, 0])
        return float(weight[noise.is_nominal].sum() / weight.sum())

    assert nominal(2.0) > 0.5
    assert nominal(4.0) < 0.5
    assert Mixture(0.3, 10.0).modes(np.eye(2)).is_nominal.tolist() == [True, False]
    assert Contamination(0.05, 10.0).modes(np.eye(2)).is_nominal.tolist() == [True, False]
