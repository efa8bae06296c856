"""Many steps of several hypotheses at once: from fix to fix, as only a fix changes their number and their weights.

A single hypothesis in the kernel runs over fixes, too, up to one that may call for others (kernel/guard.h).
"""

from typing import Any, Protocol

import numpy as np

from usbldr.filters.estimators.compiled import CompiledFilter, Doubt
from usbldr.filters.estimators.hypotheses import MultiHypothesisBelief, reported
from usbldr.filters.estimators.hypothesis_likelihoods import SENSOR
from usbldr.filters.estimators.protocol import Estimates, Filter, SeededRng, Steps, run_span
from usbldr.filters.models.noise import Contamination
from usbldr.filters.types import Indices, Vector


class Guard(Filter[MultiHypothesisBelief], Protocol):
    """A MultiHypothesisFilter."""

    @property
    def filter(self) -> Filter[Any]:
        """What runs once for each hypothesis."""
        ...

    @property
    def outlier_noise(self) -> Contamination:
        """Share and scale of outliers."""
        ...

    @property
    def decision_odds(self) -> float:
        """For a new leader."""
        ...

    def drift_probability(self, outage_s: Vector) -> Vector:
        """Return the probability of a relocation after outages, (F,)."""
        ...


def hypotheses_over(
    guard: Guard, belief: MultiHypothesisBelief, steps: Steps, epochs: range, seed: int
) -> tuple[MultiHypothesisBelief, Estimates]:
    """Return the belief after the last of some of the steps, and the estimates after each."""
    fixes = steps.of_sensor(SENSOR)
    found: list[Estimates] = []
    while epochs:
        here = fixes[(fixes >= epochs.start) & (fixes < epochs.stop)]
        without = range(epochs.start, int(here[0])) if len(here) else epochs
        some = None
        if isinstance(guard.filter, CompiledFilter) and len(belief.hypotheses) == 1:
            belief, some = _until_doubt(guard, guard.filter, belief, steps, epochs, here, seed)
        elif without:
            belief, some = _between_fixes(guard, belief, steps, without, seed)
        if some is not None:
            found.append(some)
            epochs = epochs[len(some.mean) :]
        if epochs:
            belief = guard.step(belief, steps[epochs.start], SeededRng(seed, steps.first + epochs.start))
            found.append(Estimates.of([guard.estimate(belief)]))
            epochs = epochs[1:]
    return belief, Estimates.joined(found)


def _until_doubt(
    guard: Guard,
    kernel: CompiledFilter,
    belief: MultiHypothesisBelief,
    steps: Steps,
    epochs: range,
    fixes: Indices,
    seed: int,
) -> tuple[MultiHypothesisBelief, Estimates]:
    """Run the nominal hypothesis up to a step whose fixes may call for others; ``fixes`` are those that have any."""
    outage_s = np.diff(steps.t1_s[fixes], prepend=belief.last_fix_s)
    log_relocation = np.full(len(epochs), np.nan)
    with np.errstate(divide="ignore"):  # a probability of 0 has the logarithm -inf
        log_relocation[fixes - epochs.start] = np.log(guard.drift_probability(outage_s))
    (nominal,) = belief.hypotheses
    doubt = Doubt(log_relocation, guard.outlier_noise.sd**2)
    after, estimates = kernel.span_until(nominal.belief, steps, epochs, seed, doubt)
    used = fixes[fixes < epochs.start + len(estimates.mean)]
    return belief._replace(
        hypotheses=(nominal._replace(belief=after, estimate=kernel.estimate(after)),),
        last_fix_s=float(steps.t1_s[used[-1]]) if len(used) else belief.last_fix_s,
    ), estimates._replace(reacquisitions=belief.reacquisitions)


def _between_fixes(
    guard: Guard, belief: MultiHypothesisBelief, steps: Steps, epochs: range, seed: int
) -> tuple[MultiHypothesisBelief, Estimates]:
    """Run every hypothesis over steps without fixes, at least one."""
    runs = [run_span(guard.filter, hypothesis.belief, steps, epochs, seed) for hypothesis in belief.hypotheses]
    after = tuple(
        hypothesis._replace(belief=last, estimate=estimates.last)
        for hypothesis, (last, estimates) in zip(belief.hypotheses, runs, strict=True)
    )
    estimates = reported(belief, [estimates for _, estimates in runs], guard.decision_odds)
    return belief._replace(hypotheses=after), estimates
