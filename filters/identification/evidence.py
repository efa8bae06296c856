"""Identify from a log, without truth, which sensor errors exist and how noisy the sensors are.

Both maximise the posterior of one model: the predictive likelihood of the fixes (usbl_likelihood.py) times the priors.

- The noise is the maximum over logarithms, with log-normal priors about what was stated (noise_fit.py).
- A sensor error exists if the evidence for it is strong. One that does not exist has a prior sigma of 0, so that all
  subsets of errors are members of one bank. The score of a subset is its log evidence minus log 20 for each error:
  R. Kass and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.2307/2291091, call
  20 strong. An error that is observable but does not exist would be extrapolated through outages.

The two alternate, since an error that is left out looks like noise. Errors that exist become settled numbers of the
run; states of the filter estimate what is left of them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.blocks import blocks_of
from usbldr.filters.identification.changes import FoundChanges, about_longest_part, changes
from usbldr.filters.identification.changes_of_noise import changes_of_noise, with_noise
from usbldr.filters.identification.conclusions import (
    FAR_SD,
    HEAD_OR_VEHICLE,
    LOG_PRIOR_ODDS,
    OPEN,
    Choice,
    concluded,
    noise_changes,
    subsets_of,
)
from usbldr.filters.identification.dr_usbl_fit import WIDE_LATENCIES_S, fit_rotation, gross, segment_numbers
from usbldr.filters.identification.false_runs import false_fixes, false_starts, robust_member, runs_of
from usbldr.filters.identification.identification import (
    CONTRADICTED,
    HEADING_OR_DEVIATION,
    LEVER_OR_LATENCY,
    STRONG_ODDS,
    Identification,
)
from usbldr.filters.identification.linearisation import (
    ARM,
    COMPASS_CLOCK,
    FIELDS,
    HEAD,
    HEAD_ERRORS,
    KEYS,
    RANGE,
    STEPS,
    keys_of,
    open_by_records,
    prior_sds,
)
from usbldr.filters.identification.lost_reckoning import cost, lost_spans, without_both
from usbldr.filters.identification.noise_fit import estimate_compass_noise, estimate_dvl_noise, estimate_usbl_noise
from usbldr.filters.identification.smoothed_fixes import likeliest_smoothing, log_density
from usbldr.filters.identification.unmodelled_errors import unmodelled_errors
from usbldr.filters.identification.usbl_likelihood import FixLikelihoods, Member, fix_likelihoods, kept_linearised
from usbldr.filters.models.parameters import NOT_SMOOTHED, Parameters, SensorChange
from usbldr.filters.replay.dead_reckoning import without_changes, without_smoothing
from usbldr.filters.replay.position_fixes import with_gps_fixes
from usbldr.filters.types import Mask, Timeline, Vector

LATENCY_SD_S = 1.0  # prior of a latency that exists: stamps of receipt are late by up to seconds
SCALE_SD = 0.03  # prior of a scale error that exists: a wrong sound speed or beam angle gives several per cent
USUAL_SIGMAS = 2.0  # [-] of the usual prior: an error beyond it may be far outside
LEAST_FACTOR = 1e-3  # fixed: on dead reckoning; a smaller one is as far outside
MAX_SCALE = 0.8  # [-] of a DVL that measures a fifth of the speed; at -1 dead reckoning would stand still
MAX_PRIOR_SIGMAS = 4.0  # [-] a lever arm of 20 m that explains a vehicle going in circles without DVL is none
MOST_LOST = 6  # [spans] of a DVL that loses its lock, or of a compass beside iron: each takes some seconds to be found
ROUNDS = 2  # of noise and errors in turn: a third changes nothing on the field logs
LINEARISATIONS = 2  # about the estimates of each subset
WIDE_LINEARISATIONS = 4  # the same of large errors: a deviation of 22 deg is right after them


def identify(timeline: Timeline, given: Parameters) -> Identification:
    """Return the parameters with the sensor errors and the noise for which the log has evidence.

    Without fixes there is evidence of the DVL's noise alone. Raises LogError if nothing gives the start.
    """
    return explained(timeline, given).conclude()


class Explained(NamedTuple):
    """How likely a log is if it is read right, and the function that says which sensor errors exist then."""

    log_evidence: float
    conclude: Callable[[], Identification]


def explained(timeline: Timeline, given: Parameters) -> Explained:
    """Return the evidence for a way to read a log, which needs no choice of the errors. Raises LogError as above.

    The fixes are as recorded, or those from which software made them as it smoothed.
    """
    stated = estimate_compass_noise(timeline, estimate_dvl_noise(timeline, given))
    if not len(timeline.fix_time_s):
        only_noise = Identification(replace(stated, calibrate=()), (), noise_changes(given, stated))
        return Explained(only_noise.log_evidence, lambda: only_noise)
    errors = stated.errors
    errors = replace(errors, latency_s=max(errors.latency_s, LATENCY_SD_S), scale=max(errors.scale, SCALE_SD))
    stated = replace(stated, errors=errors)
    recorded = _explained(timeline, given, stated)
    smoothing = likeliest_smoothing(timeline, stated, lambda line: _with_every_error(line, stated)[0])
    if smoothing == NOT_SMOOTHED:
        return recorded
    before = _explained(without_smoothing(timeline, smoothing), given, stated)
    log_evidence = before.log_evidence + log_density(timeline, smoothing) - math.log(STRONG_ODDS)
    if log_evidence <= recorded.log_evidence:
        return recorded

    def conclude() -> Identification:
        found = before.conclude()
        return replace(found, parameters=replace(found.parameters, smoothing=smoothing), log_evidence=log_evidence)

    return Explained(log_evidence, conclude)


def _explained(timeline: Timeline, given: Parameters, stated: Parameters) -> Explained:
    outliers = gross(timeline)
    unchanged = _explanation(timeline, stated, outliers, FoundChanges())
    noise = changes_of_noise(timeline.with_fixes(~outliers), stated)
    louder, false = _explanation(timeline, stated, outliers, noise) if noise.changes else unchanged, unchanged.false
    if louder.log_evidence > unchanged.log_evidence:  # the others are compared with these sigmas
        unchanged = louder._replace(changes=(), log_evidence=louder.log_evidence + noise.cost)
    else:
        noise = FoundChanges()
    timeline, changed = unchanged.timeline, list[FoundChanges]()
    for left_out in (outliers, false)[: 1 + bool((false != outliers).any())]:  # false fixes hide changes
        usual, blocks = blocks_of(timeline.with_fixes(~left_out), stated)
        of_parts = (about_longest_part(one, float(timeline.time_s[-1])) for one in changes(usual, stated, blocks))
        changed += [*of_parts, unmodelled_errors(usual, stated, blocks)]
    changed = [one for one in changed if one.changes]
    possible = [unchanged, *(_explanation(timeline, stated, outliers, one) for one in changed)]
    shifted = [one for one in possible if any(any(change.fix_shift_m) for change in one.changes)]
    shifts_s = [change.start_s for one in shifted for change in one.changes]
    possible.append(_with_lost_reckoning(timeline, stated, outliers, unchanged, shifts_s))
    best = max(possible, key=lambda one: one.log_evidence)
    rivals = [one.changes for one in shifted if 0 < best.log_evidence - one.log_evidence < math.log(STRONG_ODDS)]

    def conclude() -> Identification:
        found = _concluded(best, given, stated)
        changes = without_both(with_noise(best.changes, noise.changes))
        parameters = replace(found.parameters, changes=changes, rival_shift=rivals[0] if rivals else ())
        return replace(found, parameters=parameters, false_runs=runs_of(timeline, best.false))

    return Explained(best.log_evidence, conclude)


class _Explanation(NamedTuple):
    """Changes of compass and DVL, and what the log says with them."""

    changes: tuple[SensorChange, ...]
    timeline: Timeline  # without them
    false: Mask  # (F,) fixes
    members: list[Member]  # with all errors and the noise that fits the fixes
    log_evidence: float  # of the fixes that are no gross outliers, less what changes cost


def _concluded(best: _Explanation, given: Parameters, stated: Parameters) -> Identification:
    """Return the explanation with the errors that exist beside its changes."""
    false, kept = best.false, best.timeline.with_fixes(~best.false)
    choice = _likeliest([_choice(kept, member, stated) for member in best.members])
    found = concluded(kept, given, stated, choice)
    rows = tuple(np.flatnonzero(false).tolist())
    starts = false_starts(best.timeline, choice.member) if false[0] else ()
    kept_linearised.cache_clear()
    open_by_records.cache_clear()
    parameters = replace(found.parameters, false_fixes=rows, false_starts=starts)
    return replace(found, parameters=parameters, log_evidence=best.log_evidence)


def _explanation(timeline: Timeline, stated: Parameters, outliers: Mask, changed: FoundChanges) -> _Explanation:
    line, false = without_changes(timeline, changed.changes), outliers.copy()
    near = line.with_fixes(~outliers)
    members, at_fault = _with_every_error(near, stated)
    likeliest = int(np.argmax(fix_likelihoods(near, members).log_likelihood))
    false[~outliers], log_likelihood = false_fixes(near, members[likeliest], stated)
    for one in at_fault:  # as likely as it is: less would speak for changes
        log_likelihood = max(log_likelihood, false_fixes(near, one, stated)[1])
    log_evidence = log_likelihood - changed.cost
    if changed.drift_s is None:
        return _Explanation(changed.changes, line, false, members, log_evidence)
    false |= (timeline.fix_time_s >= changed.drift_s[0]) & (timeline.fix_time_s < changed.drift_s[1])
    return _Explanation((), timeline, false, _with_every_error(timeline.with_fixes(~false), stated)[0], log_evidence)


def _with_lost_reckoning(
    timeline: Timeline, stated: Parameters, outliers: Mask, best: _Explanation, shifts_s: Sequence[float]
) -> _Explanation:
    """Return the explanation with the spans of lost dead reckoning, one after the other while each is likelier.

    Where fixes seem to shift for good, at ``shifts_s``, dead reckoning may be lost instead.
    """
    found, near = FoundChanges(), timeline.with_fixes(~outliers)
    for _ in range(MOST_LOST):
        before, line = found, without_changes(near, found.changes)
        member, log_likelihood = robust_member(line, best.members[0], stated), best.log_evidence + before.cost
        for span in lost_spans(line, member, log_likelihood, () if found.changes else shifts_s):
            one = FoundChanges(tuple(sorted((*before.changes, *span))), before.cost + cost(line))
            other = _explanation(timeline, stated, outliers, one)
            if other.log_evidence > best.log_evidence:
                best, found = other, one
        if found is before:
            break
    return best


def _with_every_error(timeline: Timeline, stated: Parameters) -> tuple[list[Member], list[Member]]:
    """Return the members with all errors and the noise that fits them: of the usual priors, perhaps of wide ones, too.

    Wide are the priors of what lies beyond USUAL_SIGMAS. Their start is dead reckoning turned, scaled and delayed onto
    the fixes. They must make dead reckoning right: without bottom lock it fits some heading by chance. Those that do
    not are returned apart.
    """
    usual = Member(stated, frozenset(keys_of(timeline, stated)) - {COMPASS_CLOCK})  # which the other two clocks say
    found, sd = fix_likelihoods(timeline, [usual]), prior_sds(stated)
    value = {state: float(mean[0]) for state, mean in found.mean.items()}
    # linear in both, half a turn is a scale of 2: they are the parts of one factor on dead reckoning
    factor = 1 - value["dvl_scale"] + 1j * value["heading_bias"]
    value |= {"dvl_scale": 1 / max(abs(factor), LEAST_FACTOR) - 1, "heading_bias": float(np.angle(factor))}
    fit = fit_rotation(timeline, segment_numbers(timeline, timeline.fix_time_s), WIDE_LATENCIES_S)
    scale = fit.scale - 1 if np.isfinite(fit.scale) else 0.0
    start = value | {"dvl_scale": scale, "heading_bias": -fit.rotation_rad, "usbl_latency": fit.latency_s}
    far = [key for key in FAR_SD if any(max(abs(value[s]), abs(start[s])) > USUAL_SIGMAS * sd[s] for s in KEYS[key])]
    (usual,) = _relinearised([usual], found)
    usual = usual._replace(parameters=estimate_usbl_noise(timeline, usual, stated))
    members, at_fault = [usual], list[Member]()
    of_vehicle = [key for key in far if key not in HEAD_ERRORS]  # beside a resting head they explain as much
    of_arm = [ARM] if ARM in usual.present else []  # which a circle shows only as scales and headings within the usual
    for keys in filter(None, dict.fromkeys(map(tuple, (of_vehicle, far, of_arm)))):
        errors = replace(stated.errors, **{FIELDS[key]: FAR_SD[key] for key in keys})
        about = {state: start[state] for key in keys for state in KEYS[key]}
        wide = _about(Member(replace(stated, errors=errors), usual.present), about)
        for _ in range(WIDE_LINEARISATIONS):
            (wide,) = _relinearised([wide], fix_likelihoods(timeline, [wide]))
        wide = wide._replace(parameters=estimate_usbl_noise(timeline, wide, wide.parameters))
        contradicted = wide.parameters.process.position_m > CONTRADICTED * stated.process.position_m
        (at_fault if contradicted else members).append(wide)
    return members, at_fault


def _choice(timeline: Timeline, member: Member, stated: Parameters) -> Choice:
    """Return the best subset of errors under the priors of the member, errors and noise in turn."""
    errors = member.parameters.errors
    far = frozenset(key for key in FAR_SD if getattr(errors, FIELDS[key]) != getattr(stated.errors, FIELDS[key]))
    wide = {FIELDS[key]: FAR_SD[key] for key in far}
    choice = _best_subset(timeline, member, far)
    for _ in range(ROUNDS - 1):
        noise = estimate_usbl_noise(timeline, choice.member, replace(stated, errors=replace(stated.errors, **wide)))
        choice = _best_subset(timeline, choice.member._replace(parameters=noise), far)
    return choice


def _likeliest(choices: Sequence[Choice]) -> Choice:
    """Return the choice with the largest score; wide priors are only for errors that lie far outside what is usual.

    Evidence for them must be strong against the usual ones, too: in a circle a latency of 12 s is a compass turned by
    six degrees. One that is wide without need pays again, as the errors of a head are always present.
    """
    possible = (one for one in choices if not one.far or one.far & one.member.present)
    return max(
        possible, key=lambda one: float(one.score.max()) + LOG_PRIOR_ODDS * (bool(one.far) + len(one.far - one.named))
    )


def _best_subset(timeline: Timeline, member: Member, far: frozenset[str]) -> Choice:
    """Return the subset of errors with the largest score, under the noise of the member; aiding GPS has a say."""
    timeline = with_gps_fixes(timeline, member.parameters)
    subsets = subsets_of(keys_of(timeline, member.parameters))
    members = [member.with_errors(subset, dict(zip(STEPS, member.about, strict=True))) for subset in subsets]
    for _ in range(LINEARISATIONS - 1):
        members = _relinearised(members, fix_likelihoods(timeline, members))
    found = fix_likelihoods(timeline, members)
    score = _score(found, subsets, far)
    score[~_plausible(members, found)] = -np.inf
    present, named = _present(score, subsets)
    row, sd = subsets.index(present), prior_sds(member.parameters)
    for pair in map(frozenset, HEAD_OR_VEHICLE):
        (state,) = (name for key in pair & {HEAD, RANGE} for name in KEYS[key])
        named |= pair if named & pair and pair <= present and found.sd[state][row] > OPEN * sd[state] else named
    return Choice(_relinearised(members, found)[row], row, named, subsets, score, found, far)


def _score(found: FixLikelihoods, subsets: Sequence[frozenset[str]], far: frozenset[str]) -> Vector:
    """Return the log likelihood of each subset with the prior odds of its errors, (N,).

    Fixes or headings that are early pay them again: drivers and filters delay. At a constant speed early fixes, a late
    compass and a DVL astern are one another.
    """
    early = (found.mean["usbl_latency"] < 0) | (found.mean["compass_clock"] < 0)
    score: Vector = found.log_likelihood + LOG_PRIOR_ODDS * (
        np.array([len(subset) + len(subset & far) for subset in subsets]) + early
    )
    return score


def _plausible(members: Sequence[Member], found: FixLikelihoods) -> Mask:
    """Return for each member whether no error lies beyond MAX_PRIOR_SIGMAS of its prior, (N,)."""
    sd = prior_sds(members[0].parameters)
    within = [np.abs(found.mean[name]) <= MAX_PRIOR_SIGMAS * sd[name] for names in KEYS.values() for name in names]
    return np.all(within, axis=0)


def _present(score: Vector, subsets: Sequence[frozenset[str]]) -> tuple[frozenset[str], frozenset[str]]:
    """Return the errors of the best subset with those that are open beside it, and those of them that have evidence.

    At a constant speed v a lever arm of -v tau forward is a latency of tau: both, if the log cannot choose. On one
    heading a deviation is a bias: the bias, which is the same on others; then a state covers the deviation.
    No head is mounted without error, so that those of a head are always present; the sigma of a ship's is soon small.
    Turned or scaled fixes of a head that rests are a turned compass or a scaled DVL: these are present, too, unless the
    evidence against them is strong, also where the two hide each other: the track depends on their shares.
    """
    scores = dict(zip(subsets, score.tolist(), strict=True))
    best = max(subsets, key=scores.__getitem__)
    if "deviation" in best and _undecided(scores, best, HEADING_OR_DEVIATION):
        best ^= HEADING_OR_DEVIATION
    present = named = best
    if _undecided(scores, best, LEVER_OR_LATENCY):
        present = named = best | LEVER_OR_LATENCY
    for head, vehicle in HEAD_OR_VEHICLE:
        if math.isfinite(both := scores.get(best | {head, vehicle}, -math.inf)):
            gained = both - scores[(best | {head}) - {vehicle}] - LOG_PRIOR_ODDS
            present |= {head, vehicle} if gained > LOG_PRIOR_ODDS else {head}
    return present, named


def _undecided(scores: Mapping[frozenset[str], float], subset: frozenset[str], pair: frozenset[str]) -> bool:
    """Return whether a subset has one error of a pair, and the evidence against the other one instead is not strong."""
    other = scores.get(subset ^ pair, -math.inf)
    return len(subset & pair) == 1 and scores[subset] - other < -LOG_PRIOR_ODDS


def _relinearised(members: Sequence[Member], found: FixLikelihoods) -> list[Member]:
    """Return the members, linearised about their own plausible estimates, in steps that many of them share."""
    return [
        _about(member, {state: float(found.mean[state][row]) for state in STEPS}) for row, member in enumerate(members)
    ]


def _about(member: Member, value: Mapping[str, float]) -> Member:
    """Return the member linearised about values of some states, each as far as it is plausible."""
    limit = {state: MAX_PRIOR_SIGMAS * sd for state, sd in prior_sds(member.parameters).items()}
    limit["dvl_scale"] = min(limit["dvl_scale"], MAX_SCALE)
    return member.with_errors(member.present, {s: min(max(x, -limit[s]), limit[s]) for s, x in value.items()})
