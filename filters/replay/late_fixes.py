"""Late fixes: used at their time of validity, or when they arrived.

Offline a fix is used at its time of validity. On the vehicle it arrives later: the filter then returns to its belief
before that time, uses the fix, and runs forward again. Beliefs are immutable, so the driver keeps the last ones; random
numbers depend on seed and epoch, so a repeated step gives the same result.
"""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from usbldr.filters.estimators.protocol import Estimate, Filter, MakeRng
from usbldr.filters.replay.steps import StepSource
from usbldr.filters.types import Update

Belief = TypeVar("Belief")
MAX_FIX_DELAY_S = 10.0  # later fixes are not used


class EpochEstimate(NamedTuple):
    """The estimate at an epoch when it is reached."""

    epoch: int
    estimate: Estimate
    updates: Mapping[int, Sequence[Update]]  # epoch -> updates, of each step that was run or repeated


def by_validity(estimator: Filter[Belief], belief: Belief, source: StepSource, seed: int) -> Iterator[EpochEstimate]:
    """Yield the estimate of every epoch with all fixes up to it."""
    for k in range(len(source.time_s)):
        belief = estimator.step(belief, source.step(k), _make_rng(seed, k))
        estimate = estimator.estimate(belief)
        yield EpochEstimate(k, estimate, {k: estimate.updates})


def by_arrival(
    estimator: Filter[Belief], belief: Belief, source: StepSource, seed: int, memory_s: float = MAX_FIX_DELAY_S
) -> Iterator[EpochEstimate]:
    """Yield the estimate of every epoch with the fixes that had arrived by then."""
    used, arrived = source.arrivals()
    before: deque[Belief] = deque()  # the beliefs before the last steps; the newest is that before step k
    for k, time_s in enumerate(source.time_s.tolist()):
        before.append(belief)
        while time_s - source.time_s[k - len(before) + 1] > memory_s + 1e-9:
            before.popleft()
        oldest = k - len(before) + 1
        late = [j for j in used[arrived == k].tolist() if j >= oldest]
        first = min([k, *late])
        belief = before[first - oldest]
        updates: dict[int, Sequence[Update]] = {}
        for i in range(first, k + 1):
            before[i - oldest] = belief
            belief = estimator.step(belief, source.step(i, time_s), _make_rng(seed, i))
            updates[i] = estimator.estimate(belief).updates
        yield EpochEstimate(k, estimator.estimate(belief), updates)


def discarded_fixes(source: StepSource, memory_s: float = MAX_FIX_DELAY_S) -> int:
    """Return how many fixes arrived too late for `by_arrival`, or after the end."""
    used, arrived = source.arrivals()
    t = source.time_s
    inside = arrived < len(t)
    age_s = t[arrived[inside]] - t[used[inside]]
    return int(np.count_nonzero(~inside) + np.count_nonzero(age_s > memory_s + 1e-9))


FIX_ORDERS: Mapping[str, Callable[..., Iterator[EpochEstimate]]] = {"validity": by_validity, "arrival": by_arrival}


def _make_rng(seed: int, epoch: int) -> MakeRng:
    return functools.partial(np.random.default_rng, (seed, epoch))
