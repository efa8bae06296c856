"""The filters that run by bank, in the compiled kernel: the numbers of kalman.py and cpf.py in much less time.

`compiled` is the one place that chooses: it returns a filter as it is if NumPy runs, or if the kernel lacks what it
needs (a gate, or a motion model of a test). A span of steps is one call; particles stay in the memory of the kernel.
"""

import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.estimators.adaptive import ADAPTED_SENSORS, InflationFactor, InnovationHistory, inflate
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.encoding import (
    ARGUMENTS,
    POSITION_AXES,
    EncodedStep,
    Encoder,
    filter_bytes,
    generator_state,
    seed_words,
)
from usbldr.filters.estimators.gaussian_bank import GaussianBank, replicate
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import collapse, moment_matched
from usbldr.filters.estimators.protocol import Estimate, Filter, MakeRng, Prior, SeededRng, Step
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import Unscented
from usbldr.filters.types import Update, Vector

LANES, SHIFT = 8, 9  # fixed: as in kernel/layout.h
MATCHED, COLLAPSED, DRAWN = range(3)  # updates, as in kernel/layout.h
UPDATES = {moment_matched: MATCHED, collapse: COLLAPSED}
FAULTS = {1: np.linalg.LinAlgError("singular predicted covariance"), 2: MemoryError("no memory for the kernel")}
Compilable: TypeAlias = KalmanFilter | CubatureParticleFilter


class KernelBelief(NamedTuple):
    """The bank in the kernel's memory, the past steps that a move may change, and the estimate."""

    state: Vector  # see exchange in kernel/steps.h
    past: tuple[EncodedStep, ...]
    estimate: Estimate
    history: InnovationHistory = MappingProxyType({})  # for the inflation factor


def compiled(estimator: Filter[Any]) -> Filter[Any]:
    """Return the filter in the kernel if there is one that can run it, else the filter itself."""
    if KERNEL.advance is None or type(estimator) not in (KalmanFilter, CubatureParticleFilter):
        return estimator
    assert isinstance(estimator, KalmanFilter | CubatureParticleFilter)
    motion, known = estimator.motion, set(ARGUMENTS)
    if type(motion) is not VehicleMotion or not known.issuperset(motion.layout.names):
        return estimator
    if isinstance(estimator, KalmanFilter) and estimator.mode_update not in UPDATES:
        return estimator
    return CompiledFilter(estimator, motion)


