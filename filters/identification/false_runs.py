"""Find false fixes in a row, from both sides of each run: which fixes of a whole log share an offset that is not the
vehicle's.

Echoes, a second beacon or software that has no reply yet give false fixes in a row, also the first ones of a log, where
nothing before them contradicts. The likeliest histories are followed over all fixes (histories.py); the one that is
likeliest after the last fix judges the first ones, too. Metres and seconds.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.clusters import OFFSET_SD_M
from usbldr.filters.identification.histories import CORRECT, KINDS, Followed, HistorySearch, followed
from usbldr.filters.identification.identification import CONTRADICTED, STRONG_ODDS, FalseRun
from usbldr.filters.identification.linearisation import (
    BIAS_STATES,
    PASS_STATES,
    drift_variances_m2,
    linearised,
    prior_sds,
)
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, Member
from usbldr.filters.models.noise import robust_sd, shown_sd
from usbldr.filters.models.parameters import FalseStart, Parameters, Start
from usbldr.filters.replay.dead_reckoning import rival_share
from usbldr.filters.types import Mask, Timeline, Vector

CELL_SIGMAS = 3.0  # [-] of a fix: positions that differ by less are one
JUMP_FIXES = 5  # before and after a jump: a median ignores two outliers
FASTEST_MPS = 3.0  # [m/s] by judgement: AUVs with a DVL do up to 2.5, and dead reckoning may stand still meanwhile
ASTRAY, ASTRAY_RUNS = 0.9, 3  # [-], [runs] by judgement: of echoes by turns a third and more are correct
UNKNOWN_START_M = 1000.0  # [m] each axis: says nothing, as offsets and distances are tens to hundreds of metres


class FalseRuns(NamedTuple):
    """The likeliest history."""

    false: Mask  # (F,) fixes, of which only the first MAX_FIXES can be
    log_likelihood: float  # predictive, of all of them
    after: Sequence[Followed]  # the histories after each fix
    kind: int  # in KINDS, of its runs


def false_fixes(timeline: Timeline, member: Member, stated: Parameters) -> tuple[Mask, float]:
    """Return which fixes are false, (F,), and the log likelihood of all; of those after MAX_FIXES none is known to be.

    The noise of the member fits all fixes, false ones included. If it has grown for them, the histories are followed
    with the stated correlated error and the sigma that neighbouring fixes show, too; the likelier noise decides. None
    is false if one run has as many as are correct: nothing says then which of both is the vehicle. Nor are first or
    last ones to which dead reckoning comes near again and again, and which it leaves by a jump if it is at fault.
    """
    fitted, found = member.parameters, _from_both_ends(timeline, member)
    at_fault = fitted.process.position_m > CONTRADICTED * stated.process.position_m
    if at_fault or found.false.any() or fitted.errors.usbl_bias_m > stated.errors.usbl_bias_m:
        robust = _from_both_ends(timeline, robust_member(timeline, member, stated))
        if robust.log_likelihood > found.log_likelihood:
            found, at_fault = robust, False
    false = found.false & ~_astray(found.false)
    if at_fault and false.any() and not false[:MAX_FIXES].all():
        false &= ~_jumps(timeline, member, false)
    return false & (_longest(false) < (~false[:MAX_FIXES]).sum()), found.log_likelihood


def _from_both_ends(timeline: Timeline, member: Member) -> FalseRuns:
    """Return the likelier of the histories that are followed from the first fix and from the last one.

    Of fixes that lie by turns in two places, the first ones may decide for the wrong place: few histories are kept.
    """
    found = false_runs(timeline, member)
    if not found.false.any() or member.parameters.start is not None:
        return found
    return max(found, false_runs(timeline, member, backwards=True), key=lambda runs: runs.log_likelihood)


def _astray(false: Mask) -> Mask:
    """Return the first and the last fixes if dead reckoning leaves them again and again, (F,).

    Hardly any of them is correct, in spite of several runs: it is not the fixes that lie elsewhere each time.
    """
    astray = np.zeros_like(false)
    for mask, there in ((false, astray), (false[::-1], astray[::-1])):
        runs = np.cumsum(np.diff(mask, prepend=False) & mask)
        share = np.cumsum(mask) / np.arange(1, len(mask) + 1)
        if len(last := np.flatnonzero(mask & (runs >= ASTRAY_RUNS) & (share >= ASTRAY))):
            there[: last[-1] + 1] = True
    return astray


def _jumps(timeline: Timeline, member: Member, false: Mask) -> Mask:
    """Return which false fixes, first or last ones, dead reckoning may have left by a jump, (F,).

    No correct fixes come before or after them, and medians of the fixes beside the jump are no further apart than a
    vehicle goes.
    """
    jumps, correct = np.zeros_like(false), np.flatnonzero(~false[:MAX_FIXES])
    residual_m = linearised(timeline, member.parameters.usbl_from_dvl_m, MAX_FIXES, member.about).residual_m
    for side, edge in ((slice(correct[0]), correct[0]), (slice(correct[-1] + 1, None), correct[-1] + 1)):
        before, after = slice(max(edge - JUMP_FIXES, 0), edge), slice(edge, edge + JUMP_FIXES)
        if len(residual_m[before]) and len(residual_m[after]):
            apart_m = np.hypot(*(np.median(residual_m[after], axis=0) - np.median(residual_m[before], axis=0)))
            jumps[side] = apart_m <= FASTEST_MPS * (timeline.fix_time_s[after][-1] - timeline.fix_time_s[before][0])
    return jumps


def _longest(false: Mask) -> int:
    """Return the number of fixes of the longest run."""
    edges = np.flatnonzero(np.diff(false, prepend=False, append=False))
    return int(np.diff(edges)[::2].max(initial=0))


def runs_of(timeline: Timeline, false: Mask) -> tuple[FalseRun, ...]:
    """Return the runs of false fixes, (F,)."""
    edges = np.flatnonzero(np.diff(false.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
    t, correct = timeline.fix_time_s, int(np.count_nonzero(~false))
    return tuple(
        FalseRun(float(t[first]), float(t[end - 1]), end - first, end == len(t), rival_share(end - first, correct))
        for first, end in edges
    )


def robust_member(timeline: Timeline, member: Member, stated: Parameters) -> Member:
    """Return the member with the stated noise, but for the sigma that neighbouring fixes show."""
    shared = {name: getattr(stated.errors, name) for name in ("usbl_bias_m", "usbl_bias_s")}
    errors = replace(member.parameters.errors, **shared)
    return member._replace(parameters=replace(stated, errors=errors, usbl_sd_scale=_sd_scale(timeline, member)))


def false_starts(timeline: Timeline, member: Member) -> tuple[FalseStart, ...]:
    """Return how many of the first fixes are false as far as the fixes that have arrived show, whenever it changes.

    That the start is false is taken as soon as it is likelier, another number of fixes with strong evidence.
    """
    if member.parameters.start is None:  # that it lies in the spread of all fixes is not known yet
        residual_m = linearised(timeline, member.parameters.usbl_from_dvl_m, 1, member.about).residual_m[0]
        start = Start(*residual_m.tolist(), sd_m=UNKNOWN_START_M)
        member = member._replace(parameters=replace(member.parameters, start=start))
    received_s = np.maximum.accumulate(timeline.fix_received_s[:MAX_FIXES])
    starts = [FalseStart(-np.inf, 0)]
    for f, after in enumerate(false_runs(timeline, member).after):
        weight = dict[int, float]()
        for fixes, log_weight in zip(after.first.tolist(), after.log_weight.tolist(), strict=True):
            weight[fixes] = float(np.logaddexp(weight.get(fixes, -np.inf), log_weight))
        likeliest, last = max(weight, key=weight.__getitem__), starts[-1].fixes
        odds = weight[likeliest] - weight.get(last, -np.inf)
        if likeliest <= f and odds > (np.log(STRONG_ODDS) if last else 0):  # until then nothing shows the vehicle
            starts.append(FalseStart(float(received_s[f]), likeliest))
    return tuple(starts[1:])


def false_runs(
    timeline: Timeline,
    member: Member,
    gradual: bool = True,
    kinds: Sequence[int] = range(len(KINDS)),
    backwards: bool = False,
) -> FalseRuns:
    """Return the likeliest history with the noise and the priors of a member; it starts in the spread of the fixes.

    It is followed from the first fix to the last one, or ``backwards`` if the start is not known.
    A run may begin gradually if it ends: if the fixes leave the track slowly and for ever, dead reckoning is at fault.
    """
    time_s, errors = timeline.fix_time_s[:MAX_FIXES], member.parameters.errors
    log = linearised(timeline, member.parameters.usbl_from_dvl_m, MAX_FIXES, member.about)
    noise = member.parameters.usbl.modes(timeline.fix_cov_m2[:MAX_FIXES] * member.parameters.usbl_sd_scale**2)
    dt_s = np.maximum(np.diff(time_s, prepend=time_s[0]), 0.0)
    drift_m2 = drift_variances_m2(timeline, time_s, [member.parameters], ["scale" in member.present])[:, 0]
    sd = np.array([{**prior_sds(member.parameters)}.get(name, 0.0) for name in PASS_STATES])
    start = member.parameters.start
    if start is None:
        low, middle, high = np.percentile(log.residual_m, (10, 50, 90), axis=0)
        start_m, sd[:2] = middle, max(OFFSET_SD_M, float((high - low).max()))
    else:
        start_m, sd[:2] = np.array([start.east_m, start.north_m]), start.sd_m
    used = np.flatnonzero(sd > 0)
    H = np.pad(log.measurement_matrix[:, :, used], ((0, 0), (0, 0), (0, 4)))  # a run's states enter if there is one
    east, north = (int(np.flatnonzero(used == PASS_STATES.index(name))[0]) for name in BIAS_STATES)
    drift_m2[:1] = 0.0
    search = HistorySearch(
        residual_m=log.residual_m,
        measurement_matrix=H,
        dt_s=dt_s,
        fade=np.exp(-dt_s / errors.usbl_bias_s),
        drift_m2=drift_m2,
        noise=noise,
        bias=slice(east, north + 1),
        bias_m=errors.usbl_bias_m,
        mean=np.concatenate([start_m, np.zeros(H.shape[2] - 2)]),
        cov=np.diag(np.append(sd[used] ** 2, np.zeros(4))),
        gradual=gradual,
        cell_m=CELL_SIGMAS * float(np.sqrt(np.median(np.einsum("fkk->fk", noise.cov[0])))),
        kinds=np.array(KINDS)[list(kinds)],
    )
    after = followed(search.backwards() if backwards else search)
    row = int(np.argmax(after[-1].log_weight))
    if gradual and after[-1].gradual[row]:
        return false_runs(timeline, member, False, kinds, backwards)
    total = float(after[-1].log_weight[row])
    false = np.zeros(len(timeline.fix_time_s), np.bool_)
    followed_as = np.arange(len(time_s))[:: -1 if backwards else 1]
    for f, one in zip(followed_as[::-1], after[::-1], strict=True):
        false[f] = one.decision[row] != CORRECT
        row = int(one.parent[row])
    return FalseRuns(false, total, after, kinds[row])


def _sd_scale(timeline: Timeline, member: Member) -> float:
    """Return the factor on the stated sigmas by which neighbouring fixes differ; a median ignores where runs begin.

    It does not ignore the tails of the noise, which the stated sigma has, too.
    """
    residual_m = linearised(timeline, member.parameters.usbl_from_dvl_m, MAX_FIXES, member.about).residual_m
    sigma_m = np.linalg.cholesky(timeline.fix_cov_m2[1:MAX_FIXES])
    steps: Vector = np.linalg.solve(sigma_m, np.diff(residual_m, axis=0)[..., None]).ravel().astype(np.float64)
    usual = np.median(timeline.fix_cov_m2[:MAX_FIXES, 0, 0]) * np.eye(2)
    found = robust_sd(steps) * math.sqrt(float(usual[0, 0])) / shown_sd(member.parameters.usbl.modes(usual))
    return found if np.isfinite(found) and found > 0 else 1.0
