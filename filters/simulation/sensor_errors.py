"""Random errors of simulated sensors: noise, correlated errors, outliers, multipath clusters.

Each kind of error draws from a generator of its own, so that it does not change the draws of the others. Errors are in
the sensor's own unit.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.models.noise import NoiseFamily, StudentT
from usbldr.filters.simulation.scenario import CorrelatedError, Intervals, Multipath, Outliers
from usbldr.filters.types import Array, Vector

Flags: TypeAlias = NDArray[np.bool_]  # (n,)


def draw_noise(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    """Return noise of ``count`` records, (count, k), for the nominal covariance R: (k, k), or (count, k, k).

    If the family is per scalar, each scalar draws its own mode, from the diagonal of R; else one for the record.
    """
    k = R.shape[-1]
    if family.per_scalar:
        axes = [slice(i, i + 1) for i in range(k)]
        return np.column_stack([_draw_records(family, R[..., axis, axis], count, rng) for axis in axes])
    return _draw_records(family, R, count, rng)


def _draw_records(family: NoiseFamily, R: Array, count: int, rng: np.random.Generator) -> Array:
    if isinstance(family, StudentT):  # the distribution itself; its modes are for filters
        precision = rng.chisquare(family.dof, count) / family.dof
        cov = R / precision[:, None, None]
    elif R.ndim == 2:
        noise = family.modes(R)
        cov = noise.cov[rng.choice(len(noise.probabilities), size=count, p=noise.probabilities)]
    else:
        each = [family.modes(one) for one in R]
        mode = rng.choice(len(each[0].probabilities), size=count, p=each[0].probabilities)
        cov = np.stack([noise.cov[j] for noise, j in zip(each, mode, strict=True)])
    # a symmetric root by eigenvalues, because a sensor without noise has no Cholesky root
    value, vector = np.linalg.eigh(cov)
    root = vector * np.sqrt(np.clip(value, 0, None))[:, None, :]
    return np.einsum("nij,nj->ni", root, rng.standard_normal((count, R.shape[-1])))


def correlated_error(error: CorrelatedError, time_s: Vector, axes: int, rng: np.random.Generator) -> Array:
    """Return a stationary first-order Gauss-Markov process at the times, (n, axes), axes independent.

    c_k+1 = phi c_k + sd sqrt(1 - phi^2) N(0, 1), phi = exp(-dt/T): exact for any intervals.
    """
    phi = np.exp(-np.diff(time_s, prepend=time_s[:1]) / error.time_constant_s)
    drive = error.sd * rng.standard_normal((len(time_s), axes))
    drive[1:] *= np.sqrt(1 - phi[1:, None] ** 2)
    error_by_time, c = np.empty_like(drive), np.zeros(axes)
    for k, step in enumerate(drive):
        c = phi[k] * c + step
        error_by_time[k] = c
    return error_by_time


def outlier_errors(outliers: Outliers, count: int, axes: int, rng: np.random.Generator) -> Array:
    """Return what outliers add to the records, (count, axes): 0 for inliers, a random direction for outliers."""
    affected = rng.random(count) < outliers.share
    far = np.where(affected, rng.uniform(outliers.least, outliers.most, count), 0.0)
    return far[:, None] * _directions(count, axes, rng)


def multipath_errors(multipath: Multipath, time_s: Vector, duration_s: float, rng: np.random.Generator) -> Array:
    """Return what multipath adds to the fixes, (n, 2): the same vector for all in a cluster, plus scatter.

    Clusters are at the stated times and at random: a Poisson process with exponential durations.
    """
    clusters = list(multipath.clusters_s)
    begin_s = rng.exponential(multipath.every_s) if multipath.every_s else np.inf
    while begin_s < duration_s:
        clusters.append((begin_s, begin_s + rng.exponential(multipath.lasts_s)))
        begin_s += rng.exponential(multipath.every_s)
    n = len(time_s)
    affected, scatter = rng.random(n) < multipath.share, multipath.scatter_m * rng.standard_normal((n, 2))
    far_m = rng.uniform(multipath.least_m, multipath.most_m, len(clusters))
    direction = _directions(len(clusters), 2, rng)
    error_m = np.zeros((n, 2))
    for offset_m, cluster in zip(far_m[:, None] * direction, clusters, strict=True):
        here = affected & in_intervals((cluster,), time_s)
        error_m[here] = offset_m + scatter[here]
    return error_m


def in_intervals(intervals_s: Intervals, time_s: Vector) -> Flags:
    """Return whether each time, (n,), is in one of the intervals [from, to)."""
    inside = np.zeros(len(time_s), dtype=bool)
    for start_s, end_s in intervals_s:
        inside |= (time_s >= start_s) & (time_s < end_s)
    return inside


def _directions(count: int, axes: int, rng: np.random.Generator) -> Array:
    """Return unit vectors, (count, 2), in any direction of the plane, or signs, (count, 1)."""
    angle = rng.uniform(0, 2 * np.pi, count)
    both = np.column_stack([np.cos(angle), np.sin(angle)])
    return both if axes == 2 else np.where(angle < np.pi, 1.0, -1.0)[:, None]
