"""Factors on the predicted covariance: how afukf and aekf hear from their innovations that the prediction is off.

A filter trusts its prediction as much as its process noise says. Where the vehicle is carried off by what the motion
model does not know, the innovations of the fixes grow beyond what the filter expects, and the predicted covariance is
multiplied so that the filter follows them. Two systems that the paper's introduction names do so; its text gives
neither formulas nor a list of references, so the factors are those of the method's own literature:

- ``Fading`` (afukf): the distance M^2 = e' S^-1 e is tested against its chi-square quantile, and the factor solves
  e' (f H P H' + R)^-1 e = quantile. B. Gao, G. Hu, S. Gao, Y. Zhong and C. Gu, "Multi-sensor optimal data fusion based
  on the adaptive fading unscented Kalman filter", Sensors 18(2), 2018, doi:10.3390/s18020488.
- ``CovarianceMatching`` (aekf): with C the mean of e e' over a window, f = tr(C - R) / tr(H P H'). Y. Yang and W. Gao,
  "An optimal adaptive Kalman filter", J. Geodesy 80(4), 2006, doi:10.1007/s00190-006-0041-0 (their factor is 1/f).

Ours is what keeps them from following every gross error, because P is far below R here and a factor of hundreds hangs
on a single e: only position fixes are listened to; medians of a window stand for the last distance and for the mean
square; both ask first whether the window is more than chance; and a factor uses its evidence up, so that the next one
needs a window of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, inverse_and_logdet, project
from usbldr.filters.models.noise import Noise, chi_square_quantile
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.types import Array, Vector

ADAPTED_SENSORS = ("usbl", "gps")
"""Sensors that tell where the vehicle is. Speed and heading are measured anew at every epoch and need no help; a DVL
that errs more than it says would only blow up the position."""

MAX_FACTOR = 1e4  # beyond this the prediction counts for nothing against a fix anyway, and angles must stay angles


class Innovation(NamedTuple):
    """One measurement of k scalars as the unchanged prediction saw it."""

    e: Vector  # (k,) measured minus predicted
    predicted: Array  # (k, k) H P H'
    noise: Noise

    def distance(self, factor: float = 1.0) -> float:
        """Return e' (f H P H' + R)^-1 e with R of the whole mixture: k on average when all is as predicted."""
        inverse, _ = inverse_and_logdet((factor * self.predicted + self.noise.mixture_cov)[:, :, None])
        return float(self.e @ inverse[:, :, 0] @ self.e)


InnovationHistory: TypeAlias = Mapping[str, tuple[Innovation, ...]]
"""The last innovations of each scalar that is listened to, oldest first; never changed, only replaced."""


class InflationFactor(Protocol):
    """What a full window of innovations of one scalar (or record) makes of the predicted covariance."""

    @property
    def window(self) -> int:
        """How many innovations it takes."""
        ...

    def __call__(self, innovations: Sequence[Innovation]) -> float:
        """Return the factor, 1 where the innovations are as predicted."""
        ...


@dataclass(frozen=True, slots=True)
class FadingFactor:
    """Bring the median distance back to its limit: two false fixes in five are borne, a displacement is not."""

    window: int = 5  # [innovations] their median tolerates two outliers
    probability: float = 0.99  # of a distance below the limit if the covariance is right: of a false alarm in 100 fixes

    def __call__(self, innovations: Sequence[Innovation]) -> float:
        """Return the factor by bisection of its logarithm; the distance falls as the factor grows."""
        limit = chi_square_quantile(self.probability, len(innovations[0].e))
        if _median_distance(innovations) <= limit:
            return 1.0
        low, high = 1.0, MAX_FACTOR
        while high > 1.001 * low:
            middle = (low * high) ** 0.5
            low, high = (middle, high) if _median_distance(innovations, middle) > limit else (low, middle)
        return high


@dataclass(frozen=True, slots=True)
class CovarianceMatching:
    """Let the predicted covariance explain what the noise leaves of the innovations' square."""

    window: int = 10  # [innovations] twice those of the fading factor, as it follows their size and not their limit
    probability: float = 0.9  # of a distance below the limit; that half of ten are above is then chance once in 600

    def __call__(self, innovations: Sequence[Innovation]) -> float:
        """Return the factor where the median distance is above its limit."""
        k = len(innovations[0].e)
        if _median_distance(innovations) <= chi_square_quantile(self.probability, k):
            return 1.0
        C = np.median([one.e @ one.e for one in innovations]) * k / chi_square_quantile(0.5, k)  # trace
        R = np.median([np.trace(one.noise.mixture_cov) for one in innovations])
        predicted = np.median([np.trace(one.predicted) for one in innovations])
        return min(max(float((C - R) / predicted), 1.0), MAX_FACTOR) if predicted > 0 else 1.0


def _median_distance(innovations: Sequence[Innovation], factor: float = 1.0) -> float:
    return float(np.median([innovation.distance(factor) for innovation in innovations]))


def inflate(
    bank: GaussianBank,
    measurements: Sequence[Measurement],
    history: InnovationHistory,
    rule: MomentTransform,
    factor: InflationFactor,
) -> tuple[GaussianBank, InnovationHistory, float]:
    """Return a predicted bank of one with its covariance times the largest factor of the step's scalars.

    The innovations of the step join the history first; a factor above 1 empties it.
    """
    largest = 1.0
    for part in (part for m in measurements if m.sensor in ADAPTED_SENSORS for part in m.parts()):
        seen = project(bank, part, rule)
        scalar = f"{part.sensor} {part.axis}"
        new = Innovation(seen.innovation[:, 0], seen.cov[:, :, 0], part.noise)
        last = (*history.get(scalar, ()), new)[-factor.window :]
        history = {**history, scalar: last}
        if len(last) == factor.window:
            largest = max(largest, factor(last))
    if largest > 1.0:
        return bank._replace(cov=largest * bank.cov), {}, largest
    return bank, history, 1.0
