"""The interface of a filter: a frozen value of parameters that turns one belief into the next.

Beliefs are immutable, so a driver may keep them, go back to one and run forward again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.models.normal_scores import normal_scores
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.types import Array, Reacquisition, Update, Vector

MakeRng = Callable[[], np.random.Generator]
"""Makes the generator of one step from seed and epoch, so that a repeated step gives the same numbers.
It takes 33 microseconds; filters without random numbers do not call it."""


class SeededRng(NamedTuple):
    """Makes the generator of an epoch."""

    seed: int
    epoch: int

    def __call__(self) -> np.random.Generator:
        """Return the generator, always with the same numbers."""
        return np.random.default_rng((self.seed, self.epoch))


class Step(NamedTuple):
    """From one epoch to the next: predict, then update with the measurements in order of time, sensor and log."""

    epoch: int
    t0_s: float
    t1_s: float  # t0_s in the first step
    measurements: tuple[Measurement, ...]


class Prior(NamedTuple):
    """Mean and covariance of the n states before the first measurement."""

    mean: Vector  # (n,)
    cov: Array  # (n, n)


class Estimate(NamedTuple):
    """What is reported for an epoch."""

    mean: Vector  # (n,)
    cov: Array  # (n, n)
    updates: Sequence[Update]
    ess: float  # least effective number of particles within the step
    acceptance: float  # share of accepted moves; NaN if none was tried
    inflation: float = 1.0  # factor on the predicted covariance
    reacquisitions: tuple[Reacquisition, ...] = ()  # so far
    widening: Vector | None = None  # (n,) variances that the recovery of a gate added to the prediction


Belief = TypeVar("Belief")


class Filter(Protocol[Belief]):
    """A recursive estimator of n states."""

    def start(self, prior: Prior) -> Belief:
        """Return the belief before the first step."""
        ...

    def step(self, belief: Belief, step: Step, make_rng: MakeRng) -> Belief:
        """Return the belief after the step."""
        ...

    def estimate(self, belief: Belief) -> Estimate:
        """Return mean, covariance and the updates of the step."""
        ...


@runtime_checkable
class SpanFilter(Filter[Belief], Protocol[Belief]):
    """A filter that runs many steps at once faster than one by one."""

    def span(
        self, belief: Belief, steps: Sequence[Step], make_rngs: Sequence[MakeRng]
    ) -> tuple[Belief, list[Estimate]]:
        """Return the belief after the last step, and the estimate after each."""
        ...


def run_span(
    estimator: Filter[Belief], belief: Belief, steps: Sequence[Step], make_rngs: Sequence[MakeRng]
) -> tuple[Belief, list[Estimate]]:
    """Run a filter over steps; return the belief after the last, and the estimate after each."""
    if isinstance(estimator, SpanFilter):
        return estimator.span(belief, steps, make_rngs)
    estimates: list[Estimate] = []
    for step, make_rng in zip(steps, make_rngs, strict=True):
        belief = estimator.step(belief, step, make_rng)
        estimates.append(estimator.estimate(belief))
    return belief, estimates


def measurement_update(measurement: Measurement, projection: Projection, weight: Vector, rejected: bool) -> Update:
    """Return the update record of a measurement from the bank before it; weights (N,) add to 1."""
    e = projection.innovation @ weight
    spread = projection.innovation - e[:, None]
    predicted = projection.cov @ weight + (spread * weight) @ spread.T
    S = predicted + measurement.noise.mixture_cov
    one = Projection(e[:, None], predicted[:, :, None], projection.cross[:, :, :1])
    is_nominal = measurement.noise.is_nominal
    nominal = float(mode_likelihoods(one, measurement.noise).probability[is_nominal, 0].sum())
    scores = normal_scores(e, predicted, measurement.noise)
    return Update(
        measurement.sensor,
        measurement.axis,
        measurement.row,
        measurement.time_s,
        tuple(e.tolist()),
        tuple(np.sqrt(S.diagonal()).tolist()),
        sum(score**2 for score in scores),
        len(e),
        "rejected" if rejected else "used" if nominal >= 0.5 else "down-weighted",
        nominal,
        nominal_sd=tuple(np.sqrt((predicted + measurement.noise.cov[0]).diagonal()).tolist()),
        scores=scores,
    )


def with_state_shift(update: Update, before: GaussianBank, after: GaussianBank) -> Update:
    """Return the update of a fix with the shift of the weighted mean that it caused; others unchanged."""
    if update.axis not in ("east", "north", "position"):
        return update
    shift = after.mean @ np.exp(after.log_weight) - before.mean @ np.exp(before.log_weight)
    return update._replace(shift=tuple(shift.tolist()))
