"""Velocity in a gap of the DVL and turn rate in one of the compass: they relax to what the vehicle usually did so far.

While records come, u, v and r are random walks, since a past without manoeuvres must not resist one. Without them each
is an Ornstein-Uhlenbeck process, dv = -(v - m) dt / T + dW, whose variance has a limit; that of a random walk has none.
m is the mean of all records up to now, s their standard deviation about it.

- Velocity: T = 2 s^2 / q^2, so that over short times it is the random walk q as before. Perhaps the vehicle lies still,
  at the surface or on the bottom, which one that cruised has never shown: s^2 has a share of m^2, too.
- Turn rate: records are mean rates over TURN_S, of which s is the standard deviation. T is short, and the variance such
  that yaw spreads as it does with independent mean rates of TURN_S, by s^2 TURN_S a second.

G. E. Uhlenbeck and L. S. Ornstein, "On the theory of the Brownian motion", Physical Review 36, 1930,
doi:10.1103/PhysRev.36.823. Metres and radians per second, body frame; seconds.
"""

import math
from typing import Any, NamedTuple, Self

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Mask, Vector

LONGEST_GAP_S = 3.0  # [s] no velocity relaxes across shorter gaps: slow DVLs send every second or two
ASSUMED_SD_MPS = 0.5  # [m/s] of the velocity before any record: vehicles do 1 to 2 m/s
ASSUMED_FOR_S = 10.0  # [s] of records that ASSUMED_SD_MPS counts as much as: a first minute need not show all speeds
STOPPED = 0.2  # [-] of the gaps, by judgement: in which the vehicle lies still
TURN_S = 10.0  # [s] by judgement: a turn lasts about as long, and noise of headings hardly matters over it
TURN_TIME_S = 1.0  # [s] time constant of the turn rate in a gap, well below TURN_S
LONGEST_TURN_GAP_S = 1.0  # [s] no turn rate relaxes across shorter gaps; nor below twice the usual interval
ASSUMED_TURNS_S = 60.0  # [s] of headings that ASSUMED_SD_RADPS counts as much as: a long leg need not show a turn
ASSUMED_SD_RADPS = math.radians(10.0)  # [rad/s] of the mean turn rate before any record: AUVs turn by 3 to 10 deg/s


class UsualMotion(NamedTuple):
    """The mean of k quantities, their standard deviations and their time constants, each (k,)."""

    mean: Vector
    sd: Vector
    time_s: Vector

    def remaining(self, dt_s: float | Array) -> Array:
        """Return the share of the deviation from the mean that is left after some time, (k,), or (n, k) for (n, 1)."""
        return np.exp(-dt_s / self.time_s)

    def added_variance(self, dt_s: float) -> Vector:
        """Return the variance that the process adds in some time, (k,)."""
        return -np.expm1(-2 * dt_s / self.time_s) * self.sd**2


class _History:
    """The records of k quantities so far; what it states about a time depends on the records up to that time alone."""

    def __init__(self, quantities: int) -> None:
        self._count = 0
        self._time_s = np.empty(1)  # (m,) of which the first ``count`` are records
        self._sums = np.empty((1, 2, quantities))  # of the values up to each record, and of their squares

    def _take(self, time_s: Vector, values: Array) -> Self:
        """Take n records at ascending times, (n,), (n, k)."""
        if len(time_s):
            self._count, self._time_s = len(time_s), time_s
            self._sums = np.cumsum(np.stack([values, values**2], axis=1), axis=0)
        return self

    def _insert(self, time_s: float, values: Vector) -> None:
        """Add a record, (k,); one that comes late is put in its place."""
        row, end = self._before(time_s), self._count
        if end == len(self._time_s):  # twice the room, so that adding n records costs n
            self._time_s = np.resize(self._time_s, 2 * end + 1)
            self._sums = np.resize(self._sums, (2 * end + 1, *self._sums.shape[1:]))
        gained: Array = np.array([values, values**2])
        self._time_s[row + 1 : end + 1] = self._time_s[row:end].copy()
        self._sums[row + 1 : end + 1] = self._sums[row:end] + gained
        self._time_s[row] = time_s
        self._sums[row] = gained + (self._sums[row - 1] if row else 0.0)
        self._count += 1

    def _before(self, time_s: float | Vector) -> Any:
        """Return how many records come at a time or before it."""
        return self._time_s[: self._count].searchsorted(time_s, side="right")

    def _longest_gap_s(self, count: Any) -> Any:
        """Return the longest time since the last of so many records that is no gap."""
        raise NotImplementedError

    def gaps(self, time_s: Vector) -> Mask:
        """Return which times, (n,), lie in a gap: the last record before them is not recent."""
        count = self._before(time_s)
        return (count > 0) & (time_s - self._time_s[np.maximum(count - 1, 0)] > self._longest_gap_s(count))

    def _usual(self, time_s: float, assumed_sd: float, for_s: float) -> tuple[Vector, Vector] | None:
        """Return mean and variance of the records in a gap, None outside of one."""
        count = self._before(time_s)
        if not count or time_s - self._time_s[count - 1] <= self._longest_gap_s(count):
            return None
        mean, square = self._sums[count - 1] / count
        span_s = float(self._time_s[count - 1] - self._time_s[0])
        variance = np.maximum(square - mean**2, 0.0)  # not below 0 by rounding
        return mean, (for_s * assumed_sd**2 + span_s * variance) / (for_s + span_s)


