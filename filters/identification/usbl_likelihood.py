"""Predictive likelihood of each USBL fix, given the fixes before it and dead reckoning.

The state is the error of dead reckoning (east, north, metres) and the calibrated sensor errors; a step goes from fix to
fix. Dead reckoning is the filters' motion model driven by DVL and compass instead of
corrected by them, so what its records leave open is a random walk of the position, and what the errors do to it is the
displacement's derivative by each. All members of a bank, each with assumptions of its own, pass over the log at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection, equal_weights
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.frames import rotated
from usbldr.filters.models.calibration import STATES, layout_for
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.dead_reckoning import displacement_m, drift_rates, integrate, interpolate, velocity_mps
from usbldr.filters.replay.prior import prior
from usbldr.filters.types import Array, Timeline, Vector

MAX_FIXES = 3600  # an hour at 1 Hz, enough to estimate the noise
DR_INPUT_STATES = ("psi", "u", "v", "r")  # dead reckoning takes them from compass and DVL
BIAS_STATES = STATES["usbl-bias"]


@dataclass(frozen=True, slots=True)
class DrResiduals:
    """F fixes minus dead reckoning, in n states: those in ``rows``, which leaves DR_INPUT_STATES out."""

    timeline: Timeline
    layout: StateLayout  # of the filter
    dt_s: Vector  # (F,) since the fix before; the first since the start
    displacement_jacobian: Array  # (F, 2, n) displacement since then by each state
    residual_m: Array  # (F, 2) fix minus dead reckoning
    measurement_matrix: Array  # (F, 2, n) H of each fix
    cov_m2: Array  # (F, 2, 2) as the log states it
    dvl_noise_m2: Vector  # (F,) what the DVL's stated noise has added to dead reckoning since the fix before
    dvl_gap_s3: Vector  # (F,) the same of a velocity that walks 1 m/s in 1 s while there is no record

    @property
    def rows(self) -> list[int]:
        """Rows of the layout that are states here, (n,)."""
        return [row for row, name in enumerate(self.layout.names) if name not in DR_INPUT_STATES]


class FixLikelihoods(NamedTuple):
    """The result of a pass over the fixes, for N members."""

    log_likelihood: Vector  # (N,) predictive, of all fixes
    latency_s: float  # of the first member; 0 if it is not a state
    sd: Mapping[str, Vector]  # (N,) of each state after the last fix


def dr_residuals(timeline: Timeline, parameters: Parameters, latency_s: float = 0.0) -> DrResiduals:
    """Return the residuals of the first fixes to dead reckoning, linearised about ``latency_s``."""
    layout = layout_for(parameters.calibrate)
    states = StateLayout(tuple(name for name in layout.names if name not in DR_INPUT_STATES))
    t = timeline.fix_time_s[:MAX_FIXES]
    valid_s, count = t - latency_s, len(t)
    V, yaw = velocity_mps(timeline), timeline.dr_yaw_rad
    drift = np.stack([integrate(timeline, rate) for rate in drift_rates(timeline, states.names)], axis=2)  # (K, 2, n)
    drift_at = interpolate(timeline, drift.reshape(len(drift), -1), valid_s).reshape(count, 2, -1)
    V_at = interpolate(timeline, V, valid_s)
    reckoned_m = interpolate(timeline, displacement_m(timeline), valid_s) + V_at * latency_s
    arm_m = rotated(np.interp(valid_s, timeline.time_s, yaw), np.array(parameters.usbl_lever_m[:2]))
    measurement_matrix = np.zeros((count, 2, len(states)))
    for names in (("x", "y"), BIAS_STATES):
        for axis, row in enumerate(states.existing(*names)):
            measurement_matrix[:, axis, row] = 1.0
    for row in states.existing("usbl_latency"):
        measurement_matrix[:, :, row] = -V_at
    dvl_rows = np.flatnonzero(timeline.dvl_count)
    edges_s = np.append(timeline.time_s[dvl_rows], timeline.time_s[-1])  # each record holds from its time to the next
    spacing_s = np.diff(edges_s)
    R = timeline.dvl_sd_mps[dvl_rows] ** 2 / timeline.dvl_count[dvl_rows]
    accumulated = [np.append(0.0, np.cumsum(each)) for each in (R * spacing_s**2, spacing_s**3 / 3)]
    dvl_noise_m2, dvl_gap_s3 = (np.diff(np.interp(t, edges_s, column), prepend=0.0) for column in accumulated)
    return DrResiduals(
        timeline,
        layout,
        np.maximum(np.diff(t, prepend=0.0), 0.0),
        np.diff(drift_at, axis=0, prepend=0.0),
        timeline.fix_m[:count] - reckoned_m - arm_m,
        measurement_matrix,
        timeline.fix_cov_m2[:count],
        dvl_noise_m2,
        dvl_gap_s3,
    )


def fix_likelihoods(log: DrResiduals, members: Sequence[Parameters]) -> FixLikelihoods:
    """Run adf over the fixes for each member with its own assumptions; all calibrate the same states."""
    rows = log.rows
    starts = [prior(log.timeline, member, log.layout) for member in members]
    bank = GaussianBank(
        np.stack([start.mean[rows] for start in starts], axis=1),
        np.stack([start.cov[np.ix_(rows, rows)] for start in starts], axis=2),
        equal_weights(len(members)),
    )
    n, N = bank.mean.shape
    fade, added = _between_fixes(log, members)
    noise = BankNoise([member.usbl for member in members], [member.usbl_sd_scale for member in members])
    total, eye = np.zeros(N), np.eye(n)
    for f in range(len(log.dt_s)):
        F = eye.copy()
        F[:2] += log.displacement_jacobian[f]
        half = (F @ bank.cov.reshape(n, -1)).reshape(n, n, N).swapaxes(0, 1)
        P = (F @ half.reshape(n, -1)).reshape(n, n, N)
        cov = 0.5 * (P + P.swapaxes(0, 1)) * (fade[f, :, None] * fade[f])  # exactly symmetric, see apply_gain
        cov += added[f] * eye[:, :, None]
        bank = GaussianBank(fade[f] * (F @ bank.mean), cov, bank.log_weight)
        modes = noise.modes(log.cov_m2[f])
        for axes in modes.blocks():
            projection = _project_fix(bank, log.measurement_matrix[f, axes], log.residual_m[f, axes])
            bank, log_l, *_ = collapse(bank, projection, modes.block(axes))
            total += log_l
    latency = [row for row, state in enumerate(rows) if log.layout.names[state] == "usbl_latency"]
    sd = np.sqrt(np.maximum(np.einsum("iin->in", bank.cov), 0.0))
    by_name = {log.layout.names[row]: sd[i] for i, row in enumerate(rows)}
    return FixLikelihoods(total, float(bank.mean[latency, 0].sum()), by_name)


def _between_fixes(log: DrResiduals, members: Sequence[Parameters]) -> tuple[Array, Array]:
    """Return the decay factor of each state from fix to fix and its process noise, (F, n, N) both."""
    rows = log.rows
    walks = np.stack([VehicleMotion(log.layout, m.process, m.errors).noise(0.0, 1.0)[rows] for m in members], axis=1)
    fade, added = np.ones((len(log.dt_s), *walks.shape)), log.dt_s[:, None, None] * walks
    dvl_variance_factor = [float(m.dvl.modes(np.ones((1, 1))).mixture_cov[0, 0]) * m.dvl_sd_scale**2 for m in members]
    added[:, :2] += (
        log.dvl_noise_m2[:, None] * dvl_variance_factor
        + log.dvl_gap_s3[:, None] * [m.process.velocity_mps**2 for m in members]
    )[:, None]
    bias = [rows.index(row) for row in log.layout.existing(*BIAS_STATES)]
    T, c0 = (np.array([getattr(m.errors, name) for m in members]) for name in ("usbl_bias_s", "usbl_bias_m"))
    fade[:, bias] = np.exp(-log.dt_s[:, None] / T)[:, None]
    added[:, bias] = (1 - fade[:, bias] ** 2) * c0**2
    return fade, added


def _project_fix(bank: GaussianBank, H: Array, z: Vector) -> Projection:
    """Return the projection of a fix, or of one axis of it, for every member."""
    (k, n), N = H.shape, bank.mean.shape[1]
    cross = (H @ bank.cov.reshape(n, -1)).reshape(k, n, N).swapaxes(0, 1)
    return Projection(z[:, None] - H @ bank.mean, (H @ cross.reshape(n, -1)).reshape(k, k, N), cross)
