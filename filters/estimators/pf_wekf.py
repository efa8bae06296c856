"""A particle filter that asks the last fixes where the vehicle is, and a weighted EKF that trusts a fix accordingly.

The paper's introduction tells of a two-stage filter: "First, a particle filter selects candidate particles by
minimizing the local backward DR error. Then, the Weighted Extended Kalman Filter (WEKF) further smooths and improves
the results". Its list of references is not part of the text that we have, and nothing public that we found describes
the method further, so these two sentences are all that is the source's.

Ours is the rest. At a fix, candidates for the present position are drawn around the fixes of the last minute, carried
here by dead reckoning. Each candidate is carried back by dead reckoning to every one of those fixes; what it would have
read there, against what was read, is its local backward error, and the noise model makes a weight of it. The candidates
thus say where the vehicle is without regard to the new fix and to the EKF. Seen from there each mode of the new fix's
noise has a probability p_j, and the EKF takes the fix with the covariance R = (sum p_j R_j^-1)^-1, or not at all.
The candidates' position itself never enters the EKF: the same fixes would count again and again.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import (
    GaussianBank,
    Projection,
    inverse_and_logdet,
    log_density,
    mixture_moments,
    predict,
    project,
    replicate,
    update,
)
from usbldr.filters.estimators.mode_updates import mode_likelihoods, moment_matched
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update, with_state_shift
from usbldr.filters.estimators.resampling import effective_size, normalised
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import POSITION
from usbldr.filters.types import Array, Update, Vector

UNKNOWN_POSITION_M2 = 1e8  # variance of a position of which nothing is known


class PastFix(NamedTuple):
    """A fix as the local search needs it."""

    measurement: Measurement
    state: Vector  # (n,) predicted at its epoch
    dead_reckoned_m: Vector  # (2,) where dead reckoning was
    implied_m: Vector  # (2,) where the fix alone puts the vehicle
    implied_cov_m2: Array  # (2, 2)


class TwoStageBelief(NamedTuple):
    """The EKF's Gaussian, the local track and its fixes, and what the last step did."""

    bank: GaussianBank
    dead_reckoned_m: Vector  # (2,) east and north of the motion alone, since the start
    past: tuple[PastFix, ...]
    updates: tuple[Update, ...]
    ess: float  # of the candidates that were drawn last