class CompiledFilter:
    """A Kalman filter or a particle filter over modes, in the kernel."""

    def __init__(self, reference: Compilable, motion: VehicleMotion) -> None:
        self._encoder = Encoder(motion)
        self._reference, self._n = reference, len(motion.layout)
        self._scale = reference.rule.scale(self._n) if isinstance(reference.rule, Unscented) else 0.0
        self._particles, self._depth = 1, 0
        if isinstance(reference, CubatureParticleFilter):
            below, moved = reference.resample_below, reference.move_steps
            self._particles, self._depth = reference.particles, max(1, moved)
            self._code = filter_bytes(motion, self._scale, DRAWN, self._particles, below, moved)
        else:
            self._code = filter_bytes(motion, self._scale, UPDATES[reference.mode_update])

    def start(self, prior: Prior) -> KernelBelief:
        """Return N copies of the prior."""
        state = self._memory(replicate(prior.mean, prior.cov, self._particles))
        return KernelBelief(state, (), Estimate(prior.mean, prior.cov, (), float(self._particles), math.nan))

    def step(self, belief: KernelBelief, step: Step, make_rng: MakeRng) -> KernelBelief:
        """Return the belief after the step."""
        return self.span(belief, (step,), (make_rng,))[0]

    def span(
        self, belief: KernelBelief, steps: Sequence[Step], make_rngs: Sequence[MakeRng]
    ) -> tuple[KernelBelief, list[Estimate]]:
        """Return the belief after the last step, and the estimate after each."""
        factor = self._reference.factor if isinstance(self._reference, KalmanFilter) else None
        if factor is None:
            return self._run(belief, [self._encoded(*both) for both in zip(steps, make_rngs, strict=True)])
        estimates: list[Estimate] = []
        for step, make_rng in zip(steps, make_rngs, strict=True):
            belief = self._inflated_step(belief, step, factor, make_rng)
            estimates.append(belief.estimate)
        return belief, estimates

    def estimate(self, belief: KernelBelief) -> Estimate:
        """Return the estimate after the last step."""
        return belief.estimate

    def _inflated_step(self, belief: KernelBelief, step: Step, factor: InflationFactor, rng: MakeRng) -> KernelBelief:
        """Return the belief after a step whose predicted covariance is inflated first, if it has a position fix."""
        if not any(measurement.sensor in ADAPTED_SENSORS for measurement in step.measurements):
            return self._run(belief, [self._encoded(step, rng)])[0]
        predicted = self._run(belief, [self._encoded(step._replace(measurements=()), rng)])[0].estimate
        bank = replicate(predicted.mean, predicted.cov, 1)
        bank, history, inflation = inflate(bank, step.measurements, belief.history, self._reference.rule, factor)
        inflated = belief._replace(state=self._memory(bank), history=history)
        after = self._run(inflated, [self._encoded(step._replace(t0_s=step.t1_s), rng)])[0]
        return after._replace(estimate=after.estimate._replace(inflation=inflation))

    def _encoded(self, step: Step, make_rng: MakeRng) -> EncodedStep:
        words, state = (0, 0, 0, 0), (0, 0, 0, 0)
        if self._depth:
            words = seed_words(make_rng.seed, make_rng.epoch) if isinstance(make_rng, SeededRng) else None
            if words is None:
                state = generator_state(make_rng())
        return self._encoder.step(step, words, state)

    def _run(self, belief: KernelBelief, steps: Sequence[EncodedStep]) -> tuple[KernelBelief, list[Estimate]]:
        """Return the belief after the last step, and the estimate after each, in one call of the kernel."""
        n, every = self._n, (*belief.past, *steps)
        state = belief.state.copy()
        rows = np.empty((len(steps), n + n * n + 2))
        records = np.zeros((sum(len(step.parts) for step in steps), SHIFT + n))
        coded = b"".join([step.step for step in every]), b"".join([step.readings for step in every])
        arrays = (state, rows, records)
        assert KERNEL.advance is not None
        status = KERNEL.advance(KERNEL.variant, self._code, len(belief.past), len(steps), *coded, *arrays)
        if status:
            raise FAULTS[status]
        covs, ends = rows[:, n:-2].reshape(-1, n, n), rows[:, -2:].tolist()
        table, first = records.tolist(), 0
        estimates: list[Estimate] = []
        for row, step in enumerate(steps):
            updates, first = _updates(step, table, first)
            estimates.append(Estimate(rows[row, :n], covs[row], updates, *ends[row]))
        past = every[len(every) - self._depth :] if self._depth else ()
        return belief._replace(state=state, past=past, estimate=estimates[-1]), estimates

    def _memory(self, bank: GaussianBank) -> Vector:
        """Return a bank as the kernel keeps it: see exchange in kernel/steps.h."""
        n, N = bank.mean.shape
        count = -(-N // LANES) * LANES  # whole blocks, filled with copies of the last particle
        padded = np.array([min(member, N - 1) for member in range(count)], dtype=np.intp)
        lower = np.tril_indices(n)
        both = np.concatenate([bank.mean, bank.cov[lower]])[:, padded]
        blocks = both.reshape(len(both), -1, LANES).swapaxes(0, 1).ravel()
        if not self._depth:
            return blocks
        weight = np.zeros((2, count))  # logarithms first; none for the copies
        weight[:, :N] = bank.log_weight, np.exp(bank.log_weight)
        past = np.zeros(self._depth * blocks.size)
        return np.concatenate([blocks, past, weight.ravel(), np.zeros(self._depth * count)])


def _updates(step: EncodedStep, table: Sequence[Sequence[float]], first: int) -> tuple[tuple[Update, ...], int]:
    """Return the updates of a step from the records of its parts, and where the records of the next begin."""
    updates: list[Update] = []
    part = 0
    for count in step.counts:
        of_one = [_update(step.parts[part + i], table[first + part + i]) for i in range(count)]
        updates.append(of_one[0] if count == 1 else Update.combined(of_one))
        part += count
    return tuple(updates), first + part


def _update(part: Measurement, row: Sequence[float]) -> Update:
    """Return the update of a measurement from its record: see kernel/records.h."""
    k = len(part.z)
    scores, nominal = tuple(row[6 : 6 + k]), row[8]
    return Update(
        part.sensor,
        part.axis,
        part.row,
        part.time_s,
        tuple(row[:k]),
        tuple(row[2 : 2 + k]),
        sum([score**2 for score in scores]),
        k,
        "used" if nominal >= 0.5 else "down-weighted",
        nominal,
        tuple(row[SHIFT:]) if part.axis in POSITION_AXES else None,
        (),
        tuple(row[4 : 4 + k]),
        scores,
    )
