"""The paper's particle filter in its literal reading: `--plugin benchmarks/paper/cpf_literal.py:CPF_LITERAL`.

Read as van der Merwe's unscented particle filter with the cubature rule: particle i carries a covariance P_i, its sigma
point filter gives N(x_i, P_i), a new x_i is drawn from it and weighed with p(z | x) p(x | x_before) / N(x; x_i, P_i).
In dead reckoning the process noise Q is small against P, so p(x | x_before) is a needle that almost no draw meets: the
variance of the log weights grows like trace(P / Q), one particle keeps all the weight, and more particles do not help.

R. van der Merwe, A. Doucet, N. de Freitas and E. Wan, "The unscented particle filter", NIPS 13, 2000.
"""

import math
from dataclasses import dataclass

import numpy as np

from usbldr.filters.estimators.cpf import ParticleBelief
from usbldr.filters.estimators.gaussian_bank import GaussianBank, predict, project, replicate, update
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update
from usbldr.filters.estimators.resampling import effective_size, normalised, systematic
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import MomentTransform, cubature, linearised, unscented
from usbldr.filters.replay.methods import Method
from usbldr.filters.types import Array, Update, Vector


@dataclass(frozen=True, slots=True)
class LiteralParticleFilter:
    """N points, each with a covariance of its own; the noise is matched in the proposal and exact in the weight."""

    motion: MotionModel
    rule: MomentTransform
    particles: int = 100  # the N of the paper
    resample_below: float = 0.5  # share of N: the usual choice

    def start(self, prior: Prior) -> ParticleBelief:
        """Return N copies of the prior; the first step draws from it."""
        return ParticleBelief(replicate(prior.mean, prior.cov, self.particles), (), (), float(self.particles), math.nan)

    def step(self, belief: ParticleBelief, step: Step, make_rng: MakeRng) -> ParticleBelief:
        """Return the belief after the step: propose, draw, weigh, resample."""
        rng = make_rng()
        before = belief.bank
        predicted = predict(before, self.motion, self.rule, step.t0_s, step.t1_s)
        proposal = predicted
        updates: list[Update] = []
        for measurement in step.measurements:
            done: list[Update] = []
            for part in measurement.parts():
                seen = project(proposal, part, self.rule)
                done.append(measurement_update(part, seen, np.exp(proposal.log_weight), rejected=False))
                proposal = update(proposal, seen, part.noise.mixture_cov[:, :, None])
            updates.append(Update.combined(done))
        root = np.moveaxis(np.linalg.cholesky(np.moveaxis(proposal.cov, -1, 0)), 0, -1)
        normals = rng.standard_normal(proposal.mean.shape)
        points = proposal.mean + np.einsum("ijn,jn->in", root, normals)
        log_q = -0.5 * np.sum(normals**2, axis=0) - np.log(np.einsum("iin->in", root)).sum(axis=0)
        cloud = before._replace(mean=points, cov=np.zeros_like(before.cov))
        log_l = np.zeros(self.particles)
        for part in (part for measurement in step.measurements for part in measurement.parts()):
            log_l += mode_likelihoods(project(cloud, part, self.rule), part.noise).log_likelihood
        log_weight = normalised(
            before.log_weight + log_l + self._log_transition(before, predicted, points, step) - log_q
        )
        bank = GaussianBank(points, proposal.cov, log_weight)
        ess = effective_size(log_weight)
        if ess < self.resample_below * self.particles:
            bank = bank.resampled_members(systematic(np.exp(log_weight), rng))
        return ParticleBelief(bank, (), tuple(updates), ess, math.nan)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Return the weighted mean and covariance of the points; adding the P_i would count the spread twice."""
        w = np.exp(belief.bank.log_weight)
        mean = belief.bank.mean @ w
        spread = belief.bank.mean - mean[:, None]
        return Estimate(mean, (spread * w) @ spread.T, belief.updates, belief.ess, belief.acceptance)

    def _log_transition(self, before: GaussianBank, predicted: GaussianBank, points: Array, step: Step) -> Vector:
        """Return log p(x | x_before), constants that all particles share left out; in the first step the prior's."""
        if step.t1_s == step.t0_s:
            inverse = np.linalg.inv(predicted.cov[:, :, 0])
            off = points - predicted.mean
            return -0.5 * np.einsum("in,ij,jn->n", off, inverse, off)
        still = before._replace(cov=np.zeros_like(before.cov))
        moved = predict(still, self.motion, linearised, step.t0_s, step.t1_s).mean
        return -0.5 * np.sum((points - moved) ** 2 / self.motion.noise(step.t0_s, step.t1_s)[:, None], axis=0)


CPF_LITERAL, UPF_LITERAL = (
    Method(
        f"{name}-literal",
        f"{name} in the literal reading of the paper: loses its particles in dead reckoning",
        lambda motion, settings, rule=rule: LiteralParticleFilter(motion, rule, settings.particles),
        draws=True,
        estimates=frozenset(),
    )
    for name, rule in (("cpf", cubature), ("upf", unscented))
)
