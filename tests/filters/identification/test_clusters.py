"""False fixes in a row: the mixing of both hypotheses, against the law of total moments and exact mixtures."""

import math

import numpy as np
import pytest

from textbook import log_density
from usbldr.filters.estimators.gaussian_bank import GaussianBank
from usbldr.filters.identification import clusters
from usbldr.filters.types import Array

MEMBERS = 3


def two_hypotheses(seed: int) -> GaussianBank:
    """Return three members of position and offset, each with both hypotheses; the first has no offset."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4, 2 * MEMBERS))
    root[2:, :, :MEMBERS] = 0.0
    mean = rng.normal(size=(4, 2 * MEMBERS))
    mean[2:, :MEMBERS] = 0.0
    share = rng.uniform(0.2, 0.8, MEMBERS)
    return GaussianBank(mean, np.einsum("ikm,jkm->ijm", root, root), np.log(np.concatenate([share, 1 - share])))


def switching(dt_s: float) -> tuple[float, float]:
    begins, ends = clusters.switching(np.array([dt_s]))
    return float(begins[0]), float(ends[0])


def position_moments(bank: GaussianBank) -> tuple[Array, Array]:
    merged = clusters.members(bank)
    return merged.mean[:2], merged.cov[:2, :2]


def test_switching_does_not_move_the_position() -> None:
    bank = two_hypotheses(1)

    after = clusters.mixed(bank, *switching(20.0))

    for before_one, after_one in zip(position_moments(bank), position_moments(after), strict=True):
        np.testing.assert_allclose(after_one, before_one, atol=1e-12)
    assert not after.mean[2:, :MEMBERS].any()
    assert not after.cov[2:, :, :MEMBERS].any()


def test_clusters_begin_and_end_at_the_stated_rates() -> None:
    bank = two_hypotheses(2)
    right, false = np.split(np.exp(bank.log_weight), 2)

    after_right, after_false = np.split(np.exp(clusters.mixed(bank, *switching(5.0)).log_weight), 2)

    ends, begins = 1 - math.exp(-5 / clusters.CLUSTER_S), 1 - math.exp(-5 / clusters.BETWEEN_S)
    np.testing.assert_allclose(after_right, right * (1 - begins) + false * ends)
    np.testing.assert_allclose(after_right + after_false, 1.0)


def test_a_fix_that_may_begin_a_cluster_has_the_density_of_the_mixture() -> None:
    sd_m, z = 2.0, np.array([12.0, -5.0])
    one = GaussianBank(np.zeros((4, 1)), np.diag([sd_m**2, sd_m**2, 0.0, 0.0])[:, :, None], np.zeros(1))
    bank = clusters.mixed(clusters.both_hypotheses(one), *switching(1.0))

    H = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    spreads = [H @ bank.cov[:, :, k] @ H.T for k in (0, 1)]
    _, total = clusters.reweighted(bank, np.array([log_density(z, S) for S in spreads]))

    def density(variance_m2: float) -> float:
        return math.exp(-0.5 * float(z @ z) / variance_m2) / (2 * math.pi * variance_m2)

    begins = 1 - math.exp(-1 / clusters.BETWEEN_S)
    wide_m2 = sd_m**2 + clusters.OFFSET_SD_M**2
    expected = (1 - begins) * density(sd_m**2) + begins * density(wide_m2)
    assert math.exp(total[0]) == pytest.approx(expected, rel=1e-9)
