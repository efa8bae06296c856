"""A filter while it runs: its belief, and the steps of the last seconds that it can go back behind."""

from collections import deque
from typing import Any

from usbldr.filters.estimators.protocol import Estimate, Filter, Prior, SeededRng, Step

MAX_FIX_DELAY_S = 10.0  # later fixes are not used


class RunningFilter:
    """A filter and its belief. Random numbers depend on seed and epoch alone, so a step that is run again repeats."""

    def __init__(self, estimator: Filter[Any], prior: Prior, seed: int = 0, memory_s: float = MAX_FIX_DELAY_S) -> None:
        self.estimator, self.seed, self.memory_s = estimator, seed, memory_s
        self._belief = estimator.start(prior)
        self._before: deque[Any] = deque()  # the belief before each step of ``steps``; beliefs are immutable
        self.steps: deque[Step] = deque()  # those that ended within memory_s of the last one, oldest first

    def advance(self, step: Step) -> Estimate:
        """Run a step and return the estimate after it; a step that fails leaves the filter as it was."""
        belief = self.estimator.step(self._belief, step, SeededRng(self.seed, step.epoch))
        self._before.append(self._belief)
        self.steps.append(step)
        self._belief = belief
        while step.t1_s - self.steps[0].t1_s > self.memory_s + 1e-9:
            self._before.popleft()
            self.steps.popleft()
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """The estimate after the last step."""
        return self.estimator.estimate(self._belief)

    def __copy__(self) -> "RunningFilter":
        """Return a filter at the same belief that may run on by itself."""
        other = object.__new__(RunningFilter)
        other.__dict__ |= vars(self) | {"steps": self.steps.copy(), "_before": self._before.copy()}
        return other

    def go_back(self, count: int) -> list[Step]:
        """Undo the last ``count`` steps and return them, oldest first."""
        undone: list[Step] = []
        for _ in range(count):
            self._belief = self._before.pop()
            undone.append(self.steps.pop())
        return undone[::-1]
