"""Predictive likelihood of each USBL fix, given the fixes before it and dead reckoning.

The state is the error of dead reckoning (east, north, metres) and the sensor errors of PASS_STATES, which are constant
but for the correlated error of the fixes. A step goes from fix to fix. Dead reckoning is the filters' motion model
driven by DVL and compass instead of corrected by them: what its records leave open is a random walk of the position,
and the effect of an error on a fix is the derivative of the displacement since the start. Members of a bank, each with
noise and sensor errors of its own, pass over the log at once.

How an error moves a fix is linear about a point of each member (linearisation.py).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.identification import clusters
from usbldr.filters.identification.compiled_fixes import CompiledFixes
from usbldr.filters.identification.drift import drift_variances_m2, has_dead_reckoning
from usbldr.filters.identification.linearisation import (
    BIAS_STATES,
    CURRENT_STATES,
    HEAD,
    KEYS,
    NO_ERROR,
    OFFSET_STATES,
    PASS_STATES,
    RANGE,
    Linearised,
    Point,
    linearised,
    near,
    prior_sds,
)
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.dead_reckoning import start_position, start_sensitivity
from usbldr.filters.replay.prior import starting_fixes
from usbldr.filters.types import Array, Indices, Timeline, Vector

MAX_FIXES = 3600  # an hour at 1 Hz, enough to identify noise and sensor errors
HEAD_ROWS = [PASS_STATES.index(name) for key in (HEAD, RANGE) for name in KEYS[key]]
BOTH_AXES = slice(0, 2)  # east and north of a fix


class Member(NamedTuple):
    """One explanation of the fixes: noise, the sensor errors that exist, and the values to linearise about."""

    parameters: Parameters
    present: frozenset[str]  # keys of KEYS
    about: Point = NO_ERROR

    def with_errors(self, present: frozenset[str], value: Mapping[str, float]) -> "Member":
        """Return the member with these errors, linearised about the values of those of them that are not linear."""
        states = {name for key in present for name in KEYS[key]}
        return self._replace(present=present, about=near({name: v for name, v in value.items() if name in states}))


class FixLikelihoods(NamedTuple):
    """The result of a pass over the fixes, for N members."""

    log_likelihood: Vector  # (N,) predictive, of all fixes
    mean: Mapping[str, Vector]  # (N,) of each state after the last fix
    sd: Mapping[str, Vector]  # (N,)


def fix_likelihoods(timeline: Timeline, members: Sequence[Member]) -> FixLikelihoods:
    """Run adf over the first MAX_FIXES fixes for each member."""
    about = sorted({member.about for member in members})
    logs = [linearised(timeline, members[0].parameters, MAX_FIXES, point) for point in about]
    mean, cov = _start(timeline, members, logs[0])
    rows = np.flatnonzero(np.einsum("iim->im", cov).any(axis=1) | np.isin(PASS_STATES, OFFSET_STATES))
    used = [PASS_STATES[row] for row in rows]
    measured = _Fixes(
        np.stack([log.residual_m for log in logs], axis=2),
        np.ascontiguousarray(np.stack([log.measurement_matrix[:, :, rows] for log in logs], axis=3)),
        np.array([about.index(member.about) for member in members]),
    )
    time_s = timeline.fix_time_s[:MAX_FIXES]
    motion = _motion(timeline, members, slice(used.index(BIAS_STATES[0]), used.index(BIAS_STATES[-1]) + 1))
    noise = [
        BankNoise([m.parameters.usbl for m in members] * n, [m.parameters.usbl_sd_scale for m in members] * n)
        for n in (1, 2)
    ]
    dt_s = np.diff(time_s, prepend=0.0)
    counted = has_dead_reckoning(timeline, time_s)
    N, total = len(members), np.zeros(len(members))
    bank = GaussianBank(mean[rows], cov[np.ix_(rows, rows)], np.zeros(N))
    cov_m2, taken = np.ascontiguousarray(timeline.fix_cov_m2[:MAX_FIXES]), 0
    arrays = (measured.residual_m, measured.measurement_matrix, measured.group, motion.bias.start, motion.changes)
    kernel = CompiledFixes(*arrays, noise[0], cov_m2, counted)
    for f, R in enumerate(cov_m2):
        if f < taken:
            continue
        if kernel.usable and len(bank.log_weight) == N:
            bank, log_l, taken = kernel.until_far(bank, f)
            total += log_l
            if f < taken:
                continue
        bank = motion.predicted(bank, f)
        modes, doubled = noise[0].modes(R), len(bank.log_weight) > N
        projection = None if doubled else measured.projection(bank, f, BOTH_AXES)
        if projection is None or clusters.far(projection, modes.cov[0]):
            bank = clusters.mixed(bank if doubled else clusters.both_hypotheses(bank), dt_s[f])
            modes, doubled, projection = noise[1].modes(R), True, None
        for axes in modes.blocks():
            if kernel.usable:
                bank, log_l = kernel.updated(bank, f, axes)
            else:
                if projection is None or axes != BOTH_AXES:
                    projection = measured.projection(bank, f, axes)
                bank, log_l, *_ = collapse(bank, projection, modes.block(axes))
            if doubled:
                bank, log_l = clusters.reweighted(bank, log_l)
            total += counted[f] * log_l
        if doubled and clusters.negligible(bank):
            bank = clusters.members(bank)
    bank = clusters.members(bank) if len(bank.log_weight) > N else bank
    after = np.zeros((2, len(PASS_STATES), N))
    after[0, rows] = bank.mean
    after[1, rows] = np.sqrt(np.maximum(np.einsum("iim->im", bank.cov), 0.0))
    heading, scale = HEAD_ROWS  # the pass found one factor, (1 + scale) exp(i heading), by its real and imaginary part
    factor = 1 + after[0, scale] + 1j * after[0, heading]
    after[0, heading], after[0, scale] = np.angle(factor), np.abs(factor) - 1
    return FixLikelihoods(total, *(dict(zip(PASS_STATES, each, strict=True)) for each in after))


@dataclass(frozen=True, slots=True)
class _Fixes:
    """F fixes minus dead reckoning, for N members that share G linearisations."""

    residual_m: Array  # (F, 2, G)
    measurement_matrix: Array  # (F, 2, n, G)
    group: Indices  # (N,) linearisation of each member

    def projection(self, bank: GaussianBank, f: int, axes: slice) -> Projection:
        """Return these axes of a fix as the N members, or their 2 N hypotheses, predict it."""
        group = self.group if len(bank.log_weight) == len(self.group) else np.tile(self.group, 2)
        h = self.measurement_matrix[f, axes][:, :, group]
        cross = np.einsum("ijm,ajm->iam", bank.cov, h)
        innovation = self.residual_m[f, axes][:, group] - np.einsum("aim,im->am", h, bank.mean)
        return Projection(innovation, np.einsum("aim,ibm->abm", h, cross), cross)


@dataclass(frozen=True, slots=True)
class _Motion:
    """What changes from fix to fix for N members: the correlated error decays, dead reckoning drifts."""

    bias: slice  # rows of the correlated error
    changes: Array  # (3, F, N) decay of the correlated error, then the variances added to it and to the position

    def predicted(self, bank: GaussianBank, f: int) -> GaussianBank:
        """Return the bank of N members, or of their 2 N hypotheses, at fix f."""
        times = len(bank.log_weight) // self.changes.shape[2]
        fade, bias_m2, drift_m2 = np.concatenate([self.changes[:, f]] * times, axis=1)
        mean, cov = bank.mean.copy(), bank.cov.copy()
        mean[self.bias] *= fade
        cov[self.bias] *= fade
        cov[:, self.bias] *= fade
        for rows, added in ((range(2), drift_m2), (range(self.bias.start, self.bias.stop), bias_m2)):
            cov[rows, rows] += added
        return bank._replace(mean=mean, cov=cov)


def _motion(timeline: Timeline, members: Sequence[Member], bias: slice) -> _Motion:
    every, time_s = [member.parameters for member in members], timeline.fix_time_s[:MAX_FIXES]
    dt_s = np.maximum(np.diff(time_s, prepend=0.0), 0.0)[:, None]
    fade = np.exp(-dt_s / np.array([p.errors.usbl_bias_s for p in every]))
    bias_m2 = (1 - fade**2) * np.array([p.errors.usbl_bias_m for p in every]) ** 2
    scaled = ["scale" in member.present for member in members]
    return _Motion(bias, np.stack([fade, bias_m2, drift_variances_m2(timeline, time_s, every, scaled)]))


def _start(timeline: Timeline, members: Sequence[Member], log: Linearised) -> tuple[Array, Array]:
    """Return mean (n, N) and covariance (n, n, N) at the first epoch: as in prior.py, without the motion states."""
    first, time_s = members[0].parameters, np.zeros(1)
    carried = np.zeros((2, len(PASS_STATES)))
    if first.start is not None:
        position, sd_m = np.array([first.start.east_m, first.start.north_m]), first.start.sd_m
    else:
        own = np.ones(len(timeline.fix_m), dtype=np.bool_) if timeline.fix_is_gps is None else ~timeline.fix_is_gps
        fixes = starting_fixes(timeline.with_fixes(own), first)
        time_s = fixes.time_s
        position, sd_m = start_position(timeline, time_s, fixes.position_m)
        carried = start_sensitivity(timeline, time_s, PASS_STATES, fixes.sensor == "usbl")
        if fixes.sensor == "usbl":  # which an error of their head has moved
            carried[:, HEAD_ROWS] -= log.measurement_matrix[own[: len(log.residual_m)]][:5, :, HEAD_ROWS].mean(axis=0)
    walked_m2 = max(0.0, float(time_s[0])) * np.array([m.parameters.process.position_m**2 for m in members])
    sd = np.zeros((len(PASS_STATES), len(members)))
    sd[:2] = np.sqrt(sd_m**2 + walked_m2)
    for column, member in enumerate(members):
        known = prior_sds(member.parameters)
        always = BIAS_STATES + (CURRENT_STATES if first.water_track else ())
        for name in (*always, *(name for key in member.present for name in KEYS[key])):
            sd[PASS_STATES.index(name), column] = known[name]
    T = np.eye(len(PASS_STATES))
    T[:2] += carried
    mean = np.zeros_like(sd)
    mean[:2] = position[:, None]
    return mean, np.einsum("ik,km,jk->ijm", T, sd**2, T)
