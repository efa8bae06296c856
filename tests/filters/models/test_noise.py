"""Noise modes against closed forms; normal scores of innovations against draws from the noise that is assumed."""

import math

import numpy as np
import pytest

from usbldr.filters.models.noise import (
    Contamination,
    Gaussian,
    Mixture,
    Noise,
    NoiseFamily,
    StudentT,
    chi_square_quantile,
    normal_scores,
    robust_sd,
    shown_sd,
)

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


@pytest.mark.parametrize("family", [Gaussian(), Mixture(), StudentT(), Contamination()])
def test_shown_sd_is_the_robust_sd_of_drawn_noise(family: NoiseFamily) -> None:
    rng, modes = np.random.default_rng(1), family.modes(0.7 * np.eye(2))
    mode = rng.choice(len(modes.probabilities), 100_000, p=modes.probabilities)
    drawn = rng.normal(size=100_000) * np.sqrt(modes.cov[mode, 0, 0])

    assert shown_sd(modes) == pytest.approx(robust_sd(np.diff(drawn)), rel=0.02)


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
    assert Contamination(0.95, 2.0).modes(np.eye(2)).cov[0, 0, 0] == 5.0  # the usual mode is the first


PREDICTED = np.array([[0.3, -0.1], [-0.1, 0.4]])
FAMILIES = [Gaussian(), Mixture(0.3, 10.0), Contamination(0.05, 10.0), StudentT(4.0)]


def drawn(noise: Noise, count: int, rng: np.random.Generator) -> np.ndarray:
    """Innovations (count, k) of a right model: predicted spread plus noise of a mode drawn by its probability."""
    S = PREDICTED[: noise.cov.shape[1], : noise.cov.shape[1]] + noise.cov
    modes = rng.choice(len(S), count, p=noise.probabilities)
    return np.einsum("nkl,nl->nk", np.linalg.cholesky(S)[modes], rng.normal(size=(count, S.shape[1])))


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: type(family).__name__)
@pytest.mark.parametrize("k", [1, 2])
def test_scores_of_a_right_model_are_independent_and_normal(family, k: int) -> None:
    noise, count = family.modes(R[:k, :k]), 4000

    scores = np.array(
        [normal_scores(e, PREDICTED[:k, :k], noise) for e in drawn(noise, count, np.random.default_rng(k))]
    )

    for moment, value, spread in ((1, 0.0, 1.0), (2, 1.0, 2.0), (4, 3.0, 96.0)):  # of N(0, 1), and their variance
        assert (abs((scores**moment).mean(axis=0) - value) < 4 * np.sqrt(spread / count)).all()
    if k == 2:
        assert abs(np.mean(scores[:, 0] * scores[:, 1])) < 4 / np.sqrt(count)
        assert abs(np.mean(scores[:, 0] ** 2 * scores[:, 1] ** 2) - 1) < 4 * np.sqrt(8 / count)


def test_for_gaussian_noise_the_squares_add_to_the_normalised_innovation_and_equal_modes_are_one_gaussian() -> None:
    e, twice = np.array([2.0, -3.0]), Noise(np.array([0.4, 0.6]), np.array([R, R]))

    scores = normal_scores(e, PREDICTED, Gaussian().modes(R))

    assert np.sum(np.square(scores)) == pytest.approx(e @ np.linalg.solve(PREDICTED + R, e))
    assert normal_scores(e, PREDICTED, twice) == pytest.approx(scores)


def test_an_innovation_of_a_kilometre_has_a_large_finite_score() -> None:
    scores = np.array(normal_scores(np.array([1e3, -1e3]), PREDICTED, Contamination(0.05, 10.0).modes(R)))

    assert (np.abs(scores) > 30).all()
    assert (np.sign(scores) == [1, -1]).all()


def test_a_covariance_that_numbers_cannot_hold_apart_is_singular() -> None:
    predicted = 1e30 * np.ones((2, 2))

    with pytest.raises(np.linalg.LinAlgError):
        normal_scores(np.array([1.0, 2.0]), predicted, Contamination(0.05, 10.0).modes(R))
