"""Normal scores of innovations, against draws from the noise that the model assumes."""

import numpy as np
import pytest

from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, Noise, StudentT
from usbldr.filters.models.normal_scores import normal_scores

R = np.array([[0.6, 0.2], [0.2, 0.9]])
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


def test_for_gaussian_noise_the_squares_add_to_the_normalised_innovation() -> None:
    e = np.array([2.0, -3.0])

    scores = normal_scores(e, PREDICTED, Gaussian().modes(R))

    assert np.sum(np.square(scores)) == pytest.approx(e @ np.linalg.solve(PREDICTED + R, e))


def test_equal_modes_are_one_gaussian() -> None:
    e, twice = np.array([1.0, 0.5]), Noise(np.array([0.4, 0.6]), np.array([R, R]))

    assert normal_scores(e, PREDICTED, twice) == pytest.approx(normal_scores(e, PREDICTED, Gaussian().modes(R)))


def test_an_innovation_of_a_kilometre_has_a_large_finite_score() -> None:
    scores = np.array(normal_scores(np.array([1e3, -1e3]), PREDICTED, Contamination(0.05, 10.0).modes(R)))

    assert (np.abs(scores) > 30).all()
    assert (np.sign(scores) == [1, -1]).all()


def test_a_covariance_that_numbers_cannot_hold_apart_is_singular() -> None:
    predicted = 1e30 * np.ones((2, 2))

    with pytest.raises(np.linalg.LinAlgError):
        normal_scores(np.array([1.0, 2.0]), predicted, Contamination(0.05, 10.0).modes(R))
