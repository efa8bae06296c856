"""The prior of a filter and the anchor of dead reckoning: a stated start, or the first fixes."""

import math
from dataclasses import replace

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.estimators.protocol import Prior
from usbldr.filters.frames import rotated
from usbldr.filters.models.calibration import prior_sd
from usbldr.filters.models.motion import VehicleMotion
from usbldr.filters.models.parameters import UNKNOWN_START, Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.dead_reckoning import Anchor, start_position, start_sensitivity
from usbldr.filters.replay.position_fixes import PositionFixes, gps_fixes, usbl_fixes
from usbldr.filters.types import Array, Timeline, Truth, Vector

NO_START_TEXT = (
    "no USBL fix gives a filter its start: state [start] east_m, north_m, sd_m in the configuration, or use GPS fixes "
    "at the surface (--aid gps@FROM:TO)"
)


def prior(timeline: Timeline, parameters: Parameters, layout: StateLayout) -> Prior:
    """Return mean (n,) and covariance (n, n) at the first epoch, from the stated start or the first fixes.

    Yaw and velocity start at the first compass and DVL records with a wide sigma, as the filter uses these records
    again. A compass with error states measures only the sum of yaw and errors, so the prior correlates them; likewise
    the position from the first fixes and the errors of these fixes and of the dead reckoning that carries them back.
    Raises LogError if nothing gives the position.
    """
    carried = np.zeros((2, len(layout)))  # derivative of the start position by each sensor error
    if parameters.start is not None:
        position = np.array([parameters.start.east_m, parameters.start.north_m])
        position_sd_m = parameters.start.sd_m
    else:
        fixes = starting_fixes(timeline, parameters)
        if not len(fixes.time_s):
            raise LogError(NO_START_TEXT)
        position, position_sd_m = start_position(timeline, fixes.time_s, fixes.position_m)
        carried = start_sensitivity(timeline, fixes.time_s, layout.names, fixes.sensor == "usbl")
        motion = VehicleMotion(layout, parameters.process, parameters.errors)
        walked_m2 = float(motion.noise(0.0, max(0.0, float(fixes.time_s[0])))[layout.index("x")])
        position_sd_m = math.sqrt(position_sd_m**2 + walked_m2)
    yaw = (float(timeline.dr_yaw_rad[0]), float(timeline.yaw_sd_rad[0]))
    return prior_at(position, position_sd_m, yaw, timeline.dr_mps[0], parameters, layout, carried)


def prior_at(
    position_m: Vector,
    position_sd_m: float,
    yaw: tuple[float, float],
    mps: Vector,
    parameters: Parameters,
    layout: StateLayout,
    carried: Array,
) -> Prior:
    """Return the belief at a position (2,), with a reading of yaw and its sigma in radians, and of velocity (2,).

    ``carried`` (2, n) is the derivative of the position by each state: what its fixes and dead reckoning share.
    """
    start = parameters.start or UNKNOWN_START
    yaw_rad, yaw_sd_rad = yaw
    known: dict[str, tuple[float, float]] = {
        "psi": (yaw_rad, start.sd_yaw_rad),
        "u": (float(mps[0]), start.sd_mps),
        "v": (float(mps[1]), start.sd_mps),
        "r": (0.0, start.sd_radps),
        "x": (float(position_m[0]), position_sd_m),
        "y": (float(position_m[1]), position_sd_m),
    }
    known |= {name: (0.0, sd) for name, sd in prior_sd(parameters.errors).items()}
    mean, sd = np.array([known[name] for name in layout.names]).T
    P = np.diag(sd**2)
    h = {"heading_bias": 1.0, "deviation_sin": math.sin(yaw_rad), "deviation_cos": math.cos(yaw_rad)}
    errors = {layout.index(name): share for name, share in h.items() if name in layout.names}
    if errors:
        psi, rows, share = layout.index("psi"), list(errors), np.array(list(errors.values()))
        P[psi, psi] = yaw_sd_rad**2 + share**2 @ sd[rows] ** 2
        P[psi, rows] = P[rows, psi] = -share * sd[rows] ** 2
    position_rows = list(layout.rows("x", "y"))
    cross = carried @ P
    P[position_rows] += cross
    P[:, position_rows] += cross.T
    P[np.ix_(position_rows, position_rows)] += cross @ carried.T
    return Prior(mean, P)


def starting_fixes(timeline: Timeline, parameters: Parameters) -> PositionFixes:
    """Return the fixes at the start, as positions of the vehicle: USBL, or aiding GPS if it is earlier; may be none."""
    usbl, gps = usbl_fixes(timeline, parameters, StateLayout()), gps_fixes(timeline, parameters)
    first = min((usbl, gps), key=lambda fixes: float(fixes.time_s[0]) if len(fixes.time_s) else math.inf)
    return first._replace(position_m=vehicle_positions_m(timeline, first))


def vehicle_positions_m(timeline: Timeline, fixes: PositionFixes) -> Array:
    """Return the positions of the vehicle's reference point from fixes of its transponder or antenna, (F, 2)."""
    yaw = np.interp(fixes.time_s, timeline.time_s, timeline.dr_yaw_rad)
    return fixes.position_m - rotated(yaw, np.array(fixes.lever_m[:2]))


def find_anchor(where: str, timeline: Timeline, parameters: Parameters, truth: Truth | None) -> Anchor | None:
    """Return the anchor "start", "first-fix", "first-gps" or "first-truth" of a log, None if the log lacks it.

    "start" is the stated start, else the first fixes: as for a filter. A single fix may be an outlier,
    so "first-fix" is the median of the first five.
    """
    if where == "start" and parameters.start is not None:
        start = parameters.start
        return Anchor(np.array([start.east_m, start.north_m]), 0.0, "the stated start")
    if where in ("start", "first-fix"):
        usbl_only = where == "first-fix"
        fixes = starting_fixes(timeline, replace(parameters, aid=()) if usbl_only else parameters)
        if not len(fixes.time_s):
            return None
        position_m, _ = start_position(timeline, fixes.time_s, fixes.position_m)
        return Anchor(position_m, 0.0, "the first five fixes")
    if where == "first-gps":
        if not len(timeline.gps_time_s):
            return None
        return Anchor(timeline.gps_m[0], float(timeline.gps_time_s[0]), "the first GPS fix")
    if truth is None or not len(truth.time_s):
        return None
    inside = truth.time_s >= 0
    first = int(inside.argmax()) if inside.any() else 0
    time_s = max(0.0, float(truth.time_s[first]))
    yaw = float(np.interp(time_s, timeline.time_s, timeline.dr_yaw_rad))
    arm_m = rotated(yaw, np.array(truth.lever_m[:2]))
    return Anchor(truth.position_m[first] - arm_m, time_s, "the first row of the truth")
