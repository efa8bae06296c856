"""Resampling against its definition."""

import numpy as np
import pytest

from usbldr.filters.estimators.resampling import effective_size, normalised, systematic


def test_each_particle_is_drawn_its_share_give_or_take_one() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        weights = rng.dirichlet(np.ones(50))
        counts = np.bincount(systematic(weights, rng), minlength=50)
        assert np.all(np.abs(counts - 50 * weights) < 1)


def test_on_average_each_particle_is_drawn_its_share() -> None:
    rng = np.random.default_rng(1)
    weights = np.array([0.05, 0.15, 0.3, 0.5])
    counts = sum(np.bincount(systematic(weights, rng), minlength=4) for _ in range(20_000)) / 20_000

    np.testing.assert_allclose(counts, 4 * weights, atol=0.02)


def test_a_single_heavy_particle_is_the_only_ancestor() -> None:
    assert set(systematic(np.array([0.0, 1.0, 0.0]), np.random.default_rng(2))) == {1}


def test_effective_size_runs_from_one_to_n() -> None:
    assert effective_size(np.full(7, -np.log(7))) == pytest.approx(7)
    assert effective_size(normalised(np.array([0.0, -800.0, -900.0]))) == pytest.approx(1)


def test_weights_too_small_for_a_float_still_normalise() -> None:
    assert np.exp(normalised(np.array([-5000.0, -5001.0]))).sum() == pytest.approx(1)
