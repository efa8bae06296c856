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
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.identification import clusters
from usbldr.filters.identification.linearisation import (
    BIAS_STATES,
    CURRENT_STATES,
    HEAD,
    KEYS,
    NO_ERROR,
    OF_HEAD,
    OFFSET_STATES,
    PASS_STATES,
    RANGE,
    STEPS,
    Linearised,
    Point,
    drift_variances_m2,
    has_dead_reckoning,
    linearised,
    near,
    prior_sds,
)
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.noise import BankNoise, Noise
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.dead_reckoning import START_FIXES, freed, start_position, start_sensitivity
from usbldr.filters.replay.prior import starting_fixes
from usbldr.filters.types import Array, Indices, Mask, Timeline, Vector

MAX_FIXES = 3600  # an hour at 1 Hz, enough to identify noise and sensor errors
kept_linearised = lru_cache(maxsize=32)(linearised)  # members in turn share points; each takes 1.5 MB at most
HEAD_ROWS = [PASS_STATES.index(name) for key in (HEAD, RANGE) for name in KEYS[key]]
OF_HEAD_ROWS = [PASS_STATES.index(name) for name in OF_HEAD]
PASS = KERNEL.packer("Pass")
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
    cov: Array  # (n, n, N) of PASS_STATES


def fix_likelihoods(timeline: Timeline, members: Sequence[Member]) -> FixLikelihoods:
    """Run adf over the first MAX_FIXES fixes for each member."""
    about = sorted({member.about for member in members})
    logs = [kept_linearised(timeline, members[0].parameters.usbl_from_dvl_m, MAX_FIXES, point) for point in about]
    rows_about = np.array([about.index(member.about) for member in members])
    turned_rad = np.array([dict(zip(STEPS, point, strict=True))["usbl_heading"] for point in about])
    mean, cov = _start(timeline, members, logs, turned_rad, rows_about)
    rows = np.flatnonzero(np.einsum("iim->im", cov).any(axis=1) | np.isin(PASS_STATES, OFFSET_STATES))
    used = [PASS_STATES[row] for row in rows]
    time_s = timeline.fix_time_s[:MAX_FIXES]
    bias = slice(used.index(BIAS_STATES[0]), used.index(BIAS_STATES[-1]) + 1)
    fixes = FixPass(
        np.stack([log.residual_m for log in logs], axis=2),
        np.ascontiguousarray(np.stack([log.measurement_matrix[:, :, rows] for log in logs], axis=3)),
        rows_about,
        bias,
        _changes(timeline, members),
        BankNoise([m.parameters.usbl for m in members], [m.parameters.usbl_sd_scale for m in members]),
        timeline.fix_cov_m2[:MAX_FIXES],
        has_dead_reckoning(timeline, time_s),
        np.diff(time_s, prepend=0.0),
    )
    bank, total = passed(fixes, GaussianBank(mean[rows], cov[np.ix_(rows, rows)], np.zeros(len(members))))
    after, after_cov = np.zeros((2, len(PASS_STATES), len(members))), np.zeros_like(cov)
    after[0, rows] = bank.mean
    after_cov[np.ix_(rows, rows)] = bank.cov
    after[1] = np.sqrt(np.maximum(np.einsum("iim->im", after_cov), 0.0))
    # beyond the point the pass found one factor, (1 + scale) exp(i heading), by its real and imaginary part
    (heading, scale), there_rad = HEAD_ROWS, turned_rad[rows_about]
    factor = 1 + after[0, scale] + 1j * (after[0, heading] - there_rad)
    after[0, heading], after[0, scale] = there_rad + np.angle(factor), np.abs(factor) - 1
    of_states, sd = (dict(zip(PASS_STATES, each, strict=True)) for each in after)
    return FixLikelihoods(total, of_states, sd, after_cov)


