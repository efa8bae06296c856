"""A fix of a transponder that lies still, as the head on the ship sees it.

Axes are starboard, forward, up of the ship or the head, and east, north, up of the map. Heading is clockwise from
north, pitch positive with the bow up, roll positive with starboard down; they turn a vector in the order roll, pitch,
heading. With the antenna's position A, the ship's attitude R, the lever arm a from the antenna to the head, the mount M
of the head and the scale s of its ranges, a fix v of the head places the transponder at ::

    T = A + R (a + s M v)

A head that takes off roll and pitch itself gives a v that is turned by the heading alone; the arm is turned as before.
The attitude is that of the ship's record ``attitude_latency_s`` after the fix, the position that of the record
``position_latency_s`` after it: records that arrive late.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Mask, Vector
from usbldr.filters.windows import columns_at

NAMES = (
    *("mount_roll_deg", "mount_pitch_deg", "mount_heading_deg", "scale"),
    *("arm_starboard_m", "arm_forward_m", "attitude_latency_s", "position_latency_s"),
    *("east_m", "north_m", "depth_m"),
)
"""The errors of an installation, and the place of the transponder: the order of every vector of parameters here."""
LATENCIES, PLACE = slice(6, 8), slice(8, 11)  # of attitude and of position, of the transponder in NAMES
OF_FIXES = ("time_s", "range_m", "direction", "bearing_rad", "two_way_s")  # fields of a survey with a row for each fix
SMOOTHED_S = 2.01  # [s] more than the noise of positions, less than a wave; 0.01 lest rounding decide what is within


class ShipMotion(NamedTuple):
    """The ship's records."""

    position_time_s: Vector  # (k,)
    position_m: Array  # (k, 2) of its antenna, east and north
    smoothed_m: Array  # (k, 2) the same over SMOOTHED_S, so that the noise of the positions does not pass for motion
    attitude_time_s: Vector  # (m,)
    attitude_deg: Array  # (m, 3) heading without jumps of 360 degrees, pitch, roll

    def positions(self, time_s: Vector, latency_s: float) -> Array:
        """Return the antenna's east and north as recorded a latency after the times, (n, 2); NaN outside."""
        return columns_at(time_s + latency_s, self.position_time_s, self.smoothed_m, np.nan)

    def attitudes(self, time_s: Vector) -> Array:
        """Return heading, pitch and roll in degrees, (n, 3), NaN outside of the records."""
        return columns_at(time_s, self.attitude_time_s, self.attitude_deg, np.nan)


def ship_motion(position_time_s: Vector, position_m: Array, attitude_time_s: Vector, attitude_deg: Array) -> ShipMotion:
    """Return a ship's motion by its records in order of time: (k,), (k, 2), (m,), (m, 3) heading, pitch, roll."""
    smoothed = _along_lines(position_time_s, position_m)
    smoothed = smoothed + _along_lines(position_time_s, position_m - smoothed)  # twice, so that waves keep their height
    attitude = attitude_deg.copy()
    attitude[:, 0] = np.degrees(np.unwrap(np.radians(attitude[:, 0])))
    return ShipMotion(position_time_s, position_m, smoothed, attitude_time_s, attitude)


def _along_lines(time_s: Vector, values: Array) -> Array:
    """Return at each time (k,) the straight line through the values (k, 2) of SMOOTHED_S around it, (k, 2)."""
    first = np.searchsorted(time_s, time_s - SMOOTHED_S / 2)
    last = np.searchsorted(time_s, time_s + SMOOTHED_S / 2, side="right")
    t, around = (time_s - time_s[0])[:, None], values - values.mean(axis=0)

    def mean(of: Array) -> Array:
        total = np.concatenate([np.zeros((1, of.shape[1])), np.cumsum(of, axis=0)])
        return (total[last] - total[first]) / (last - first)[:, None]

    away, spread = t - mean(t), mean(t**2) - mean(t) ** 2
    along = mean(t * around) - mean(t) * mean(around)
    slope = np.divide(along, spread, out=np.zeros_like(along), where=spread > 1e-6)
    return values.mean(axis=0) + mean(around) + slope * away


@dataclass(frozen=True, slots=True)
class UsblSurvey:
    """The fixes of one transponder (n,), as the head measured them, and how the ship moved."""

    time_s: Vector  # (n,)
    range_m: Vector  # (n,) slant range
    direction: Array  # (n, 3) unit vectors along starboard, forward, up of the head; NaN if without elevation
    bearing_rad: Vector  # (n,) clockwise from the head's forward axis
    ship: ShipMotion
    two_way_s: Vector | None = None  # (n,) between question and reply, if fixes are stamped by the reply
    arm_up_m: float = 0.0  # of the head above the antenna, as stated: a survey cannot tell it from the depth
    antenna_up_m: float = 0.0  # of the antenna above the surface, from where the transponder's depth counts
    level: bool = False  # the head has taken off the ship's roll and pitch from its fixes

    def __len__(self) -> int:
        return len(self.time_s)

    def part(self, chosen: Mask) -> "UsblSurvey":
        """Return the survey with the chosen fixes, (n,)."""
        columns = {name: getattr(self, name) for name in OF_FIXES}
        return replace(self, **{name: column[chosen] for name, column in columns.items() if column is not None})


