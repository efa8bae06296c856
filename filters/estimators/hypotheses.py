"""Hypotheses about fixes that contradict the track: their likelihoods, which agree, which remain, how they ended."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, inverse_and_logdet, project
from usbldr.filters.estimators.mode_updates import mode_likelihoods
from usbldr.filters.estimators.protocol import Estimate, Estimates, Step
from usbldr.filters.frames import wrapped
from usbldr.filters.models.noise import Contamination, Noise
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import POSITION, YAW
from usbldr.filters.types import Array, Reacquisition, Vector

MEDIAN_CHI_SQUARE_2 = 2 * math.log(2)  # fixed: median of chi-square for two
Reported = TypeVar("Reported", Estimate, Estimates)
MIN_CLUSTER_FIXES = 2  # one rejected fix is a single outlier and not reported
SENSOR = "usbl"  # the sensor whose outliers come in clusters
TAIL_DOF = 4.0  # [degrees of freedom] of Student's t
MAX_SENTENCES = 5  # sentences: more hide the other warnings of a run


class Hypothesis(NamedTuple):
    """One explanation of the fixes: a belief and its weight."""

    kind: str  # "nominal", "rejecting", "resumed" or "relocated"
    belief: Any  # of the wrapped filter
    estimate: Estimate
    log_weight: float  # normalised over the hypotheses
    since_s: float = math.nan  # first fix that a rejecting one takes for an outlier
    accepted_by: str = ""  # kind of the hypothesis that took the same fixes for inliers: it lies at their cluster


class Ambiguity(NamedTuple):
    """The fixes that the hypotheses explain; all fields but the last as in Reacquisition."""

    since_s: float
    outage_s: float
    resolved_s: float
    refused: int = 0
    jump_m: float = 0.0
    accepting: tuple[str, ...] = ()  # kinds of hypotheses that take the fixes as inliers


class MultiHypothesisBelief(NamedTuple):
    """The hypotheses, the leading one first."""

    hypotheses: tuple[Hypothesis, ...]
    ambiguity: Ambiguity | None
    last_fix_s: float  # -inf: no fix yet
    reacquisitions: tuple[Reacquisition, ...] = ()


def pruned(hypotheses: Sequence[Hypothesis], pruning_ratio: float, decision_odds: float) -> list[Hypothesis]:
    """Return the remaining hypotheses, leader first: unlikely ones dropped, those at the same position merged.

    ``hypotheses[0]`` is the leader so far. The likeliest hypothesis replaces it at once if it is rejecting or
    resumed, and otherwise if it is ``decision_odds`` times as likely.
    """
    ordered = sorted(hypotheses, key=lambda hypothesis: -hypothesis.log_weight)
    best = leader = ordered[0]
    needs_odds = best.kind in ("nominal", "relocated")
    remaining: list[Hypothesis] = []
    for hypothesis in ordered:
        same = next((other for other in remaining if _agree(hypothesis, other)), None)
        if same is None and hypothesis.log_weight - best.log_weight > math.log(pruning_ratio):
            remaining.append(hypothesis)
        close = best.log_weight - hypothesis.log_weight < math.log(decision_odds)
        if hypothesis is hypotheses[0] and needs_odds and close:
            leader = same or hypothesis
    remaining.sort(key=lambda hypothesis: hypothesis is not leader)
    total = float(np.logaddexp.reduce([hypothesis.log_weight for hypothesis in remaining]))
    return [hypothesis._replace(log_weight=hypothesis.log_weight - total) for hypothesis in remaining]


def with_outcome(
    before: tuple[Reacquisition, ...], ambiguity: Ambiguity, last: Hypothesis, refusing: str
) -> tuple[Reacquisition, ...]:
    """Return the outcome of the ambiguity after those before, if fixes moved the track or a cluster was refused."""
    if not ambiguity.jump_m and not (last.kind == refusing and ambiguity.refused >= MIN_CLUSTER_FIXES):
        return before
    return (*before, Reacquisition(*ambiguity[:-1], accepted=last.kind in ambiguity.accepting))


def _agree(a: Hypothesis, b: Hypothesis) -> bool:
    """Return whether both hypotheses use fixes and have the same position."""
    return "rejecting" not in (a.kind, b.kind) and same_position(a, b)


def same_position(a: Hypothesis, b: Hypothesis) -> bool:
    """Return whether the Mahalanobis distance of the positions is below the median of its chi-square."""
    offset_m = position_m(a) - position_m(b)
    block = np.ix_(POSITION, POSITION)
    cov = a.estimate.cov[block] + b.estimate.cov[block]
    return float(offset_m @ np.linalg.solve(cov, offset_m)) < MEDIAN_CHI_SQUARE_2


def position_m(hypothesis: Hypothesis) -> Vector:
    """Return the east and north position (2,), m."""
    return hypothesis.estimate.mean[POSITION]


def reported(belief: MultiHypothesisBelief, each: Sequence[Reported], decision_odds: float) -> Reported:
    """Return the mean of the leader and the second moment of all hypotheses about it.

    ``each`` are the estimates of the hypotheses, of one epoch or of several. If only the nominal hypothesis accepts the
    fixes and the odds of the leader are above ``decision_odds``, return the leader's own covariance: its noise model
    already allows for outliers.
    """
    reacquisitions, leader = belief.reacquisitions, belief.hypotheses[0]
    if belief.ambiguity is not None:  # the outcome if no more fixes came
        reacquisitions = with_outcome(reacquisitions, belief.ambiguity, leader, "rejecting")
    first = each[0]._replace(reacquisitions=reacquisitions)
    ahead = math.exp(leader.log_weight) > 1 - 1 / decision_odds
    if belief.ambiguity is None or (ahead and belief.ambiguity.accepting == ("nominal",)):
        return first
    cov = np.zeros_like(first.cov)
    for hypothesis, one in zip(belief.hypotheses, each, strict=True):
        offset = one.mean - first.mean
        offset[..., YAW] = wrapped(offset[..., YAW])
        cov += math.exp(hypothesis.log_weight) * (one.cov + offset[..., :, None] * offset[..., None, :])
    return first._replace(cov=cov)


def reacquisition_texts(found: Sequence[Reacquisition], least_outage_s: float = math.inf) -> tuple[str, ...]:
    """Return sentences on how ambiguities ended; of many, a summary and those that moved the track most.

    Fixes that are ``least_outage_s`` apart have an outage between them.
    """
    if len(found) <= MAX_SENTENCES:
        return tuple(_reacquisition_text(one, least_outage_s) for one in found)
    accepted = sum(one.accepted for one in found)
    largest = sorted(found, key=lambda one: -one.jump_m)[:MAX_SENTENCES]
    summary = (
        f"USBL fixes contradicted the track or the fixes around them {len(found)} times: {accepted} times accepted, "
        f"{len(found) - accepted} times rejected; the {MAX_SENTENCES} that moved the track most follow"
    )
    return summary, *(_reacquisition_text(one, least_outage_s) for one in sorted(largest, key=lambda one: one.since_s))


def _reacquisition_text(one: Reacquisition, least_outage_s: float) -> str:
    outage = f" (after an outage of {one.outage_s:.0f} s)" if least_outage_s <= one.outage_s < math.inf else ""
    fixes = f"USBL fixes from {one.since_s:.1f} s{outage}"
    if one.accepted:
        rejected = f" after {_count(one.refused, 'rejected fix')}" if one.refused else ""
        moved = f"track moved {one.jump_m:.1f} m"
        return f"{fixes} contradicted the track: accepted at {one.resolved_s:.1f} s{rejected}; {moved}"
    moved = f"; track moved back {one.jump_m:.1f} m" if one.jump_m else f" ({_count(one.refused, 'fix')})"
    return f"{fixes} contradicted the fixes before and after them: rejected at {one.resolved_s:.1f} s{moved}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 'es'}"


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
    """Return the likelihoods of fixes from a predicted bank of one; each fix alone, without updates in between.

    An inlier follows the noise model of the fix. For an outlier, and for a vehicle that is not where the belief
    predicts it, the innovation follows a Student's t, whose heavy tail never excludes a position. Natural logarithms
    of densities in metres.
    """
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
