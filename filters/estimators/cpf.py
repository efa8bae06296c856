"""The cubature particle filter in its Rao-Blackwellised form.

The paper's section 2.2, step by step, in the reading that does not collapse: a particle is a history of noise modes
with its own cubature Kalman filter (mean and carried covariance). Then
(1) initial particles are N copies of the prior;
(2) each particle gets its cubature time and measurement update, eqs. (8) to (20);
(3) the importance density is the exact conditional p(mode | history, z), so the weight is the predictive likelihood of
    the measurement, and does not depend on the mode that is drawn: resampling comes before the draw (fully adapted);
(4) resampling is systematic, when fewer than half of the particles count, and is followed by a Markov chain Monte Carlo
    move over the modes of the last steps, which leaves p(modes | z) as it is;
(5) the estimate is the weighted mean, eqs. (21) and (22) with the weights that they lack.

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
from usbldr.filters.types import Array, Indices, Update, Vector


class PastStep(NamedTuple):
    """A step that a move may run again."""

    start: GaussianBank  # the bank before the step, by today's particles
    step: Step
    log_likelihood: Vector  # (N,) of the step's measurements along each particle's modes

    def take(self, ancestors: Indices) -> "PastStep":
        """Follow the particles through resampling."""
        return PastStep(self.start.take(ancestors), self.step, self.log_likelihood[ancestors])


class ParticleBelief(NamedTuple):
    """N Gaussians, the steps that a move may still change, and what the last step did."""

    bank: GaussianBank
    past: tuple[PastStep, ...]
    updates: tuple[Update, ...]
    ess: float
    acceptance: float


@dataclass(frozen=True, slots=True)
class CubatureParticleFilter:
    """N Kalman filters, each on the noise modes that it has drawn."""

    motion: MotionModel
    rule: MomentTransform
    particles: int = 100  # the N of the paper; 20 give nearly the same error
    resample_below: float = 0.5  # share of N: the usual choice
    move_steps: int = 2  # [epochs] how far back a move reaches; 0: no move

    def start(self, prior: Prior) -> ParticleBelief:
        """Return N copies of the prior."""
        return ParticleBelief(replicate(prior.mean, prior.cov, self.particles), (), (), float(self.particles), math.nan)

    def step(self, belief: ParticleBelief, step: Step, make_rng: MakeRng) -> ParticleBelief:
        """Return the belief after the step: predict; weigh, resample, draw and update per measurement; move."""
        rng = make_rng()
        past: tuple[PastStep, ...] = (
            *belief.past[-(self.move_steps - 1) :],
            PastStep(belief.bank, step, np.zeros(self.particles)),
        )
        if self.move_steps < 2:
            past = past[-1:]
        bank = predict(belief.bank, self.motion, self.rule, step.t0_s, step.t1_s)
        updates: list[Update] = []
        least, resampled = float(self.particles), False
        for measurement in step.measurements:
            done: list[Update] = []
            for part in measurement.parts():
                seen, before = project(bank, part, self.rule), bank
                described = measurement_update(part, seen, np.exp(bank.log_weight), rejected=False)
                weighed = mode_likelihoods(seen, part.noise)
                log_l = weighed.log_likelihood
                bank = bank._replace(log_weight=normalised(bank.log_weight + log_l))
                past = (*past[:-1], past[-1]._replace(log_likelihood=past[-1].log_likelihood + log_l))
                ess = effective_size(bank.log_weight)
                least = min(least, ess)
                if ess < self.resample_below * self.particles:
                    ancestors = systematic(np.exp(bank.log_weight), rng)
                    bank = bank.resampled_members(ancestors)
                    past = tuple(old.take(ancestors) for old in past)
                    seen, weighed = seen.take(ancestors), ModeLikelihoods(*(x[..., ancestors] for x in weighed))
                    resampled = True
                bank = _drawn_update(bank, seen, weighed, part, rng)
                done.append(with_state_shift(described, before, bank))
            updates.append(Update.combined(done))
        acceptance = math.nan
        if resampled and self.move_steps:
            bank, past, acceptance = self._move(bank, past, rng)
        return ParticleBelief(bank, past, tuple(updates), least, acceptance)

    def estimate(self, belief: ParticleBelief) -> Estimate:
        """Return the weighted mean and the covariance of the whole mixture."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, belief.acceptance)

    def _move(
        self, bank: GaussianBank, past: Sequence[PastStep], rng: np.random.Generator
    ) -> tuple[GaussianBank, tuple[PastStep, ...], float]:
        """Offer each particle new modes for its last steps; accept with min(1, product of l* / product of l).

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
                seen = project(state, part, self.rule)
                weighed = mode_likelihoods(seen, part.noise)
                log_l += weighed.log_likelihood
                state = _drawn_update(state, seen, weighed, part, rng)
            proposal.append(PastStep(start, step, log_l))
        gain = sum(new.log_likelihood for new in proposal) - sum(old.log_likelihood for old in past)
        accepted = np.log(rng.random(self.particles)) < gain
        moved = tuple(
            PastStep(
                _chosen(accepted, new.start, old.start),
                new.step,
                np.where(accepted, new.log_likelihood, old.log_likelihood),
            )
            for new, old in zip(proposal, past, strict=True)
        )
        return _chosen(accepted, state, bank), moved, float(accepted.mean())


def _drawn_update(
    bank: GaussianBank, seen: Projection, weighed: ModeLikelihoods, measurement: Measurement, rng: np.random.Generator
) -> GaussianBank:
    """Draw each particle's noise mode from p(mode | history, z) and update it as if that mode were known."""
    R = measurement.noise.cov
    if len(R) == 1:
        return update(bank, seen, R[0, :, :, None])
    edges = np.cumsum(weighed.probability, axis=0)
    mode = (rng.random(len(bank.log_weight)) >= edges[:-1]).sum(axis=0)
    return update(bank, seen, _by_mode(R, mode))


def _by_mode(R: Array, mode: Indices) -> Array:
    """Return each particle's own R: (J, k, k) and (N,) to (k, k, N)."""
    return np.moveaxis(R[mode], 0, -1)


def _chosen(accepted: NDArray[np.bool_], new: GaussianBank, old: GaussianBank) -> GaussianBank:
    """Return the new member where accepted, the old elsewhere; a move changes no weight."""
    return GaussianBank(np.where(accepted, new.mean, old.mean), np.where(accepted, new.cov, old.cov), old.log_weight)
