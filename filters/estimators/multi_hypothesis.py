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

from usbldr.filters.estimators.gaussian_bank import Gaussians, copies, predict, project
from usbldr.filters.estimators.hypothesis_likelihoods import SENSOR, Evidence, evidence, whole_fixes, without_fixes
from usbldr.filters.estimators.protocol import Chance, Estimate, Filter, Prior, Step, moved, record
from usbldr.filters.models.motion import MotionModel
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.sigma_points import linearised
from usbldr.filters.models.states import POSITION
from usbldr.filters.types import Reacquisition, Vector

EVEN = 2 * math.log(2)  # median of chi-square for two
CLUSTER = 2  # fixes: a single one that is refused is an outlier, and no news


class Rival(NamedTuple):
    """One belief in the running."""

    kind: str  # "usual", "held", "resumed" or "moved"
    belief: Any  # the filter's own
    estimate: Estimate
    log_weight: float


class Doubt(NamedTuple):
    """What the rivals are about; all but the last as in Reacquisition."""

    since_s: float
    silent_s: float
    settled_s: float
    refused: int = 0
    jump_m: float = 0.0
    believers: tuple[str, ...] = ()  # the kinds that take the fixes for true


class GuardedBelief(NamedTuple):
    """The rivals, first the one that leads."""

    rivals: tuple[Rival, ...]
    doubt: Doubt | None
    last_fix_s: float
    reacquisitions: tuple[Reacquisition, ...] = ()


