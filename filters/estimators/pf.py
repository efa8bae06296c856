"""The bootstrap particle filter: sample the process noise, weigh by the likelihood, resample.

N. Gordon, D. Salmond and A. Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE Proc. F
140(2), 1993, doi:10.1049/ip-f-2.1993.0015. A particle is a Gaussian with covariance 0, so the functions of the bank
apply.

Constant sensor errors are not sampled, since resampling would soon leave a single value. If there are such states, only
the yaw is sampled: given its path the rest is nearly linear, and each particle carries a Gaussian over it, updated for
mixture noise by the collapse of mode_updates.py (T. Schon, F. Gustafsson and P.-J. Nordlund, "Marginalized particle
filters for mixed linear/nonlinear state-space models", IEEE Trans. Signal Processing 53(7), 2005,
doi:10.1109/TSP.2005.849151).
"""

import math
from dataclasses import dataclass

import numpy as np

from usbldr.filters.estimators.cpf import ParticleBelief
from usbldr.filters.estimators.gaussian_bank import (
    GaussianBank,
    equal_weights,
    mixture_moments,
    predict,
    project,
    replicate,
)
from usbldr.filters.estimators.mode_updates import collapse, mode_likelihoods
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update
from usbldr.filters.estimators.resampling import effective_size, normalised, systematic
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import MOTION_STATES
from usbldr.filters.types import Array, Update

SAMPLED_STATES = len(MOTION_STATES)  # fixed: a state with more is marginalised; psi is its row 0


@dataclass(frozen=True, slots=True)
class BootstrapParticleFilter:
    """N sampled states; needs a small state with enough process noise, and thousands of particles."""

    motion: MotionModel
    particles: int = 1000  # with 100 some dives diverge, and 5000 are hardly better
    resample_below: float = 0.5  # share of N: the usual choice
    start_seed: int = 0

    def start(self, prior: Prior) -> ParticleBelief:
        """Return N draws from the prior."""
        rng = np.random.default_rng((self.start_seed, 2**32))  # no epoch has this number
        if len(prior.mean) > SAMPLED_STATES:
            bank = _sampled(replicate(prior.mean, prior.cov, self.particles), rng)
            return ParticleBelief(bank, (), (), float(self.particles), math.nan)
        draws = prior.mean[:, None] + np.linalg.cholesky(prior.cov) @ rng.normal(size=(len(prior.mean), self.particles))
        bank = GaussianBank(draws, np.zeros((*prior.cov.shape, self.particles)), equal_weights(self.particles))
        return ParticleBelief(bank, (), (), float(self.particles), math.nan)

    def step(self, belief: ParticleBelief, step: Step, make_rng: MakeRng) -> ParticleBelief:
        """Return the belief after the step: predict, sample, weigh, resample."""
        rng = make_rng()
        bank = predict(belief.bank, self.motion, linearised, step.t0_s, step.t1_s)
        bank = _sampled(bank, rng)  # x ~ p(x_k | x_{k-1})
        updates: list[Update] = []
        least = float(self.particles)
        for measurement in step.measurements:
            part_updates: list[Update] = []
            for part in measurement.parts():
                projection = project(bank, part, linearised)
                part_updates.append(measurement_update(part, projection, np.exp(bank.log_weight), rejected=False))
                if len(bank.mean) > SAMPLED_STATES:
                    result = collapse(bank, projection, part.noise)
                    bank, log_l = result.bank, result.log_likelihood
                else:
                    log_l = mode_likelihoods(projection, part.noise).log_likelihood
                bank = bank._replace(log_weight=normalised(bank.log_weight + log_l))  # w_k = w_{k-1} p(z | x)
                ess = effective_size(bank.log_weight)
                least = min(least, ess)
                if ess < self.resample_below * self.particles:
                    bank = bank.resampled_members(systematic(np.exp(bank.log_weight), rng))
            updates.append(Update.combined(part_updates))
        return ParticleBelief(bank, (), tuple(updates), least, math.nan)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Return the weighted mean (n,) and covariance (n, n) of the particles."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, belief.acceptance)


def _sampled(bank: GaussianBank, rng: np.random.Generator) -> GaussianBank:
    """Sample the predicted covariance: of all states, or of the yaw alone, with the rest conditional on it."""
    variance = np.einsum("iin->in", bank.cov)
    if len(bank.mean) > SAMPLED_STATES:
        yaw: Array = variance[:1]
        gain: Array = bank.cov[:, 0] * np.where(yaw > 0, 1 / np.where(yaw > 0, yaw, 1.0), 0.0)
        mean = bank.mean + gain * np.sqrt(yaw) * rng.standard_normal(yaw.shape)
        cov = bank.cov - gain[:, None] * gain[None] * yaw
        cov[0], cov[:, 0] = 0.0, 0.0
        return bank._replace(mean=mean, cov=cov)
    if not variance.any():
        return bank
    return bank._replace(
        mean=bank.mean + np.sqrt(variance) * rng.standard_normal(bank.mean.shape), cov=np.zeros_like(bank.cov)
    )
