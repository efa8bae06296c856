"""Velocity in a gap of the DVL: it relaxes to what the vehicle usually did, learnt from its own records so far.

While records come, u and v are random walks, since a past without manoeuvres must not resist one. Without them each
axis is an Ornstein-Uhlenbeck process, dv = -(v - m) dt / T + q dW: m is the mean of all records up to now, s their
standard deviation about it, and T = 2 s^2 / q^2, so that over short times it is the same random walk q. Its variance
never exceeds s^2, where that of a held velocity grows without end. Metres per second, body frame; seconds.

G. E. Uhlenbeck and L. S. Ornstein, "On the theory of the Brownian motion", Physical Review 36, 1930,
doi:10.1103/PhysRev.36.823.
"""

import bisect
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Vector

LONGEST_GAP_S = 3.0  # [s] no velocity relaxes across shorter gaps: slow DVLs send every second or two
ASSUMED_SD_MPS = 0.5  # [m/s] of the velocity before any record: vehicles do 1 to 2 m/s
ASSUMED_FOR_S = 10.0  # [s] of records that ASSUMED_SD_MPS counts as much as: a first minute need not show all speeds


class UsualVelocity(NamedTuple):
    """The mean of the velocity, its standard deviation and its time constant, each (2,): starboard, forward."""

    mean_mps: Vector
    sd_mps: Vector
    time_s: Vector

    def remaining(self, dt_s: float | Array) -> Array:
        """Return the share of the deviation from the mean that is left after some time, (2,), or (n, 2) for (n, 1)."""
        return np.exp(-dt_s / self.time_s)

    def added_variance(self, dt_s: float) -> Vector:
        """Return the variance that the process adds in some time, m^2/s^2, (2,)."""
        return -np.expm1(-2 * dt_s / self.time_s) * self.sd_mps**2


class VelocityHistory:
    """The DVL records so far; what it tells about a time depends on the records up to that time alone."""

    def __init__(self) -> None:
        self._time_s: list[float] = []
        self._sums: list[Array] = []  # (2, 2) each: of the velocities up to this record, and of their squares

    @classmethod
    def of(cls, time_s: Vector, mps: Array) -> "VelocityHistory":
        """Return the history of n records at ascending times, (n,), with starboard and forward velocity, (n, 2)."""
        made = cls()
        made._time_s = time_s.tolist()
        made._sums = list(np.cumsum(np.stack([mps, mps**2], axis=1), axis=0))
        return made

    def add(self, time_s: float, mps: Vector) -> None:
        """Add a record, (2,); one that comes late is put in its place."""
        row = bisect.bisect_right(self._time_s, time_s)
        gained: Array = np.array([mps, mps**2])
        self._time_s.insert(row, time_s)
        self._sums.insert(row, gained + (self._sums[row - 1] if row else 0.0))
        for later in range(row + 1, len(self._sums)):
            self._sums[later] = self._sums[later] + gained

    def in_gap(self, time_s: float, walk_mps: float) -> UsualVelocity | None:
        """Return the process from a time on; None if the last record is recent or none came, or the walk is 0.

        ``walk_mps`` is the random walk of the velocity, its standard deviation after one second.
        """
        count = bisect.bisect_right(self._time_s, time_s)
        if not count or time_s - self._time_s[count - 1] <= LONGEST_GAP_S or not walk_mps:
            return None
        mean, square = self._sums[count - 1] / count
        span_s = self._time_s[count - 1] - self._time_s[0]
        variance = np.maximum(square - mean**2, 0.0)  # not below 0 by rounding
        variance = (ASSUMED_FOR_S * ASSUMED_SD_MPS**2 + span_s * variance) / (ASSUMED_FOR_S + span_s)
        return UsualVelocity(mean, np.sqrt(variance), 2 * variance / max(walk_mps**2, np.finfo(float).tiny))
