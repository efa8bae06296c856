"""Factors on the predicted covariance: afukf and aekf detect an over-confident prediction.

If the vehicle drifts in a way that the motion model does not cover, the innovations of the fixes exceed their predicted
covariance; it is then multiplied by a factor so that the filter follows the fixes. The paper's introduction names two
such filters without formulas or references, so the factors are those of the literature:

- ``FadingFactor`` (afukf): M^2 = e' S^-1 e is tested against its chi-square quantile, and the factor f solves
  e' (f H P H' + R)^-1 e = quantile. B. Gao, G. Hu, S. Gao, Y. Zhong and C. Gu, "Multi-sensor optimal data fusion based
  on the adaptive fading unscented Kalman filter", Sensors 18(2), 2018, doi:10.3390/s18020488.
- ``CovarianceMatching`` (aekf): with C the mean of e e' over a window, f = tr(C - R) / tr(H P H'). Y. Yang and W. Gao,
  "An optimal adaptive Kalman filter", J. Geodesy 80(4), 2006, doi:10.1007/s00190-006-0041-0 (their factor is 1/f).

Added here, so that one outlier does not set the factor (P is far below R, and a single e could ask for hundreds): only
position fixes are used; the median over a window replaces the last distance and the mean square; the window must first
exceed its chi-square limit; and a factor above 1 empties the window, so that the next needs new innovations.
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
"""Sensors whose innovations are used: those of position. Velocity and heading are measured at every epoch, and a DVL
with more noise than stated would inflate the position."""

# larger factors change nothing: the prediction has no weight against a fix; yaw must stay within a turn
MAX_FACTOR = 1e4


class Innovation(NamedTuple):
    """The innovation of one measurement of k scalars before any inflation."""

    e: Vector  # (k,) measured minus predicted
    predicted: Array  # (k, k) H P H'
    noise: Noise

    def distance(self, factor: float = 1.0) -> float:
        """Return e' (f H P H' + R)^-1 e with R of the whole mixture: k on average if the covariance is right."""
        inverse, _ = inverse_and_logdet((factor * self.predicted + self.noise.mixture_cov)[:, :, None])
        return float(self.e @ inverse[:, :, 0] @ self.e)


InnovationHistory: TypeAlias = Mapping[str, tuple[Innovation, ...]]
"""The last innovations of each position scalar, oldest first; immutable."""


class InflationFactor(Protocol):
    """The factor on the predicted covariance, from a full window of innovations of one scalar or fix."""

    @property
    def window(self) -> int:
        """Number of innovations in a window."""
        ...

    def __call__(self, innovations: Sequence[Innovation]) -> float:
        """Return the factor, 1 if the innovations fit their predicted covariance."""
        ...


@dataclass(frozen=True, slots=True)
class FadingFactor:
    """Bring the median distance back to its limit; tolerates two outliers in five fixes."""

    window: int = 5  # [innovations] their median tolerates two outliers
    probability: float = 0.99  # of a distance below the limit if the covariance is right

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
    """Match the predicted covariance to the squared innovations minus the measurement noise."""

    window: int = 10  # [innovations] twice that of the fading factor, as it uses their size and not only their limit
    probability: float = 0.9  # of a distance below the limit; that half of ten are above is then a chance of 1 in 600

    def __call__(self, innovations: Sequence[Innovation]) -> float:
        """Return the factor; 1 if the median distance is below its limit."""
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
    """Return the predicted bank of one, inflated, the new history and the largest factor of the step's scalars.

    The innovations of the step join the history first; a factor above 1 empties it.
    """
    largest = 1.0
    for part in (part for m in measurements if m.sensor in ADAPTED_SENSORS for part in m.parts()):
        projection = project(bank, part, rule)
        scalar = f"{part.sensor} {part.axis}"
        new = Innovation(projection.innovation[:, 0], projection.cov[:, :, 0], part.noise)
        last = (*history.get(scalar, ()), new)[-factor.window :]
        history = {**history, scalar: last}
        if len(last) == factor.window:
            largest = max(largest, factor(last))
    if largest > 1.0:
        return bank._replace(cov=largest * bank.cov), {}, largest
    return bank, history, 1.0
