"""The filters that run by bank, in the compiled kernel: the numbers of kalman.py and cpf.py in much less time.

`compiled` is the one place that chooses: it returns a filter as it is if NumPy runs, or if the kernel lacks what it
needs (a gate, a sensor model of one's own, a noise family of many modes). A span of steps is one call; particles stay
in the memory of the kernel.
"""

import math
from collections.abc import Iterable, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from usbldr.filters.estimators.adaptive import ADAPTED_SENSORS, InflationFactor, InnovationHistory, inflate
from usbldr.filters.estimators.cpf import CubatureParticleFilter
from usbldr.filters.estimators.encoding import (
    FIXES,
    EncodedStep,
    EncodedSteps,
    Encoder,
    can_encode,
    encoded_steps,
    filter_bytes,
    generator_state,
    seed_words,
)
from usbldr.filters.estimators.gaussian_bank import GaussianBank, replicate
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import collapse, moment_matched
from usbldr.filters.estimators.protocol import Estimate, Estimates, Filter, MakeRng, Prior, SeededRng, Step, Steps
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import NoiseFamily
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import StateFunction, Unscented
from usbldr.filters.types import Array, Update, Vector
from usbldr.filters.updates import Parts, UpdateTable

RECORD = 9  # fixed: numbers of a record before the shift of each state, as in kernel/layout.h
MATCHED, COLLAPSED, DRAWN = range(3)  # updates, as in kernel/layout.h
UPDATES = {moment_matched: MATCHED, collapse: COLLAPSED}
FAULTS = {-1: np.linalg.LinAlgError("singular predicted covariance"), -2: MemoryError("no memory for the kernel")}
Compilable: TypeAlias = KalmanFilter | CubatureParticleFilter


class Doubt(NamedTuple):
    """When a step calls for hypotheses about its fixes, see kernel/guard.h."""

    log_relocation: Vector  # of each step: log probability of a drift that nothing has shown; NaN: it has no fix
    outlier_m2: float  # variance of an outlier


class KernelBelief(NamedTuple):
    """The bank in the kernel's memory, the past steps that a move may change, and the estimate."""

    state: Vector  # see exchange in kernel/steps.h
    past: tuple[tuple[bytes, bytes], ...]  # code of each step, and of its readings
    estimate: Estimate
    history: InnovationHistory = MappingProxyType({})  # for the inflation factor


def compiled(estimator: Filter[Any], kinds: Iterable[tuple[StateFunction, NoiseFamily]]) -> Filter[Any]:
    """Return the filter in the kernel if there is one that can run it, else the filter itself.

    ``kinds`` are the sensor models and noise families of all measurements that it will be given.
    """
    if KERNEL.advance is None or type(estimator) not in (KalmanFilter, CubatureParticleFilter):
        return estimator
    assert isinstance(estimator, KalmanFilter | CubatureParticleFilter)
    if isinstance(estimator, KalmanFilter):
        known = estimator.mode_update in UPDATES
    else:
        known = estimator.move_steps <= KERNEL.limits.depth
    motion = estimator.motion
    if not known or not isinstance(motion, VehicleMotion) or not can_encode(motion, kinds):
        return estimator
    return CompiledFilter(estimator, motion)


