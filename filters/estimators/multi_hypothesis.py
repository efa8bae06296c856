"""A guard for any filter: fixes that agree with each other, but not with the past, are a question and not an answer.

When fixes come back after a silence a filter knows its place badly and takes what it is told; false fixes in a row (an
echo, a second beacon) then capture the track, and the true ones that follow look like outliers. A filter that has
really been carried off, on the other hand, must believe its fixes again. Neither can be told from the other at the
first fix, so the guard lets rival beliefs run beside each other for a while and asks which of them foresaw what came:

- usual: the filter as it is, which takes each fix as its noise model says;
- held: the fixes since then are false, and false in the same way, so that none of them is taken;
- resumed: so they were, up to this fix;
- moved: the vehicle is where the fixes put it, further off than the filter thought possible.

They are weighed by their predictive likelihoods (D. Reid, "An algorithm for tracking multiple targets", IEEE Trans.
Automatic Control 24(6), 1979, doi:10.1109/TAC.1979.1102177). A false fix is followed by another of its kind with
probability exp(-dt / lasts_s), so what agrees for long is true. The estimate is one of the beliefs, until another has
clearly won, and its covariance counts them all. Metres, seconds, the filter's own states.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, predict, project, replicate
from usbldr.filters.estimators.hypothesis_likelihoods import (
    HypothesisLikelihoods,
    hypothesis_likelihoods,
    usbl_measurements,
    without_fixes,
)
from usbldr.filters.estimators.protocol import (
    Estimate,
    Filter,
    MakeRng,
    Prior,
    Step,
    measurement_update,
    with_state_shift,
)
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.sensors import Measurement
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import POSITION
from usbldr.filters.types import Reacquisition, Update, Vector

MEDIAN_CHI_SQUARE_2 = 2 * math.log(2)  # fixed: median of chi-square for two
MIN_CLUSTER_FIXES = 2  # a single one that is refused is an outlier, and no news


class Hypothesis(NamedTuple):
    """One belief in the running."""

    kind: str  # "usual", "held", "resumed" or "moved"
    belief: Any  # the filter's own
    estimate: Estimate
    log_weight: float


class Ambiguity(NamedTuple):
    """What the rivals are about; all but the last as in Reacquisition."""

    since_s: float
    outage_s: float
    resolved_s: float
    refused: int = 0
    jump_m: float = 0.0
    accepting: tuple[str, ...] = ()  # the kinds that take the fixes for true


class MultiHypothesisBelief(NamedTuple):
    """The rivals, first the one that leads."""

    hypotheses: tuple[Hypothesis, ...]
    ambiguity: Ambiguity | None
    last_fix_s: float
    reacquisitions: tuple[Reacquisition, ...] = ()


@dataclass(frozen=True, slots=True)
class MultiHypothesisFilter:
    """The filter, and its rivals while fixes are in doubt."""

    filter: Filter[Any]
    motion: MotionModel
    outlier_noise: Contamination = Contamination()  # how often fixes are false, and how far off
    outlier_cluster_s: float = 3.0  # how long a cluster of false fixes is, on average
    relocation_probability: float = (
        0.05  # how often a vehicle is where dead reckoning cannot have brought it, after a long silence
    )
    long_outage_s: float = 60.0  # which is so long; in a shorter one, in proportion, less can have happened
    decision_odds: float = 20.0  # at which a rival that moves the track takes over: strong evidence by Kass and Raftery
    pruning_ratio: float = 1e-4  # share of the likeliest one's weight below which a rival is dropped

    def start(self, prior: Prior) -> MultiHypothesisBelief:
        """Return the filter's start, without a rival."""
        belief = self.filter.start(prior)
        return MultiHypothesisBelief(
            (Hypothesis("nominal", belief, self.filter.estimate(belief), 0.0),), None, -math.inf
        )

    def step(self, belief: MultiHypothesisBelief, step: Step, make_rng: MakeRng) -> MultiHypothesisBelief:
        """Return the belief after the step: each rival steps, and a fix weighs them."""
        fixes = usbl_measurements(step)
        if not fixes:
            return belief._replace(
                hypotheses=tuple(self._stepped(hypothesis, step, make_rng) for hypothesis in belief.hypotheses)
            )
        seen = [
            hypothesis_likelihoods(self._predicted(hypothesis.estimate, step), fixes, self.outlier_noise)
            for hypothesis in belief.hypotheses
        ]
        outage_s = step.t1_s - belief.last_fix_s
        ambiguity = belief.ambiguity or Ambiguity(step.t1_s, outage_s, step.t1_s)
        cluster_continues = math.exp(-outage_s / self.outlier_cluster_s)
        hypotheses = self._reweighted(belief.hypotheses, seen, cluster_continues, ambiguity.accepting, step, make_rng)
        relocation_probability = self.relocation_probability * min(1.0, outage_s / self.long_outage_s)
        if new := self._new_hypotheses(belief.hypotheses, seen, relocation_probability, step, make_rng):
            ambiguity = ambiguity._replace(
                accepting=(*ambiguity.accepting, "relocated" if new[-1].kind == "relocated" else "nominal")
            )
        if any(
            hypothesis.kind == "rejecting" for hypothesis in new
        ):  # that its fix is false is from here on the other's story
            alone = belief.hypotheses[0].log_weight + seen[0].modelled
            hypotheses[0] = hypotheses[0]._replace(log_weight=alone)
        led, hypotheses = hypotheses[0], self._pruned([*hypotheses, *new])
        if hypotheses[0].kind != led.kind:
            jump_m = (
                0.0
                if _same_position(hypotheses[0], led)
                else float(np.hypot(*(_position_m(hypotheses[0]) - _position_m(led))))
            )
            ambiguity = ambiguity._replace(resolved_s=step.t1_s, jump_m=max(ambiguity.jump_m, jump_m))
        if hypotheses[0].kind == "rejecting":
            ambiguity = ambiguity._replace(refused=ambiguity.refused + len(fixes))
        told = belief.reacquisitions
        if len(hypotheses) > 1:
            return MultiHypothesisBelief(tuple(hypotheses), ambiguity, step.t1_s, told)
        last = hypotheses[0]
        if ambiguity.jump_m or (last.kind == "resumed" and ambiguity.refused >= MIN_CLUSTER_FIXES):
            told = (*told, Reacquisition(*ambiguity[:-1], accepted=last.kind in ambiguity.accepting))
        return MultiHypothesisBelief((last._replace(kind="nominal", log_weight=0.0),), None, step.t1_s, told)

    def estimate(self, belief: MultiHypothesisBelief) -> Estimate:
        """Return the leader's mean, and the second moment of all rivals about it.

        A leader that expected the fixes and is far ahead stands alone: that they might be false is then as ever.
        """
        told, leader = belief.reacquisitions, belief.hypotheses[0]
        if (
            belief.ambiguity is not None
            and leader.kind == "rejecting"
            and belief.ambiguity.refused >= MIN_CLUSTER_FIXES
        ):  # as it stands
            told = (*told, Reacquisition(*belief.ambiguity[:-1], accepted=False))
        first = leader.estimate._replace(reacquisitions=told)
        ahead = math.exp(leader.log_weight) > 1 - 1 / self.decision_odds
        if belief.ambiguity is None or (ahead and belief.ambiguity.accepting == ("nominal",)):
            return first
        cov = np.zeros_like(first.cov)
        for hypothesis in belief.hypotheses:
            off = hypothesis.estimate.mean - first.mean
            cov += math.exp(hypothesis.log_weight) * (hypothesis.estimate.cov + np.outer(off, off))
        return first._replace(cov=cov)

    def _reweighted(
        self,
        hypotheses: Sequence[Hypothesis],
        seen: Sequence[HypothesisLikelihoods],
        cluster_continues: float,
        accepting: Sequence[str],
        step: Step,
        make_rng: MakeRng,
    ) -> list[Hypothesis]:
        """Return the rivals after a fix, each weighed by how it saw it coming, in their order.

        For one that holds, a fix is one more of the cluster with the probability goes_on, and then lies where the
        believers expect it; or the cluster is over, and another belief resumes from this one.
        """
        both = list(zip(hypotheses, seen, strict=True))
        another = max((told.inlier for hypothesis, told in both if hypothesis.kind in accepting), default=-math.inf)
        after: list[Hypothesis] = []
        resumed: list[Hypothesis] = []
        for hypothesis, told in both:
            if hypothesis.kind == "rejecting":
                log_rejecting = float(np.logaddexp(_log(cluster_continues) + another, told.outlier))
                after.append(
                    self._stepped_rejecting(
                        hypothesis._replace(log_weight=hypothesis.log_weight + log_rejecting), step, make_rng
                    )
                )
                over = hypothesis.log_weight + _log(1 - cluster_continues) + told.inlier
                resumed.append(self._stepped(hypothesis._replace(kind="resumed", log_weight=over), step, make_rng))
            else:
                after.append(
                    self._stepped(
                        hypothesis._replace(log_weight=hypothesis.log_weight + told.if_accepted), step, make_rng
                    )
                )
        return after + resumed

    def _new_hypotheses(
        self,
        hypotheses: Sequence[Hypothesis],
        seen: Sequence[HypothesisLikelihoods],
        relocation_probability: float,
        step: Step,
        make_rng: MakeRng,
    ) -> list[Hypothesis]:
        """Return the new rivals, after the step, that its fixes give cause for.

        Fixes far from what any belief expected: one that holds and one that has moved, which happens with the
        probability ``displaced``. Fixes that the only belief would follow, being unsure: one that holds.
        """
        leader, told = hypotheses[0], seen[0]
        far = all(_log(relocation_probability) + other.relocated > other.inlier for other in seen)
        far = far and all(hypothesis.kind != "relocated" for hypothesis in hypotheses)
        if not far and not (told.informative and len(hypotheses) == 1):
            return []
        new: list[Hypothesis] = []
        if leader.kind != "rejecting":
            held = leader._replace(kind="rejecting", log_weight=leader.log_weight + told.outlier)
            new.append(self._stepped_rejecting(held, step, make_rng))
        if far:
            mean, cov = leader.estimate.mean, leader.estimate.cov.copy()
            cov[POSITION, POSITION] += told.excess_m2
            weight = leader.log_weight + _log(relocation_probability) + told.relocated
            moved = Hypothesis("relocated", self.filter.start(Prior(mean, cov)), leader.estimate, weight)
            new.append(self._stepped(moved, step, make_rng))
        return new

    def _pruned(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the rivals that are left, the leader first: none forgotten, no two that are of one mind.

        The first that comes in has led. Another leads when it is the likeliest and refuses the fixes, or is ``odds``
        times as likely.
        """
        ordered = sorted(hypotheses, key=lambda hypothesis: -hypothesis.log_weight)
        best = leader = ordered[0]
        patient = best.kind in ("nominal", "relocated")
        kept: list[Hypothesis] = []
        for hypothesis in ordered:
            mate = next((other for other in kept if _agree(hypothesis, other)), None)
            if mate is None and hypothesis.log_weight - best.log_weight > math.log(self.pruning_ratio):
                kept.append(hypothesis)
            if (
                hypothesis is hypotheses[0]
                and patient
                and best.log_weight - hypothesis.log_weight < math.log(self.decision_odds)
            ):
                leader = mate or hypothesis
        kept.sort(key=lambda hypothesis: hypothesis is not leader)
        total = float(np.logaddexp.reduce([hypothesis.log_weight for hypothesis in kept]))
        return [hypothesis._replace(log_weight=hypothesis.log_weight - total) for hypothesis in kept]

    def _stepped(self, hypothesis: Hypothesis, step: Step, make_rng: MakeRng) -> Hypothesis:
        """Return the rival after the step, which one that holds takes without its fixes."""
        belief = self.filter.step(
            hypothesis.belief, without_fixes(step) if hypothesis.kind == "rejecting" else step, make_rng
        )
        return hypothesis._replace(belief=belief, estimate=self.filter.estimate(belief))

    def _stepped_rejecting(self, hypothesis: Hypothesis, step: Step, make_rng: MakeRng) -> Hypothesis:
        """Return the rival after the step, its fixes refused."""
        bank = self._predicted(hypothesis.estimate, step)
        refused = [
            Update.combined([self._refused(bank, part) for part in measurement.parts()])
            for measurement in usbl_measurements(step)
        ]
        after = self._stepped(hypothesis, step, make_rng)
        return after._replace(estimate=after.estimate._replace(updates=(*after.estimate.updates, *refused)))

    def _refused(self, bank: GaussianBank, part: Measurement) -> Update:
        update = measurement_update(part, project(bank, part, linearised), np.ones(1), rejected=True)
        return with_state_shift(update, bank, bank)

    def _predicted(self, estimate: Estimate, step: Step) -> GaussianBank:
        return predict(replicate(estimate.mean, estimate.cov, 1), self.motion, linearised, step.t0_s, step.t1_s)


def reacquisition_text(one: Reacquisition) -> str:
    """Say in words what was made of fixes that were in doubt."""
    silence = f" after {one.outage_s:.0f} s without any" if math.isfinite(one.outage_s) and one.outage_s > 5 else ""
    fixes = f"USBL fixes from {one.since_s:.1f} s on{silence}"
    if one.accepted:
        wait = f", {one.refused} of them refused until then" if one.refused else ""
        return f"{fixes} did not fit the track, which jumped {one.jump_m:.1f} m to them at {one.resolved_s:.1f} s{wait}"
    jump = f"the track jumped {one.jump_m:.1f} m away from them" if one.jump_m else f"{one.refused} were refused"
    return f"{fixes} agreed with each other, but not with those before and after: {jump} ({one.resolved_s:.1f} s)"


def _agree(a: Hypothesis, b: Hypothesis) -> bool:
    """Tell whether two beliefs that take fixes have come to the same place."""
    return "rejecting" not in (a.kind, b.kind) and _same_position(a, b)


def _same_position(a: Hypothesis, b: Hypothesis) -> bool:
    """Tell whether two beliefs are no further apart than by even chance."""
    off = _position_m(a) - _position_m(b)
    block = np.ix_(POSITION, POSITION)
    cov = a.estimate.cov[block] + b.estimate.cov[block]
    return float(off @ np.linalg.solve(cov, off)) < MEDIAN_CHI_SQUARE_2


def _position_m(hypothesis: Hypothesis) -> Vector:
    return hypothesis.estimate.mean[POSITION]


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0 else -math.inf
