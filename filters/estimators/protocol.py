"""The interface of a filter: a frozen value of parameters that turns one belief into the next.

Beliefs are immutable, so a driver may keep them, go back to one and run forward again.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple, Protocol, TypeVar, cast, overload

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection, project
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.models.noise import normal_scores
from usbldr.filters.models.readings import Readings
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.types import Array, Indices, Reacquisition, Update, Vector
from usbldr.filters.updates import UpdateTable, UpdateTableBuilder

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


class Steps(Sequence[Step]):
    """The steps to K neighbouring epochs, their readings as columns; a Step is made if one is asked for."""

    def __init__(self, first: int, t0_s: Vector, t1_s: Vector, readings: Sequence[Readings]) -> None:
        self.first, self.t0_s, self.t1_s, self.readings = first, t0_s, t1_s, tuple(readings)  # t: (K,)

    def __len__(self) -> int:
        return len(self.t1_s)

    @overload
    def __getitem__(self, index: int) -> Step: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Step, ...]: ...
    def __getitem__(self, index: int | slice) -> Step | tuple[Step, ...]:
        if isinstance(index, slice):
            return tuple(self.step(k) for k in range(len(self))[index])
        return self.step(range(len(self))[index])

    def step(self, k: int, received_by_s: float = math.inf) -> Step:
        """Return step k with those of its readings that had arrived by then."""
        measurements = [
            one.measurement(r)
            for one, begin in zip(self.readings, self._begin, strict=True)
            for r in range(begin[k], begin[k + 1])
            if one.received_s[r] <= received_by_s
        ]
        measurements.sort(key=lambda measurement: (measurement.time_s, measurement.sensor))  # stable: order in the log
        return Step(self.first + k, float(self.t0_s[k]), float(self.t1_s[k]), tuple(measurements))

    def of_sensor(self, sensor: str) -> Indices:
        """Return the steps that have a measurement of a sensor."""
        return np.unique(np.concatenate([one.epoch for one in self.readings if one.sensor == sensor])) - self.first

    @cached_property
    def _begin(self) -> list[list[int]]:
        """The first reading of each step, and the end, in each of the columns."""
        edges = self.first + np.arange(len(self) + 1)
        return [one.epoch.searchsorted(edges).tolist() for one in self.readings]


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


COLUMNS = ("mean", "cov", "ess", "acceptance", "inflation")
"""Fields of Estimates with a row for each epoch, but for those that may be missing."""


class Estimates(NamedTuple):
    """The estimates of K epochs as columns, named as in Estimate."""

    mean: Array  # (K, n)
    cov: Array  # (K, n, n)
    updates: UpdateTable  # of all of them
    ess: Vector  # (K,)
    acceptance: Vector  # (K,)
    inflation: Vector  # (K,)
    reacquisitions: tuple[Reacquisition, ...] = ()  # up to the last
    widening: Array | None = None  # (K, n)

    @classmethod
    def of(cls, each: Sequence[Estimate]) -> "Estimates":
        """Return the estimates of at least one epoch as columns."""
        none = np.zeros(len(each[0].mean))
        columns = {name: np.array([getattr(one, name) for one in each], np.float64) for name in COLUMNS}
        updates = UpdateTable.of([update for one in each for update in one.updates])
        widening = np.array([none if one.widening is None else one.widening for one in each])
        return cls(updates=updates, **columns, reacquisitions=each[-1].reacquisitions, widening=widening)

    @classmethod
    def joined(cls, each: "Sequence[Estimates]") -> "Estimates":
        """Return the estimates of neighbouring spans."""
        if len(each) == 1:
            return each[0]
        updates = UpdateTableBuilder()
        for one in each:
            updates.add(one.updates)
        columns = {name: np.concatenate([getattr(one, name) for one in each]) for name in COLUMNS}
        widening = np.concatenate([np.zeros_like(one.mean) if one.widening is None else one.widening for one in each])
        return cls(updates=updates.table(), **columns, reacquisitions=each[-1].reacquisitions, widening=widening)

    @property
    def last(self) -> Estimate:
        """The estimate of the last epoch, without its updates."""
        ess, acceptance, inflation = float(self.ess[-1]), float(self.acceptance[-1]), float(self.inflation[-1])
        return Estimate(self.mean[-1], self.cov[-1], (), ess, acceptance, inflation, self.reacquisitions)


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


class SpanFilter(Filter[Belief], Protocol[Belief]):
    """A filter that runs many steps at once faster than one by one."""

    def span(self, belief: Belief, steps: Steps, epochs: range, seed: int) -> tuple[Belief, Estimates]:
        """Return the belief after the last of some of the steps, and the estimates after each."""
        ...


def run_span(
    estimator: Filter[Belief], belief: Belief, steps: Steps, epochs: range, seed: int
) -> tuple[Belief, Estimates]:
    """Run a filter over some of the steps, at least one; return the belief after the last, and the estimates."""
    if hasattr(estimator, "span"):
        return cast(SpanFilter[Belief], estimator).span(belief, steps, epochs, seed)
    estimates: list[Estimate] = []
    for k in epochs:
        belief = estimator.step(belief, steps[k], SeededRng(seed, steps.first + k))
        estimates.append(estimator.estimate(belief))
    return belief, Estimates.of(estimates)


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
        sum(score * score for score in scores),
        len(e),
        "rejected" if rejected else "used" if nominal >= 0.5 else "down-weighted",
        nominal,
        nominal_sd=tuple(np.sqrt((predicted + measurement.noise.cov[0]).diagonal()).tolist()),
        scores=scores,
    )


def rejected_update(bank: GaussianBank, measurement: Measurement) -> Update:
    """Return the update record of a measurement that is not used; the bank has one member."""
    both = [(part, project(bank, part, linearised)) for part in measurement.parts()]
    parts = [measurement_update(part, projection, np.ones(1), rejected=True) for part, projection in both]
    return Update.combined([with_state_shift(part, bank, bank) for part in parts])


def with_state_shift(update: Update, before: GaussianBank, after: GaussianBank) -> Update:
    """Return the update of a fix with the shift of the weighted mean that it caused; others unchanged."""
    if update.axis not in ("east", "north", "position"):
        return update
    shift = after.mean @ np.exp(after.log_weight) - before.mean @ np.exp(before.log_weight)
    return update._replace(shift=tuple(shift.tolist()))
