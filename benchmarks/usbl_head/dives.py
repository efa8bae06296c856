"""Dives beside a USBL head with errors of its own, and the exact posterior of a dive whose head rests.

The posterior shares no code with the filters: one batch least squares over the start, the four errors and the fixes,
with the random walk of dead reckoning as correlated noise.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Timeline, Vector

HZ = 5
DVL_SD_MPS, HEADING_SD_RAD, FIX_SD_M, GPS_SD_M = 0.02, np.radians(0.3), 0.5, 0.5
START_M = np.array([25.0, -15.0])  # 30 m from the head
PRIOR_SD = np.array([np.radians(1.0), 0.01, np.radians(5.0), 0.03])  # docs/configuration.md, in the order of HeadErrors
START_SD_M = 1e3  # of the posterior: unknown


class HeadErrors(NamedTuple):
    """Errors of the head and of the vehicle's sensors: angles in radians counter-clockwise, scales as shares."""

    head_rad: float = 0.0
    range_scale: float = 0.0
    compass_rad: float = 0.0
    dvl_scale: float = 0.0
    arm_starboard_m: float = 0.0  # from where the lever arm on the ship says, to the head
    arm_forward_m: float = 0.0


CLEAN = HeadErrors()


class Dive(NamedTuple):
    """A dive as a filter sees it, and its truth."""

    line: Timeline
    position_m: Array  # (K, 2) true, at the epochs


def drawn_errors(seed: int) -> HeadErrors:
    """Return errors drawn from their documented priors."""
    return HeadErrors(*(PRIOR_SD * np.random.default_rng([seed, 1]).standard_normal(4)).tolist())


def dive(errors: HeadErrors, seed: int, ship: bool = False, seconds: int = 500, homewards: bool = False) -> Dive:
    """Return a dive in bends of 100 m, from 30 m beside the head to 260 m away, or homewards from there.

    A ship circles 100 m about a point that moves on with the vehicle, bow ahead. GPS fixes of GPS_SD_M cover the last
    30 s.
    """
    rng = np.random.default_rng([seed, 0])
    t = np.arange(seconds * HZ + 1) / HZ
    clock = t[::-1] if homewards else t
    yaw = 0.5 + np.pi / 2 * np.sin(clock / 19.0) + (np.pi if homewards else 0.0)
    body = np.column_stack([0.1 * np.cos(t / 11), 1.0 + 0.1 * np.sin(t / 7)])
    mps = _turned(yaw, body)
    moved = np.vstack([np.zeros(2), np.cumsum((mps[1:] + mps[:-1]) / 2 / HZ, axis=0)])
    position = moved + START_M - (moved[-1] if homewards else 0.0)
    seen = (1 + errors.dvl_scale) * body + DVL_SD_MPS * rng.standard_normal(body.shape)
    seen_yaw = yaw + errors.compass_rad + HEADING_SD_RAD * rng.standard_normal(len(yaw))
    rows = np.arange(HZ, len(t), HZ)
    head, arm, ship_yaw = np.zeros((len(rows), 2)), np.zeros((len(rows), 2)), None
    if ship:
        angle = t[rows] / 60.0
        head = np.linspace(position[0], position[-1], len(rows)) + 100 * np.column_stack([np.sin(angle), np.cos(angle)])
        ship_yaw = -angle - np.pi / 2
        arm = _turned(ship_yaw, np.tile(errors[4:], (len(rows), 1)))
    away = (1 + errors.range_scale) * _turned(np.full(len(rows), errors.head_rad), position[rows] - head - arm)
    away += FIX_SD_M * rng.standard_normal(away.shape)
    gps = rows[-30:]
    ones = np.ones(len(t), dtype=np.intp)
    line = Timeline(
        start_ns=0,
        time_s=t,
        slow=np.arange(0, len(t), HZ),
        dvl_mps=seen,
        dvl_count=ones,
        dvl_sd_mps=np.full(len(t), DVL_SD_MPS),
        yaw_rad=seen_yaw,
        yaw_count=ones,
        yaw_sd_rad=np.full(len(t), HEADING_SD_RAD),
        dr_mps=seen,
        dr_yaw_rad=seen_yaw,
        fix_time_s=t[rows],
        fix_received_s=t[rows],
        fix_m=head + away,
        fix_away_m=away,
        fix_ship_yaw_rad=ship_yaw,
        fix_cov_m2=np.tile(FIX_SD_M**2 * np.eye(2), (len(rows), 1, 1)),
        gps_time_s=t[gps],
        gps_m=position[gps] + GPS_SD_M * rng.standard_normal((len(gps), 2)),
        gps_sd_m=np.full(len(gps), GPS_SD_M),
    )
    return Dive(line, position)


