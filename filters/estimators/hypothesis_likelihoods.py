"""Likelihood of USBL fixes under each hypothesis about them, from the predicted Gaussian of one belief.

An inlier follows the noise model of the fix. For an outlier, and for a vehicle that is not where the belief predicts
it, the innovation follows a Student's t, whose heavy tail never excludes a position. Natural logarithms of densities in
metres.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, inverse_and_logdet, project
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.estimators.protocol import Step
from usbldr.filters.models.noise import Contamination, Noise
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.types import Array, Vector

SENSOR = "usbl"  # the sensor whose outliers come in clusters
TAIL_DOF = 4.0  # [degrees of freedom] of Student's t


class HypothesisLikelihoods(NamedTuple):
    """Predictive log likelihoods of the fixes of a step, from one belief."""

    modelled: float  # under the whole noise mixture
    if_accepted: float  # under the mixture or as an outlier: log(exp(modelled) + exp(outlier))
    inlier: float  # under the modes of the mixture that are not outliers themselves
    relocated: float  # if the vehicle is not at the predicted position; without the prior of that
    outlier: float  # as an outlier, times the share of outliers
    excess_m2: float  # squared innovation minus its expectation, per axis, at least 0
    informative: bool  # the fix is more precise than the predicted position


def hypothesis_likelihoods(
    bank: GaussianBank, fixes: Sequence[Measurement], outlier_noise: Contamination
) -> HypothesisLikelihoods:
    """Return the likelihoods of fixes from a predicted bank of one; each fix alone, without updates in between."""
    each_fix = [_fix_likelihoods(bank, fix, outlier_noise) for fix in fixes]
    modelled, if_accepted, inlier, relocated, outliers, excess_m2, informative = zip(*each_fix, strict=True)
    sums = (sum(column) for column in (modelled, if_accepted, inlier, relocated, outliers))
    return HypothesisLikelihoods(*sums, excess_m2=max(excess_m2), informative=any(informative))


def _fix_likelihoods(bank: GaussianBank, fix: Measurement, outlier_noise: Contamination) -> HypothesisLikelihoods:
    projection, noise = project(bank, fix, linearised), fix.noise.joint()
    e, predicted, R = projection.innovation[:, 0], projection.cov[:, :, 0], noise.cov[0]
    k, outlier_m2 = len(e), outlier_noise.sd**2
    mode_m2 = np.trace(noise.cov, axis1=1, axis2=2) / k
    inliers = mode_m2 <= max(outlier_m2, mode_m2[0])  # wider modes are the noise model's own outliers
    log_outlier = math.log(outlier_noise.share) + _log_t(e, predicted + R + outlier_m2 * np.eye(k))
    modelled = inlier = float(mode_likelihoods(projection, noise).log_likelihood[0])
    if not inliers.all():
        of_inliers = Noise(noise.probabilities[inliers], noise.cov[inliers])
        inlier = float(mode_likelihoods(projection, of_inliers).log_likelihood[0])
    return HypothesisLikelihoods(
        modelled,
        float(np.logaddexp(modelled, log_outlier)),
        inlier,
        _log_t(e, predicted + R),
        log_outlier,
        max(0.0, float(e @ e - np.trace(predicted + R)) / k),
        bool(np.trace(predicted) > np.trace(R)),
    )


def usbl_measurements(step: Step) -> list[Measurement]:
    """Return the step's USBL fixes."""
    return [measurement for measurement in step.measurements if measurement.sensor == SENSOR]


def without_fixes(step: Step) -> Step:
    """Return the step without its USBL fixes."""
    return step._replace(measurements=tuple(m for m in step.measurements if m.sensor != SENSOR))


def _log_t(e: Vector, S: Array) -> float:
    """Return the log density of Student's t at e (k,), with TAIL_DOF degrees of freedom and scale matrix S (k, k)."""
    inverse, logdet = inverse_and_logdet(S[:, :, None])
    k, dof = len(e), TAIL_DOF
    constant = math.lgamma((dof + k) / 2) - math.lgamma(dof / 2) - k / 2 * math.log(dof * math.pi)
    distance = float(e @ inverse[:, :, 0] @ e)
    return constant - 0.5 * float(logdet[0]) - (dof + k) / 2 * math.log1p(distance / dof)
