"""Several runs of the same thing: means with standard errors, medians, paired differences. Metres, or any unit.

A standard error is the sample standard deviation over the square root of the number of runs. Differences are paired
(the same dives, so that what makes a dive hard cancels) and judged by Student's t test.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from usbldr.filters.evaluation.consistency import CONFIDENCE, Nees, nees_with_bounds
from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.types import Vector

LEAST_PAIRS = 3  # pairs of runs: the t test of two demands 13 standard errors, so it decides nothing
DIVERGED_M = 5.0  # mean horizontal error of a run that has lost the vehicle
DIVERGED_SHARE = Metric(
    "diverged_share", f"Share of the seeds with a mean horizontal error over {DIVERGED_M:g} m.", direction="lower"
)


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
