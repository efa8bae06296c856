"""The bootstrap particle filter: scatter by the motion's noise, weigh by the likelihood, resample.

N. Gordon, D. Salmond and A. Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE Proc. F
140(2), 1993, doi:10.1049/ip-f-2.1993.0015. A particle is a Gaussian without spread, so the bank's functions serve.
"""

import math
from dataclasses import dataclass

import numpy as np

from usbldr.filters.bank import Gaussians, equal_weights, moments, predict, project
from usbldr.filters.cpf import ParticleBelief
from usbldr.filters.filter import Chance, Estimate, Prior, Step, record
from usbldr.filters.motion import MotionModel
from usbldr.filters.policies import modes
from usbldr.filters.resampling import effective_size, normalised, systematic
from usbldr.filters.rules import linearised
from usbldr.filters.types import Update


@dataclass(frozen=True, slots=True)
class BootstrapParticleFilter:
    """N points that move by chance; the state has to be small and noisy, for it needs thousands of them."""

    motion: MotionModel
    particles: int = 1000
    resample_below: float = 0.5  # share of N
    start_seed: int = 0

    def start(self, prior: Prior) -> ParticleBelief:
        """Return N draws from the prior."""
        rng = np.random.default_rng((self.start_seed, 2**32))  # no epoch has this number
        draws = prior.mean[:, None] + np.linalg.cholesky(prior.cov) @ rng.normal(size=(len(prior.mean), self.particles))
        bank = Gaussians(draws, np.zeros((*prior.cov.shape, self.particles)), equal_weights(self.particles))
        return ParticleBelief(bank, (), (), float(self.particles), math.nan)

    def step(self, belief: ParticleBelief, step: Step, chance: Chance) -> ParticleBelief:
        """Return the belief after the step: move, scatter, weigh, resample."""
        rng = chance()
        bank = predict(belief.bank, self.motion, linearised, step.t0_s, step.t1_s)
        bank = _scattered(bank, rng)
        updates: list[Update] = []
        least = float(self.particles)
        for measurement in step.measurements:
            seen = project(bank, measurement, linearised)
            updates.append(record(measurement, seen, np.exp(bank.log_weight), rejected=False))
            log_l = modes(seen, measurement.noise).log_likelihood
            bank = bank._replace(log_weight=normalised(bank.log_weight + log_l))
            ess = effective_size(bank.log_weight)
            least = min(least, ess)
            if ess < self.resample_below * self.particles:
                bank = bank.offspring(systematic(np.exp(bank.log_weight), rng))
        return ParticleBelief(bank, (), tuple(updates), least, math.nan)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Return the weighted mean and covariance of the cloud."""
        mean, cov = moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, belief.acceptance)


def _scattered(bank: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Turn the process noise that the prediction left as variance into chance; it has no covariances."""
    variance = np.einsum("iin->in", bank.cov)
    if not variance.any():
        return bank
    return bank._replace(
        mean=bank.mean + np.sqrt(variance) * rng.standard_normal(bank.mean.shape), cov=np.zeros_like(bank.cov)
    )
