"""Identify from a log, without truth, which sensor errors exist and how noisy the sensors are.

Both maximise the posterior of one model: the predictive likelihood of the fixes (usbl_likelihood.py) times the priors.

- The noise is the maximum over logarithms, with log-normal priors about what was stated (noise_fit.py).
- A sensor error exists if the evidence for it is strong. One that does not exist has a prior sigma of 0, so that all
  subsets of errors are members of one bank. The score of a subset is its log evidence minus log 20 for each error:
  R. Kass and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.2307/2291091, call
  20 strong. An error that is observable but does not exist would be extrapolated through outages.

The two alternate, since an error that is left out looks like noise. Lever arm and clock of the DVL become settled
numbers of the run; the other errors become states of the filter.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import fit_rotation, gross, segment_numbers
from usbldr.filters.identification.false_runs import false_fixes
from usbldr.filters.identification.identification import (
    CONTRADICTED,
    DR_WALK_NAME,
    LEVER_OR_LATENCY,
    ErrorEstimate,
    Explanation,
    FalseRun,
    Identification,
    NoiseChange,
    OpenPair,
    SensorErrorEvidence,
)
from usbldr.filters.identification.linearisation import (
    CLOCK,
    HEAD,
    KEYS,
    LEVER,
    PASS_STATES,
    RANGE,
    REPORTED,
    STEPS,
    keys_of,
    linearised,
    prior_sds,
)
from usbldr.filters.identification.noise_fit import estimate_dvl_noise, estimate_usbl_noise
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, FixLikelihoods, Member, fix_likelihoods
from usbldr.filters.models.calibration import SENSOR_ERRORS, STATES
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.position_fixes import with_gps_fixes
from usbldr.filters.types import Mask, Timeline, Vector

LOG_PRIOR_ODDS = -math.log(20)  # of an error that exists against one that does not: strong evidence is required
LATENCY_SD_S = 1.0  # prior of a latency that exists: stamps of receipt are late by up to seconds
SCALE_SD = 0.03  # prior of a scale error that exists: a wrong sound speed or beam angle gives several per cent
FAR_SD = {"scale": 0.2, "heading_rad": math.pi / 2, "latency_s": 10.0}
"""Fields of SensorErrors and the prior sigma of an error far outside what is usual: velocities in another unit, a
compass mounted any way round, stamps of a slow export. Each needs strong evidence once more."""
USUAL_SIGMAS = 2.0  # [-] of the usual prior: an error beyond it may be far outside
LEAST_FACTOR = 1e-3  # fixed: on dead reckoning; a smaller one is as far outside
MAX_SCALE = 0.8  # [-] of a DVL that measures a fifth of the speed; at -1 dead reckoning would stand still
MAX_PRIOR_SIGMAS = 4.0  # [-] a lever arm of 20 m that explains a vehicle going in circles without DVL is none
ROUNDS = 2  # of noise and errors in turn: a third changes nothing on the field logs
WIDE_LATENCIES_S = tuple(float(s) for s in range(-20, 21))  # tried for the start of the search
LINEARISATIONS = 2  # about the estimates of each subset
FAR_KEYS = {SENSOR_ERRORS[field].key: field for field in FAR_SD}
HEAD_OR_VEHICLE = (HEAD, "heading"), (RANGE, "scale")
FARTHEST = 0.98  # quantile of distances from the head: an outlier is none
OPEN = 0.5  # [-] of its prior sigma: an error so uncertain after the log is not told from its rival


class _Choice(NamedTuple):
    """The chosen subset among all."""

    member: Member
    row: int  # in the subsets
    named: frozenset[str]  # errors in it for which there is evidence, alone or with those they may be taken for
    subsets: Sequence[frozenset[str]]
    score: Vector  # (N,) of each subset
    found: FixLikelihoods


@cache
def subsets_of(keys: tuple[str, ...]) -> tuple[frozenset[str], ...]:
    """Return all subsets of some keys, smaller ones first."""
    return tuple(
        frozenset(some) for count in range(len(keys) + 1) for some in itertools.combinations(sorted(keys), count)
    )


def identify(timeline: Timeline, given: Parameters) -> Identification:
    """Return the parameters with the sensor errors and the noise for which the log has evidence.

    Without fixes there is evidence of the DVL's noise alone. Raises LogError if nothing gives the start.
    """
    stated = estimate_dvl_noise(timeline, given)
    if not len(timeline.fix_time_s):
        return Identification(replace(stated, calibrate=()), (), _noise_changes(given, stated))
    errors = stated.errors
    errors = replace(errors, latency_s=max(errors.latency_s, LATENCY_SD_S), scale=max(errors.scale, SCALE_SD))
    stated = replace(stated, errors=errors)
    false = gross(timeline)
    members = _with_every_error(timeline.with_fixes(~false), stated)
    likeliest = int(np.argmax(fix_likelihoods(timeline.with_fixes(~false), members).log_likelihood))
    false[~false] = false_fixes(timeline.with_fixes(~false), members[likeliest], stated)
    kept = timeline
    if false.any():
        kept = timeline.with_fixes(~false)
        members = _with_every_error(kept, stated)
    choice = max((_choice(kept, member, stated) for member in members), key=lambda one: float(one.score.max()))
    found = _identification(kept, given, stated, choice)
    rows = tuple(np.flatnonzero(false).tolist())
    return replace(found, parameters=replace(found.parameters, false_fixes=rows), false_runs=_runs(timeline, false))


def _with_every_error(timeline: Timeline, stated: Parameters) -> list[Member]:
    """Return the members with all errors and the noise that fits them: of the usual priors, perhaps of wide ones, too.

    Wide are the priors of what lies beyond USUAL_SIGMAS. Their start is dead reckoning turned, scaled and delayed onto
    the fixes. They must make dead reckoning right: without bottom lock it fits some heading by chance.
    """
    usual = Member(stated, frozenset(keys_of(timeline)))
    found, sd = fix_likelihoods(timeline, [usual]), prior_sds(stated)
    value = {state: float(found.mean[state][0]) for state in STEPS}
    # linear in both, half a turn is a scale of 2: they are the parts of one factor on dead reckoning
    factor = 1 - value["dvl_scale"] + 1j * value["heading_bias"]
    value |= {"dvl_scale": 1 / max(abs(factor), LEAST_FACTOR) - 1, "heading_bias": float(np.angle(factor))}
    far = [key for key in FAR_KEYS if any(abs(value[s]) > USUAL_SIGMAS * sd[s] for s in KEYS[key])]
    (usual,) = _relinearised([usual], found)
    usual = usual._replace(parameters=estimate_usbl_noise(timeline, usual, stated))
    if not far:
        return [usual]
    fit = fit_rotation(timeline, segment_numbers(timeline, timeline.fix_time_s), WIDE_LATENCIES_S)
    scale = fit.scale - 1 if np.isfinite(fit.scale) else 0.0
    start = {"dvl_scale": scale, "heading_bias": -fit.rotation_rad, "usbl_latency": fit.latency_s}
    errors = replace(stated.errors, **{FAR_KEYS[key]: FAR_SD[FAR_KEYS[key]] for key in far})
    wide = _about(
        Member(replace(stated, errors=errors), usual.present), {s: start[s] for key in far for s in KEYS[key]}
    )
    for _ in range(LINEARISATIONS):
        (wide,) = _relinearised([wide], fix_likelihoods(timeline, [wide]))
    wide = wide._replace(parameters=estimate_usbl_noise(timeline, wide, wide.parameters))
    at_fault = wide.parameters.process.position_m > CONTRADICTED * stated.process.position_m
    return [usual] if at_fault else [usual, wide]


def _far(member: Member, stated: Parameters) -> frozenset[str]:
    """Return the keys of the errors whose prior is that of FAR_SD."""
    errors, usual = member.parameters.errors, stated.errors
    return frozenset(key for key, field in FAR_KEYS.items() if getattr(errors, field) != getattr(usual, field))


def _choice(timeline: Timeline, member: Member, stated: Parameters) -> _Choice:
    """Return the best subset of errors under the priors of the member, errors and noise in turn."""
    far = _far(member, stated)
    fields = [FAR_KEYS[key] for key in far]
    wide = {field: getattr(member.parameters.errors, field) for field in fields}
    choice = _best_subset(timeline, member, far)
    for _ in range(ROUNDS - 1):
        noise = estimate_usbl_noise(timeline, choice.member, replace(stated, errors=replace(stated.errors, **wide)))
        choice = _best_subset(timeline, choice.member._replace(parameters=noise), far)
    return choice


def _runs(timeline: Timeline, false: Mask) -> tuple[FalseRun, ...]:
    edges = np.flatnonzero(np.diff(false.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
    t = timeline.fix_time_s
    return tuple(FalseRun(float(t[first]), float(t[end - 1]), end - first) for first, end in edges)


def _best_subset(timeline: Timeline, member: Member, far: frozenset[str]) -> _Choice:
    """Return the subset of errors with the largest score, under the noise of the member; aiding GPS has a say."""
    timeline = with_gps_fixes(timeline, member.parameters)
    subsets = subsets_of(keys_of(timeline))
    members = [member.with_errors(subset, dict(zip(STEPS, member.about, strict=True))) for subset in subsets]
    for _ in range(LINEARISATIONS - 1):
        members = _relinearised(members, fix_likelihoods(timeline, members))
    found = fix_likelihoods(timeline, members)
    score = found.log_likelihood + LOG_PRIOR_ODDS * np.array([len(subset) + len(subset & far) for subset in subsets])
    score[~_plausible(members, found)] = -np.inf
    present, named = _present(score, subsets)
    row, sd = subsets.index(present), prior_sds(member.parameters)
    for pair in map(frozenset, HEAD_OR_VEHICLE):
        (state,) = (name for key in pair & {HEAD, RANGE} for name in KEYS[key])
        named |= pair if named & pair and pair <= present and found.sd[state][row] > OPEN * sd[state] else named
    return _Choice(_relinearised(members, found)[row], row, named, subsets, score, found)


def _plausible(members: Sequence[Member], found: FixLikelihoods) -> Mask:
    """Return for each member whether no error lies beyond MAX_PRIOR_SIGMAS of its prior, (N,)."""
    sd = prior_sds(members[0].parameters)
    within = [np.abs(found.mean[name]) <= MAX_PRIOR_SIGMAS * sd[name] for names in KEYS.values() for name in names]
    return np.all(within, axis=0)


def _present(score: Vector, subsets: Sequence[frozenset[str]]) -> tuple[frozenset[str], frozenset[str]]:
    """Return the errors of the best subset with those that are open beside it, and those of them that have evidence.

    At a constant speed v a lever arm of -v tau forward is a latency of tau: both, if the log cannot choose.
    No head is mounted without error, so that those of a head are always present; the sigma of a ship's is soon small.
    Turned or scaled fixes of a head that rests are a turned compass or a scaled DVL: these are present, too, unless the
    evidence against them is strong, also where the two hide each other: the track depends on their shares.
    """
    best = subsets[int(np.argmax(score))]
    present = named = best
    if len(best & LEVER_OR_LATENCY) == 1:
        other = subsets.index(best ^ LEVER_OR_LATENCY)
        present |= LEVER_OR_LATENCY if score.max() - score[other] < -LOG_PRIOR_ODDS else best
        named = present
    for head, vehicle in HEAD_OR_VEHICLE:
        if head in subsets[-1] and np.isfinite(score[both := subsets.index(best | {head, vehicle})]):
            gained = score[both] - score[subsets.index((best | {head}) - {vehicle})] - LOG_PRIOR_ODDS
            present |= {head, vehicle} if gained > LOG_PRIOR_ODDS else {head}
    return present, named


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


def _identification(timeline: Timeline, given: Parameters, stated: Parameters, choice: _Choice) -> Identification:
    """Return the choice as parameters of a run: what is far is settled, what is left of it has the usual prior."""
    far = _far(choice.member, stated)
    (parameters, present, about), row, found = choice.member, choice.row, choice.found
    far_states = {state for key in far & present for state in KEYS[key]}
    settled = {state: value for state, value in zip(STEPS, about, strict=True) if state in far_states}
    usual = {FAR_KEYS[key]: getattr(stated.errors, FAR_KEYS[key]) for key in far}
    parameters = replace(parameters, settled=settled, errors=replace(parameters.errors, **usual))
    if LEVER in present:
        starboard_m, forward_m = (float(found.mean[name][row]) for name in KEYS[LEVER])
        starboard, forward, up = given.dvl_lever_m
        parameters = replace(parameters, dvl_lever_m=(starboard + starboard_m, forward + forward_m, up))
    if CLOCK in present:
        parameters = replace(parameters, dvl_clock_s=given.dvl_clock_s + float(found.mean["dvl_clock"][row]))
    of_head = [name for key in (HEAD, RANGE) if key in present for name in KEYS[key]]
    parameters = replace(
        parameters,
        settled={**parameters.settled, **{name: float(found.mean[name][row]) for name in of_head}},
        settled_sd={name: float(found.sd[name][row]) for name in of_head},
    )
    told = choice.named - (LEVER_OR_LATENCY if _shared_by_priors(choice) else frozenset())
    always = {"usbl-bias", "current"} if given.water_track else {"usbl-bias"}
    kept = tuple(key for key in STATES if key in present | always)
    evidence = tuple(
        SensorErrorEvidence(
            key,
            _log_odds(key, choice),
            key in choice.named,
            _estimates((key,), found, row) if key in told else (),
            _effect_m(timeline, choice, key) if key in choice.named else 0.0,
        )
        for key in KEYS
        if key in choice.subsets[-1]
    )
    parameters = replace(parameters, calibrate=kept)
    pairs = _open_pairs(timeline, choice, parameters.settled_sd)
    return Identification(parameters, evidence, _noise_changes(given, parameters), _explanations(choice), pairs)


def _open_pairs(timeline: Timeline, choice: _Choice, sd: Mapping[str, float]) -> tuple[OpenPair, ...]:
    """Return the errors of the head with evidence that the log does not tell from those of the vehicle."""
    if timeline.fix_away_m is None:
        return ()
    away_m = float(np.quantile(np.hypot(*timeline.fix_away_m.T), FARTHEST))
    known = prior_sds(choice.member.parameters)
    states = [(pair, state) for pair in HEAD_OR_VEHICLE if choice.named.issuperset(pair) for state in KEYS[pair[0]]]
    return tuple(OpenPair(*pair, away_m, away_m * sd[s]) for pair, s in states if sd[s] > OPEN * known[s])


def _explanations(choice: _Choice) -> tuple[Explanation, ...]:
    """Return the best subset, then those within log 20 of it that have another meaning.

    A subset with an error more or less than a better one says of the others the same: `_log_odds` judges that error.
    Lever arm and latency whose shares follow from their priors are two explanations, each of which is all of it.
    """
    score, subsets, present = choice.score, choice.subsets, choice.member.present
    if _shared_by_priors(choice):
        alone = [subsets.index(present - {key}) for key in LEVER_OR_LATENCY]
        return tuple(_explanation(choice, row) for row in sorted(alone, key=lambda row: -score[row]))
    taken: list[int] = []
    for row in map(int, np.argsort(-score)):
        if score[row] - score.max() < LOG_PRIOR_ODDS:
            break
        if not any(subsets[row] <= subsets[other] or subsets[row] >= subsets[other] for other in taken):
            taken.append(row)
    return tuple(_explanation(choice, row) for row in taken)


def _explanation(choice: _Choice, row: int) -> Explanation:
    keys = tuple(key for key in KEYS if key in choice.subsets[row])
    return Explanation(keys, float(choice.score[row] - choice.score.max()), _estimates(keys, choice.found, row))


def _shared_by_priors(choice: _Choice) -> bool:
    """Return whether lever arm and latency both exist, and the log shows little but their sum."""
    prior_s, sd_s = prior_sds(choice.member.parameters)["usbl_latency"], choice.found.sd["usbl_latency"][choice.row]
    return choice.member.present >= LEVER_OR_LATENCY and float(sd_s) > OPEN * prior_s


def _estimates(keys: Sequence[str], found: FixLikelihoods, row: int) -> tuple[ErrorEstimate, ...]:
    return tuple(_estimate(name, found, row) for key in keys for name in KEYS[key])


def _effect_m(timeline: Timeline, choice: _Choice, key: str) -> float:
    """Return how far an error moves the fixes against dead reckoning, RMS about the mean."""
    log = linearised(timeline, choice.member.parameters, MAX_FIXES, choice.member.about)
    columns = [PASS_STATES.index(name) for name in KEYS[key]]
    moved_m = log.measurement_matrix[:, :, columns] @ [choice.found.mean[name][choice.row] for name in KEYS[key]]
    return math.sqrt(moved_m.var(axis=0).sum())


def _estimate(state: str, found: FixLikelihoods, row: int) -> ErrorEstimate:
    reported = REPORTED[state]
    value, sd = float(found.mean[state][row]), float(found.sd[state][row])
    return ErrorEstimate(reported.name, reported.factor * value, abs(reported.factor) * sd)


def _log_odds(key: str, choice: _Choice) -> float:
    """Return the score of the best subset with the error minus that of the best without."""
    exists = np.array([key in subset for subset in choice.subsets])
    return float(choice.score[exists].max() - choice.score[~exists].max())


def _noise_changes(given: Parameters, current: Parameters) -> tuple[NoiseChange, ...]:
    """Return the numbers of the noise that differ."""
    numbers = {
        "dvl_sd_scale": attrgetter("dvl_sd_scale"),
        "velocity_walk_mps": attrgetter("process.velocity_mps"),
        "usbl_sd_scale": attrgetter("usbl_sd_scale"),
        "usbl_bias_sd_m": attrgetter("errors.usbl_bias_m"),
        "usbl_bias_time_s": attrgetter("errors.usbl_bias_s"),
        DR_WALK_NAME: attrgetter("process.position_m"),
    }
    if isinstance(given.usbl, Contamination):
        numbers |= {"usbl_outlier_share": attrgetter("usbl.share"), "usbl_outlier_sd_m": attrgetter("usbl.sd")}
    found = [NoiseChange(name, number(given), number(current)) for name, number in numbers.items()]
    return tuple(one for one in found if one.after != one.before)
