"""An innovation as independent normal scores: how far it lies in its own predictive distribution, for any noise family.

With noise modes the innovation is a mixture sum eps_j N(0, S_j), whose square over its variance has no fixed
distribution: outliers of 10 m in the variance make good fixes look far too good. Rosenblatt's transform maps each
scalar, given those before it, through its own distribution function to a quantile of N(0, 1). If the model is right the
scores are independent N(0, 1), so their squares add to a chi-square value; for Gaussian noise that is e' S^-1 e.

M. Rosenblatt, "Remarks on a multivariate transformation", Annals of Mathematical Statistics 23(3), 1952,
doi:10.1214/aoms/1177729394.
"""

import math

import numpy as np

from usbldr.filters.models.noise import Noise, normal_quantile
from usbldr.filters.types import Array, Vector

ROUNDING = 1e-15  # fixed: of double precision; a smaller share of a variance is no number
LEAST_TAIL = 1e-300  # fixed: near the smallest number of double precision, 37 sigma


def normal_scores(e: Vector, predicted: Array, noise: Noise) -> tuple[float, ...]:
    """Return the scores of an innovation e (1,) or (2,) with predicted covariance H P H' (k, k) without the noise.

    Raises LinAlgError if the covariance is singular.
    """
    S = predicted + noise.cov  # (J, k, k)
    if len(S) == 1:
        only: Array = S[0]
        return tuple(float(score) for score in np.linalg.solve(np.linalg.cholesky(only), e))
    variance, weight = S[:, 0, 0], noise.probabilities
    scores = (_score(float(e[0]), weight, np.zeros(len(S)), np.sqrt(variance)),)
    if len(e) == 1:
        return scores
    log_w = np.log(weight) - 0.5 * (e[0] ** 2 / variance + np.log(variance))  # of the modes, given the first scalar
    weight = np.exp(log_w - log_w.max())
    slope = S[:, 1, 0] / variance
    rest = S[:, 1, 1] - slope * S[:, 1, 0]
    if not (rest > ROUNDING * S[:, 1, 1]).all():
        raise np.linalg.LinAlgError("singular predicted covariance")
    return (*scores, _score(float(e[1]), weight / weight.sum(), slope * e[0], np.sqrt(rest)))


def _score(value: float, weight: Vector, mean: Vector, sd: Vector) -> float:
    """Return the quantile of N(0, 1) that the value has in sum w_j N(mean_j, sd_j^2)."""
    t = (value - mean) / (math.sqrt(2) * sd)
    below, above = (sum(w * math.erfc(x) / 2 for w, x in zip(weight, side.tolist(), strict=True)) for side in (-t, t))
    score = normal_quantile(max(float(min(below, above)), LEAST_TAIL))
    return score if below < above else -score
