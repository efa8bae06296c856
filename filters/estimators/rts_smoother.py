"""The Rauch-Tung-Striebel smoother: estimate each epoch from the whole dive, backwards over the estimates of a filter.

It needs only the means and covariances of the filter, so it applies to every filter whose belief is near a Gaussian;
mixture noise was handled in the forward pass. The motion is reversed part by part with the covariances of the filter's
moment transform; for a part from x to y, x_s = x + G (y_s - y) and P_s = P + G (P_y,s - P_y) G',
G = cov(x, y) cov(y)^-1.

H. Rauch, F. Tung and C. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3(8), 1965,
doi:10.2514/3.3166; for sigma points S. Sarkka, "Unscented Rauch-Tung-Striebel smoother", IEEE Trans. Automatic Control
53(3), 2008, doi:10.1109/TAC.2008.919531.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import predict_parts, replicate
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.sigma_points import MomentTransform
from usbldr.filters.types import Array, Vector


class StateMoments(NamedTuple):
    """Mean (n,) and covariance (n, n)."""

    mean: Vector
    cov: Array


def smooth(
    mean: Array,
    cov: Array,
    inflation: Vector,
    widening: Array,
    time_s: Vector,
    motion: MotionModel,
    rule: MomentTransform,
) -> tuple[Array, Array]:
    """Return the smoothed mean (K, n) and covariance (K, n, n) from the filtered ones, at the K epochs ``time_s``.

    ``inflation`` (K,) is the factor by which the filter inflated its predicted covariance at each epoch, ``widening``
    (K, n) the variances that it added to it.
    """
    smoothed_mean, smoothed_cov = mean.copy(), cov.copy()
    for k in range(len(time_s) - 2, -1, -1):
        after = StateMoments(smoothed_mean[k + 1], smoothed_cov[k + 1])
        factor, added = float(inflation[k + 1]), widening[k + 1]
        before = _before(StateMoments(mean[k], cov[k]), after, factor, added, time_s[k : k + 2], motion, rule)
        smoothed_mean[k], smoothed_cov[k] = before
    return smoothed_mean, smoothed_cov


def _before(
    filtered: StateMoments,
    after: StateMoments,
    inflation: float,
    widening: Vector,
    times_s: Vector,
    motion: MotionModel,
    rule: MomentTransform,
) -> StateMoments:
    """Return the smoothed moments of an epoch from its filtered ones and the smoothed ones of the next."""
    t0_s, t1_s = times_s.tolist()
    stages = [filtered]
    crosses: list[Array] = []  # covariance of each stage with the next
    for bank, rows, cross in predict_parts(replicate(*filtered, 1), motion, rule, t0_s, t1_s):
        with_next = stages[-1].cov.copy()
        with_next[:, rows] += cross[:, :, 0]
        crosses.append(with_next)
        stages.append(StateMoments(bank.mean[:, 0], bank.cov[:, :, 0]))
    predicted = stages[-1]
    crosses.append(predicted.cov)  # process noise and inflation are independent of the states before
    noise = inflation * np.diag(motion.noise(t0_s, t1_s)) + np.diag(widening)
    stages.append(StateMoments(predicted.mean, inflation * predicted.cov + noise))
    for before, cross, then in zip(stages[-2::-1], crosses[::-1], stages[:0:-1], strict=True):
        G = _gain(cross, then.cov)
        P = before.cov + G @ (after.cov - then.cov) @ G.T
        after = StateMoments(before.mean + G @ (after.mean - then.mean), 0.5 * (P + P.T))
    return after


def _gain(cross: Array, P: Array) -> Array:
    """Return cross P^-1 on the states that vary, 0 elsewhere; by correlations, as variances differ by 1e10."""
    sd = np.sqrt(P.diagonal())
    vary = np.flatnonzero(sd > 0)
    sd = sd[vary]
    G = np.zeros_like(cross)
    correlation = P[np.ix_(vary, vary)] / np.outer(sd, sd)
    G[:, vary] = np.linalg.solve(correlation, (cross[:, vary] / sd).T).T / sd
    return G
