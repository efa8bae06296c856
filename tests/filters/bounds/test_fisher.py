"""Fisher information against closed forms and adaptive quadrature."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from usbldr.filters.bounds.pcrlb import fisher_information
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, Noise, StudentT

R1 = np.array([[2.3]])
R2 = np.array([[2.0, 0.5], [0.5, 1.0]])


@pytest.mark.parametrize("R", [R1, R2], ids=["scalar", "record"])
def test_of_gaussian_noise_it_is_the_inverse_covariance(R: np.ndarray) -> None:
    np.testing.assert_allclose(fisher_information(Gaussian().modes(R)), np.linalg.inv(R), rtol=1e-10)


def test_of_eq_23_it_is_the_number_of_the_literature_per_scalar_and_per_record() -> None:
    np.testing.assert_allclose(fisher_information(Mixture().modes(R1)) @ R1, [[0.529]], atol=5e-4)
    np.testing.assert_allclose(fisher_information(Mixture().modes(R2)) @ R2, 0.589 * np.eye(2), atol=5e-4)


NOISES = {family: family.modes(R1) for family in (Mixture(), Contamination(0.05, 10.0), StudentT(3.0))}
# mode 0 is not the narrowest
THREE_MODES = Noise(np.array([0.5, 0.3, 0.2]), np.array([[[1.0]], [[0.04]], [[900.0]]]))


@pytest.mark.parametrize("noise", [*NOISES.values(), THREE_MODES], ids=[*map(repr, NOISES), "three modes"])
def test_of_a_scalar_it_agrees_with_adaptive_quadrature(noise: Noise) -> None:
    variances = noise.cov[:, 0, 0]

    def integrand(e: float) -> float:
        p = noise.probabilities * np.exp(-0.5 * e * e / variances) / np.sqrt(2 * math.pi * variances)
        return float((p * e / variances).sum() ** 2 / p.sum())

    sd = np.sqrt(variances)
    edges = [0.0, *np.sort(np.concatenate([0.5 * sd, 3 * sd])), 20 * sd.max()]
    want = 2 * sum(quad(integrand, low, high, epsabs=0, epsrel=1e-10)[0] for low, high in pairwise(edges))

    assert fisher_information(noise)[0, 0] == pytest.approx(want, rel=1e-7)


def test_of_a_record_it_agrees_with_adaptive_quadrature() -> None:
    noise = Contamination(0.2, 3.0).modes(R2)
    inverse, det = np.linalg.inv(noise.cov), np.linalg.det(noise.cov)

    def information(a: int, b: int) -> float:
        def integrand(y: float, x: float) -> float:
            e = np.array([x, y])
            p = noise.probabilities * np.exp(-0.5 * (inverse @ e) @ e) / (2 * math.pi * np.sqrt(det))
            slope = p @ (inverse @ e)
            return float(slope[a] * slope[b] / p.sum())

        return 2 * dblquad(integrand, 0, 20, -20, 20, epsabs=1e-6, epsrel=1e-6)[0]  # p(-e) = p(e)

    want = [[information(a, b) if a <= b else math.nan for b in (0, 1)] for a in (0, 1)]
    np.testing.assert_allclose(np.triu(fisher_information(noise)), np.triu(np.nan_to_num(want)), atol=2e-5)


def test_nine_modes_of_student_t_have_nearly_its_closed_form() -> None:
    for dof in (4.0, 10.0):
        got = fisher_information(StudentT(dof).modes(R1))[0, 0]
        assert got == pytest.approx((dof + 1) / (dof + 3) / R1[0, 0], rel=0.03)


def test_a_mixture_tells_more_than_the_gaussian_that_matches_it() -> None:
    for family in (Mixture(), Contamination(), StudentT()):
        noise = family.modes(R2)
        gain = fisher_information(noise) - np.linalg.inv(noise.mixture_cov)
        assert np.linalg.eigvalsh(gain).min() > 0.05


def test_noise_without_variance_has_no_bound() -> None:
    with pytest.raises(UsageError, match="no bound exists if a sensor has no noise"):
        fisher_information(Gaussian().modes(np.zeros((1, 1))))
