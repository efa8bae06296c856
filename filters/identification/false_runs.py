"""Find false fixes in a row, from both sides of each run: which fixes of a whole log share an offset that is not the
vehicle's.

Echoes, a second beacon or software that has no reply yet give false fixes in a row, also the first ones of a log, where
nothing before them contradicts. A Markov chain of two states, correct and in a run with an offset of its own, is
followed by the likeliest histories: D. Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979, doi:10.1109/TAC.1979.1102177; those that agree in the last RECENT fixes are one. The history that
is likeliest after the last fix judges the first ones, too. Metres and seconds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.clusters import FAR, OFFSET_SD_M
from usbldr.filters.identification.drift import drift_variances_m2
from usbldr.filters.identification.identification import CONTRADICTED, STRONG_ODDS
from usbldr.filters.identification.linearisation import BIAS_STATES, PASS_STATES, linearised, prior_sds
from usbldr.filters.identification.noise_fit import estimate_usbl_noise
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, Member
from usbldr.filters.models.noise import Noise, robust_sd
from usbldr.filters.models.parameters import FalseStart, Parameters, Start
from usbldr.filters.types import Array, Indices, Mask, Timeline, Vector

OFFSET_WALK_M = 0.1  # [m/√s] by judgement: an echo moves with the geometry, slowly
RATE_MPS = 0.1  # [m/s] each axis, by judgement: of an offset that grows
DURATIONS_S = ((60.0, 3600.0), (20.0, 120.0), (30.0, 60.0))
"""Mean duration of a run and mean time between runs; the likeliest pair is taken."""
HISTORIES = 10  # of each pair
RECENT = 10  # [fixes] by judgement: decisions that are older no longer distinguish two histories
UNKNOWN_START_M = 1000.0  # [m] each axis: says nothing, as offsets and distances are tens to hundreds of metres
CORRECT, BEGINS, CONTINUES = range(3)
RUN, OFFSET, RATE = slice(-4, None), slice(-4, -2), slice(-2, None)  # of the states, the last four are a run's


class FalseRuns(NamedTuple):
    """The likeliest history."""

    false: Mask  # (F,) fixes, of which only the first MAX_FIXES can be
    log_likelihood: float  # predictive, of all of them
    first: Sequence[Mapping[int, float]]  # after each fix: number of first fixes that are false -> log weight


class _Histories(NamedTuple):
    """N histories with the state of each, n numbers."""

    log_weight: Vector  # (N,)
    mean: Array  # (N, n)
    cov: Array  # (N, n, n)
    in_run: Mask  # (N,)
    gradual: Mask  # (N,) the run began with a fix that was not far from the track
    pair: Indices  # (N,) in DURATIONS_S
    recent: Indices  # (N,) the last RECENT decisions as bits
    first: Indices  # (N,) how many of the first fixes are false
    octave: Indices  # (N,) of the fix with which the run began, or the last one if it was long, counted from 1; 0: none


def false_fixes(timeline: Timeline, member: Member, stated: Parameters) -> tuple[Mask, float]:
    """Return which fixes are false, (F,), and the log likelihood of all; of those after MAX_FIXES none is known to be.

    The noise of the member fits all fixes, false ones included. If it has grown for them, the histories are followed
    with the stated correlated error and the sigma that neighbouring fixes show, too, then with the noise that fits
    those of them that are correct; the likeliest noise decides. None is false if half of them would be: nothing says
    then which half.
    """
    fitted, found, errors = member.parameters, false_runs(timeline, member), stated.errors
    at_fault = fitted.process.position_m > CONTRADICTED * stated.process.position_m
    if at_fault or found.false.any() or fitted.errors.usbl_bias_m > errors.usbl_bias_m:
        errors = replace(fitted.errors, usbl_bias_m=errors.usbl_bias_m, usbl_bias_s=errors.usbl_bias_s)
        robust = replace(stated, errors=errors, usbl_sd_scale=_sd_scale(timeline, member))
        other = false_runs(timeline, member._replace(parameters=robust))
        found = max(found, other, key=lambda runs: runs.log_likelihood)
        if not other.false.all():
            correct = timeline.with_fixes(~other.false)
            refitted = estimate_usbl_noise(correct, member._replace(parameters=robust), stated)
            other = false_runs(timeline, member._replace(parameters=refitted))
            found = max(found, other, key=lambda runs: runs.log_likelihood)
    return found.false & (found.false[:MAX_FIXES].mean() < 0.5), found.log_likelihood


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
    for f, weight in enumerate(false_runs(timeline, member).first):
        likeliest, last = max(weight, key=weight.__getitem__), starts[-1].fixes
        odds = weight[likeliest] - weight.get(last, -np.inf)
        if likeliest <= f and odds > (np.log(STRONG_ODDS) if last else 0):  # until then nothing shows the vehicle
            starts.append(FalseStart(float(received_s[f]), likeliest))
    return tuple(starts[1:])


def false_runs(timeline: Timeline, member: Member, gradual: bool = True) -> FalseRuns:
    """Return the likeliest history with the noise and the priors of a member; it starts in the spread of the fixes.

    A run may begin gradually if it ends: if the fixes leave the track slowly and for ever, dead reckoning is at fault.
    """
    time_s, errors = timeline.fix_time_s[:MAX_FIXES], member.parameters.errors
    log = linearised(timeline, member.parameters.usbl_from_dvl_m, MAX_FIXES, member.about)
    modes = member.parameters.usbl.modes(timeline.fix_cov_m2[:MAX_FIXES] * member.parameters.usbl_sd_scale**2)
    dt_s = np.maximum(np.diff(time_s, prepend=time_s[0]), 0.0)
    fade = np.exp(-dt_s / errors.usbl_bias_s)
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
    bias = slice(east, north + 1)
    pairs = len(DURATIONS_S)
    mean = np.zeros((pairs, H.shape[2]))
    mean[:, :2] = start_m
    now = _Histories(
        np.zeros(pairs),
        mean,
        np.tile(np.diag(np.append(sd[used] ** 2, np.zeros(4))), (pairs, 1, 1)),
        np.zeros(pairs, np.bool_),
        np.zeros(pairs, np.bool_),
        np.arange(pairs),
        *np.zeros((3, pairs), np.intp),
    )
    first: list[Mapping[int, float]] = []
    parents: list[Indices] = []
    decisions: list[Indices] = []
    for f, z in enumerate(log.residual_m):
        now = _predicted(now, bias, fade[f], errors.usbl_bias_m, drift_m2[f] if f else 0.0, dt_s[f])
        noise = Noise(modes.probabilities, modes.cov[:, f])
        now, parent, decision = _updated(now, z, H[f], noise, dt_s[f], f, gradual)
        weight = dict[int, float]()
        for fixes, log_weight in zip(now.first.tolist(), now.log_weight.tolist(), strict=True):
            weight[fixes] = float(np.logaddexp(weight.get(fixes, -np.inf), log_weight))
        first.append(weight)
        parents.append(parent)
        decisions.append(decision)
    row = int(np.argmax(now.log_weight))
    if gradual and now.gradual[row]:
        return false_runs(timeline, member, gradual=False)
    total = float(now.log_weight[row])
    false = np.zeros(len(timeline.fix_time_s), np.bool_)
    for f in range(len(time_s) - 1, -1, -1):
        false[f] = decisions[f][row] != CORRECT
        row = int(parents[f][row])
    return FalseRuns(false, total, first)


def _sd_scale(timeline: Timeline, member: Member) -> float:
    """Return the factor on the stated sigmas by which neighbouring fixes differ; a median ignores where runs begin."""
    residual_m = linearised(timeline, member.parameters.usbl_from_dvl_m, MAX_FIXES, member.about).residual_m
    sigma_m = np.linalg.cholesky(timeline.fix_cov_m2[1:MAX_FIXES])
    steps: Vector = np.linalg.solve(sigma_m, np.diff(residual_m, axis=0)[..., None]).ravel().astype(np.float64)
    found = robust_sd(steps)
    return found if np.isfinite(found) and found > 0 else 1.0


def _predicted(now: _Histories, bias: slice, fade: float, bias_m: float, drift_m2: float, dt_s: float) -> _Histories:
    mean, cov = now.mean.copy(), now.cov.copy()
    mean[:, bias] *= fade
    cov[:, bias] *= fade
    cov[:, :, bias] *= fade
    variance = np.einsum("nii->ni", cov)  # a view
    variance[:, :2] += drift_m2
    variance[:, bias] += (1 - fade**2) * bias_m**2
    mean[:, OFFSET] += dt_s * mean[:, RATE]
    cov[:, OFFSET] += dt_s * cov[:, RATE]
    cov[:, :, OFFSET] += dt_s * cov[:, :, RATE]
    variance[now.in_run, OFFSET] += OFFSET_WALK_M**2 * dt_s
    return now._replace(mean=mean, cov=cov)


def _updated(
    now: _Histories, z: Vector, H: Array, noise: Noise, dt_s: float, f: int, gradual: bool
) -> tuple[_Histories, Indices, Indices]:
    """Return the likeliest histories with this fix, the history before of each, and what each takes the fix for."""
    count, offset = len(now.log_weight), now.cov[:, :, OFFSET]
    decision, parent = np.divmod(np.arange(3 * count), count)
    cross = np.concatenate([now.cov @ H.T] * 3)  # (3 N, n, 2)
    e, S = z - now.mean @ H.T, H @ cross[:count]
    # two offsets of which none is known: that of a run that begins, and that of first fixes that were all false
    begun_m2 = np.maximum(OFFSET_SD_M**2, (e**2).sum(axis=1) / 2)[:, None, None] * np.eye(2)
    apart_m2 = np.where(((now.first == f) & (f > 0))[:, None, None], begun_m2 - OFFSET_SD_M**2 * np.eye(2), 0.0)
    shared = H @ offset
    cross[: 2 * count, RUN] = 0.0
    cross[:count, :2] += apart_m2
    cross[count : 2 * count, OFFSET] = begun_m2
    cross[2 * count :] += offset
    log_l, inverse, weighted = _by_mode(
        np.concatenate([e, e, e - now.mean[:, OFFSET]]),
        np.concatenate([S + apart_m2, S + begun_m2, S + shared + shared.transpose(0, 2, 1) + offset[:, OFFSET]]),
        noise,
    )
    of_fix = np.logaddexp.reduce(log_l, axis=0)
    near = _chi_square(e, S + noise.cov[0]) < FAR
    log_prior = _log_prior(now, dt_s, f)
    log_prior[BEGINS, near & (now.first < f) & (not gradual)] = -np.inf
    log_weight = of_fix + (now.log_weight + log_prior).ravel()
    # a tail as heavy as a scale that is not known
    offset_m2 = np.concatenate([apart_m2[:, 0, 0] + OFFSET_SD_M**2, begun_m2[:, 0, 0]])
    log_weight[: 2 * count] += 0.5 * np.log(OFFSET_SD_M**2 / offset_m2)
    recent = ((now.recent[parent] << 1) | (decision != CORRECT)) & (2**RECENT - 1)
    in_run = decision != CORRECT
    short = now.in_run[parent] & ~in_run & (now.recent[parent] != 2**RECENT - 1)
    octave = np.where(decision == BEGINS, (f + 1).bit_length(), np.where(short, 0, now.octave[parent]))
    first = now.first[parent] + (in_run & (now.first[parent] == f))
    kept, log_weight = _chosen(log_weight, now.pair[parent], recent, octave, np.where(in_run, 0, first), in_run)
    decision, parent, cross = decision[kept], parent[kept], cross[kept]
    mean, cov = now.mean[parent], now.cov[parent]
    ended = decision != CONTINUES
    mean[ended, RUN] = 0.0
    cov[ended, RUN] = 0.0
    cov[ended, :, RUN] = 0.0
    cov[decision == CORRECT, :2, :2] += apart_m2[parent[decision == CORRECT]]
    cov[decision == BEGINS, OFFSET, OFFSET] = begun_m2[parent[decision == BEGINS]]
    cov[decision == BEGINS, RATE, RATE] = RATE_MPS**2 * np.eye(2)
    g, G = _correction(np.exp(log_l[:, kept] - of_fix[kept]), inverse[:, kept], weighted[:, kept])
    mean += (cross @ g[:, :, None])[:, :, 0]
    cov += cross @ G @ cross.transpose(0, 2, 1)
    slowly = np.where(decision == BEGINS, near[parent], (decision == CONTINUES) & now.gradual[parent])
    after = _Histories(
        log_weight, mean, cov, in_run[kept], slowly, now.pair[parent], recent[kept], first[kept], octave[kept]
    )
    return after, parent, decision


def _log_prior(now: _Histories, dt_s: float, f: int) -> Array:
    """Return the log probability that each history takes the fix for correct, the first or another one of a run."""
    run_s, gap_s = np.array(DURATIONS_S)[now.pair].T
    begins = run_s / (run_s + gap_s) if f == 0 else -np.expm1(-dt_s / gap_s)
    ends = np.where(now.in_run, -np.expm1(-dt_s / run_s), 1.0)
    with np.errstate(divide="ignore"):
        log_prior: Array = np.log([(1 - begins) * ends, begins * ends, 1 - ends])
    return log_prior


def _chosen(
    log_weight: Vector, pair: Indices, recent: Indices, octave: Indices, start: Indices, in_run: Mask
) -> tuple[Indices, Vector]:
    """Return rows and weights of the likeliest HISTORIES of each pair, and of the likeliest long run of each octave.

    So are the likeliest long run that has ended, of each octave, and the likeliest false start, of each octave of its
    ``start`` fixes: many correct ones may have to follow until it is the likeliest of all. Of those that agree in the
    recent fixes, or in the octave of a long run, the likeliest stands for all.
    """
    order = np.argsort(-log_weight, kind="stable")
    order = order[np.isfinite(log_weight[order])]
    long = recent[order] == 2**RECENT - 1
    of_long = np.where(long | ~in_run[order], octave[order], 0)
    code = ((pair[order] << RECENT | recent[order]) << 6) | of_long  # MAX_FIXES has 12 bits
    _, first, group = np.unique(code, return_index=True, return_inverse=True)
    top = log_weight[order[first]]
    total = top + np.log(np.bincount(group, np.exp(log_weight[order] - top[group])))
    kept = order[first]
    likeliest = np.argsort(-total, kind="stable")
    its_pair = np.where(long[first], -1, pair[kept])[likeliest]
    rows = [np.flatnonzero(long[first]), *(likeliest[its_pair == p][:HISTORIES] for p in range(len(DURATIONS_S)))]
    for ended in (np.frexp(start[kept])[1], np.where(in_run[kept], 0, octave[kept])):  # octaves
        octaves, best = np.unique(ended[likeliest], return_index=True)
        rows.append(likeliest[best[octaves > 0]])
    each = np.unique(np.concatenate(rows))
    return kept[each], total[each]


def _by_mode(e: Vector, S: Array, noise: Noise) -> tuple[Array, Array, Array]:
    """Return the log of each mode's part of the likelihood, (J, N), (S + R)^-1, (J, N, 2, 2), and its product by e."""
    inverse, det = _inverse(S + noise.cov[:, None])
    weighted = (inverse @ e[:, :, None])[..., 0]
    log_l = -0.5 * ((weighted * e).sum(axis=-1) + np.log(det)) - np.log(2 * np.pi)
    return log_l + np.log(noise.probabilities)[:, None], inverse, weighted


def _chi_square(e: Array, S: Array) -> Vector:
    """Return how far innovations (N, 2) are from zero by their covariances (N, 2, 2)."""
    inverse, _ = _inverse(S)
    return ((inverse @ e[:, :, None])[..., 0] * e).sum(axis=-1)


def _inverse(S: Array) -> tuple[Array, Array]:
    """Return the inverses and the determinants of symmetric matrices (..., 2, 2)."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    det = a * c - b * b
    return np.stack([c, -b, -b, a], axis=-1).reshape(S.shape) / det[..., None, None], det


def _correction(p: Array, inverse: Array, weighted: Array) -> tuple[Array, Array]:
    """Return g and G of the moment-matched update: mean + C g, covariance + C G C^T with the cross covariance C."""
    g = np.einsum("jn,jna->na", p, weighted)
    outer = weighted[..., :, None] * weighted[..., None, :] - inverse
    return g, np.einsum("jn,jnab->nab", p, outer) - g[:, :, None] * g[:, None, :]
