"""The filters against the whole posterior density on a grid, in one dimension.

x is a random walk drawn towards 0, measured once a second with heavy-tailed noise. The oracle multiplies and smears
densities on a fine grid: it knows no Gaussians, no modes' histories and no particles.
"""

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from paper.cpf_gaussian import GaussianParticleFilter
from textbook import position_steps
from usbldr.filters.bounds.pcrlb import bounds
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.gaussian_bank import predict, project
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import collapse, mode_likelihoods
from usbldr.filters.estimators.pf import BootstrapParticleFilter
from usbldr.filters.estimators.protocol import Prior
from usbldr.filters.models.motion import GaussMarkovIncrement
from usbldr.filters.models.noise import Mixture, Noise
from usbldr.filters.models.sigma_points import cubature, linearised

Q, PULL, START_SD = 0.25, 0.97, 2.0
PRIOR = Prior(np.zeros(1), np.array([[START_SD**2]]))
PAPER = Mixture().modes(np.eye(1))  # eq. (23)
HARSH = Mixture(0.3, 60.0).modes(np.array([[0.2]]))  # its posteriors are lopsided and have two tops now and then
EPOCHS = 30


class Walk:
    """x *= PULL a second, and a random walk."""

    def parts(self, t0_s: float, t1_s: float) -> Iterator:
        yield slice(0, 1), GaussMarkovIncrement((0,), np.array([PULL]), np.zeros(1))

    def noise(self, t0_s: float, t1_s: float):
        return np.array([Q * (t1_s - t0_s)])


class Posterior(NamedTuple):
    mean: np.ndarray  # (EPOCHS,)
    sd: np.ndarray  # (EPOCHS,)
    log_likelihood: np.ndarray  # (EPOCHS,) of each reading given those before


def gaussian(e: np.ndarray, variance: float) -> np.ndarray:
    return np.exp(-0.5 * e * e / variance) / math.sqrt(2 * math.pi * variance)


def likelihood(e: np.ndarray, noise: Noise) -> np.ndarray:
    return np.sum(
        [share * gaussian(e, R[0, 0]) for share, R in zip(noise.probabilities, noise.cov, strict=True)], axis=0
    )


