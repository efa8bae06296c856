"""Late fixes: used at their time of validity, or when they arrived.

Offline a fix is used at its time of validity. On the vehicle it arrives later: the filter then returns to its belief
before that time, uses the fix, and runs forward again. Beliefs are immutable, so the driver keeps the last ones; random
numbers depend on seed and epoch, so a repeated step gives the same result.
"""

import bisect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.estimators.protocol import Estimates, Filter, Prior, run_span
from usbldr.filters.replay.running_filter import MAX_FIX_DELAY_S, RunningFilter
from usbldr.filters.replay.steps import StepSource
from usbldr.filters.types import Update, Vector

SPAN = 1000  # [epochs] that a filter is given at once: enough that the call itself costs nothing


class Stretch(NamedTuple):
    """The estimates of neighbouring epochs when they are reached, and updates that no late fix repeats any more."""

    first: int  # epoch
    estimates: Estimates
    settled: Iterable[Update]


def by_validity(estimator: Filter[Any], prior: Prior, source: StepSource, seed: int) -> Iterator[Stretch]:
    """Yield the estimates of all epochs, each with all fixes up to it."""
    belief, count = estimator.start(prior), len(source.time_s)
    for first in range(0, count, SPAN):
        steps = source.steps(first, min(first + SPAN, count))
        belief, estimates = run_span(estimator, belief, steps, range(len(steps)), seed)
        yield Stretch(first, estimates, estimates.updates)


def by_arrival(
    estimator: Filter[Any], prior: Prior, source: StepSource, seed: int, memory_s: float = MAX_FIX_DELAY_S
) -> Iterator[Stretch]:
    """Yield the estimate of every epoch with the fixes that had arrived by then."""
    used, arrived = source.arrivals()
    running = RunningFilter(estimator, prior, seed, memory_s)
    updates: dict[int, Sequence[Update]] = {}  # of the last epochs, which a late fix may run again
    times_s: list[float] = source.time_s.tolist()
    for k, time_s in enumerate(times_s):
        late = [j for j in used[arrived == k].tolist() if time_s - source.time_s[j] <= memory_s + 1e-9]
        first = min([k, *late])
        running.go_back(k - first)
        again = [running.advance(source.every.step(i, time_s)) for i in range(first, k + 1)]
        updates |= {first + i: estimate.updates for i, estimate in enumerate(again)}
        last = k + 1 == len(times_s)
        oldest = k + 1 if last else settled_before(times_s, time_s, memory_s)
        settled = [update for i in range(min(updates), oldest) for update in updates.pop(i)]
        yield Stretch(k, Estimates.of([again[-1]._replace(updates=())]), settled)


def settled_before(times_s: Sequence[float] | Vector, time_s: float, memory_s: float = MAX_FIX_DELAY_S) -> int:
    """Return the first epoch that a late fix may still run again at a time, of epochs at ``times_s``."""
    return bisect.bisect_left(times_s, time_s - memory_s - 1e-6)


def discarded_fixes(source: StepSource) -> int:
    """Return how many fixes arrived too late for `by_arrival`, or after the end."""
    used, arrived = source.arrivals()
    t = source.time_s
    inside = arrived < len(t)
    age_s = t[arrived[inside]] - t[used[inside]]
    return int(np.count_nonzero(~inside) + np.count_nonzero(age_s > MAX_FIX_DELAY_S + 1e-9))


FIX_ORDERS: Mapping[str, Callable[..., Iterator[Stretch]]] = {"validity": by_validity, "arrival": by_arrival}
