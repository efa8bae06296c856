"""Identify from a log, without truth, which sensor errors exist, and the noise of its sensors.

Both maximise the posterior of one model: the predictive likelihood of the fixes (usbl_likelihood.py) times the priors.

- The noise is the maximum over logarithms, with log-normal priors about what was stated (noise_fit.py).
- An error exists if the evidence for it is strong. The prior sigma of an error that does not exist is 0, so that all
  subsets of errors are members of one bank; the score of a subset is its log evidence minus log 20 for each error (R. Kass
  and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.1080/01621459.1995.10476572,
  call 20 strong). An error that is observable but does not exist would be extrapolated through outages.

The two alternate, since an error that is left out looks like noise. Lever arm and clock of the DVL become settled
numbers of the run; the others become states of the filter, with their prior sigma.
"""

import itertools
import math
from dataclasses import replace
from operator import attrgetter

import numpy as np

from usbldr.filters.identification.identification import DR_WALK_NAME, Identification, NoiseChange, SensorErrorEvidence
from usbldr.filters.identification.noise_fit import estimate_dvl_noise, estimate_usbl_noise
from usbldr.filters.identification.usbl_likelihood import CLOCK, KEYS, LEVER, FixLikelihoods, Member, fix_likelihoods
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline, Vector

LOG_PRIOR_ODDS = -math.log(20)  # of an error that exists against one that does not
ROUNDS = 2  # of noise and errors in turn
LINEARISATIONS = 2  # about the estimates of each subset
LATENCY_SD_S = 1.0  # prior: stamps of receipt are late by seconds
SUBSETS = tuple(
    frozenset(keys) for count in range(len(KEYS) + 1) for keys in itertools.combinations(sorted(KEYS), count)
)


def identify(timeline: Timeline, given: Parameters) -> Identification:
    """Return the parameters with the sensor errors and the noise for which the log has evidence.

    Without fixes there is evidence of the DVL's noise alone. Raises LogError if nothing gives the start.
    """
    with_dvl = estimate_dvl_noise(timeline, given)
    if not len(timeline.fix_time_s):
        return Identification(replace(with_dvl, calibrate=()), (), _noise_changes(given, with_dvl))
    errors = replace(with_dvl.errors, latency_s=max(with_dvl.errors.latency_s, LATENCY_SD_S))
    best = Member(replace(with_dvl, errors=errors), frozenset(KEYS))
    latency_s, clock_s = _estimates(fix_likelihoods(timeline, [best]))
    best = best.with_errors(best.present, float(latency_s[0]), float(clock_s[0]))
    stated = best.parameters
    for turn in range(ROUNDS):
        best = best._replace(parameters=estimate_usbl_noise(timeline, best, stated, widely=turn == 0))
        members = [best.with_errors(subset, best.latency_s, best.clock_s) for subset in SUBSETS]
        for _ in range(LINEARISATIONS):
            found = fix_likelihoods(timeline, members)
            at = zip(members, *_estimates(found), strict=True)
            members = [one.with_errors(one.present, float(tau), float(c)) for one, tau, c in at]
        score = found.log_likelihood + LOG_PRIOR_ODDS * np.array([len(member.present) for member in members])
        row = _with_ambiguous_pair(score)
        best = members[row]
    return _identification(given, best, found, score, row)


def _with_ambiguous_pair(score: Vector) -> int:
    """Return the row of the best subset; with both lever arm and latency if the log cannot choose between them.

    At a constant speed v a lever arm of -v tau forward is a latency of tau. Both together have the sigma that the log
    leaves open, while the wrong one alone would be sure of itself.
    """
    best = int(np.argmax(score))
    pair = frozenset((LEVER, "latency"))
    if len(SUBSETS[best] & pair) == 1:
        rival = SUBSETS.index(SUBSETS[best] ^ pair)
        if score[best] - score[rival] < -LOG_PRIOR_ODDS:
            return SUBSETS.index(SUBSETS[best] | pair)
    return best


def _estimates(found: FixLikelihoods) -> tuple[Vector, Vector]:
    """Return latency and clock offset of each member, (N,) each, in steps that many members share."""
    return np.round(found.mean["usbl_latency"], 2), np.round(found.mean["dvl_clock"], 2)


def _identification(given: Parameters, best: Member, found: FixLikelihoods, score: Vector, row: int) -> Identification:
    current = best.parameters
    if LEVER in best.present:
        starboard, forward, up = given.dvl_lever_m
        found_m = [float(found.mean[name][row]) for name in KEYS[LEVER]]
        current = replace(current, dvl_lever_m=(starboard + found_m[0], forward + found_m[1], up))
    if CLOCK in best.present:
        current = replace(current, dvl_clock_s=best.clock_s)
    kept = tuple(key for key in STATES if key in best.present or key == "usbl-bias")
    errors = []
    for key, names in KEYS.items():
        having, lacking = (
            max(s for s, subset in zip(score, SUBSETS, strict=True) if (key in subset) is present)
            for present in (True, False)
        )
        errors.append(SensorErrorEvidence(key, float(having - lacking), key in best.present,
            tuple(float(found.mean[name][row]) for name in names), tuple(float(found.sd[name][row]) for name in names)))
    return Identification(replace(current, calibrate=kept), tuple(errors), _noise_changes(given, current))


def _noise_changes(given: Parameters, current: Parameters) -> tuple[NoiseChange, ...]:
    """Return the numbers of the noise that differ."""
    numbers = {
        "dvl_sd_scale": attrgetter("dvl_sd_scale"),
        "velocity_walk_mps": attrgetter("process.velocity_mps"),
        "usbl_sd_scale": attrgetter("usbl_sd_scale"),
        "usbl_bias_sd_m": attrgetter("errors.usbl_bias_m"),
        "usbl_bias_time_s": attrgetter("errors.usbl_bias_s"),
        "usbl_outlier_share": attrgetter("usbl.share"),
        "usbl_outlier_sd_m": attrgetter("usbl.sd"),
        DR_WALK_NAME: attrgetter("process.position_m"),
    }
    shared = current.errors.usbl_bias_m > 0  # else there is no bias, whose numbers would mean nothing
    found = [
        NoiseChange(name, number(given), number(current))
        for name, number in numbers.items()
        if (shared or "bias" not in name) and ("outlier" not in name or isinstance(given.usbl, Contamination))
    ]
    return tuple(one for one in found if one.after != one.before)
