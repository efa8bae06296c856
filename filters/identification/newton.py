"""Newton's method with batches: value, gradient and curvature by differences from one call for many points.

Made for a log likelihood that costs a pass over a log, and little more for fifty points than for one.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector

LogLikelihood = Callable[[Sequence[Vector]], Vector]
"""The log likelihoods, (m,), of m points, (d,) each."""

DIFFERENCE_STEP = 0.1  # between neighbours, in logarithms: rounding and curvature both stay small
MAX_STEP = 1.5  # in logarithms, 4.5 times: the quadratic is not valid further away
MIN_GAIN = 0.05  # of the log posterior; a smaller one needs no further batch
PATTERN = (1.0, 1 / 4, 1 / 16)  # of a step: from MAX_STEP down to about DIFFERENCE_STEP
MAX_BATCHES = 20  # by judgement: a search that takes more has no clear maximum


class Maximum(NamedTuple):
    """The result of the search."""

    point: Vector  # (d,)
    value: float  # the log posterior there, but for a constant
    converged: bool


class _Quadratic(NamedTuple):
    """The log posterior around a point."""

    point: Vector  # (d,)
    value: float
    gradient: Vector  # (d,)
    information: Array  # (d, d) minus its curvature, positive definite

    @property
    def step(self) -> Vector:
        """Newton's step, no coordinate longer than MAX_STEP."""
        whole: Vector = np.linalg.solve(self.information, self.gradient).astype(np.float64, copy=False)
        return whole * min(1.0, MAX_STEP / float(np.abs(whole).max(initial=MAX_STEP)))

    @property
    def expected_gain(self) -> float:
        """Gain of the log posterior by the whole step, if quadratic."""
        return 0.5 * float(self.gradient @ np.linalg.solve(self.information, self.gradient))


def maximise(log_likelihood: LogLikelihood, centre: Vector, prior_sd: Vector, start: Vector) -> Maximum:
    """Return the maximum of log likelihood plus the prior N(centre, diag prior_sd^2), sought from the start.

    A likelihood of several hypotheses is not smooth: if Newton's step gains nothing, the best point of a pattern is
    next, and the search has converged if that gains nothing either.
    """
    best, batches, converged = _around(log_likelihood, start, centre, prior_sd), 1, False
    while batches < MAX_BATCHES and not converged:
        if best.expected_gain >= MIN_GAIN:
            ahead = _around(log_likelihood, best.point + best.step, centre, prior_sd)
            batches += 1
            if ahead.value >= best.value + MIN_GAIN:
                best = ahead
                continue
        pattern = _pattern(best)
        values = log_likelihood(pattern) - _penalty(np.array(pattern), centre, prior_sd)
        converged = bool(values.max() < best.value + MIN_GAIN)
        if not converged:
            best = _around(log_likelihood, pattern[int(np.argmax(values))], centre, prior_sd)
        batches += 2 - converged
    return Maximum(best.point, best.value, converged)


def _pattern(around: _Quadratic) -> list[Vector]:
    """Return points along Newton's step and both ways along each axis, near and far."""
    axes = MAX_STEP * np.eye(len(around.point))
    directions = [around.step, *axes, *-axes]
    return [around.point + part * direction for part in PATTERN for direction in directions]


def _penalty(points: Array, centre: Vector, prior_sd: Vector) -> Vector:
    """Return minus the log of the prior at points (m, d), (m,)."""
    return 0.5 * np.sum(((points - centre) / prior_sd) ** 2, axis=-1)


def _around(log_likelihood: LogLikelihood, point: Vector, centre: Vector, prior_sd: Vector) -> _Quadratic:
    """Return the quadratic from the point, its neighbours on each axis, and those on each pair of axes."""
    d, h = len(point), DIFFERENCE_STEP
    unit, pairs = h * np.eye(d), list(combinations(range(d), 2))
    points = [point, *(point + unit), *(point - unit), *(point + unit[i] + unit[j] for i, j in pairs)]
    (here,), up, down, both = np.split(log_likelihood(points), [1, 1 + d, 1 + 2 * d])
    curvature = np.diag(up - 2 * here + down) / h**2
    for (i, j), corner in zip(pairs, both, strict=True):
        curvature[i, j] = curvature[j, i] = (corner - up[i] - up[j] + here) / h**2
    # information of data is not negative: no eigenvalue below the least of the prior
    values, vectors = np.linalg.eigh(np.diag(prior_sd**-2) - curvature)
    return _Quadratic(
        point,
        float(here - _penalty(point, centre, prior_sd)),
        (up - down) / (2 * h) - (point - centre) / prior_sd**2,
        (vectors * np.maximum(values, prior_sd.max() ** -2)) @ vectors.T,
    )
