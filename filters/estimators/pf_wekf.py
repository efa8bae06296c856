"""Two-stage filter: particles weighed by backward dead reckoning, then an EKF that weights each fix by them.

The paper's introduction describes a two-stage filter: "First, a particle filter selects candidate particles by
minimizing the local backward DR error. Then, the Weighted Extended Kalman Filter (WEKF) further smooths and improves
the results". Its reference is not part of the text available here, and no public description was found; these two
sentences are all that comes from the source.

The rest is this project's. At a fix, candidates for the present position are drawn around the fixes of the last minute,
moved here by dead reckoning. Each candidate is moved back by dead reckoning to the epoch of each of those fixes; the
difference from the fix is its local backward error, which the noise model turns into a weight. So the candidates give
the position independently of the new fix and of the EKF. From them each noise mode of the new fix has a probability
p_j, and the EKF updates with the covariance R = (sum p_j R_j^-1)^-1, or rejects the fix. The position of the candidates
never enters the EKF, which would use the same fixes again.
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

UNKNOWN_POSITION_M2 = 1e8  # variance of an unknown position


class PastFix(NamedTuple):
    """A past fix, with the dead reckoning at its epoch."""

    measurement: Measurement
    state: Vector  # (n,) predicted by the EKF at its epoch
    dead_reckoned_m: Vector  # (2,) east, north of dead reckoning at its epoch
    implied_m: Vector  # (2,) east, north of the vehicle from the fix alone
    implied_cov_m2: Array  # (2, 2)


class TwoStageBelief(NamedTuple):
    """The Gaussian of the EKF, dead reckoning, the recent fixes, and the updates of the last step."""

    bank: GaussianBank
    dead_reckoned_m: Vector  # (2,) displacement east and north without fixes, since the start
    past: tuple[PastFix, ...]
    updates: tuple[Update, ...]
    ess: float  # effective sample size of the last candidates


@dataclass(frozen=True, slots=True)
class TwoStageFilter:
    """Candidates weighed by backward dead reckoning, then an EKF whose fixes they weight."""

    motion: MotionModel
    particles: int = 100  # as many as those of the cpf
    max_fixes: int = 10  # by judgement; in the scenario multipath half is 9 % worse, twice 52 % better
    window_s: float = 60.0  # older fixes are not local; half and twice change nothing in the scenarios
    min_fixes: int = 3  # with fewer, the noise mixture is moment-matched
    reject_below: float = 0.01  # probability of the nominal mode; half and twice change nothing in the scenarios
    drift_per_distance: float = 0.01  # 1-sigma of dead reckoning per distance travelled

    def start(self, prior: Prior) -> TwoStageBelief:
        """Return the prior, without any fix."""
        return TwoStageBelief(replicate(prior.mean, prior.cov, 1), np.zeros(2), (), (), float(self.particles))

    def step(self, belief: TwoStageBelief, step: Step, make_rng: MakeRng) -> TwoStageBelief:
        """Return the belief after the step; candidates are drawn only for a fix."""
        bank = predict(belief.bank, self.motion, linearised, step.t0_s, step.t1_s)
        dead_reckoned_m = belief.dead_reckoned_m + (bank.mean - belief.bank.mean)[POSITION, 0]
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
            local_m, local_m2 = mixture_moments(candidates)
            local = _at_position(predicted, local_m, local_m2)
        for measurement in step.measurements:
            part_updates: list[Update] = []
            for part in measurement.parts():
                projection = project(bank, part, linearised)
                rejected, before = False, bank
                if measurement.sensor != "usbl" or local is None:
                    bank = moment_matched(bank, projection, part.noise).bank
                else:
                    p = mode_likelihoods(project(local, part, linearised), part.noise).probability
                    rejected = len(p) > 1 and bool(p[0, 0] < self.reject_below)
                    if not rejected:
                        bank = update(bank, projection, _weighted(part.noise.cov, p[:, 0])[:, :, None])
                part_updates.append(
                    with_state_shift(measurement_update(part, projection, np.ones(1), rejected), before, bank)
                )
            updates.append(Update.combined(part_updates))
        for fix in fixes:
            past = (*past, _past_fix(fix, predicted, dead_reckoned_m))[-self.max_fixes :]
        return TwoStageBelief(bank, dead_reckoned_m, past, tuple(updates), ess)

    def estimate(self, belief: TwoStageBelief) -> Estimate:
        """Return mean and covariance of the EKF; the effective sample size is that of the candidates."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, belief.ess, math.nan)

    def _candidates(
        self, past: tuple[PastFix, ...], now_s: float, dead_reckoned_m: Vector, rng: np.random.Generator
    ) -> GaussianBank:
        """Return candidates for the present position, (2, N), weighed by their backward errors at the past fixes."""
        source = np.arange(self.particles) % len(past)
        centres = np.stack([fix.implied_m + dead_reckoned_m - fix.dead_reckoned_m for fix in past], axis=1)
        roots = np.stack([np.linalg.cholesky(fix.implied_cov_m2) for fix in past], axis=2)
        normals = rng.standard_normal((2, self.particles))
        points = centres[:, source] + np.einsum("abn,bn->an", roots[:, :, source], normals)
        log_q = np.stack([log_density(points, centres[:, j : j + 1], fix.implied_cov_m2) for j, fix in enumerate(past)])
        top = log_q.max(axis=0)
        log_w = -(top + np.log(np.exp(log_q - top).sum(axis=0)))
        for fix in past:
            log_w += self._backward(fix, points, now_s, dead_reckoned_m)
        return GaussianBank(points, np.zeros((2, 2, self.particles)), normalised(log_w))

    def _backward(self, fix: PastFix, points: Array, now_s: float, dead_reckoned_m: Vector) -> Vector:
        """Return the log likelihood of a past fix for candidates moved back to it by dead reckoning, (N,)."""
        dr_displacement_m = dead_reckoned_m - fix.dead_reckoned_m
        states = np.repeat(fix.state[:, None], points.shape[1], axis=1)
        states[POSITION] = points - dr_displacement_m[:, None]
        walk_m2 = self.motion.noise(fix.measurement.time_s, now_s)[POSITION].max()
        drift_m2 = walk_m2 + self.drift_per_distance**2 * float(dr_displacement_m @ dr_displacement_m)
        log_l = np.zeros(points.shape[1])
        for part in fix.measurement.parts():
            innovation = part.model.residual(part.z[:, None], part.model.predict(states))
            k = len(innovation)
            projection = Projection(innovation, drift_m2 * np.eye(k)[:, :, None], np.zeros((len(states), k, 1)))
            log_l += mode_likelihoods(projection, part.noise).log_likelihood
        return log_l


