"""Which errors of its sensors a log can tell: those whose sigma its readings narrow down. The truth has no part in it.

One pass over the fixes (fix_noise.py) with all states tells how far each is narrowed; what stays as wide as it was
assumed is left out. The same pass settles by the predictive likelihood of the readings what a sigma cannot tell: the
sigma that is stated of the fixes is taken for their whole error, and the share of it that neighbouring fixes have in
common is chosen; and whether their stamps may be trusted to the third of a second or not.

R. Kass and A. Raftery, "Bayes factors", J. American Statistical Association 90(430), 1995, doi:10.2307/2291091, call
20 strong. Misalignment of the DVL is left to the user: on the track it does what a bias of the heading does.
"""

import itertools
import math
from dataclasses import replace

import numpy as np

from usbldr.filters.assumptions import Assumptions, Observed
from usbldr.filters.calibration import NARROWED, STATES, prior_sd
from usbldr.filters.fix_noise import fix_likelihoods, fix_log
from usbldr.filters.types import Timeline

ROUNDS = 2  # of linearising the latency
CANDIDATES = ("scale", "heading", "deviation", "latency", "usbl-bias")
WIDE_LATENCY_S = 1.0  # of stamps that are not to be trusted
STRONG = math.log(20)  # the Bayes factor that it takes to say so of stamps
SHARED = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95)  # of the fixes' variance; the middle serves as reference
TURNING = ("deviation", "latency")  # what a straight track at constant speed cannot tell
LEAST_TURN_RAD = math.radians(45)


def observe(timeline: Timeline, assumptions: Assumptions) -> Assumptions:
    """Return the assumptions with the states that the log can tell.

    Their field ``observed`` says how far each was narrowed. A log without fixes tells nothing.
    """
    if not len(timeline.fix_time_s):
        nothing = tuple(Observed(key, 1.0, "not observable") for key in CANDIDATES)
        return replace(assumptions, calibrate=(), observed=nothing)
    every = replace(assumptions, calibrate=CANDIDATES)
    latencies_s = (assumptions.errors.latency_s, max(assumptions.errors.latency_s, WIDE_LATENCY_S))
    sd_m = float(np.sqrt(np.median(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)))
    members = [_shared(every, sd_m, *choice) for choice in itertools.product(SHARED, latencies_s)]
    middle = members[len(members) // 2]
    latency_s = 0.0
    for _ in range(ROUNDS - 1):
        latency_s = fix_likelihoods(fix_log(timeline, middle, latency_s), [middle]).latency_s
    found = fix_likelihoods(fix_log(timeline, middle, latency_s), members)
    doubt = np.array([STRONG * (member.errors.latency_s > latencies_s[0]) for member in members])
    best = int(np.argmax(found.log_likelihood - doubt))
    settled, before = members[best], prior_sd(members[best].errors)
    straight = float(np.ptp(timeline.dr_yaw_rad)) < LEAST_TURN_RAD
    observed: list[Observed] = []
    for key in CANDIDATES:
        narrowed = min(float(found.sd[name][best]) / before[name] if before[name] else 1.0 for name in STATES[key])
        seen = settled.errors.usbl_bias_m > 0 if key == "usbl-bias" else narrowed < NARROWED
        hidden = "only in turns" if straight and key in TURNING else "not observable"
        observed.append(Observed(key, narrowed, "observable" if seen else hidden))
    kept = tuple(told.key for told in observed if told.verdict == "observable")
    return replace(settled, calibrate=kept, observed=tuple(observed))


def _shared(assumptions: Assumptions, sd_m: float, share: float, latency_s: float) -> Assumptions:
    """Return assumptions under which the fixes share so much of the variance of their error."""
    errors = assumptions.errors
    total = assumptions.usbl_sd_scale
    return replace(
        assumptions,
        errors=replace(errors, latency_s=latency_s, usbl_bias_m=math.sqrt(share) * total * sd_m),
        usbl_sd_scale=total * math.sqrt(1 - share),
    )