def attitude_matrix(heading_deg: Vector, pitch_deg: Vector, roll_deg: Vector) -> Array:
    """Return the matrices, (n, 3, 3), that turn starboard, forward, up to east, north, up."""
    (sh, sp, sr), (ch, cp, cr) = (
        [trig(np.radians(angle)) for angle in (heading_deg, pitch_deg, roll_deg)] for trig in (np.sin, np.cos)
    )
    starboard = (cr * ch + sr * sp * sh, -cr * sh + sr * sp * ch, -sr * cp)
    forward = (cp * sh, cp * ch, sp)
    up = (sr * ch - cr * sp * sh, -sr * sh - cr * sp * ch, cr * cp)
    return np.stack([np.stack(axis, axis=-1) for axis in (starboard, forward, up)], axis=-1)


def mount_matrix(values: Vector) -> Array:
    """Return the matrix (3, 3) that turns a vector of the head to the ship's axes; ``values`` by NAMES."""
    return attitude_matrix(*values[2::-1, None])[0]


def seen_from_head(survey: UsblSurvey, values: Vector) -> Array:
    """Return where the transponder lies from the head, (n, 3) along its axes, in metres of its own ranges."""
    turning, head = _head_at(survey, values)
    east, north, depth = values[PLACE]
    return np.einsum("nji,nj->ni", turning, [east, north, -depth] - head) @ mount_matrix(values) / values[3]


def placed(survey: UsblSurvey, values: Vector) -> Array:
    """Return where each fix places the transponder: east, north, up, (n, 3).

    A fix without elevation takes that of the transponder's place in ``values``.
    """
    turning, head = _head_at(survey, values)
    seen = seen_from_head(survey, values)
    flat, down = np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2]
    length = np.hypot(flat, down)
    by_bearing = [flat * np.sin(survey.bearing_rad), flat * np.cos(survey.bearing_rad), down] / length
    direction = np.where(np.isfinite(survey.direction), survey.direction, by_bearing.T)
    measured = _way_back_m(survey, values, length)[:, None] * direction
    return head + np.einsum("nij,nj->ni", turning, values[3] * measured @ mount_matrix(values).T)


def residuals(survey: UsblSurvey, values: Vector) -> Array:
    """Return what each fix differs from the model by, (n, 3): range in metres, bearing and elevation in radians.

    Bearing and elevation are angles across the line of sight, as large as the displacement over the range, along axes
    of the measured line: those of the model's would spin with the parameters if the transponder lies below the head.
    They are NaN if the fix has no elevation and no bearing, and if the ship has no record at its time.
    """
    seen = seen_from_head(survey, values)
    length = np.linalg.norm(seen, axis=1)
    line = seen / length[:, None]
    sin_b, cos_b = np.sin(survey.bearing_rad), np.cos(survey.bearing_rad)
    flat, up = np.hypot(survey.direction[:, 0], survey.direction[:, 1]), survey.direction[:, 2]
    upward = np.column_stack([-up * sin_b, -up * cos_b, flat])
    by_bearing = wrapped(survey.bearing_rad - np.arctan2(line[:, 0], line[:, 1])) * np.hypot(line[:, 0], line[:, 1])
    found = np.empty((len(survey), 3))
    found[:, 0] = _way_back_m(survey, values, length) - length
    found[:, 1] = np.where(np.isfinite(flat), line[:, 1] * sin_b - line[:, 0] * cos_b, by_bearing)
    found[:, 2] = -np.sum(line * upward, axis=1)
    return found


def _head_at(survey: UsblSurvey, values: Vector) -> tuple[Array, Array]:
    """Return the matrices (n, 3, 3) that turn the fixes to the map, and the head's east, north, up (n, 3) at each."""
    attitude_latency_s, position_latency_s = values[LATENCIES]
    attitudes = survey.ship.attitudes(survey.time_s + attitude_latency_s)
    antenna = survey.ship.positions(survey.time_s, position_latency_s)
    turning = attitude = attitude_matrix(*attitudes.T)
    if survey.level:
        turning = attitude_matrix(*(attitudes * [1, 0, 0]).T)
    arm = np.array([values[4], values[5], survey.arm_up_m])
    return turning, np.column_stack([antenna, np.full(len(antenna), survey.antenna_up_m)]) + attitude @ arm


def _way_back_m(survey: UsblSurvey, values: Vector, length_m: Vector) -> Vector:
    """Return the measured range of the reply, (n,): a range is the mean of both ways, and the ship moved between them.

    ``length_m`` (n,) is that of the reply by the model.
    """
    if survey.two_way_s is None:
        return survey.range_m
    asked = seen_from_head(replace(survey, time_s=survey.time_s - survey.two_way_s), values)
    return survey.range_m + (length_m - np.linalg.norm(asked, axis=1)) / 2
