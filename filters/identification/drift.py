"""How far dead reckoning drifts from fix to fix, as variances: of the filters' motion model, driven by its sensors."""

from collections.abc import Sequence

import numpy as np

from usbldr.filters.models.noise import BankNoise
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.dead_reckoning import displacement_m, interpolate
from usbldr.filters.types import Array, Mask, Timeline, Vector

UNKNOWN_DIRECTION = 0.5  # fixed: variance of each axis of a unit vector in any direction


def has_dead_reckoning(timeline: Timeline, time_s: Vector) -> Mask:
    """Return at which times, (T,), DVL and compass were there: without them the vehicle's motion looks like noise."""
    silent = [
        (time_s > gap.start_s) & (time_s <= gap.end_s) for gap in timeline.outages if gap.sensor in ("dvl", "compass")
    ]
    return ~np.any([np.zeros(len(time_s), dtype=np.bool_), *silent], axis=0)


def drift_variances_m2(
    timeline: Timeline, time_s: Vector, members: Sequence[Parameters], scaled: Sequence[bool]
) -> Array:
    """Return the variance of each axis of dead reckoning from time to time, (T, N), ascending, from 0 to the first.

    ``scaled`` says of each of N members whether the DVL's scale error is one of its states.
    """
    dvl_rows = np.flatnonzero(timeline.dvl_count)
    dvl_s = np.append(timeline.time_s[dvl_rows], timeline.time_s[-1])  # each record holds from its time to the next
    spacing_s = np.diff(dvl_s)
    R = timeline.dvl_sd_mps[dvl_rows] ** 2 / timeline.dvl_count[dvl_rows]
    # of the modes, what grows with R: records that contamination stands for do not enter dead reckoning
    dvl = BankNoise([p.dvl for p in members], [p.dvl_sd_scale for p in members])
    noise_m2 = _gained(time_s, dvl_s, R * spacing_s**2) * (dvl.probabilities * dvl.gain).sum(axis=0)
    process = [p.process for p in members]
    held_m2 = _gained(time_s, dvl_s, spacing_s**3 / 3) * [q.velocity_mps**2 for q in process]

    yaw_s = np.append(timeline.time_s[timeline.yaw_count > 0], timeline.time_s[-1])
    moved_m2 = np.sum(np.diff(interpolate(timeline, displacement_m(timeline), yaw_s), axis=0) ** 2, axis=1)
    # a random walk of the turn rate q, interpolated over s seconds: the integral of yaw has the variance q^2 s^5 / 120
    turned = np.minimum(process[0].turn_rate_radps ** 2 * np.diff(yaw_s) ** 3 / 120, UNKNOWN_DIRECTION)

    walk_m2 = [
        q.position_m**2 + (0.0 if known else q.uncalibrated_m**2) for q, known in zip(process, scaled, strict=True)
    ]
    dt_s = np.maximum(np.diff(time_s, prepend=0.0), 0.0)[:, None]
    return dt_s * walk_m2 + noise_m2 + held_m2 + _gained(time_s, yaw_s, moved_m2 * turned)


def _gained(time_s: Vector, edges_s: Vector, gained: Vector) -> Array:
    """Return what is gained from time to time, (T, 1), of a quantity that grows linearly between edges."""
    total = np.interp(time_s, edges_s, np.append(0.0, np.cumsum(gained)))
    return np.diff(total, prepend=0.0)[:, None]
