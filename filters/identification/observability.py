"""Decide which sensor errors are observable in a log, and estimate its noise. The truth is not used.

One pass over the fixes (usbl_likelihood.py) with all error states gives the ratio of posterior to prior sigma of each;
errors with a ratio near 1 are left out. The predictive likelihood of the fixes then selects what a sigma cannot show:
the share of their variance that neighbouring fixes have in common and its time constant, the share of outliers, whether
the stamps are reliable, and the process noise of dead reckoning, which is far off without bottom lock or with a wrong
mounting or heading. Before that, the noise of the DVL and the random walk of the velocity are estimated from the DVL's
own records (dvl_likelihood.py). A number changes only if the evidence is strong.

R. Kass and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.2307/2291091, call
20 strong. Misalignment of the DVL is left to the user: its effect on the track equals that of a heading bias.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.dvl_likelihood import dvl_likelihoods
from usbldr.filters.identification.identification import (
    DR_WALK_NAME,
    Identification,
    NoiseChange,
    StateObservability,
)
from usbldr.filters.identification.tuning import estimate_dvl_noise
from usbldr.filters.identification.usbl_likelihood import dr_residuals, fix_likelihoods
from usbldr.filters.models.calibration import MAX_SIGMA_RATIO, STATES, prior_sd
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Timeline, Vector

CANDIDATE_KEYS = ("scale", "heading", "deviation", "latency", "usbl-bias")
UNTRUSTED_LATENCY_SD_S = 1.0  # of unreliable stamps
MIN_LOG_BAYES_FACTOR = math.log(20)  # required for a change of the assumptions
CORRELATED_VARIANCE_SHARES = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95)  # of the fixes' variance; the middle serves as reference
BIAS_TIME_FACTORS = (0.5, 1.0, 2.0, 4.0)  # factors on the assumed time constant
OUTLIER_SHARE_FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0)  # factors on the assumed share
DR_WALK_FACTORS = (
    1.0,
    25.0,
    125.0,
)  # factors on the assumed random walk of dead reckoning; coarse, for gross failures
USBL_SD_FACTORS = (2.0, 4.0)  # factors on the stated sigma of fixes
MAX_OUTLIER_SHARE = 0.5  # of the fixes
NEEDS_TURNS = ("deviation", "latency")  # not observable on a straight track at constant speed
MIN_YAW_RANGE_RAD = math.radians(45)  # by judgement: a survey line with its corrections stays within


class _NoiseModel(NamedTuple):
    """One candidate noise model of the log."""

    parameters: Parameters
    changes: int = 0  # number of changes from the given assumptions
    inflates_dr_walk: bool = False  # random walk of dead reckoning larger than assumed
    inflates_usbl_sd: bool = False  # fixes noisier than stated: never chosen, only compared with drift


def identify(timeline: Timeline, parameters: Parameters) -> Identification:
    """Return the assumptions with the observable error states, and with the noise for which the evidence is strong.

    Field ``observed`` holds the sigma ratio of each error, ``noise_changes`` the changed numbers of the noise. Without
    fixes no state is observable. Raises LogError if nothing gives the start.
    """
    with_dvl = _with_dvl_noise(timeline, parameters)
    if not len(timeline.fix_time_s):
        nothing = tuple(StateObservability(key, 1.0, "not observable") for key in CANDIDATE_KEYS)
        return Identification(replace(with_dvl, calibrate=()), nothing, _noise_changes(parameters, with_dvl))
    every = replace(with_dvl, calibrate=CANDIDATE_KEYS)
    sd_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    current = _with_correlation(
        every, every, sd_m, CORRELATED_VARIANCE_SHARES[len(CORRELATED_VARIANCE_SHARES) // 2], every.errors.latency_s
    )
    latency_s = fix_likelihoods(dr_residuals(timeline, current), [current]).latency_s  # linearised once more about it
    for choices in (
        _correlation_models,
        _noise_models,
        _correlation_models,
    ):  # the first choice was made under what the second may have changed
        among = choices(current, every, sd_m)
        told = fix_likelihoods(dr_residuals(timeline, current, latency_s), [choice.parameters for choice in among])
        best = _best(among, told.log_likelihood)
        current = among[best].parameters
    before = prior_sd(current.errors)
    straight = float(np.ptp(timeline.dr_yaw_rad)) < MIN_YAW_RANGE_RAD
    observed: list[StateObservability] = []
    for key in CANDIDATE_KEYS:
        sigma_ratio = min(float(told.sd[name][best]) / before[name] if before[name] else 1.0 for name in STATES[key])
        seen = current.errors.usbl_bias_m > 0 if key == "usbl-bias" else sigma_ratio < MAX_SIGMA_RATIO
        hidden = "only in turns" if straight and key in NEEDS_TURNS else "not observable"
        observed.append(StateObservability(key, sigma_ratio, "observable" if seen else hidden))
    kept = tuple(told.key for told in observed if told.conclusion == "observable")
    return Identification(replace(current, calibrate=kept), tuple(observed), _noise_changes(parameters, current))


def _with_dvl_noise(timeline: Timeline, given: Parameters) -> Parameters:
    """Return the assumptions with the noise estimated from the DVL's own records, if the evidence is strong."""
    found = estimate_dvl_noise(timeline, given)
    changes = sum(one.identified for one in found.tuned)
    before, after = dvl_likelihoods(timeline, [given, found.parameters])
    return found.parameters if after - before > MIN_LOG_BAYES_FACTOR * changes else given


