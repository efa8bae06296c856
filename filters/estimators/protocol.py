"""What a filter is: a frozen value of parameters that turns one belief into the next.

Beliefs are immutable, so whoever drives the filter may keep them, go back to one and run forward again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.types import Array, Reacquisition, Update, Vector

MakeRng = Callable[[], np.random.Generator]
"""Makes the generator of one step, from the seed and the epoch: a step run again repeats itself to the bit.
Making it costs 33 microseconds, so filters without chance leave it uncalled."""


class Step(NamedTuple):
    """From one epoch to the next: time passes, then measurements come in by time, sensor and order in the log."""

    epoch: int
    t0_s: float
    t1_s: float  # t0_s in the first step
    measurements: tuple[Measurement, ...]


class Prior(NamedTuple):
    """The belief before anything is measured."""

    mean: Vector  # (n,)
    cov: Array  # (n, n)


class Estimate(NamedTuple):
    """What is reported for an epoch."""

    mean: Vector  # (n,)
    cov: Array  # (n, n)
    updates: Sequence[Update]
    ess: float  # least effective number of particles within the step
    acceptance: float  # share of accepted moves; NaN where none was tried
    inflation: float = 1.0  # of the predicted covariance; infinite where a gate's recovery refuted the past
    reacquisitions: tuple[Reacquisition, ...] = ()  # so far


Belief = TypeVar("Belief")


class Filter(Protocol[Belief]):
    """A recursive estimator."""

    def start(self, prior: Prior) -> Belief:
        """Return the belief before the first step."""
        ...

    def step(self, belief: Belief, step: Step, make_rng: MakeRng) -> Belief:
        """Return the belief after the step."""
        ...

    def estimate(self, belief: Belief) -> Estimate:
        """Return mean, covariance and what became of the step's measurements."""
        ...


def measurement_update(measurement: Measurement, seen: Projection, weight: Vector, rejected: bool) -> Update:
    """Tell what became of a measurement, from the bank as it was before: weights (N,) add to 1."""
    e = seen.innovation @ weight
    spread = seen.innovation - e[:, None]
    predicted = seen.cov @ weight + (spread * weight) @ spread.T
    S = predicted + measurement.noise.mixture_cov
    one = Projection(e[:, None], predicted[:, :, None], seen.cross[:, :, :1])
    nominal = float(mode_likelihoods(one, measurement.noise).probability[0, 0])
    likely = nominal >= 0.5 or len(measurement.noise.probabilities) == 1
    return Update(
        measurement.sensor,
        measurement.axis,
        measurement.row,
        measurement.time_s,
        tuple(e.tolist()),
        tuple(np.sqrt(S.diagonal()).tolist()),
        float(e @ np.linalg.solve(S, e)) if len(e) > 1 else float(e[0] ** 2 / S[0, 0]),
        len(e),
        "rejected" if rejected else "used" if likely else "down-weighted",
        nominal,
    )


def with_state_shift(update: Update, before: GaussianBank, after: GaussianBank) -> Update:
    """Add to what became of a fix how far it moved the weighted mean; other measurements stay as they are."""
    if update.axis not in ("east", "north", "position"):
        return update
    shift = after.mean @ np.exp(after.log_weight) - before.mean @ np.exp(before.log_weight)
    return update._replace(shift=tuple(shift.tolist()))