def exact_posterior(line: Timeline, gps: bool = False) -> tuple[Array, Array]:
    """Return means (K, 2) at all epochs, and covariance (2, 2) of the last, for a head that rests at the origin.

    Gauss-Newton of x = (start, head, range, compass, scale). Fix k is A p_k with A = (1 + range) R(head), and p_k the
    start plus dead reckoning freed of compass and scale plus a walk, whose own estimate is left out. Positions are
    complex numbers, east + i north. With ``gps`` the GPS fixes are used, too.
    """
    moved = np.cumsum((mps := _turned(line.dr_yaw_rad, line.dr_mps) @ [1, 1j]) / HZ) - mps / 2 / HZ - mps[0] / 2 / HZ
    used = [(line.fix_time_s, line.fix_m, FIX_SD_M)] + [(line.gps_time_s, line.gps_m, GPS_SD_M)] * gps
    t, z = np.concatenate([one[0] for one in used]), np.vstack([one[1] for one in used]) @ [1, 1j]
    of_usbl, rows = np.arange(len(t)) < len(line.fix_time_s), np.round(t * HZ).astype(int)
    walk_m2 = (DVL_SD_MPS**2 + HEADING_SD_RAD**2) / HZ  # per second, at 1 m/s: white errors of each record
    white = np.concatenate([np.full(len(one[0]), one[2] ** 2) for one in used])
    noise = np.linalg.inv(np.diag(white) + walk_m2 * np.minimum.outer(t, t))
    x, prior = np.zeros(6), np.concatenate([np.full(2, START_SD_M), PRIOR_SD])

    def track(x: Vector) -> Array:
        return x[0] + 1j * x[1] + moved * np.exp(-1j * x[4]) / (1 + x[5])

    def derivatives(x: Vector, there: Array) -> Array:
        gone = there - x[0] - 1j * x[1]
        return np.column_stack([gone**0, 1j * gone**0, 0 * gone, 0 * gone, -1j * gone, -gone / (1 + x[5])])

    information = np.diag(prior**-2.0)
    for _ in range(6):
        there, gain = track(x)[rows], np.where(of_usbl, (1 + x[3]) * np.exp(1j * x[2]), 1.0)
        J = gain[:, None] * derivatives(x, there)
        J[of_usbl, 2], J[of_usbl, 3] = (1j * gain * there)[of_usbl], (gain * there / (1 + x[3]))[of_usbl]
        information = np.real(J.conj().T @ noise @ J) + np.diag(prior**-2.0)
        x = x + np.linalg.solve(information, np.real(J.conj().T @ noise @ (z - gain * there)) - x / prior**2)
    there = track(x)
    last = derivatives(x, there[-1:])[0]
    G = np.vstack([np.real(last), np.imag(last)])
    cov: Array = np.asarray(G @ np.linalg.inv(information) @ G.T, dtype=np.float64)
    return np.column_stack([np.real(there), np.imag(there)]), cov


def _turned(yaw_rad: Vector, vector: Array) -> Array:
    turned = vector @ [1, 1j] * np.exp(1j * yaw_rad)
    return np.column_stack([np.real(turned), np.imag(turned)]).astype(np.float64)
