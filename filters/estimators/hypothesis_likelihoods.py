"""How well a belief foresaw a fix, under each of the stories that may be behind it.

A fix that tells where the vehicle is follows its noise model. One that is false lies anywhere around, and a vehicle
that is where it should not be lies anywhere around, too: both by Student's t, whose long tail never makes a thing
impossible. Log likelihoods of metres.
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

SENSOR = "usbl"  # whose fixes may be false in clusters
TAIL_DOF = 4.0  # [degrees of freedom] of Student's t


class HypothesisLikelihoods(NamedTuple):
    """Log likelihoods of the fixes of a step, as one belief saw them coming."""

    modelled: float  # by the whole noise model
    if_accepted: float  # by that, or false
    inlier: float  # by those modes of it that tell where the vehicle is
    relocated: float  # of a vehicle that is not where the belief has it
    outlier: float
    excess_m2: float  # of the squared innovations over the expected, each axis
    informative: bool  # the fixes know better than the belief where the vehicle is


def hypothesis_likelihoods(
    bank: GaussianBank, fixes: Sequence[Measurement], outlier_noise: Contamination
) -> HypothesisLikelihoods:
    """Hold fixes against a predicted bank of one; each for itself, as if no other had been taken before it."""
    told = [_fix_likelihoods(bank, fix, outlier_noise) for fix in fixes]
    modelled, if_accepted, inlier, relocated, outliers, excess_m2, informative = zip(*told, strict=True)
    sums = (sum(each) for each in (modelled, if_accepted, inlier, relocated, outliers))
    return HypothesisLikelihoods(*sums, excess_m2=max(excess_m2), informative=any(informative))


def _fix_likelihoods(bank: GaussianBank, fix: Measurement, outlier_noise: Contamination) -> HypothesisLikelihoods:
    seen, noise = project(bank, fix, linearised), fix.noise.joint()
    e, predicted, R = seen.innovation[:, 0], seen.cov[:, :, 0], noise.cov[0]
    k, far_m2 = len(e), outlier_noise.sd**2
    size_m2 = np.trace(noise.cov, axis1=1, axis2=2) / k
    near = size_m2 <= max(far_m2, size_m2[0])  # wider modes are the noise model's own false fixes
    log_outlier = math.log(outlier_noise.share) + _log_t(e, predicted + R + far_m2 * np.eye(k))
    modelled = inlier = float(mode_likelihoods(seen, noise).log_likelihood[0])
    if not near.all():
        inlier = float(mode_likelihoods(seen, Noise(noise.probabilities[near], noise.cov[near])).log_likelihood[0])
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
    """Return the log density of Student's t with TAIL_DOF degrees of freedom and the scale matrix S, (k, k)."""
    inverse, logdet = inverse_and_logdet(S[:, :, None])
    k, dof = len(e), TAIL_DOF
    constant = math.lgamma((dof + k) / 2) - math.lgamma(dof / 2) - k / 2 * math.log(dof * math.pi)
    distance = float(e @ inverse[:, :, 0] @ e)
    return constant - 0.5 * float(logdet[0]) - (dof + k) / 2 * math.log1p(distance / dof)
