"""The white and the slow part of the noise of a series, of which some shapes are known only up to a factor.

The series is a sum of the shapes, of a first-order Gauss-Markov process (the slow part) and of white noise. The shapes
are projected out, so that the likelihood is that of what is left (restricted maximum likelihood: H. Patterson and
R. Thompson, Biometrika 58(3), 1971, doi:10.2307/2334389). The posterior is summed over a grid of the ratio of both
parts and of the time constant: a short dive leaves both uncertain, and a maximum alone would hide that. Of the slow
part the median is taken: its posterior has a long tail of large and very slow errors, and its mean is 5 to 30 % too
large.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector

RATIOS = np.concatenate([[0.0], np.geomspace(0.1, 10.0, 24)])  # [1] of the sigma of the slow part over the white one
CONSTANTS = 8  # of time, tried from SHORTEST to LONGEST
SHORTEST = 3.0  # [1] median intervals, of those above zero: a faster process is white to these fixes
LONGEST = 0.5  # [1] of the span: a slower one is a shape that was projected out, an offset or a drift
MOST = 3000  # of a series, from its beginning: half a second of computing, and an hour or more of fixes
STEP = 0.0635  # of a sigma: what the steps between RATIOS leave of the slow one
LEAST_M2 = 1e-12  # of all values: the shapes explain them but for rounding, so that there is no noise
SINGULAR = 1e-6  # of the largest singular value of the shapes: below it two of them are the same


class NoisePart(NamedTuple):
    """The 1-sigma of a part of the noise, and its own 1-sigma."""

    sd: float
    sd_of_sd: float


class SlowNoise(NamedTuple):
    """The parts of the noise."""

    white: NoisePart
    slow: NoisePart
    time_constant_s: float  # of the slow part: its geometric mean


def slow_noise(time_s: Vector, values: Vector, shapes: Array) -> SlowNoise:
    """Return the parts of the noise of values (n,) with shapes (n, p), at ascending times, of which some differ."""
    time_s, values, shapes = time_s[:MOST], values[:MOST], shapes[:MOST]
    left, size, _ = np.linalg.svd(shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-300), full_matrices=False)
    data = np.column_stack([values, left[:, size > SINGULAR * size[0]]])
    step_s = np.diff(time_s)
    interval_s, span_s = float(np.median(step_s[step_s > 0])), float(time_s[-1] - time_s[0])
    shortest_s = SHORTEST * interval_s
    constants_s = np.geomspace(shortest_s, max(LONGEST * span_s, 2 * shortest_s), CONSTANTS)
    ratio, constant_s = (grid.ravel() for grid in np.meshgrid(RATIOS, constants_s, indexing="ij"))
    moments, log_det = _whitened(np.append(np.inf, step_s), data, ratio**2, constant_s)
    free = len(values) - data.shape[1] + 1
    solved = np.linalg.solve(moments[:, 1:, 1:], moments[:, 1:, :1])[..., 0]
    left_over = np.maximum(moments[:, 0, 0] - np.einsum("gi,gi->g", moments[:, 0, 1:], solved), LEAST_M2)
    log_det = log_det + np.linalg.slogdet(moments[:, 1:, 1:])[1]
    log_posterior = -0.5 * (free * np.log(left_over) + log_det) + np.log(np.repeat(_prior(), CONSTANTS))
    weight = np.exp(log_posterior - log_posterior.max())
    weight /= weight.sum()
    white = np.sqrt(left_over / free)
    constant = float(np.exp(np.average(np.log(constant_s), weights=weight * ratio + 1e-12)))
    slow = _median(ratio * white, weight)
    steps = STEP * slow
    return SlowNoise(
        _part(float(weight @ white), white, weight, free), _part(slow, ratio * white, weight, free, steps), constant
    )


def _prior() -> Vector:
    """Return the prior weight of RATIOS: half-Cauchy (A. Gelman, Bayesian Anal. 1(3), 2006, doi:10.1214/06-BA117A)."""
    edges = np.concatenate([[0.0], (RATIOS[1:] + RATIOS[:-1]) / 2, [np.inf]])
    return np.diff(np.arctan(edges))


def _median(sd: Vector, weight: Vector) -> float:
    order = np.argsort(sd)
    below = np.cumsum(weight[order]) - weight[order] / 2
    return float(np.interp(0.5, below, sd[order]))


def _part(estimate: float, sd: Vector, weight: Vector, free: int, step: float = 0.0) -> NoisePart:
    own = float(weight @ (sd - estimate) ** 2 + weight @ sd**2 / (2 * free))
    return NoisePart(estimate, float(np.hypot(np.sqrt(own), step)))


def _whitened(step_s: Vector, data: Array, variance: Vector, constant_s: Vector) -> tuple[Array, Vector]:
    """Return the moments (g, q, q) of whitened data (n, q) and the log determinants (g,) for g processes.

    A Kalman filter of all processes at once; the white noise has variance 1.
    """
    mean = np.zeros((len(variance), data.shape[1]))
    before, log_det = np.zeros(len(variance)), np.zeros(len(variance))
    moments = np.zeros((len(variance), data.shape[1], data.shape[1]))
    for wait_s, row in zip(step_s.tolist(), data, strict=True):
        kept = np.exp(-wait_s / constant_s)
        mean *= kept[:, None]
        before = kept**2 * before + variance * (1 - kept**2)
        S = before + 1.0
        error = row - mean
        moments += (error / S[:, None])[:, :, None] * error[:, None, :]
        log_det += np.log(S)
        gain = before / S
        mean += gain[:, None] * error
        before = before * (1 - gain)
    return moments, log_det
