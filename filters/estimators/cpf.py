"""The cubature particle filter in its Rao-Blackwellised form.

The paper's section 2.2, step by step, in the reading that does not degenerate: a particle is a history of noise modes
with its own cubature Kalman filter (mean and covariance). Then
(1) initial particles are N copies of the prior;
(2) each particle gets its cubature time and measurement update, eqs. (8) to (20);
(3) the importance density is the exact conditional p(mode | history, z), so the weight is the predictive likelihood of
    the measurement, and does not depend on the mode that is drawn: resampling comes before the draw (fully adapted);
(4) resampling is systematic, if the effective sample size is below half of N, and is followed by a Markov chain
    Monte Carlo move over the modes of the last steps, which leaves p(modes | z) invariant;
(5) the estimate is the weighted mean, eqs. (21) and (22) with the weights that the paper omits.

A. Doucet, N. de Freitas, K. Murphy and S. Russell, "Rao-Blackwellised particle filtering for dynamic Bayesian
networks", UAI 2000; W. Gilks and C. Berzuini, "Following a moving target", J. Royal Statistical Society B 63(1), 2001,
doi:10.1111/1467-9868.00280 (resample and move).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.estimators.gaussian_bank import (
    GaussianBank,
    Projection,
    mixture_moments,
    predict,
    project,
    replicate,
    update,
)
from usbldr.filters.estimators.mode_updates import ModeLikelihoods, mode_likelihoods
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update, with_state_shift
from usbldr.filters.estimators.resampling import effective_size, normalised, systematic
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.types import Indices, Update, Vector


class PastStep(NamedTuple):
    """A past step whose noise modes the MCMC move may draw again."""

    start: GaussianBank  # the bank before the step, one member for each current particle
    step: Step
    log_likelihood: Vector  # (N,) of the step's measurements, given each particle's earlier modes

    def take(self, ancestors: Indices) -> "PastStep":
        """Follow the particles through resampling."""
        return PastStep(self.start.take(ancestors), self.step, self.log_likelihood[ancestors])


class ParticleBelief(NamedTuple):
    """N Gaussians, the past steps that a move may change, and the updates of the last step."""

    bank: GaussianBank
    past: tuple[PastStep, ...]
    updates: tuple[Update, ...]
    ess: float  # least effective sample size within the step
    acceptance: float  # share of accepted moves; NaN if none was tried


@dataclass(frozen=True, slots=True)
class CubatureParticleFilter:
    """N Kalman filters, each conditional on the noise modes that it has drawn."""

    motion: MotionModel
    rule: MomentTransform
    particles: int = 100  # the N of the paper; 20 give nearly the same error
    resample_below: float = 0.5  # share of N: the usual choice
    move_steps: int = 2  # [epochs] how far back a move reaches; 0: no move

    def start(self, prior: Prior) -> ParticleBelief:
        """Return N copies of the prior with weights 1 / N: step (1) of the paper."""
        return ParticleBelief(replicate(prior.mean, prior.cov, self.particles), (), (), float(self.particles), math.nan)

    def step(self, belief: ParticleBelief, step: Step, make_rng: MakeRng) -> ParticleBelief:
        """Return the belief after the step: predict; per measurement weigh, resample, draw modes and update; move."""
        rng = make_rng()
        kept = belief.past[1 - self.move_steps :] if self.move_steps > 1 else ()
        past: tuple[PastStep, ...] = (*kept, PastStep(belief.bank, step, np.zeros(self.particles)))
        bank = predict(belief.bank, self.motion, self.rule, step.t0_s, step.t1_s)  # time update, eqs. (8) to (12)
        updates: list[Update] = []
        least, resampled = float(self.particles), False
        for measurement in step.measurements:
            part_updates: list[Update] = []
            for part in measurement.parts():
                # cubature points of the prediction and their measurement moments, eqs. (13) to (18), (17) without R
                projection, before = project(bank, part, self.rule), bank
                record = measurement_update(part, projection, np.exp(bank.log_weight), rejected=False)
                modes = mode_likelihoods(projection, part.noise)
                log_l = modes.log_likelihood
                # step (3): w_k = w_{k-1} p(z_k | modes so far), normalised
                bank = bank._replace(log_weight=normalised(bank.log_weight + log_l))
                past = (*past[:-1], past[-1]._replace(log_likelihood=past[-1].log_likelihood + log_l))
                ess = effective_size(bank.log_weight)
                least = min(least, ess)
                if ess < self.resample_below * self.particles:  # step (4)
                    ancestors = systematic(np.exp(bank.log_weight), rng)
                    bank = bank.resampled_members(ancestors)
                    past = tuple(old.take(ancestors) for old in past)
                    projection, modes = projection.take(ancestors), ModeLikelihoods(*(x[..., ancestors] for x in modes))
                    resampled = True
                bank = _drawn_update(bank, projection, modes, part, rng)  # (17) with the drawn R, then (19) and (20)
                part_updates.append(with_state_shift(record, before, bank))
            updates.append(Update.combined(part_updates))
        acceptance = math.nan
        if resampled and self.move_steps:
            bank, past, acceptance = self._move(bank, past, rng)  # step (4): Markov chain Monte Carlo
        return ParticleBelief(bank, past, tuple(updates), least, acceptance)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Return mean and covariance of the weighted mixture: eqs. (21) and (22) with weights."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, belief.acceptance)

    def _move(
        self, bank: GaussianBank, past: Sequence[PastStep], rng: np.random.Generator
    ) -> tuple[GaussianBank, tuple[PastStep, ...], float]:
        """Propose new modes for the last steps of each particle; accept with min(1, product of l* / product of l).

        The proposal draws every mode from its exact conditional, so the ratio of target to proposal is the product of
        the predictive likelihoods along the path (independence Metropolis-Hastings).
        """
        proposal: list[PastStep] = []
        state = past[0].start
        for _, step, _ in past:
            start = state
            state = predict(start, self.motion, self.rule, step.t0_s, step.t1_s)
            log_l = np.zeros(self.particles)
            for part in (part for measurement in step.measurements for part in measurement.parts()):
                projection = project(state, part, self.rule)
                modes = mode_likelihoods(projection, part.noise)
                log_l += modes.log_likelihood
                state = _drawn_update(state, projection, modes, part, rng)
            proposal.append(PastStep(start, step, log_l))
        gain = sum(new.log_likelihood for new in proposal) - sum(old.log_likelihood for old in past)
        accepted = np.log(rng.random(self.particles)) < gain
        moved: list[PastStep] = []
        for new, old in zip(proposal, past, strict=True):
            log_l = np.where(accepted, new.log_likelihood, old.log_likelihood)
            moved.append(PastStep(_chosen(accepted, new.start, old.start), new.step, log_l))
        return _chosen(accepted, state, bank), tuple(moved), float(accepted.mean())


def _drawn_update(
    bank: GaussianBank,
    projection: Projection,
    modes: ModeLikelihoods,
    measurement: Measurement,
    rng: np.random.Generator,
) -> GaussianBank:
    """Draw each particle's mode from p(mode | history, z) and update with its R: (19), (20), K = P^xz (P^z)^-1."""
    R = measurement.noise.cov
    if len(R) == 1:
        return update(bank, projection, R[0, :, :, None])
    edges = np.cumsum(modes.probability, axis=0)
    mode = (rng.random(len(bank.log_weight)) >= edges[:-1]).sum(axis=0)
    return update(bank, projection, np.moveaxis(R[mode], 0, -1))  # R of each particle: (k, k, N)


def _chosen(accepted: NDArray[np.bool_], new: GaussianBank, old: GaussianBank) -> GaussianBank:
    """Return the proposed member if accepted, else the current one; a move changes no weight."""
    return GaussianBank(np.where(accepted, new.mean, old.mean), np.where(accepted, new.cov, old.cov), old.log_weight)