def dive(seed: int, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return a truth and its readings, (EPOCHS,) each."""
    rng = np.random.default_rng(seed)
    x = START_SD * rng.normal(size=EPOCHS)
    for k in range(1, EPOCHS):
        x[k] = PULL * x[k - 1] + math.sqrt(Q) * rng.normal()
    mode = rng.choice(2, size=EPOCHS, p=noise.probabilities)
    return x, x + np.sqrt(noise.cov[mode, 0, 0]) * rng.normal(size=EPOCHS)


GRID = np.linspace(-20.0, 20.0, 801)  # spacing 0.05: a ninth of the narrowest density in it
WIDTH = GRID[1] - GRID[0]
SMEAR = gaussian(GRID[:, None] - PULL * GRID, Q) * WIDTH


def on_the_grid(z: np.ndarray, noise: Noise) -> Posterior:
    """Return the posterior of a dive's readings (EPOCHS,), or of many dives', (EPOCHS, D)."""
    density = gaussian(GRID, START_SD**2)[:, None]
    rows = []
    for k, values in enumerate(z.reshape(EPOCHS, -1)):
        if k:
            density = SMEAR @ density
        density = density * likelihood(values - GRID[:, None], noise)
        total = density.sum(axis=0) * WIDTH
        density = density / total
        mean = GRID @ density * WIDTH
        rows.append((mean, np.sqrt(((GRID[:, None] - mean) ** 2 * density).sum(axis=0) * WIDTH), np.log(total)))
    return Posterior(*(np.reshape(reported, z.shape) for reported in zip(*rows, strict=True)))


def follow(estimator, rule, z: np.ndarray, noise: Noise, seed: int = 0) -> Posterior:
    """Return what a filter says, the likelihood of each reading from its belief just before."""
    belief, rows = estimator.start(PRIOR), []
    for step in position_steps(z, noise):
        before = predict(belief.bank, estimator.motion, rule, step.t0_s, step.t1_s)
        (reading,) = step.measurements
        log_l = mode_likelihoods(project(before, reading, rule), noise).log_likelihood
        belief = estimator.step(belief, step, functools.partial(np.random.default_rng, (seed, step.epoch)))
        estimate = estimator.estimate(belief)
        likely = float(np.exp(before.log_weight + log_l).sum())
        rows.append((estimate.mean[0], math.sqrt(estimate.cov[0, 0]), math.log(likely)))
    return Posterior(*np.array(rows).T)


def test_the_grid_is_the_kalman_filter_where_that_is_exact() -> None:
    plain = Noise(np.ones(1), np.array([[[0.8]]]))
    _, z = dive(0, PAPER)
    got = on_the_grid(z, plain)
    m, P = 0.0, START_SD**2
    for k, value in enumerate(z):
        m, P = (PULL * m, PULL**2 * P + Q) if k else (m, P)
        log_l = -0.5 * (math.log(2 * math.pi * (P + 0.8)) + (value - m) ** 2 / (P + 0.8))
        m, P = m + P / (P + 0.8) * (value - m), P * 0.8 / (P + 0.8)
        np.testing.assert_allclose([reported[k] for reported in got], [m, math.sqrt(P), log_l], atol=1e-8)


BOTH_NOISES = pytest.mark.parametrize("noise", [PAPER, HARSH], ids=["eq. 23", "harsh"])


@BOTH_NOISES
@pytest.mark.parametrize("name", ["cpf", "pf"])
def test_particles_tend_to_the_posterior_on_the_grid(name: str, noise: Noise) -> None:
    """At every epoch the mean over runs lies within 4.5 standard errors, and the bias that a ratio of averages has."""
    _, z = dive(1, noise)
    right = on_the_grid(z, noise)
    runs = []
    for seed in range(20):
        if name == "cpf":
            runs.append(follow(CubatureParticleFilter(Walk(), cubature, 500), cubature, z, noise, seed))
        else:
            runs.append(follow(BootstrapParticleFilter(Walk(), 5000, start_seed=seed), linearised, z, noise, seed))
    for reported, want, unit in zip(zip(*runs, strict=True), right, (right.sd, right.sd, 1.0), strict=True):
        variance = np.var(reported, axis=0, ddof=1) / unit**2
        off = np.abs(np.mean(reported, axis=0) - want) / unit

        assert np.all(off < 4.5 * np.sqrt(variance / len(runs)) + variance + 1e-6)
        assert 4.5 * math.sqrt(variance.max() / len(runs)) < 0.05  # so the comparison is a sharp one


@BOTH_NOISES
@pytest.mark.parametrize("name", ["adf", "cpf-gaussian"])
def test_one_gaussian_at_a_time_loses_little_of_the_posterior(name: str, noise: Noise) -> None:
    """The grid's mean has the least mean squared error there is, its variance; a filter adds its own distance to it.

    Collapsing costs under 1 % with eq. (23), under 4 % with the harsh noise, whitened draws and their errors included.
    """
    excess, surprise, variance = [], [], []
    for seed in range(12):
        _, z = dive(seed, noise)
        want = on_the_grid(z, noise)
        if name == "adf":
            got = follow(KalmanFilter(Walk(), cubature, collapse), cubature, z, noise)
        else:
            got = follow(GaussianParticleFilter(Walk(), cubature, 1000), cubature, z, noise, seed)
        excess.append((got.mean - want.mean) ** 2)
        variance.append(want.sd**2)
        surprise.append(got.log_likelihood - want.log_likelihood)

    assert np.mean(excess) < (0.01 if noise is PAPER else 0.04) * np.mean(variance)
    assert abs(np.mean(surprise)) < 0.02


@BOTH_NOISES
def test_the_least_error_there_is_lies_above_the_bound(noise: Noise) -> None:
    """400 dives are drawn; the mean posterior variance is the error of the best of all estimators.

    Here two or three readings make the estimate, and nobody reaches the bound: it is a tenth too low for eq. (23).
    """
    z = np.stack([dive(seed, noise)[1] for seed in range(400)], axis=1)
    variance = on_the_grid(z, noise).sd ** 2
    steps = list(position_steps(np.zeros(EPOCHS), noise))
    bound = bounds(steps, Walk(), np.zeros((EPOCHS, 1)), PRIOR.cov).filtered[:, 0, 0]

    least, standard_error = variance.mean(axis=1), variance.std(axis=1) / math.sqrt(400)
    assert np.all(least > bound - 3 * standard_error)
    if noise is PAPER:
        assert 1.05 < least[10:].mean() / bound[10:].mean() < 1.2
