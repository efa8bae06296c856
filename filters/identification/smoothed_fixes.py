"""Find whether software smoothed the USBL fixes, so that they lag behind the vehicle: as a mean of the last ones, or by
a filter that knows a velocity, too.

Fixes before they were smoothed are as likely as usual fixes, by the volume that smoothing takes from both axes. P.
Kalata, "The tracking index: a generalized parameter for alpha-beta and alpha-beta-gamma target trackers", IEEE Trans.
Aerospace and Electronic Systems AES-20(2), 1984, doi:10.1109/TAES.1984.310438, gives the shares of a Kalman filter.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.dr_usbl_fit import gross
from usbldr.filters.identification.identification import CONTRADICTED
from usbldr.filters.identification.linearisation import (
    COMPASS_CLOCK,
    DVL_CLOCK,
    LEVER,
    STEPS,
    has_dead_reckoning,
    keys_of,
)
from usbldr.filters.identification.usbl_likelihood import MAX_FIXES, Member, fix_likelihoods
from usbldr.filters.models.parameters import NOT_SMOOTHED, Parameters, Smoothing
from usbldr.filters.replay.dead_reckoning import without_smoothing
from usbldr.filters.types import Timeline

LAGS = 0.25, 0.5, 1.0, 2.0, 4.0, 8.0  # [fixes] tried first: with 8, fixes follow a manoeuvre after half a minute
MOST_FIXES = 17  # of a mean with equal weights: its lag is 8 fixes
FINER = 4  # [-] times is the best lag searched in steps of a third of those before: to 1 %
ROUNDS = 2  # of noise and lag in turn: in a transit each takes off most of what is left of the error
SD_SCALES = 0.25, 1.0, 4.0  # [-] on stated sigmas of the fixes, which may be wrong


class _Likeliest(NamedTuple):
    """The likeliest smoothing of a kind."""

    log_likelihood: float
    lag: float  # [fixes]
    kind: Callable[[float], Smoothing]

    @property
    def smoothing(self) -> Smoothing:
        """The gains; none if nothing lags."""
        return self.kind(self.lag) if self.lag else NOT_SMOOTHED


def likeliest_smoothing(
    timeline: Timeline, stated: Parameters, fitted: Callable[[Timeline], Sequence[Member]]
) -> Smoothing:
    """Return the likeliest smoothing of the fixes, perhaps none.

    It is sought by the stated noise with each of SD_SCALES, then by that of the members ``fitted`` to the fixes before
    they were smoothed.
    """
    timeline = timeline.with_fixes(np.arange(min(len(timeline.fix_time_s), MAX_FIXES)))
    present = frozenset(keys_of(timeline, stated)) - {COMPASS_CLOCK}
    scaled = [replace(stated, usbl_sd_scale=scale * stated.usbl_sd_scale) for scale in SD_SCALES]
    members = [Member(parameters, present) for parameters in scaled]
    possible = [_likeliest(timeline, members, kind) for kind in (weighted_mean, by_kalman, mean_of_last)]
    most_walk_m = CONTRADICTED * stated.process.position_m
    for _ in range(ROUNDS):
        possible = [_refined(timeline, fitted, found, most_walk_m) for found in possible if found.lag]
    lagging = [one for one in possible if one.lag]
    return max(lagging, key=lambda one: one.log_likelihood).smoothing if lagging else NOT_SMOOTHED


def _refined(
    timeline: Timeline, fitted: Callable[[Timeline], Sequence[Member]], found: _Likeliest, most_walk_m: float
) -> _Likeliest:
    """Return the likeliest smoothing of the same kind by members fitted to the fixes before they were smoothed.

    If these fixes contradict dead reckoning, nothing shows a lag: a filter's velocity explains any vehicle.
    """
    before = without_smoothing(timeline, found.smoothing)
    members = fitted(before.with_fixes(~gross(before)))
    sound = [_in_time(one) for one in members if one.parameters.process.position_m <= most_walk_m]
    return _likeliest(timeline, sound, found.kind) if sound else found._replace(lag=0.0)


def _in_time(member: Member) -> Member:
    """Return the member without errors that look like a lag: evidence for them is sought afterwards."""
    return member.with_errors(
        member.present - {"latency", DVL_CLOCK, LEVER}, dict(zip(STEPS, member.about, strict=True))
    )


def weighted_mean(lag: float) -> Smoothing:
    """Return the smoothing by a weighted mean that lags behind by so many fixes."""
    return Smoothing(1 / (1 + lag))


def mean_of_last(lag: float) -> Smoothing:
    """Return the smoothing by a mean of the last fixes, with equal weights, that lags behind by half their number."""
    last = round(1 + 2 * lag)
    return Smoothing(1 / last, last=last)


def by_kalman(lag: float) -> Smoothing:
    """Return the smoothing by a Kalman filter of position and velocity whose position takes as much of a fix."""
    alpha = 1 / (1 + lag)
    return Smoothing(alpha, 2 * (2 - alpha) - 4 * math.sqrt(1 - alpha))


def _likeliest(timeline: Timeline, members: Sequence[Member], kind: Callable[[float], Smoothing]) -> _Likeliest:
    """Return the likeliest smoothing of a kind by the likeliest of some members."""

    def log_likelihood(lag: float) -> float:
        smoothing = _Likeliest(0.0, lag, kind).smoothing
        found = fix_likelihoods(without_smoothing(timeline, smoothing), members).log_likelihood
        return float(found.max()) + log_density(timeline, smoothing)

    equal = kind is mean_of_last
    tried = (np.arange(1, MOST_FIXES) / 2).tolist() if equal else LAGS
    value = {lag: log_likelihood(lag) for lag in (0.0, *tried)}
    best, step = max(value, key=value.__getitem__), LAGS[1] / LAGS[0]
    for _ in range(FINER if best and not equal else 0):
        step **= 1 / 3
        value |= {lag: log_likelihood(lag) for lag in (best * step**n for n in (-2, -1, 1, 2))}
        best = max(value, key=value.__getitem__)
    return _Likeliest(value[best], best, kind)


def log_density(timeline: Timeline, smoothing: Smoothing) -> float:
    """Return the logarithm of the volume of the fixes before they were smoothed, per volume of those recorded."""
    counted = has_dead_reckoning(timeline, timeline.fix_time_s[:MAX_FIXES])
    return -2 * math.log(smoothing.position) * int(np.count_nonzero(counted))
