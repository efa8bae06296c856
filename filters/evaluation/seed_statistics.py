"""Several runs of the same thing: means with standard errors, medians, paired differences. Metres, or any unit.

A standard error is the sample standard deviation over the square root of the number of runs. Differences are paired
(the same dives, so that what makes a dive hard cancels) and judged by Student's t test.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from usbldr.filters.evaluation.consistency import CONFIDENCE, Nees, effective_number, nees_with_bounds
from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.types import Vector

LEAST_PAIRS = 3  # pairs of runs: the t test of two demands 13 standard errors, so it decides nothing
DIVERGED_M = 5.0  # mean horizontal error of a run that has lost the vehicle
DIVERGED_SHARE = Metric(
    "diverged_share", f"Share of the seeds with a mean horizontal error over {DIVERGED_M:g} m.", direction="lower"
)
LEAST_EPOCHS = 40  # below, no block is long and frequent enough
LEAST_BLOCKS = 4  # in the series: 3 degrees of freedom
LONGER = 2.0  # [-] times the block of least variance: intervals of AR(1) series then cover 92 to 95 %, not 88


class MeanWithError(NamedTuple):
    """The mean of several runs; the standard error is None for a single one."""

    mean: float
    se: float | None
    median: float


class PairedDifference(NamedTuple):
    """How much larger one method's value is than another's, on average over the same runs."""

    mean: float
    se: float | None
    significant: bool | None  # at 95 %; None with fewer than LEAST_PAIRS runs
    probability: float | None = None  # of so large a difference between equals; of a single dive


def average(values: Sequence[float]) -> MeanWithError:
    """Return mean, standard error and median of n >= 1 values."""
    return MeanWithError(float(np.mean(values)), _standard_error(np.asarray(values)), float(np.median(values)))


def paired_difference(values: Sequence[float], others: Sequence[float]) -> PairedDifference:
    """Return the mean of values - others, (n,) each and in the same order of runs."""
    if len(values) != len(others):
        raise ValueError(f"{len(values)} and {len(others)} runs cannot be paired")
    difference = np.asarray(values) - np.asarray(others)
    mean, se = float(np.mean(difference)), _standard_error(difference)
    if se is None or len(values) < LEAST_PAIRS:
        return PairedDifference(mean, se, None)
    return PairedDifference(mean, se, abs(mean) > student_quantile((1 + CONFIDENCE) / 2, len(values) - 1) * se)


def diverged_share(mean_horizontal_m: Sequence[float]) -> float:
    """Return which share of the runs has a mean horizontal error over DIVERGED_M."""
    return float(np.mean(np.asarray(mean_horizontal_m) > DIVERGED_M))


def pooled_nees(nees_mean: Sequence[float], independent: Sequence[float]) -> Nees:
    """Return the mean NEES of independent runs with the bounds that 95 of 100 such ensembles keep.

    ``independent`` are the effective numbers of errors of each run; that of the mean of means is K^2 / sum(1 / n).
    """
    count = len(nees_mean) ** 2 / float(np.sum(1 / np.asarray(independent)))
    return nees_with_bounds(float(np.mean(nees_mean)), count)


def student_quantile(probability: float, dof: float) -> float:
    """Return the quantile of Student's t: exact for 1 and 2 degrees of freedom, else to 0.2 % at 97.5 %.

    R. A. Fisher and E. A. Cornish, "The percentile points of distributions having known cumulants", Technometrics
    2(2), 1960: four terms of the expansion about the normal quantile.
    """
    if dof == 1:
        return math.tan(math.pi * (probability - 0.5))
    if dof == 2:
        a = 2 * probability - 1
        return a * math.sqrt(2 / (1 - a**2))
    z = NormalDist().inv_cdf(probability)
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / dof ** (k + 1) for k, term in enumerate(terms))


def _standard_error(values: Vector) -> float | None:
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else None


def mean_difference(difference: Vector) -> PairedDifference:
    """Return the mean of the differences (M,) of a dive's successive epochs with its standard error and probability.

    A block is as long as is best for an AR(1) series (E. Carlstein, Annals of Statistics 14(3), 1986; times 1.5^(1/3)
    for blocks that overlap) with the same effective number of errors as NEES uses: M (1 - a²) / (1 + a²).

    The moving-block bootstrap: H. R. Künsch, "The jackknife and the bootstrap for general stationary observations",
    Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265. The variance of the bootstrapped mean has a closed
    form, so that nothing is drawn.
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
