"""Hypotheses about fixes that contradict the track: their values, which agree, and which remain."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from usbldr.filters.estimators.protocol import Estimate, Estimates
from usbldr.filters.frames import wrapped
from usbldr.filters.models.states import POSITION, YAW
from usbldr.filters.types import Reacquisition, Vector

MEDIAN_CHI_SQUARE_2 = 2 * math.log(2)  # fixed: median of chi-square for two
Reported = TypeVar("Reported", Estimate, Estimates)
MIN_CLUSTER_FIXES = 2  # one rejected fix is a single outlier and not reported


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