@dataclass(frozen=True, slots=True)
class Guarded:
    """The filter, and its rivals while fixes are in doubt."""

    filter: Filter[Any]
    motion: MotionModel
    false: Contamination = Contamination()  # how often fixes are false, and how far off
    lasts_s: float = 3.0  # how long a cluster of false fixes is, on average
    displaced: float = 0.05  # how often a vehicle is where dead reckoning cannot have brought it, after a long silence
    silence_s: float = 60.0  # which is so long; in a shorter one, in proportion, less can have happened
    odds: float = 20.0  # at which a rival that moves the track takes over
    forgotten: float = 1e-4  # share of the likeliest one's weight below which a rival is dropped

    def start(self, prior: Prior) -> GuardedBelief:
        """Return the filter's start, without a rival."""
        belief = self.filter.start(prior)
        return GuardedBelief((Rival("usual", belief, self.filter.estimate(belief), 0.0),), None, -math.inf)

    def step(self, belief: GuardedBelief, step: Step, chance: Chance) -> GuardedBelief:
        """Return the belief after the step: each rival steps, and a fix weighs them."""
        fixes = whole_fixes(step)
        if not fixes:
            return belief._replace(rivals=tuple(self._taking(rival, step, chance) for rival in belief.rivals))
        seen = [evidence(self._predicted(rival.estimate, step), fixes, self.false) for rival in belief.rivals]
        silent_s = step.t1_s - belief.last_fix_s
        doubt = belief.doubt or Doubt(step.t1_s, silent_s, step.t1_s)
        goes_on = math.exp(-silent_s / self.lasts_s)
        rivals = self._weighed(belief.rivals, seen, goes_on, doubt.believers, step, chance)
        displaced = self.displaced * min(1.0, silent_s / self.silence_s)
        if new := self._challengers(belief.rivals, seen, displaced, step, chance):
            doubt = doubt._replace(believers=(*doubt.believers, "moved" if new[-1].kind == "moved" else "usual"))
        if any(rival.kind == "held" for rival in new):  # that its fix is false is from here on the other's story
            alone = belief.rivals[0].log_weight + seen[0].modelled
            rivals[0] = rivals[0]._replace(log_weight=alone)
        led, rivals = rivals[0], self._kept([*rivals, *new])
        if rivals[0].kind != led.kind:
            jump_m = 0.0 if _together(rivals[0], led) else float(np.hypot(*(_place(rivals[0]) - _place(led))))
            doubt = doubt._replace(settled_s=step.t1_s, jump_m=max(doubt.jump_m, jump_m))
        if rivals[0].kind == "held":
            doubt = doubt._replace(refused=doubt.refused + len(fixes))
        told = belief.reacquisitions
        if len(rivals) > 1:
            return GuardedBelief(tuple(rivals), doubt, step.t1_s, told)
        last = rivals[0]
        if doubt.jump_m or (last.kind == "resumed" and doubt.refused >= CLUSTER):
            told = (*told, Reacquisition(*doubt[:-1], believed=last.kind in doubt.believers))
        return GuardedBelief((last._replace(kind="usual", log_weight=0.0),), None, step.t1_s, told)

    def estimate(self, belief: GuardedBelief) -> Estimate:
        """Return the leader's mean, and the second moment of all rivals about it.

        A leader that expected the fixes and is far ahead stands alone: that they might be false is then as ever.
        """
        told, leader = belief.reacquisitions, belief.rivals[0]
        if belief.doubt is not None and leader.kind == "held" and belief.doubt.refused >= CLUSTER:  # as it stands
            told = (*told, Reacquisition(*belief.doubt[:-1], believed=False))
        first = leader.estimate._replace(reacquisitions=told)
        ahead = math.exp(leader.log_weight) > 1 - 1 / self.odds
        if belief.doubt is None or (ahead and belief.doubt.believers == ("usual",)):
            return first
        cov = np.zeros_like(first.cov)
        for rival in belief.rivals:
            off = rival.estimate.mean - first.mean
            cov += math.exp(rival.log_weight) * (rival.estimate.cov + np.outer(off, off))
        return first._replace(cov=cov)

    def _weighed(
        self,
        rivals: Sequence[Rival],
        seen: Sequence[Evidence],
        goes_on: float,
        believers: Sequence[str],
        step: Step,
        chance: Chance,
    ) -> list[Rival]:
        """Return the rivals after a fix, each weighed by how it saw it coming, in their order.

        For one that holds, a fix is one more of the cluster with the probability goes_on, and then lies where the
        believers expect it; or the cluster is over, and another belief resumes from this one.
        """
        both = list(zip(rivals, seen, strict=True))
        another = max((told.genuine for rival, told in both if rival.kind in believers), default=-math.inf)
        after: list[Rival] = []
        resumed: list[Rival] = []
        for rival, told in both:
            if rival.kind == "held":
                false = float(np.logaddexp(_log(goes_on) + another, told.false))
                after.append(self._holding(rival._replace(log_weight=rival.log_weight + false), step, chance))
                over = rival.log_weight + _log(1 - goes_on) + told.genuine
                resumed.append(self._taking(rival._replace(kind="resumed", log_weight=over), step, chance))
            else:
                after.append(self._taking(rival._replace(log_weight=rival.log_weight + told.taken), step, chance))
        return after + resumed

    def _challengers(
        self, rivals: Sequence[Rival], seen: Sequence[Evidence], displaced: float, step: Step, chance: Chance
    ) -> list[Rival]:
        """Return the new rivals, after the step, that its fixes give cause for.

        Fixes far from what any belief expected: one that holds and one that has moved, which happens with the
        probability ``displaced``. Fixes that the only belief would follow, being unsure: one that holds.
        """
        leader, told = rivals[0], seen[0]
        far = all(_log(displaced) + other.displaced > other.genuine for other in seen)
        far = far and all(rival.kind != "moved" for rival in rivals)
        if not far and not (told.telling and len(rivals) == 1):
            return []
        new: list[Rival] = []
        if leader.kind != "held":
            held = leader._replace(kind="held", log_weight=leader.log_weight + told.false)
            new.append(self._holding(held, step, chance))
        if far:
            mean, cov = leader.estimate.mean, leader.estimate.cov.copy()
            cov[POSITION, POSITION] += told.excess_m2
            weight = leader.log_weight + _log(displaced) + told.displaced
            moved = Rival("moved", self.filter.start(Prior(mean, cov)), leader.estimate, weight)
            new.append(self._taking(moved, step, chance))
        return new

    def _kept(self, rivals: Sequence[Rival]) -> list[Rival]:
        """Return the rivals that are left, the leader first: none forgotten, no two that are of one mind.

        The first that comes in has led. Another leads when it is the likeliest and refuses the fixes, or is ``odds``
        times as likely.
        """
        ordered = sorted(rivals, key=lambda rival: -rival.log_weight)
        best = leader = ordered[0]
        patient = best.kind in ("usual", "moved")
        kept: list[Rival] = []
        for rival in ordered:
            mate = next((other for other in kept if _agree(rival, other)), None)
            if mate is None and rival.log_weight - best.log_weight > math.log(self.forgotten):
                kept.append(rival)
            if rival is rivals[0] and patient and best.log_weight - rival.log_weight < math.log(self.odds):
                leader = mate or rival
        kept.sort(key=lambda rival: rival is not leader)
        total = float(np.logaddexp.reduce([rival.log_weight for rival in kept]))
        return [rival._replace(log_weight=rival.log_weight - total) for rival in kept]

    def _taking(self, rival: Rival, step: Step, chance: Chance) -> Rival:
        """Return the rival after the step, which one that holds takes without its fixes."""
        belief = self.filter.step(rival.belief, without_fixes(step) if rival.kind == "held" else step, chance)
        return rival._replace(belief=belief, estimate=self.filter.estimate(belief))

    def _holding(self, rival: Rival, step: Step, chance: Chance) -> Rival:
        """Return the rival after the step, its fixes refused."""
        bank = self._predicted(rival.estimate, step)
        refused = [
            moved(record(measurement, project(bank, measurement, linearised), np.ones(1), rejected=True), bank, bank)
            for measurement in step.measurements
            if measurement.sensor == SENSOR
        ]
        after = self._taking(rival, step, chance)
        return after._replace(estimate=after.estimate._replace(updates=(*after.estimate.updates, *refused)))

    def _predicted(self, estimate: Estimate, step: Step) -> Gaussians:
        return predict(copies(estimate.mean, estimate.cov, 1), self.motion, linearised, step.t0_s, step.t1_s)


def reacquisition_text(one: Reacquisition) -> str:
    """Say in words what was made of fixes that were in doubt."""
    silence = f" after {one.silent_s:.0f} s without any" if math.isfinite(one.silent_s) and one.silent_s > 5 else ""
    fixes = f"USBL fixes from {one.since_s:.1f} s on{silence}"
    if one.believed:
        wait = f", {one.refused} of them refused until then" if one.refused else ""
        return f"{fixes} did not fit the track, which jumped {one.jump_m:.1f} m to them at {one.settled_s:.1f} s{wait}"
    jump = f"the track jumped {one.jump_m:.1f} m away from them" if one.jump_m else f"{one.refused} were refused"
    return f"{fixes} agreed with each other, but not with those before and after: {jump} ({one.settled_s:.1f} s)"


def _agree(a: Rival, b: Rival) -> bool:
    """Tell whether two beliefs that take fixes have come to the same place."""
    return "held" not in (a.kind, b.kind) and _together(a, b)


def _together(a: Rival, b: Rival) -> bool:
    """Tell whether two beliefs are no further apart than by even chance."""
    off = _place(a) - _place(b)
    block = np.ix_(POSITION, POSITION)
    cov = a.estimate.cov[block] + b.estimate.cov[block]
    return float(off @ np.linalg.solve(cov, off)) < EVEN


def _place(rival: Rival) -> Vector:
    return rival.estimate.mean[POSITION]


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0 else -math.inf
