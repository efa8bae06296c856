"""Multiple-hypothesis tracking around any filter: decide whether fixes that contradict the track are outliers.

After an outage the position is uncertain and the filter accepts almost any fix. Outliers in a row (an echo, a second
beacon) then capture the track, and the correct fixes that follow look like outliers. A vehicle that has really drifted
away, on the other hand, must follow its fixes. One fix cannot separate the two cases, so several hypotheses run in
parallel, each with its own belief:

- nominal: the filter as it is; each fix follows its noise model;
- rejecting: the fixes since the ambiguity began are outliers with a common offset; none is used;
- resumed: they were outliers, but the cluster has ended; fixes are used again;
- relocated: the vehicle is at the fixes, further away than the filter thought possible.

Weights are products of predictive likelihoods (D. Reid, "An algorithm for tracking multiple targets", IEEE Trans.
Automatic Control 24(6), 1979, doi:10.1109/TAC.1979.1102177). Clusters last for seconds, few for a minute, so
fixes that agree for long are inliers. The rejecting hypothesis is kept for some time after the track has followed its
fixes: if the cluster ends after all, the track returns at once. The estimate is the mean of the leading hypothesis,
which another replaces only with clear odds; its covariance includes all hypotheses. Metres, seconds, the states of the
filter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usbldr.filters.estimators.compiled import CompiledFilter, Doubt
from usbldr.filters.estimators.gaussian_bank import GaussianBank, replicate
from usbldr.filters.estimators.hypotheses import (
    SENSOR,
    Ambiguity,
    Hypothesis,
    HypothesisLikelihoods,
    MultiHypothesisBelief,
    hypothesis_likelihoods,
    position_m,
    pruned,
    reported,
    same_position,
    usbl_measurements,
    with_outcome,
    without_fixes,
)
from usbldr.filters.estimators.kalman import KalmanFilter
from usbldr.filters.estimators.mode_updates import moment_matched
from usbldr.filters.estimators.protocol import (
    Estimate,
    Estimates,
    Filter,
    MakeRng,
    Prior,
    SeededRng,
    Step,
    Steps,
    rejected_update,
    run_span,
)
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import POSITION
from usbldr.filters.types import Indices, Vector


@dataclass(frozen=True, slots=True)
class MultiHypothesisFilter:
    """A filter, run once for each hypothesis while an ambiguity lasts."""

    filter: Filter[Any]
    motion: MotionModel
    outlier_noise: Contamination = Contamination()  # share and scale of outliers
    outlier_cluster_s: float = 3.0  # mean duration of a cluster of outliers
    long_cluster_s: float = 60.0  # mean duration of a few clusters: a leg beside a wall that reflects
    long_cluster_share: float = 1e-4  # so few that no decision waits for them, but the way back is remembered
    relocation_probability: float = 0.05  # of a drift that dead reckoning missed, after a long outage
    long_outage_s: float = 60.0  # in a shorter outage the probability of relocation is proportionally smaller
    decision_odds: float = 20.0  # for a new leader that moves the track: strong evidence by Kass and Raftery
    pruning_ratio: float = 1e-4  # of the largest weight; hypotheses below it are dropped
    predictor: Filter[Any] | None = None  # a linearised filter that predicts their fixes; None: kalman.py's

    def start(self, prior: Prior) -> MultiHypothesisBelief:
        """Return the nominal hypothesis alone, at the filter's prior."""
        belief = self.filter.start(prior)
        nominal = Hypothesis("nominal", belief, self.filter.estimate(belief), 0.0)
        return MultiHypothesisBelief((nominal,), None, -math.inf)

    def step(self, belief: MultiHypothesisBelief, step: Step, make_rng: MakeRng) -> MultiHypothesisBelief:
        """Return the belief after the step: step each hypothesis; on a fix, reweight, branch and prune."""
        fixes = usbl_measurements(step)
        if not fixes:
            return belief._replace(
                hypotheses=tuple(self._stepped(hypothesis, step, make_rng) for hypothesis in belief.hypotheses)
            )
        likelihoods = [
            hypothesis_likelihoods(self._predicted(hypothesis.estimate, step), fixes, self.outlier_noise)
            for hypothesis in belief.hypotheses
        ]
        outage_s = step.t1_s - belief.last_fix_s
        ambiguity = belief.ambiguity or Ambiguity(step.t1_s, outage_s, step.t1_s)
        hypotheses = self._reweighted(belief, likelihoods, step, make_rng)
        relocation_probability = float(self.drift_probability(np.array(outage_s)))
        if new := self._new_hypotheses(belief.hypotheses, likelihoods, relocation_probability, step, make_rng):
            ambiguity = ambiguity._replace(
                accepting=(*ambiguity.accepting, "relocated" if new[-1].kind == "relocated" else "nominal")
            )
        if any(hypothesis.kind == "rejecting" for hypothesis in new):
            # from here on the rejecting hypothesis covers the outlier case: count it once
            log_weight = belief.hypotheses[0].log_weight + likelihoods[0].modelled
            hypotheses[0] = hypotheses[0]._replace(log_weight=log_weight)
        previous, hypotheses = hypotheses[0], pruned([*hypotheses, *new], self.pruning_ratio, self.decision_odds)
        if hypotheses[0].kind != previous.kind:
            moved = not same_position(hypotheses[0], previous)
            jump_m = float(np.hypot(*(position_m(hypotheses[0]) - position_m(previous)))) if moved else 0.0
            ambiguity = ambiguity._replace(resolved_s=step.t1_s, jump_m=max(ambiguity.jump_m, jump_m))
        if hypotheses[0].kind == "rejecting":
            ambiguity = ambiguity._replace(refused=ambiguity.refused + len(fixes))
        reacquisitions = belief.reacquisitions
        if len(hypotheses) > 1:
            return MultiHypothesisBelief(tuple(hypotheses), ambiguity, step.t1_s, reacquisitions)
        last = hypotheses[0]
        reacquisitions = with_outcome(reacquisitions, ambiguity, last, "resumed")
        return MultiHypothesisBelief((last._replace(kind="nominal", log_weight=0.0),), None, step.t1_s, reacquisitions)

    def span(
        self, belief: MultiHypothesisBelief, steps: Steps, epochs: range, seed: int
    ) -> tuple[MultiHypothesisBelief, Estimates]:
        """Return the belief after the last of some of the steps, and the estimates after each.

        From fix to fix, as only a fix changes the number and the weights of the hypotheses. A single one in the kernel
        runs over fixes, too, up to one that may call for others (kernel/guard.h).
        """
        fixes = steps.of_sensor(SENSOR)
        found: list[Estimates] = []
        while epochs:
            here = fixes[(fixes >= epochs.start) & (fixes < epochs.stop)]
            without = range(epochs.start, int(here[0])) if len(here) else epochs
            some = None
            if isinstance(self.filter, CompiledFilter) and len(belief.hypotheses) == 1:
                belief, some = self._until_doubt(self.filter, belief, steps, epochs, here, seed)
            elif without:
                belief, some = self._between_fixes(belief, steps, without, seed)
            if some is not None:
                found.append(some)
                epochs = epochs[len(some.mean) :]
            if epochs:
                belief = self.step(belief, steps[epochs.start], SeededRng(seed, steps.first + epochs.start))
                found.append(Estimates.of([self.estimate(belief)]))
                epochs = epochs[1:]
        return belief, Estimates.joined(found)

    def _until_doubt(
        self,
        kernel: CompiledFilter,
        belief: MultiHypothesisBelief,
        steps: Steps,
        epochs: range,
        fixes: Indices,
        seed: int,
    ) -> tuple[MultiHypothesisBelief, Estimates]:
        """Run the nominal hypothesis up to a step whose fixes may call for others; ``fixes`` are those with any."""
        outage_s = np.diff(steps.t1_s[fixes], prepend=belief.last_fix_s)
        log_relocation = np.full(len(epochs), np.nan)
        with np.errstate(divide="ignore"):  # a probability of 0 has the logarithm -inf
            log_relocation[fixes - epochs.start] = np.log(self.drift_probability(outage_s))
        (nominal,) = belief.hypotheses
        doubt = Doubt(log_relocation, self.outlier_noise.sd**2)
        after, estimates = kernel.span_until(nominal.belief, steps, epochs, seed, doubt)
        used = fixes[fixes < epochs.start + len(estimates.mean)]
        return belief._replace(
            hypotheses=(nominal._replace(belief=after, estimate=kernel.estimate(after)),),
            last_fix_s=float(steps.t1_s[used[-1]]) if len(used) else belief.last_fix_s,
        ), estimates._replace(reacquisitions=belief.reacquisitions)

    def _between_fixes(
        self, belief: MultiHypothesisBelief, steps: Steps, epochs: range, seed: int
    ) -> tuple[MultiHypothesisBelief, Estimates]:
        """Run every hypothesis over steps without fixes, at least one."""
        runs = [run_span(self.filter, hypothesis.belief, steps, epochs, seed) for hypothesis in belief.hypotheses]
        after = tuple(
            hypothesis._replace(belief=last, estimate=estimates.last)
            for hypothesis, (last, estimates) in zip(belief.hypotheses, runs, strict=True)
        )
        estimates = reported(belief, [estimates for _, estimates in runs], self.decision_odds)
        return belief._replace(hypotheses=after), estimates

    def estimate(self, belief: MultiHypothesisBelief) -> Estimate:
        """Return the mean of the leader with a covariance that includes all hypotheses."""
        return reported(belief, [hypothesis.estimate for hypothesis in belief.hypotheses], self.decision_odds)

    def drift_probability(self, outage_s: Vector) -> Vector:
        """Return the probability of a relocation after outages, (F,)."""
        return self.relocation_probability * np.minimum(1.0, outage_s / self.long_outage_s)

    def _survival(self, time_s: float) -> float:
        """Return the probability that a cluster of outliers lasts for longer."""
        share = self.long_cluster_share
        usual, long = (math.exp(-time_s / mean_s) for mean_s in (self.outlier_cluster_s, self.long_cluster_s))
        return (1 - share) * usual + share * long

    def _reweighted(
        self, belief: MultiHypothesisBelief, likelihoods: Sequence[HypothesisLikelihoods], step: Step, make_rng: MakeRng
    ) -> list[Hypothesis]:
        """Return the hypotheses after the fixes, reweighted, in their order, then those that resume.

        For a rejecting hypothesis the cluster continues with some probability, and then a fix has the likelihood that
        the hypothesis which accepted that cluster gives it; otherwise the cluster has ended, and the fix is an outlier
        of its own, or an inlier of the branch that resumes.
        """
        both = list(zip(belief.hypotheses, likelihoods, strict=True))
        log_accepted = {hypothesis.kind: one.if_accepted for hypothesis, one in both}
        after: list[Hypothesis] = []
        resumed: list[Hypothesis] = []
        for hypothesis, one in both:
            log_before = hypothesis.log_weight
            if hypothesis.kind != "rejecting":
                accepting = hypothesis._replace(log_weight=log_before + one.if_accepted)
                after.append(self._stepped(accepting, step, make_rng))
                continue
            lasted_s, lasts_s = belief.last_fix_s - hypothesis.since_s, step.t1_s - hypothesis.since_s
            cluster_continues = self._survival(lasts_s) / self._survival(lasted_s)
            log_continues, log_ended = _log(cluster_continues), _log(1 - cluster_continues)
            log_cluster = log_accepted.get(hypothesis.accepted_by, one.outlier)
            log_rejecting = float(np.logaddexp(log_continues + log_cluster, log_ended + one.outlier))
            rejecting = hypothesis._replace(log_weight=log_before + log_rejecting)
            after.append(self._stepped_rejecting(rejecting, step, make_rng))
            ended = hypothesis._replace(kind="resumed", log_weight=log_before + log_ended + one.inlier)
            resumed.append(self._stepped(ended, step, make_rng))
        return after + resumed

    def _new_hypotheses(
        self,
        hypotheses: Sequence[Hypothesis],
        likelihoods: Sequence[HypothesisLikelihoods],
        relocation_probability: float,
        step: Step,
        make_rng: MakeRng,
    ) -> list[Hypothesis]:
        """Return the new hypotheses, after the step, that its fixes call for.

        If the fixes are far from every prediction: a rejecting and a relocated one, the latter with the prior
        ``relocation_probability``. If there is one hypothesis and its position is less certain than the fixes, so that
        it would follow outliers: a rejecting one.
        """
        leader, likelihood = hypotheses[0], likelihoods[0]
        far = all(_log(relocation_probability) + one.relocated > one.inlier for one in likelihoods)
        far = far and all(hypothesis.kind != "relocated" for hypothesis in hypotheses)
        if not far and not (likelihood.informative and len(hypotheses) == 1):
            return []
        new: list[Hypothesis] = []
        if leader.kind != "rejecting":
            rejecting = leader._replace(
                kind="rejecting",
                log_weight=leader.log_weight + likelihood.outlier,
                since_s=step.t1_s,
                accepted_by="relocated" if far else "nominal",
            )
            new.append(self._stepped_rejecting(rejecting, step, make_rng))
        if far:
            mean, cov = leader.estimate.mean, leader.estimate.cov.copy()
            cov[POSITION, POSITION] += likelihood.excess_m2
            log_weight = leader.log_weight + _log(relocation_probability) + likelihood.relocated
            relocated = Hypothesis("relocated", self.filter.start(Prior(mean, cov)), leader.estimate, log_weight)
            new.append(self._stepped(relocated, step, make_rng))
        return new

    def _stepped(self, hypothesis: Hypothesis, step: Step, make_rng: MakeRng) -> Hypothesis:
        """Return the hypothesis after the step; a rejecting one leaves out the fixes."""
        used = without_fixes(step) if hypothesis.kind == "rejecting" else step
        belief = self.filter.step(hypothesis.belief, used, make_rng)
        return hypothesis._replace(belief=belief, estimate=self.filter.estimate(belief))

    def _stepped_rejecting(self, hypothesis: Hypothesis, step: Step, make_rng: MakeRng) -> Hypothesis:
        """Return the hypothesis after the step, with its fixes reported as rejected."""
        bank = self._predicted(hypothesis.estimate, step)
        rejected = [rejected_update(bank, measurement) for measurement in usbl_measurements(step)]
        after = self._stepped(hypothesis, step, make_rng)
        return after._replace(estimate=after.estimate._replace(updates=(*after.estimate.updates, *rejected)))

    def _predicted(self, estimate: Estimate, step: Step) -> GaussianBank:
        linear = self.predictor or KalmanFilter(self.motion, linearised, moment_matched)
        before = linear.start(Prior(estimate.mean, estimate.cov))
        after = linear.step(before, step._replace(measurements=()), SeededRng(0, step.epoch))
        predicted = linear.estimate(after)
        return replicate(predicted.mean, predicted.cov, 1)


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0 else -math.inf