@dataclass(frozen=True, slots=True)
class TwoStageFilter:
    """Candidates by local backward dead reckoning, then an EKF whose measurements they weigh."""

    motion: MotionModel
    particles: int = 100  # as many as those of the cpf
    max_fixes: int = 10  # by judgement; in the scenario multipath half is 9 % worse, twice 52 % better
    window_s: float = 60.0  # older fixes are not local; half and twice change nothing in the scenarios
    min_fixes: int = 3  # below, a fix is taken with matched noise
    reject_below: float = 0.01  # probability of the nominal mode; half and twice change nothing in the scenarios
    drift_per_distance: float = 0.01  # 1-sigma of dead reckoning, of the way that it went

    def start(self, prior: Prior) -> TwoStageBelief:
        """Return the prior, without any fix."""
        return TwoStageBelief(replicate(prior.mean, prior.cov, 1), np.zeros(2), (), (), float(self.particles))

    def step(self, belief: TwoStageBelief, step: Step, make_rng: MakeRng) -> TwoStageBelief:
        """Return the belief after the step; candidates are drawn only where a fix came."""
        bank = predict(belief.bank, self.motion, linearised, step.t0_s, step.t1_s)
        here = POSITION
        dead_reckoned_m = belief.dead_reckoned_m + (bank.mean - belief.bank.mean)[here, 0]
        predicted = bank.mean[:, 0]
        past = tuple(fix for fix in belief.past if fix.measurement.time_s > step.t1_s - self.window_s)
        updates: list[Update] = []
        ess = belief.ess
        rng: np.random.Generator | None = None
        fixes = [measurement for measurement in step.measurements if measurement.sensor == "usbl"]
        local: GaussianBank | None = None
        if len(past) >= self.min_fixes and fixes:
            rng = make_rng()
            candidates = self._candidates(past, step.t1_s, dead_reckoned_m, rng)
            ess = effective_size(candidates.log_weight)
            where_m, where_m2 = mixture_moments(candidates)
            local = _at_position(predicted, where_m, where_m2)
        for measurement in step.measurements:
            done: list[Update] = []
            for part in measurement.parts():
                seen = project(bank, part, linearised)
                rejected, before = False, bank
                if measurement.sensor != "usbl" or local is None:
                    bank = moment_matched(bank, seen, part.noise, 0).bank
                else:
                    p = mode_likelihoods(project(local, part, linearised), part.noise).probability
                    rejected = len(p) > 1 and bool(p[0, 0] < self.reject_below)
                    if not rejected:
                        bank = update(bank, seen, _weighted(part.noise.cov, p[:, 0])[:, :, None])
                done.append(with_state_shift(measurement_update(part, seen, np.ones(1), rejected), before, bank))
            updates.append(Update.combined(done))
        for fix in fixes:
            past = (*past, _past_fix(fix, predicted, dead_reckoned_m))[-self.max_fixes :]
        return TwoStageBelief(bank, dead_reckoned_m, past, tuple(updates), ess)

    def estimate(self, belief: TwoStageBelief) -> Estimate:
        """Return mean and covariance of the EKF; the effective number is that of the candidates."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, math.nan)

    def _candidates(
        self, past: tuple[PastFix, ...], now_s: float, dead_reckoned_m: Vector, rng: np.random.Generator
    ) -> GaussianBank:
        """Return candidates for the present position, (2, N), weighed by how far they miss the past fixes."""
        turn = np.arange(self.particles) % len(past)
        centres = np.stack([fix.implied_m + dead_reckoned_m - fix.dead_reckoned_m for fix in past], axis=1)
        roots = np.stack([np.linalg.cholesky(fix.implied_cov_m2) for fix in past], axis=2)
        normals = rng.standard_normal((2, self.particles))
        points = centres[:, turn] + np.einsum("abn,bn->an", roots[:, :, turn], normals)
        log_q = np.stack([log_density(points, centres[:, j : j + 1], fix.implied_cov_m2) for j, fix in enumerate(past)])
        top = log_q.max(axis=0)
        log_w = -(top + np.log(np.exp(log_q - top).sum(axis=0)))
        for fix in past:
            log_w += self._backward(fix, points, now_s, dead_reckoned_m)
        return GaussianBank(points, np.zeros((2, 2, self.particles)), normalised(log_w))

    def _backward(self, fix: PastFix, points: Array, now_s: float, dead_reckoned_m: Vector) -> Vector:
        """Return the log likelihood of a past fix for candidates that dead reckoning carries back to it, (N,)."""
        dr_displacement_m = dead_reckoned_m - fix.dead_reckoned_m
        states = np.repeat(fix.state[:, None], points.shape[1], axis=1)
        states[POSITION] = points - dr_displacement_m[:, None]
        walk_m2 = self.motion.noise(fix.measurement.time_s, now_s)[POSITION].max()
        drift_m2 = walk_m2 + self.drift_per_distance**2 * float(dr_displacement_m @ dr_displacement_m)
        log_l = np.zeros(points.shape[1])
        for part in fix.measurement.parts():
            innovation = part.model.residual(part.z[:, None], part.model.predict(states))
            k = len(innovation)
            seen = Projection(innovation, drift_m2 * np.eye(k)[:, :, None], np.zeros((len(states), k, 1)))
            log_l += mode_likelihoods(seen, part.noise).log_likelihood
        return log_l


def _weighted(R: Array, p: Vector) -> Array:
    """Return (sum p_j R_j^-1)^-1 of the modes R (J, k, k) and their probabilities p (J,)."""
    inverse, _ = inverse_and_logdet(np.moveaxis(R, 0, -1))
    return inverse_and_logdet((inverse @ p)[:, :, None])[0][:, :, 0]


def _at_position(state: Vector, position_m: Vector, cov_m2: Array) -> GaussianBank:
    """Return a bank of one that knows the state but for its position."""
    mean, cov = state.copy(), np.zeros((len(state), len(state)))
    mean[POSITION] = position_m
    cov[np.ix_(POSITION, POSITION)] = cov_m2
    return replicate(mean, cov, 1)


def _past_fix(fix: Measurement, state: Vector, dead_reckoned_m: Vector) -> PastFix:
    """Remember a fix, and where it alone, by its nominal noise, puts the vehicle."""
    alone = _at_position(state, state[POSITION], UNKNOWN_POSITION_M2 * np.eye(2))
    for part in fix.parts():
        alone = update(alone, project(alone, part, linearised), part.noise.cov[0, :, :, None])
    mean, cov = mixture_moments(alone)
    return PastFix(fix, state, dead_reckoned_m, mean[POSITION], cov[np.ix_(POSITION, POSITION)])