def _changes(timeline: Timeline, members: Sequence[Member]) -> Array:
    """Return the changes of a FixPass, (3, F, N)."""
    every, time_s = [member.parameters for member in members], timeline.fix_time_s[:MAX_FIXES]
    dt_s = np.maximum(np.diff(time_s, prepend=0.0), 0.0)[:, None]
    fade = np.exp(-dt_s / np.array([p.errors.usbl_bias_s for p in every]))
    bias_m2 = (1 - fade**2) * np.array([p.errors.usbl_bias_m for p in every]) ** 2
    scaled = ["scale" in member.present for member in members]
    return np.stack([fade, bias_m2, drift_variances_m2(timeline, time_s, every, scaled)])


def _start(
    timeline: Timeline, members: Sequence[Member], logs: Sequence[Linearised], turned_rad: Vector, about: Indices
) -> tuple[Array, Array]:
    """Return mean (n, N) and covariance (n, n, N) at the first epoch: as in prior.py, without the motion states.

    ``turned_rad`` (P,) is the heading error of the USBL head at the points of P logs, ``about`` (N,) the log of each
    member. Errors of the head move the first fixes.
    """
    first, time_s = members[0].parameters, np.zeros(1)
    T = np.tile(np.eye(len(PASS_STATES)), (len(logs), 1, 1))
    if first.start is not None:
        sd_m, position = first.start.sd_m, np.array([[first.start.east_m, first.start.north_m]])
    else:
        own = np.ones(len(timeline.fix_m), dtype=np.bool_) if timeline.fix_is_gps is None else ~timeline.fix_is_gps
        fixes = starting_fixes(timeline.with_fixes(own), first)
        time_s = fixes.time_s
        position_m, sd_m = start_position(timeline, time_s, fixes.position_m)
        position = np.tile(position_m, (len(logs), 1))
        T[:, :2] += start_sensitivity(timeline, time_s, PASS_STATES, fixes.sensor == "usbl")
        for k, log in enumerate(logs if fixes.sensor == "usbl" else ()):
            rows = np.flatnonzero(own[: len(log.residual_m)])[:START_FIXES]
            moved = log.measurement_matrix[rows][:, :, OF_HEAD_ROWS].mean(axis=0)
            T[k, :2, OF_HEAD_ROWS] -= moved.T
            if turned_rad[k]:  # not linear so far from the point
                begin = timeline.with_fixes(rows)
                apart_m = freed(begin, {"usbl_heading": float(turned_rad[k])}).fix_m - begin.fix_m
                position[k] += apart_m.mean(axis=0) + moved[:, 0] * turned_rad[k]
    walked_m2 = max(0.0, float(time_s[0])) * np.array([m.parameters.process.position_m**2 for m in members])
    sd = np.zeros((len(PASS_STATES), len(members)))
    sd[:2] = np.sqrt(sd_m**2 + walked_m2)
    for column, member in enumerate(members):
        known = prior_sds(member.parameters)
        always = BIAS_STATES + (CURRENT_STATES if first.water_track else ())
        for name in (*always, *(name for key in member.present for name in KEYS[key])):
            sd[PASS_STATES.index(name), column] = known[name]
    mean = np.zeros_like(sd)
    mean[:2] = np.broadcast_to(position, (len(logs), 2))[about].T
    return mean, np.einsum("mik,km,mjk->ijm", T[about], sd**2, T[about])


