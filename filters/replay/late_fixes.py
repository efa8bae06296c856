"""Late fixes: used at their time of validity, or when they arrived.

Offline a fix is used at its time of validity. On the vehicle it arrives later: the filter then returns to its belief
before that time, uses the fix, and runs forward again. Beliefs are immutable, so the driver keeps the last ones; random
numbers depend on seed and epoch, so a repeated step gives the same result.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.estimators.protocol import Estimate, Filter, Prior, SeededRng, run_span
from usbldr.filters.replay.running_filter import MAX_FIX_DELAY_S, RunningFilter
from usbldr.filters.replay.steps import StepSource
from usbldr.filters.types import Update

SPAN = 100  # [epochs] that a filter is given at once: enough that the call itself costs nothing


class EpochEstimate(NamedTuple):
    """The estimate at an epoch when it is reached."""

    epoch: int
    estimate: Estimate
    updates: Mapping[int, Sequence[Update]]  # epoch -> updates, of each step that was run or repeated


def by_validity(estimator: Filter[Any], prior: Prior, source: StepSource, seed: int) -> Iterator[EpochEstimate]:
    """Yield the estimate of every epoch with all fixes up to it."""
    belief, count = estimator.start(prior), len(source.time_s)
    for first in range(0, count, SPAN):
        epochs = range(first, min(first + SPAN, count))
        rngs = [SeededRng(seed, k) for k in epochs]
        belief, estimates = run_span(estimator, belief, [source.step(k) for k in epochs], rngs)
        yield from (EpochEstimate(k, one, {k: one.updates}) for k, one in zip(epochs, estimates, strict=True))


def by_arrival(
    estimator: Filter[Any], prior: Prior, source: StepSource, seed: int, memory_s: float = MAX_FIX_DELAY_S
) -> Iterator[EpochEstimate]:
    """Yield the estimate of every epoch with the fixes that had arrived by then."""
    used, arrived = source.arrivals()
    running = RunningFilter(estimator, prior, seed, memory_s)
    for k, time_s in enumerate(source.time_s.tolist()):
        late = [j for j in used[arrived == k].tolist() if time_s - source.time_s[j] <= memory_s + 1e-9]
        first = min([k, *late])
        running.go_back(k - first)
        again = [running.advance(source.step(i, time_s)) for i in range(first, k + 1)]
        yield EpochEstimate(k, again[-1], {first + i: estimate.updates for i, estimate in enumerate(again)})


def discarded_fixes(source: StepSource, memory_s: float = MAX_FIX_DELAY_S) -> int:
    """Return how many fixes arrived too late for `by_arrival`, or after the end."""
    used, arrived = source.arrivals()
    t = source.time_s
    inside = arrived < len(t)
    age_s = t[arrived[inside]] - t[used[inside]]
    return int(np.count_nonzero(~inside) + np.count_nonzero(age_s > memory_s + 1e-9))


FIX_ORDERS: Mapping[str, Callable[..., Iterator[EpochEstimate]]] = {"validity": by_validity, "arrival": by_arrival}
