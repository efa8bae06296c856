"""Resampling of particles and the effective sample size."""

import numpy as np

from usbldr.filters.types import Indices, Vector


def systematic(weights: Vector, rng: np.random.Generator) -> Indices:
    """Return N ancestor indices, (N,), for normalised weights (N,); particle i is drawn N w_i times, give or take one.

    J. Carpenter, P. Clifford and P. Fearnhead, "Improved particle filter for nonlinear problems", IEE Proc. Radar,
    Sonar and Navigation 146(1), 1999, doi:10.1049/ip-rsn:19990255.
    """
    count = len(weights)
    edges = np.cumsum(weights)
    edges *= count / edges[-1]
    edges[-1] = count  # rounding below the last pointer would index past the end
    return np.searchsorted(edges, np.arange(count) + rng.random(), side="right")


def effective_size(log_weight: Vector) -> float:
    """Return 1 / sum w^2 of normalised log weights (N,): between 1 and N."""
    return float(1 / np.sum(np.exp(2 * log_weight)))


def normalised(log_weight: Vector) -> Vector:
    """Return log weights (N,) shifted so that the weights add to 1."""
    top = log_weight.max()
    return log_weight - (top + np.log(np.sum(np.exp(log_weight - top))))