@dataclass(frozen=True, slots=True)
class FixPass:
    """F fixes minus dead reckoning, linear in n states, for N members that share G linearisations.

    Between fixes the correlated error decays and dead reckoning drifts. Metres and seconds.
    """

    residual_m: Array  # (F, 2, G)
    measurement_matrix: Array  # (F, 2, n, G)
    group: Indices  # (N,) linearisation of each member
    bias: slice  # rows of the correlated error
    changes: Array  # (3, F, N) decay of the correlated error, then the variances added to it and to the position
    noise: BankNoise
    cov_m2: Array  # (F, 2, 2) stated
    counted: Mask  # (F,) whether the likelihood of a fix counts
    dt_s: Vector  # (F,) since the fix before

    def over(self, bank: GaussianBank) -> tuple[GaussianBank, Vector]:
        """Return the bank after all fixes, and the log likelihood that each of the N members gives them."""
        N, total = len(self.group), np.zeros(len(self.group))
        begins, ends = clusters.switching(self.dt_s)
        for f, R in enumerate(self.cov_m2):
            bank = self._predicted(bank, f)
            modes, doubled = self.noise.modes(R), len(bank.log_weight) > N
            if doubled or clusters.far(self._projection(bank, f, BOTH_AXES), modes.cov[0]):
                bank = clusters.mixed(bank if doubled else clusters.both_hypotheses(bank), begins[f], ends[f])
                modes, doubled = Noise(np.tile(modes.probabilities, 2), np.tile(modes.cov, 2), modes.per_scalar), True
            for axes in modes.blocks():
                bank, log_l, *_ = collapse(bank, self._projection(bank, f, axes), modes.block(axes))
                if doubled:
                    bank, log_l = clusters.reweighted(bank, log_l)
                total += self.counted[f] * log_l
            if doubled and clusters.negligible(bank):
                bank = clusters.members(bank)
        return clusters.members(bank) if len(bank.log_weight) > N else bank, total

    def _projection(self, bank: GaussianBank, f: int, axes: slice) -> Projection:
        """Return these axes of a fix as the N members, or their 2 N hypotheses, predict it."""
        group = np.tile(self.group, len(bank.log_weight) // len(self.group))
        h = self.measurement_matrix[f, axes][:, :, group]
        cross = np.einsum("ijm,ajm->iam", bank.cov, h)
        innovation = self.residual_m[f, axes][:, group] - np.einsum("aim,im->am", h, bank.mean)
        return Projection(innovation, np.einsum("aim,ibm->abm", h, cross), cross)

    def _predicted(self, bank: GaussianBank, f: int) -> GaussianBank:
        """Return the bank of N members, or of their 2 N hypotheses, at fix f."""
        fade, bias_m2, drift_m2 = np.tile(self.changes[:, f], len(bank.log_weight) // len(self.group))
        mean, cov = bank.mean.copy(), bank.cov.copy()
        mean[self.bias] *= fade
        cov[self.bias] *= fade
        cov[:, self.bias] *= fade
        for rows, added in ((range(2), drift_m2), (range(self.bias.start, self.bias.stop), bias_m2)):
            cov[rows, rows] += added
        return bank._replace(mean=mean, cov=cov)


def passed(fixes: FixPass, bank: GaussianBank) -> tuple[GaussianBank, Vector]:
    """Return what FixPass.over returns, from the kernel if it runs and has room for so many noise modes and states."""
    F, _, n, G = fixes.measurement_matrix.shape
    noise, limits = fixes.noise, KERNEL.limits
    if KERNEL.run_pass is None or len(noise.probabilities) > limits.modes or n > limits.states:
        return fixes.over(bank)
    sizes = (n, len(fixes.group), F, G, len(noise.probabilities), fixes.bias.start, noise.per_scalar)
    coded = PASS.pack(clusters.FAR, clusters.OFFSET_SD_M**2, np.log(clusters.NEGLIGIBLE), *sizes, 0)
    mean, cov, log_l = bank.mean.copy("C"), bank.cov.copy("C"), np.zeros(len(fixes.group))
    switching = np.column_stack(clusters.switching(fixes.dt_s))
    inputs = (fixes.residual_m, fixes.measurement_matrix, fixes.changes, fixes.group.astype(np.int64))
    tables = (noise.probabilities, noise.gain, noise.offset, fixes.cov_m2, fixes.counted.astype(np.float64), switching)
    arrays = (np.ascontiguousarray(array) for array in (*inputs, *tables))
    KERNEL.run_pass(KERNEL.variant, coded, mean, cov, log_l, *arrays)
    return bank._replace(mean=mean, cov=cov), log_l
