"""Predictive likelihood of each USBL fix, given the fixes before it and dead reckoning.

The state is the error of dead reckoning (east, north, metres) and the sensor errors of PASS_STATES, which are constant
but for the correlated error of the fixes. A step goes from fix to fix. Dead reckoning is the filters' motion model
driven by DVL and compass instead of corrected by them: what its records leave open is a random walk of the position,
and the effect of an error on a fix is the derivative of the displacement since the start. Members of a bank, each with
noise and sensor errors of its own, pass over the log at once.

The position is that of the DVL. A lever arm from the transponder to the DVL moves the fix by -R(psi) arm, which is
linear and free of the noise of the turn rate. A DVL whose stamps are late by c measured v(t + c) at t.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.frames import rotated
from usbldr.filters.identification import clusters
from usbldr.filters.models.calibration import REPORTED_QUANTITIES, STATES, prior_sd
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.quantities import ReportedQuantity
from usbldr.filters.replay.dead_reckoning import (
    displacement_m,
    drift_rates,
    integrate,
    interpolate,
    start_position,
    start_sensitivity,
    velocity_mps,
)
from usbldr.filters.replay.prior import starting_fixes
from usbldr.filters.types import Array, Mask, Timeline, Vector

MAX_FIXES = 3600  # an hour at 1 Hz, enough to identify noise and sensor errors
LEVER, CLOCK = "dvl-lever", "dvl-clock"
UNKNOWN_DIRECTION = 0.5  # fixed: variance of each axis of a unit vector in any direction
CLOCK_STEP_S = 0.5  # of the central difference of the displacement by the clock
KEYS: Mapping[str, tuple[str, ...]] = {
    "scale": STATES["scale"],
    "heading": STATES["heading"],
    "deviation": STATES["deviation"],
    "latency": STATES["latency"],
    LEVER: ("dvl_lever_starboard", "dvl_lever_forward"),
    CLOCK: ("dvl_clock",),
}
"""Sensor errors that a log may have or not, and their states in the pass."""
REPORTED: Mapping[str, ReportedQuantity] = {
    **REPORTED_QUANTITIES,
    "dvl_lever_starboard": ReportedQuantity("dvl_lever_starboard_m", "m", 1.0),
    "dvl_lever_forward": ReportedQuantity("dvl_lever_forward_m", "m", 1.0),
    "dvl_clock": ReportedQuantity("dvl_clock_s", "s", 1.0),
}
BIAS_STATES = STATES["usbl-bias"]
CURRENT_STATES = STATES["current"]
OFFSET_STATES = ("cluster_east", "cluster_north")  # of false fixes in a row, see clusters.py
ERROR_STATES = tuple(name for names in KEYS.values() for name in names)
PASS_STATES = ("x", "y", *BIAS_STATES, *CURRENT_STATES, *ERROR_STATES, *OFFSET_STATES)


class Member(NamedTuple):
    """One explanation of the fixes: noise, the sensor errors that exist, and the values to linearise about."""

    parameters: Parameters
    present: frozenset[str]  # keys of KEYS
    latency_s: float = 0.0
    clock_s: float = 0.0

    def with_errors(self, present: frozenset[str], latency_s: float, clock_s: float) -> "Member":
        """Return the member with these errors, linearised about those of them that are not linear."""
        return self._replace(
            present=present,
            latency_s=latency_s if "latency" in present else 0.0,
            clock_s=clock_s if CLOCK in present else 0.0,
        )


class FixLikelihoods(NamedTuple):
    """The result of a pass over the fixes, for N members."""

    log_likelihood: Vector  # (N,) predictive, of all fixes
    mean: Mapping[str, Vector]  # (N,) of each state after the last fix
    sd: Mapping[str, Vector]  # (N,)


@dataclass(frozen=True, slots=True)
class _Linearised:
    """F fixes minus dead reckoning, linear in n states about a latency and a clock offset."""

    residual_m: Array  # (F, 2) fix minus dead reckoning
    measurement_matrix: Array  # (F, 2, n) H of each fix


def fix_likelihoods(timeline: Timeline, members: Sequence[Member]) -> FixLikelihoods:
    """Run adf over the first MAX_FIXES fixes for each member."""
    about = sorted({(member.latency_s, member.clock_s) for member in members})
    logs = [_linearised(timeline, members[0].parameters, *point) for point in about]
    group = np.array([about.index((member.latency_s, member.clock_s)) for member in members])
    H = np.stack([log.measurement_matrix for log in logs], axis=3)
    z = np.stack([log.residual_m for log in logs], axis=2)
    mean, cov = _start(timeline, members)
    n, N = mean.shape
    bank = clusters.both_hypotheses(mean, cov)
    group = np.tile(group, 2)
    fade, added = (np.tile(each, 2) for each in _between_fixes(timeline, members))
    dt_s = np.diff(timeline.fix_time_s[: len(z)], prepend=0.0)
    noise = BankNoise([m.parameters.usbl for m in members] * 2, [m.parameters.usbl_sd_scale for m in members] * 2)
    counted = _dead_reckoned(timeline)
    total, bias = np.zeros(N), [PASS_STATES.index(name) for name in BIAS_STATES]
    for f in range(len(z)):
        mean, cov = bank.mean.copy(), bank.cov.copy()
        mean[bias] *= fade[f]
        cov[bias] *= fade[f]
        cov[:, bias] *= fade[f]
        cov[range(n), range(n)] += added[f]
        bank = clusters.mixed(bank._replace(mean=mean, cov=cov), dt_s[f])
        modes = noise.modes(timeline.fix_cov_m2[f])
        for axes in modes.blocks():
            h = H[f, axes][:, :, group]
            cross = np.einsum("ijm,ajm->iam", bank.cov, h)
            projection = Projection(
                z[f, axes][:, group] - np.einsum("aim,im->am", h, bank.mean),
                np.einsum("aim,ibm->abm", h, cross),
                cross,
            )
            bank, log_l, *_ = collapse(bank, projection, modes.block(axes))
            bank, log_l = clusters.reweighted(bank, log_l)
            total += counted[f] * log_l
    bank = clusters.members(bank)
    sd = np.sqrt(np.maximum(np.einsum("iim->im", bank.cov), 0.0))
    return FixLikelihoods(
        total, dict(zip(PASS_STATES, bank.mean, strict=True)), dict(zip(PASS_STATES, sd, strict=True))
    )


def _linearised(timeline: Timeline, parameters: Parameters, latency_s: float, clock_s: float) -> _Linearised:
    t = timeline.fix_time_s[:MAX_FIXES]
    valid_s, count = t - latency_s, len(t)
    line = reckoned_by_clock(timeline, clock_s)
    moved_m = displacement_m(line)
    late, early = (
        displacement_m(reckoned_by_clock(timeline, clock_s + step)) for step in (CLOCK_STEP_S, -CLOCK_STEP_S)
    )
    by_clock = (late - early) / (2 * CLOCK_STEP_S)
    drift = [integrate(line, rate) for rate in drift_rates(line, PASS_STATES)]
    drift[PASS_STATES.index("dvl_clock")] = by_clock
    drift_at = interpolate(line, np.concatenate(drift, axis=1), valid_s).reshape(count, -1, 2).swapaxes(1, 2)
    V_at = interpolate(line, velocity_mps(line), valid_s)
    yaw = np.interp(valid_s, line.time_s, line.dr_yaw_rad)
    # the position is that of the DVL: what the stated lever arms add to it
    lever_m = np.array(parameters.usbl_lever_m[:2]) - np.array(parameters.dvl_lever_m[:2])
    reckoned_m = interpolate(line, moved_m - clock_s * by_clock, valid_s) + V_at * latency_s
    H = drift_at
    for names in (("x", "y"), BIAS_STATES, OFFSET_STATES):
        for axis, name in enumerate(names):
            H[:, axis, PASS_STATES.index(name)] = 1.0
    H[:, :, PASS_STATES.index("usbl_latency")] = -V_at
    for name, unit in zip(KEYS[LEVER], np.eye(2), strict=True):
        H[:, :, PASS_STATES.index(name)] = -rotated(yaw, unit)
    return _Linearised(timeline.fix_m[:count] - reckoned_m - rotated(yaw, lever_m), H)


def reckoned_by_clock(timeline: Timeline, clock_s: float) -> Timeline:
    """Return the timeline with dead reckoning by a DVL whose stamps are late by ``clock_s``."""
    if not clock_s:
        return timeline
    return replace(timeline, dr_mps=interpolate(timeline, timeline.dr_mps, timeline.time_s + clock_s))


def prior_sds(parameters: Parameters) -> Mapping[str, float]:
    """Return state -> prior 1-sigma of every sensor error that may exist."""
    return {
        **prior_sd(parameters.errors),
        **dict.fromkeys(KEYS[LEVER], parameters.errors.dvl_lever_m),
        **dict.fromkeys(KEYS[CLOCK], parameters.errors.dvl_clock_s),
    }


def _start(timeline: Timeline, members: Sequence[Member]) -> tuple[Array, Array]:
    """Return mean (n, N) and covariance (n, n, N) at the first epoch: as in prior.py, without the motion states."""
    first, time_s = members[0].parameters, np.zeros(1)
    carried = np.zeros((2, len(PASS_STATES)))
    if first.start is not None:
        position, sd_m = np.array([first.start.east_m, first.start.north_m]), first.start.sd_m
    else:
        fixes = starting_fixes(timeline, first)
        time_s = fixes.time_s
        position, sd_m = start_position(timeline, time_s, fixes.position_m)
        carried = start_sensitivity(timeline, time_s, PASS_STATES, fixes.sensor == "usbl")
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


def _dead_reckoned(timeline: Timeline) -> Mask:
    """Return which fixes have dead reckoning: in an outage of DVL or compass the vehicle's motion looks like noise."""
    t = timeline.fix_time_s[:MAX_FIXES]
    silent = [(t > gap.start_s) & (t <= gap.end_s) for gap in timeline.outages if gap.sensor in ("dvl", "compass")]
    return ~np.any([np.zeros(len(t), dtype=np.bool_), *silent], axis=0)