def _best(among: Sequence[_NoiseModel], log_likelihood: Vector) -> int:
    """Return the index of the best candidate; drift is excluded if the evidence for noisier fixes is strong."""
    score = log_likelihood - MIN_LOG_BAYES_FACTOR * np.array([choice.changes for choice in among])
    inflates_dr_walk, inflates_usbl_sd = (
        np.array([getattr(choice, name) for choice in among]) for name in ("inflates_dr_walk", "inflates_usbl_sd")
    )
    if (
        score[inflates_usbl_sd].max(initial=-np.inf)
        > score[inflates_dr_walk].max(initial=-np.inf) + MIN_LOG_BAYES_FACTOR
    ):
        score[inflates_dr_walk] = -np.inf
    score[inflates_usbl_sd] = -np.inf
    return int(np.argmax(score))


def _noise_changes(given: Parameters, current: Parameters) -> tuple[NoiseChange, ...]:
    """Return the numbers of the noise that differ."""
    numbers = {
        "dvl_sd_scale": attrgetter("dvl_sd_scale"),
        "velocity_walk_mps": attrgetter("process.velocity_mps"),
        "usbl_sd_scale": attrgetter("usbl_sd_scale"),
        "usbl_bias_sd_m": attrgetter("errors.usbl_bias_m"),
        "usbl_bias_time_s": attrgetter("errors.usbl_bias_s"),
        "usbl_outlier_share": attrgetter("usbl.share"),
        "usbl_latency_sd_s": attrgetter("errors.latency_s"),
        DR_WALK_NAME: attrgetter("process.position_m"),
    }
    shared = current.errors.usbl_bias_m > 0  # else there is no bias, whose numbers would mean nothing
    found = [
        NoiseChange(name, number(given), number(current))
        for name, number in numbers.items()
        if (shared or "bias" not in name) and (name != "usbl_outlier_share" or isinstance(given.usbl, Contamination))
    ]
    return tuple(one for one in found if one.after != one.before)


def _correlation_models(current: Parameters, given: Parameters, sd_m: float) -> list[_NoiseModel]:
    """Return candidates for the correlation of fixes, with reliable and unreliable stamps."""
    trusted_s = given.errors.latency_s
    stamps_s = (trusted_s, max(trusted_s, UNTRUSTED_LATENCY_SD_S))
    return [
        _NoiseModel(
            _with_correlation(current, given, sd_m, share, latency_s), int(share > 0) + int(latency_s > trusted_s)
        )
        for share, latency_s in itertools.product(CORRELATED_VARIANCE_SHARES, stamps_s)
    ]


def _noise_models(current: Parameters, given: Parameters, sd_m: float) -> list[_NoiseModel]:
    """Return candidates for the time constant of fixes, the share of outliers and the random walk of dead reckoning."""
    found: list[_NoiseModel] = []
    stories = [(further, 1.0) for further in DR_WALK_FACTORS] + [(1.0, wider) for wider in USBL_SD_FACTORS]
    for longer, more, (further, wider) in itertools.product(BIAS_TIME_FACTORS, OUTLIER_SHARE_FACTORS, stories):
        choice = replace(
            current,
            errors=replace(current.errors, usbl_bias_s=longer * given.errors.usbl_bias_s),
            process=replace(current.process, position_m=further * given.process.position_m),
            usbl_sd_scale=wider * current.usbl_sd_scale,
        )
        if more != 1:
            if not isinstance(given.usbl, Contamination) or more * given.usbl.share > MAX_OUTLIER_SHARE:
                continue
            choice = replace(choice, usbl=replace(given.usbl, share=more * given.usbl.share))
        changes = sum(factor != 1 for factor in (longer, more, further, wider))
        found.append(_NoiseModel(choice, changes, further != 1, wider != 1))
    return found


def _with_correlation(
    current: Parameters, given: Parameters, sd_m: float, share: float, latency_s: float
) -> Parameters:
    """Return assumptions in which fixes have this share of their variance in common."""
    total = given.usbl_sd_scale
    return replace(
        current,
        errors=replace(current.errors, latency_s=latency_s, usbl_bias_m=math.sqrt(share) * total * sd_m),
        usbl_sd_scale=total * math.sqrt(1 - share),
    )
