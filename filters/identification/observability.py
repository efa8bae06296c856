"""Which errors of its sensors a log can tell: those whose sigma its readings narrow down. The truth has no part in it.

One pass over the fixes (usbl_likelihood.py) with all states tells how far each is narrowed; what stays as wide as it
was assumed is left out. The predictive likelihood of the readings settles what a sigma cannot tell: what share of their
stated variance neighbouring fixes have in common, for how long they err alike, how many are outliers, whether their
stamps may be trusted to the third of a second, and whether dead reckoning reckons at all: without bottom lock, or with
the wrong mounting or heading, it does not, and a filter that trusts it takes the fixes for outliers. Before all that
the DVL is heard for itself (dvl_likelihood.py): how much its records scatter, and how fast the vehicle changes its
velocity. Each stays as assumed unless the log speaks strongly against it.

R. Kass and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.2307/2291091, call
20 strong. Misalignment of the DVL is left to the user: on the track it does what a bias of the heading does.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.dvl_likelihood import velocity_likelihoods
from usbldr.filters.identification.tuning import hear
from usbldr.filters.identification.usbl_likelihood import fix_likelihoods, fix_log
from usbldr.filters.models.calibration import NARROWED, STATES, prior_sd
from usbldr.filters.models.noise import Contamination
from usbldr.filters.models.parameters import DRIFT, Assumptions, Observed, Settled
from usbldr.filters.types import Timeline, Vector

CANDIDATES = ("scale", "heading", "deviation", "latency", "usbl-bias")
WIDE_LATENCY_S = 1.0  # of stamps that are not to be trusted
STRONG = math.log(20)  # the Bayes factor that it takes to depart from what is assumed
SHARED = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95)  # of the fixes' variance; the middle serves as reference
LONGER = (0.5, 1.0, 2.0, 4.0)  # times as long as assumed do fixes err alike
MORE_OUTLIERS = (0.5, 1.0, 2.0, 4.0, 8.0)  # times as many as assumed
FURTHER = (1.0, 25.0, 125.0)  # times as far as assumed does dead reckoning walk; coarse, as it is for those that fail
WIDER = (2.0, 4.0)  # times the stated sigma of fixes: scatter that dead reckoning is not to be blamed for
MOST_OUTLIERS = 0.5  # of the fixes
TURNING = ("deviation", "latency")  # what a straight track at constant speed cannot tell
LEAST_TURN_RAD = math.radians(45)


class _Choice(NamedTuple):
    """One way to see the log's noise."""

    assumptions: Assumptions
    departs: int = 0  # in so many things from what is assumed
    drifts: bool = False  # dead reckoning walks further than assumed
    scatters: bool = False  # fixes err more than stated: no choice to be made, but a better story than drift