def _between_fixes(timeline: Timeline, members: Sequence[Member]) -> tuple[Array, Array]:
    """Return the decay of the correlated error from fix to fix, (F, N), and the process noise, (F, n, N)."""
    t = timeline.fix_time_s[:MAX_FIXES]
    dt_s = np.maximum(np.diff(t, prepend=0.0), 0.0)[:, None]
    every = [member.parameters for member in members]
    process, errors = [p.process for p in every], [p.errors for p in every]

    dvl_rows = np.flatnonzero(timeline.dvl_count)
    dvl_s = np.append(timeline.time_s[dvl_rows], timeline.time_s[-1])  # each record holds from its time to the next
    spacing_s = np.diff(dvl_s)
    R = timeline.dvl_sd_mps[dvl_rows] ** 2 / timeline.dvl_count[dvl_rows]
    noise_m2, gap_s3 = _between(t, dvl_s, R * spacing_s**2), _between(t, dvl_s, spacing_s**3 / 3)

    yaw_s = timeline.time_s[timeline.yaw_count > 0]
    moved_m2 = np.sum(np.diff(interpolate(timeline, displacement_m(timeline), yaw_s), axis=0) ** 2, axis=1)
    # a random walk of the turn rate q, interpolated over s seconds: the integral of yaw has the variance q^2 s^5 / 120
    turned = np.minimum(process[0].turn_rate_radps ** 2 * np.diff(yaw_s) ** 3 / 120, UNKNOWN_DIRECTION)
    noise_m2 += _between(t, yaw_s, moved_m2 * turned)
    # of the modes, what grows with R: records that contamination stands for do not enter dead reckoning
    dvl = BankNoise([p.dvl for p in every], [p.dvl_sd_scale for p in every])
    variance_factor = (dvl.probabilities * dvl.gain).sum(axis=0)
    added = np.zeros((len(t), len(PASS_STATES), len(members)))
    walk_m2 = [
        q.position_m**2 + (0.0 if "scale" in member.present else q.uncalibrated_m**2)
        for q, member in zip(process, members, strict=True)
    ]
    added[:, :2] = (dt_s * walk_m2 + noise_m2 * variance_factor + gap_s3 * [q.velocity_mps**2 for q in process])[
        :, None
    ]
    T, c0 = (np.array([getattr(e, name) for e in errors]) for name in ("usbl_bias_s", "usbl_bias_m"))
    fade = np.exp(-dt_s / T)
    for name in BIAS_STATES:
        added[:, PASS_STATES.index(name)] = (1 - fade**2) * c0**2
    return fade, added


def _between(t: Vector, edges_s: Vector, gained: Vector) -> Array:
    """Return what is gained from each time to the next, (F, 1), of a quantity that grows linearly between edges."""
    total = np.interp(t, edges_s, np.append(0.0, np.cumsum(gained)))
    return np.diff(total, prepend=0.0)[:, None]