def _weighted(R: Array, p: Vector) -> Array:
    """Return (sum p_j R_j^-1)^-1 from the modes R (J, k, k) and their probabilities p (J,)."""
    inverse, _ = inverse_and_logdet(np.moveaxis(R, 0, -1))
    return inverse_and_logdet((inverse @ p)[:, :, None])[0][:, :, 0]


def _at_position(state: Vector, position_m: Vector, cov_m2: Array) -> GaussianBank:
    """Return a bank of one with the given position moments and no variance in the other states."""
    mean, cov = state.copy(), np.zeros((len(state), len(state)))
    mean[POSITION] = position_m
    cov[np.ix_(POSITION, POSITION)] = cov_m2
    return replicate(mean, cov, 1)


def _past_fix(fix: Measurement, state: Vector, dead_reckoned_m: Vector) -> PastFix:
    """Return a fix with the position that it alone implies under its nominal noise."""
    implied = _at_position(state, state[POSITION], UNKNOWN_POSITION_M2 * np.eye(2))
    for part in fix.parts():
        implied = update(implied, project(implied, part, linearised), part.noise.cov[0, :, :, None])
    mean, cov = mixture_moments(implied)
    return PastFix(fix, state, dead_reckoned_m, mean[POSITION], cov[np.ix_(POSITION, POSITION)])