class VelocityHistory(_History):
    """The DVL records so far."""

    def __init__(self) -> None:
        super().__init__(2)

    @classmethod
    def of(cls, time_s: Vector, mps: Array) -> Self:
        """Return the history of n records at ascending times, (n,), with starboard and forward velocity, (n, 2)."""
        return cls()._take(time_s, mps)

    def add(self, time_s: float, mps: Vector) -> None:
        """Add a record, (2,); one that comes late is put in its place."""
        self._insert(time_s, mps)

    def _longest_gap_s(self, count: Any) -> Any:
        return LONGEST_GAP_S

    def in_gap(self, time_s: float, walk_mps: float, stopped: float = STOPPED) -> UsualMotion | None:
        """Return the process from a time on; None if the last record is recent or none came, or the walk is 0.

        ``walk_mps`` is the random walk of the velocity, its standard deviation after one second, ``stopped`` the share
        of the vehicles that lie still: none, if the likeliest velocity is asked for and not its sigma.
        """
        found = self._usual(time_s, ASSUMED_SD_MPS, ASSUMED_FOR_S) if walk_mps else None
        if found is None:
            return None
        mean, variance = found
        variance = variance + stopped * mean**2
        return UsualMotion(mean, np.sqrt(variance), 2 * variance / max(walk_mps**2, np.finfo(float).tiny))


class TurnHistory(_History):
    """The headings so far, as mean turn rates over TURN_S."""

    def __init__(self) -> None:
        super().__init__(1)
        self._yaw_rad = np.empty(0)

    @classmethod
    def of(cls, time_s: Vector, yaw_rad: Vector) -> Self:
        """Return the history of n unwrapped yaw angles at ascending times, (n,) each."""
        made = cls()
        made._yaw_rad = yaw_rad
        turned_rad = yaw_rad - yaw_rad[np.searchsorted(time_s, time_s - TURN_S)]
        return made._take(time_s, (turned_rad / TURN_S)[:, None])

    def add(self, time_s: float, yaw_rad: float) -> None:
        """Add a yaw angle within half a turn of the one before; one that comes late is put in its place."""
        count, row = self._count, self._before(time_s)
        yaw = self._yaw_rad[:count]
        if row < count:  # others after it have turned since then
            late = self.of(np.insert(self._time_s[:count], row, time_s), np.insert(yaw, row, yaw_rad))
            self.__dict__.update(late.__dict__)
            return
        if count:
            yaw_rad = float(yaw[-1] + wrapped(yaw_rad - yaw[-1]))
        if len(self._yaw_rad) == count:
            self._yaw_rad = np.resize(self._yaw_rad, 2 * count + 1)
        self._yaw_rad[count] = yaw_rad
        first = int(self._time_s[:count].searchsorted(time_s - TURN_S))
        self._insert(time_s, np.array([(yaw_rad - self._yaw_rad[first]) / TURN_S]))

    def _longest_gap_s(self, count: Any) -> Any:
        span_s = self._time_s[np.maximum(count - 1, 0)] - self._time_s[0]
        return np.maximum(LONGEST_TURN_GAP_S, 2 * span_s / np.maximum(count - 1, 1))

    def in_gap(self, time_s: float, walk_radps: float) -> UsualMotion | None:
        """Return the process from a time on; None if the last record is recent or none came, or the walk is 0."""
        found = self._usual(time_s, ASSUMED_SD_RADPS, ASSUMED_TURNS_S) if walk_radps else None
        if found is None:
            return None
        mean, variance = found
        return UsualMotion(mean, np.sqrt(variance * TURN_S / (2 * TURN_TIME_S)), np.full(1, TURN_TIME_S))