def observe(timeline: Timeline, assumptions: Assumptions) -> Assumptions:
    """Return the assumptions with the states that the log can tell, and with the noise that it speaks strongly for.

    Their field ``observed`` says how far each state was narrowed, ``settled`` which numbers of the noise are other than
    assumed. A log without fixes tells no state. Raises LogError where nothing tells where it starts.
    """
    heard = _heard(timeline, assumptions)
    if not len(timeline.fix_time_s):
        nothing = tuple(Observed(key, 1.0, "not observable") for key in CANDIDATES)
        return replace(heard, calibrate=(), observed=nothing, settled=_changed(assumptions, heard))
    every = replace(heard, calibrate=CANDIDATES)
    sd_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    settled = _shared(every, every, sd_m, SHARED[len(SHARED) // 2], every.errors.latency_s)
    latency_s = fix_likelihoods(fix_log(timeline, settled), [settled]).latency_s  # linearised once more about it
    for choices in (_shares, _wanderings, _shares):  # the first choice was made under what the second may have changed
        among = choices(settled, every, sd_m)
        told = fix_likelihoods(fix_log(timeline, settled, latency_s), [choice.assumptions for choice in among])
        best = _best(among, told.log_likelihood)
        settled = among[best].assumptions
    before = prior_sd(settled.errors)
    straight = float(np.ptp(timeline.dr_yaw_rad)) < LEAST_TURN_RAD
    observed: list[Observed] = []
    for key in CANDIDATES:
        narrowed = min(float(told.sd[name][best]) / before[name] if before[name] else 1.0 for name in STATES[key])
        seen = settled.errors.usbl_bias_m > 0 if key == "usbl-bias" else narrowed < NARROWED
        hidden = "only in turns" if straight and key in TURNING else "not observable"
        observed.append(Observed(key, narrowed, "observable" if seen else hidden))
    kept = tuple(told.key for told in observed if told.verdict == "observable")
    return replace(settled, calibrate=kept, observed=tuple(observed), settled=_changed(assumptions, settled))


def _heard(timeline: Timeline, given: Assumptions) -> Assumptions:
    """Return the assumptions with the noise that the DVL's records tell of themselves, where they speak strongly."""
    tuned = hear(timeline, given).assumptions
    told = replace(tuned, tuned=given.tuned)
    departs = sum(one.told for one in tuned.tuned)
    before, after = velocity_likelihoods(timeline, [given, told])
    return told if after - before > STRONG * departs else given


def _best(among: Sequence[_Choice], log_likelihood: Vector) -> int:
    """Return which choice the log speaks for; drift is none where it speaks strongly for wider fixes instead."""
    spoken = log_likelihood - STRONG * np.array([choice.departs for choice in among])
    drifts, scatters = (np.array([getattr(choice, name) for choice in among]) for name in ("drifts", "scatters"))
    if spoken[scatters].max(initial=-np.inf) > spoken[drifts].max(initial=-np.inf) + STRONG:
        spoken[drifts] = -np.inf
    spoken[scatters] = -np.inf
    return int(np.argmax(spoken))


def _changed(given: Assumptions, settled: Assumptions) -> tuple[Settled, ...]:
    """Tell which numbers of the noise are no longer as they were."""
    numbers = {
        "dvl_sd_scale": attrgetter("dvl_sd_scale"),
        "velocity_walk_mps": attrgetter("process.velocity_mps"),
        "usbl_sd_scale": attrgetter("usbl_sd_scale"),
        "usbl_bias_sd_m": attrgetter("errors.usbl_bias_m"),
        "usbl_bias_time_s": attrgetter("errors.usbl_bias_s"),
        "usbl_outlier_share": attrgetter("usbl.share"),
        "usbl_latency_sd_s": attrgetter("errors.latency_s"),
        DRIFT: attrgetter("process.position_m"),
    }
    shared = settled.errors.usbl_bias_m > 0  # else there is no bias, whose numbers would mean nothing
    found = [
        Settled(name, number(given), number(settled))
        for name, number in numbers.items()
        if (shared or "bias" not in name) and (name != "usbl_outlier_share" or isinstance(given.usbl, Contamination))
    ]
    return tuple(one for one in found if one.after != one.before)


def _shares(settled: Assumptions, given: Assumptions, sd_m: float) -> list[_Choice]:
    """Return what may be common to neighbouring fixes, under stamps to be trusted or not."""
    trusted_s = given.errors.latency_s
    stamps_s = (trusted_s, max(trusted_s, WIDE_LATENCY_S))
    return [
        _Choice(_shared(settled, given, sd_m, share, latency_s), int(share > 0) + int(latency_s > trusted_s))
        for share, latency_s in itertools.product(SHARED, stamps_s)
    ]


def _wanderings(settled: Assumptions, given: Assumptions, sd_m: float) -> list[_Choice]:
    """Return for how long fixes may err alike, how many may be outliers, and how far dead reckoning may walk."""
    found: list[_Choice] = []
    stories = [(further, 1.0) for further in FURTHER] + [(1.0, wider) for wider in WIDER]
    for longer, more, (further, wider) in itertools.product(LONGER, MORE_OUTLIERS, stories):
        choice = replace(
            settled,
            errors=replace(settled.errors, usbl_bias_s=longer * given.errors.usbl_bias_s),
            process=replace(settled.process, position_m=further * given.process.position_m),
            usbl_sd_scale=wider * settled.usbl_sd_scale,
        )
        if more != 1:
            if not isinstance(given.usbl, Contamination) or more * given.usbl.share > MOST_OUTLIERS:
                continue
            choice = replace(choice, usbl=replace(given.usbl, share=more * given.usbl.share))
        departs = sum(factor != 1 for factor in (longer, more, further, wider))
        found.append(_Choice(choice, departs, further != 1, wider != 1))
    return found


def _shared(settled: Assumptions, given: Assumptions, sd_m: float, share: float, latency_s: float) -> Assumptions:
    """Return assumptions under which the fixes share so much of the variance of their error."""
    total = given.usbl_sd_scale
    return replace(
        settled,
        errors=replace(settled.errors, latency_s=latency_s, usbl_bias_m=math.sqrt(share) * total * sd_m),
        usbl_sd_scale=total * math.sqrt(1 - share),
    )
