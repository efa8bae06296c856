"""How sure the mean of one dive's differences is: the moving-block bootstrap, and Holm's correction for several.

H. R. Künsch, "The jackknife and the bootstrap for general stationary observations", Annals of Statistics 17(3), 1989,
doi:10.1214/aos/1176347265. The variance of the bootstrapped mean has a closed form, so that nothing is drawn.
"""

import math
from collections.abc import Sequence

import numpy as np

from usbldr.filters.evaluation.consistency import CONFIDENCE, effective_number
from usbldr.filters.evaluation.seed_statistics import PairedDifference, student_quantile
from usbldr.filters.types import Vector

LEAST_EPOCHS = 40  # below, no block is long and frequent enough
LEAST_BLOCKS = 4  # in the series: 3 degrees of freedom
LONGER = 2.0  # [-] times the block of least variance: intervals of AR(1) series then cover 92 to 95 %, not 88


def mean_difference(difference: Vector) -> PairedDifference:
    """Return the mean of the differences (M,) of a dive's successive epochs with its standard error and probability.

    A block is as long as is best for an AR(1) series (E. Carlstein, Annals of Statistics 14(3), 1986; times 1.5^(1/3)
    for blocks that overlap) with the same effective number of errors as NEES uses: M (1 - a²) / (1 + a²).
    """
    M = len(difference)
    mean = float(np.mean(difference)) if M else math.nan
    e = difference - mean
    if M < LEAST_EPOCHS or not e.any():
        return PairedDifference(mean, None, None)
    correlated = M / effective_number(e[:, None])
    a = math.sqrt((correlated - 1) / (correlated + 1)) if correlated > 1 else 0.0
    best = (1.5 * M) ** (1 / 3) * (math.sqrt(6) * a / (1 - a**2)) ** (2 / 3)
    length = max(1, min(round(LONGER * best), M // LEAST_BLOCKS))
    sums = np.concatenate([[0.0], np.cumsum(e)])
    blocks = (sums[length:] - sums[:-length]) / length
    se = float(np.std(blocks)) * math.sqrt(length / M)
    probability = two_sided(abs(mean) / se, M / length - 1) if se > 0 else 0.0
    return PairedDifference(mean, se, probability <= 1 - CONFIDENCE, probability)


def two_sided(t: float, dof: float) -> float:
    """Return the probability that Student's t is at least so far from 0, by halving."""
    low, high = 0.0, 0.5  # of one side
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (low, middle) if student_quantile(1 - middle, dof) < t else (middle, high)
    return 2 * high


def significant_among(probability: float, probabilities: Sequence[float]) -> bool:
    """Return whether a probability, one of several, is significant by Holm's step-down correction.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian J. of Statistics 6(2), 1979.
    """
    ordered = sorted(probabilities)
    left = zip(ordered, range(len(ordered), 0, -1), strict=True)
    failed = next((one for one, count in left if one > (1 - CONFIDENCE) / count), math.inf)
    return probability < failed