class CompiledFilter:
    """A Kalman filter or a particle filter over modes, in the kernel."""

    def __init__(self, reference: Compilable, motion: VehicleMotion) -> None:
        self._encoder = Encoder(motion)
        self._reference, self._n = reference, len(motion.layout)
        self._scale = reference.rule.scale(self._n) if isinstance(reference.rule, Unscented) else 0.0
        self._particles, self._depth = 1, 0
        self._last: tuple[Steps, int | None, EncodedSteps] | None = None
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
        factor = self._reference.factor if isinstance(self._reference, KalmanFilter) else None
        if factor is not None and any(one.sensor in ADAPTED_SENSORS for one in step.measurements):
            return self._inflated_step(belief, step, factor, make_rng)
        return self._stepped(belief, step, make_rng)

    def span(self, belief: KernelBelief, steps: Steps, epochs: range, seed: int) -> tuple[KernelBelief, Estimates]:
        """Return the belief after the last of some of the steps, and the estimates after each."""
        if isinstance(self._reference, KalmanFilter) and self._reference.factor is not None:
            each = [belief]
            for k in epochs:
                each.append(self.step(each[-1], steps[k], SeededRng(seed, steps.first + k)))
            return each[-1], Estimates.of([one.estimate for one in each[1:]])
        return self.span_until(belief, steps, epochs, seed, None)

    def span_until(
        self, belief: KernelBelief, steps: Steps, epochs: range, seed: int, doubt: Doubt | None
    ) -> tuple[KernelBelief, Estimates]:
        """Return the same, but stop before a step whose fixes may call for hypotheses."""
        coded = self._encoded(steps, seed if self._depth else None)
        mine = slice(epochs.start, epochs.stop)
        parts = slice(*coded.begin[[mine.start, mine.stop]].tolist())
        arrays = (coded.steps[mine].data, coded.readings[parts].data)
        state, rows, records = self._run(belief, len(epochs), *arrays, parts.stop - parts.start, doubt)
        done = epochs[: len(rows)]
        parts = slice(parts.start, int(coded.begin[epochs.start + len(done)]))
        n = self._n
        covs, ess, acceptance = rows[:, n:-2].reshape(-1, n, n), rows[:, -2], rows[:, -1]
        updates = update_table(coded, parts, records[: parts.stop - parts.start])
        estimates = Estimates(rows[:, :n], covs, updates, ess, acceptance, np.ones(len(rows)))
        if done:
            belief = belief._replace(state=state, past=self._past(belief, coded, done), estimate=estimates.last)
        return belief, estimates

    def estimate(self, belief: KernelBelief) -> Estimate:
        """Return the estimate after the last step."""
        return belief.estimate

    def _inflated_step(self, belief: KernelBelief, step: Step, factor: InflationFactor, rng: MakeRng) -> KernelBelief:
        """Return the belief after a step with a position fix, its predicted covariance inflated first."""
        predicted = self._stepped(belief, step._replace(measurements=()), rng).estimate
        bank = replicate(predicted.mean, predicted.cov, 1)
        bank, history, inflation = inflate(bank, step.measurements, belief.history, self._reference.rule, factor)
        inflated = belief._replace(state=self._memory(bank), history=history)
        after = self._stepped(inflated, step._replace(t0_s=step.t1_s), rng)
        return after._replace(estimate=after.estimate._replace(inflation=inflation))

    def _stepped(self, belief: KernelBelief, step: Step, make_rng: MakeRng) -> KernelBelief:
        """Return the belief after one step."""
        words, generator = (0, 0, 0, 0), (0, 0, 0, 0)
        if self._depth:
            words = seed_words(make_rng.seed, make_rng.epoch) if isinstance(make_rng, SeededRng) else None
            if words is None:
                generator = generator_state(make_rng())
        coded, n = self._encoder.step(step, words, generator), self._n
        state, rows, records = self._run(belief, 1, coded.step, coded.readings, len(coded.parts), None)
        updates = step_updates(coded, records.tolist())
        estimate = Estimate(rows[0, :n], rows[0, n:-2].reshape(n, n), updates, *rows[0, -2:])
        past = (*belief.past, (coded.step, coded.readings))[-self._depth :] if self._depth else ()
        return belief._replace(state=state, past=past, estimate=estimate)

    def _past(self, belief: KernelBelief, coded: EncodedSteps, done: range) -> tuple[tuple[bytes, bytes], ...]:
        """Return the code of the last steps, which a move may change."""
        if not self._depth:
            return ()
        readings = (coded.readings[coded.begin[k] : coded.begin[k + 1]] for k in done[-self._depth :])
        last = zip(coded.steps[done[-self._depth :]], readings, strict=True)
        return (*belief.past, *((step.tobytes(), some.tobytes()) for step, some in last))[-self._depth :]

    def _encoded(self, steps: Steps, seed: int | None) -> EncodedSteps:
        """Return the code of steps; that of the last ones is kept, as hypotheses take them one after the other."""
        if self._last is None or self._last[0] is not steps or self._last[1] != seed:
            self._last = (steps, seed, encoded_steps(steps, self._encoder.motion, seed))
        return self._last[2]

    def _run(
        self,
        belief: KernelBelief,
        count: int,
        steps: bytes | memoryview,
        readings: bytes | memoryview,
        parts: int,
        doubt: Doubt | None,
    ) -> tuple[Vector, Array, Array]:
        """Return the bank after some steps, the estimate after each as a row, and a record for each part."""
        n = self._n
        state = belief.state.copy()
        rows = np.empty((count + 1, n + n * n + 2))  # the first is of the epoch before
        rows[0, :n], rows[0, n:-2] = belief.estimate.mean, belief.estimate.cov.ravel()
        records = np.full((parts, RECORD + n), np.nan)
        if belief.past:
            past_steps, past_readings = zip(*belief.past, strict=True)
            steps, readings = b"".join((*past_steps, steps)), b"".join((*past_readings, readings))
        assert KERNEL.advance is not None
        watch = (None, 0.0) if doubt is None else doubt
        inputs = (KERNEL.variant, self._code, len(belief.past), count, steps, readings, *watch)
        done = KERNEL.advance(*inputs, state, rows, records)
        if done < 0:
            raise FAULTS[done]
        return state, rows[1 : done + 1], records

    def _memory(self, bank: GaussianBank) -> Vector:
        """Return a bank as the kernel keeps it: see exchange in kernel/steps.h."""
        n, N = bank.mean.shape
        lanes = KERNEL.limits.lanes
        count = -(-N // lanes) * lanes  # whole blocks, filled with copies of the last particle
        padded = np.array([min(member, N - 1) for member in range(count)], dtype=np.intp)
        lower = np.tril_indices(n)
        both = np.concatenate([bank.mean, bank.cov[lower]])[:, padded]
        blocks = both.reshape(len(both), -1, lanes).swapaxes(0, 1).ravel()
        if not self._depth:
            return blocks
        weight = np.zeros((2, count))  # logarithms first; none for the copies
        weight[:, :N] = bank.log_weight, np.exp(bank.log_weight)
        past = np.zeros(self._depth * blocks.size)
        return np.concatenate([blocks, past, weight.ravel(), np.zeros(self._depth * count)])


def update_table(coded: EncodedSteps, parts: slice, records: Array) -> UpdateTable:
    """Return the updates of neighbouring parts from their records, see kernel/records.h."""
    scores, nominal, dof, shift = records[:, 6:8], records[:, 8].copy(), coded.dof[parts], records[:, RECORD:]
    nis = scores[:, 0] ** 2
    nis[dof == 2] += scores[dof == 2, 1] ** 2
    of_fix = coded.readings["fix"][parts] > 0
    columns = Parts(
        coded.sensor[parts],
        coded.axis[parts],
        (nominal < 0.5).astype(np.uint8),  # index into OUTCOMES
        coded.row[parts],
        coded.time_s[parts],
        nis,
        dof,
        nominal,
        records[:, 0:2].copy(),  # not the records themselves
        records[:, 2:4].copy(),
        records[:, 4:6].copy(),
        scores.copy(),
        np.where(of_fix, np.cumsum(of_fix) - 1, -1).astype(np.int32),
    )
    return UpdateTable(columns, np.flatnonzero(coded.is_first[parts]), coded.names, shift[of_fix])


def step_updates(step: EncodedStep, table: Sequence[Sequence[float]]) -> tuple[Update, ...]:
    """Return the updates of a step from the records of its parts."""
    updates: list[Update] = []
    part = 0
    for count in step.counts:
        of_one = [_update(step.parts[part + i], table[part + i]) for i in range(count)]
        updates.append(of_one[0] if count == 1 else Update.combined(of_one))
        part += count
    return tuple(updates)


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
        sum([score * score for score in scores]),
        k,
        "used" if nominal >= 0.5 else "down-weighted",
        nominal,
        tuple(row[RECORD:]) if part.sensor in FIXES else None,
        (),
        tuple(row[4 : 4 + k]),
        scores,
    )
