"""The Kalman filters ekf, ckf, ukf and adf, and afukf and aekf, which inflate their predicted covariance.

Predict: m- = f(m), P- = F P F' + Q. Update: e = z - h(m-), S = H P- H' + R, K = P- H' S^-1, m = m- + K e,
P = P- - K S K'. The moment transform (linearised, cubature, unscented) computes f(m), F P F', h(m-), H P- H' and P- H';
the mode update decides which R applies (mode_updates.py). All states are in metres, radians and seconds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.adaptive import InflationFactor, InnovationHistory, inflate
from usbldr.filters.estimators.gaussian_bank import GaussianBank, mixture_moments, predict, project, replicate
from usbldr.filters.estimators.mode_updates import ModeUpdate, UpdateResult
from usbldr.filters.estimators.protocol import Estimate, MakeRng, Prior, Step, measurement_update, with_state_shift
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.models.states import StateLayout
from usbldr.filters.types import Update, Vector

VARIANCE_FACTOR = 4.0  # of one widening: the sigma doubles; 2 follows manoeuvres half as fast, 10 also follows spikes
MAX_REJECTIONS = 10  # [fixes in a row] half as many nearly double the error in the scenario multipath


class KalmanBelief(NamedTuple):
    """One Gaussian, the updates of the last step, and how many measurements of each axis were rejected in a row."""

    bank: GaussianBank
    updates: tuple[Update, ...]
    log_likelihood: float  # predictive, of all measurements so far
    rejected: Mapping[str, int]  # sensor and axis -> rejections in a row
    history: InnovationHistory = MappingProxyType({})  # for the inflation factor
    inflation: float = 1.0  # see Estimate
    widening: Vector | None = None  # (n,) see Estimate


@dataclass(frozen=True, slots=True)
class Recovery:
    """What the refused measurements of an axis widen, and when, for a filter to recover.

    A diverged filter refuses every fix, and a manoeuvre looks like an error of the DVL. The refused measurements then
    say that the vehicle did not move as predicted, so independent noise widens the position (fixes) or the velocity
    (DVL). They say nothing about constant errors of a sensor or about the heading, whose sigmas stay as they are; a
    refused compass needs no recovery, as the turn rate's own noise widens the heading within seconds.
    """

    rows: tuple[int, ...]  # states that the axis measures
    max_rejections: int  # refused in a row before the states are widened
    until_passed: bool  # widen until the measurement passes; otherwise once per refused measurement


@dataclass(frozen=True, slots=True)
class KalmanFilter:
    """Predict by the moment transform, inflate by the factor if there is one, update with each measurement in turn."""

    motion: MotionModel
    rule: MomentTransform
    mode_update: ModeUpdate
    factor: InflationFactor | None = None
    recoveries: Mapping[str, Recovery] = field(default_factory=lambda: RECOVERIES)  # by axis; of a gate

    def start(self, prior: Prior) -> KalmanBelief:
        """Return the prior as a bank of one."""
        return KalmanBelief(replicate(prior.mean, prior.cov, 1), (), 0.0, {})

    def step(self, belief: KalmanBelief, step: Step, make_rng: MakeRng) -> KalmanBelief:
        """Return the belief after the step; no random numbers are used."""
        bank = predict(belief.bank, self.motion, self.rule, step.t0_s, step.t1_s)  # m-, P- = F P F' + Q
        history, inflation = belief.history, 1.0
        if self.factor is not None:
            bank, history, inflation = inflate(bank, step.measurements, history, self.rule, self.factor)
        updates: list[Update] = []
        log_likelihood, rejected = belief.log_likelihood, belief.rejected
        widening = np.zeros(len(bank.mean))
        for measurement in step.measurements:
            part_updates: list[Update] = []
            for part in measurement.parts():
                projection = project(bank, part, self.rule)  # e, H P- H', P- H'
                axis = f"{part.sensor} {part.axis}"  # an accepted north must not reset the count of a rejected east
                in_a_row, before = rejected.get(axis, 0), bank
                # K = P- H' S^-1, m = m- + K e, P = P- - K S K'
                bank, log_l, is_rejected = self.mode_update(before, projection, part.noise)
                if is_rejected:
                    (bank, log_l, is_rejected), added = self._recover(before, part, in_a_row)
                    widening += added
                rejected = {**rejected, axis: in_a_row + 1 if is_rejected else 0}
                log_likelihood += float(log_l[0])
                part_updates.append(
                    with_state_shift(measurement_update(part, projection, np.ones(1), is_rejected), before, bank)
                )
            updates.append(Update.combined(part_updates))
        return KalmanBelief(bank, tuple(updates), log_likelihood, rejected, history, inflation, widening)

    def _recover(self, bank: GaussianBank, part: Measurement, in_a_row: int) -> tuple[UpdateResult, Vector]:
        """Return the bank after a refused measurement, and the variances added to its states, (n,)."""
        recovery, widening = self.recoveries.get(part.axis), np.zeros(len(bank.mean))
        result = UpdateResult(bank, np.zeros(1), True)
        if recovery is None or in_a_row < recovery.max_rejections or not bank.cov[recovery.rows, recovery.rows].all():
            return result, widening
        while result.rejected:
            bank, added = widened(bank, recovery.rows)
            widening += added
            if not recovery.until_passed:
                return result._replace(bank=bank), widening
            result = self.mode_update(bank, project(bank, part, self.rule), part.noise)
        return result, widening

    def estimate(self, belief: KalmanBelief) -> Estimate:
        """Return mean (n,), covariance (n, n) and the updates of the last step."""
        mean, cov = mixture_moments(belief.bank)
        return Estimate(mean, cov, belief.updates, 1.0, math.nan, belief.inflation, widening=belief.widening)


RECOVERIES: Mapping[str, Recovery] = {
    "starboard": Recovery(StateLayout().rows("u"), 0, until_passed=False),
    "forward": Recovery(StateLayout().rows("v"), 0, until_passed=False),
    "position": Recovery(StateLayout().rows("x", "y"), MAX_REJECTIONS, until_passed=True),
    "east": Recovery(StateLayout().rows("x"), MAX_REJECTIONS, until_passed=True),
    "north": Recovery(StateLayout().rows("y"), MAX_REJECTIONS, until_passed=True),
}
"""By axis of a measurement. Outliers of fixes often agree with each other, so the position waits, and then follows at
once. Spikes of a DVL do not: the sigma of the velocity doubles with every refusal, so a manoeuvre passes within a
second, and a spike only if it repeats."""


def widened(bank: GaussianBank, rows: tuple[int, ...]) -> tuple[GaussianBank, Vector]:
    """Return a bank of one with independent noise in these rows, and the variances that it added, (n,)."""
    added = np.zeros(len(bank.mean))
    added[list(rows)] = (VARIANCE_FACTOR - 1) * bank.cov[rows, rows, 0]
    return bank._replace(cov=bank.cov + np.diag(added)[:, :, None]), added
