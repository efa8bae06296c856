"""ekf, ckf, ukf and adf: one Gaussian, one rule, one policy; afukf and aekf also doubt their prediction."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.adaptive import InflationFactor, InnovationHistory, inflate
from usbldr.filters.estimators.gaussian_bank import GaussianBank, mixture_moments, predict, project, replicate
from usbldr.filters.estimators.mode_updates import ModeUpdate
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update, with_state_shift
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.types import Update


class KalmanBelief(NamedTuple):
    """One Gaussian, what the last step did, and how many readings of each scalar were refused in a row."""

    bank: GaussianBank
    updates: tuple[Update, ...]
    log_likelihood: float  # predictive, of all measurements so far
    rejected: Mapping[str, int]
    history: InnovationHistory = MappingProxyType({})  # of the adaptive factor
    inflation: float = 1.0  # see Estimate


@dataclass(frozen=True, slots=True)
class KalmanFilter:
    """Predict by the rule, multiply the predicted covariance by the factor, take each measurement by the policy."""

    motion: MotionModel
    rule: MomentTransform
    mode_update: ModeUpdate
    factor: InflationFactor | None = None

    def start(self, prior: Prior) -> KalmanBelief:
        """Return the prior as a bank of one."""
        return KalmanBelief(replicate(prior.mean, prior.cov, 1), (), 0.0, {})

    def step(self, belief: KalmanBelief, step: Step, make_rng: MakeRng) -> KalmanBelief:
        """Return the belief after the step; nothing is left to chance."""
        bank = predict(belief.bank, self.motion, self.rule, step.t0_s, step.t1_s)
        history, inflation = belief.history, 1.0
        if self.factor is not None:
            bank, history, inflation = inflate(bank, step.measurements, history, self.rule, self.factor)
        updates: list[Update] = []
        log_likelihood, rejected = belief.log_likelihood, belief.rejected
        for measurement in step.measurements:
            done: list[Update] = []
            for part in measurement.parts():
                seen = project(bank, part, self.rule)
                axis = f"{part.sensor} {part.axis}"  # a good north must not excuse a refused east
                past, before = rejected.get(axis, 0), bank
                bank, log_l, refused, covariance_inflated = self.mode_update(before, seen, part.noise, past)
                inflation = math.inf if covariance_inflated else inflation
                rejected = {**rejected, axis: past + 1 if refused else 0}
                log_likelihood += float(log_l[0])
                done.append(with_state_shift(measurement_update(part, seen, np.ones(1), refused), before, bank))
            updates.append(Update.combined(done))
        return KalmanBelief(bank, tuple(updates), log_likelihood, rejected, history, inflation)

    def estimate(self, belief: KalmanBelief) -> Estimate:
        """Return mean and covariance."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, 1.0, math.nan, belief.inflation)
