"""Velocity in a gap of the DVL: it relaxes to what the vehicle usually did, learnt from its own records so far.

While records come, u and v are random walks, since a past without manoeuvres must not resist one. Without them each
axis is an Ornstein-Uhlenbeck process, dv = -(v - m) dt / T + q dW: m is the mean of all records up to now, s their
standard deviation about it, and T = 2 s^2 / q^2, so that over short times it is the same random walk q. Its variance
never exceeds s^2, where that of a held velocity grows without end. Metres per second, body frame; seconds.

G. E. Uhlenbeck and L. S. Ornstein, "On the theory of the Brownian motion", Physical Review 36, 1930,
doi:10.1103/PhysRev.36.823.
"""

from typing import Any, NamedTuple

import numpy as np

from usbldr.filters.types import Array, Mask, Vector

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
    """The DVL records so far; what it states about a time depends on the records up to that time alone."""

    def __init__(self) -> None:
        self._count = 0
        self._time_s = np.empty(1)  # (m,) of which the first ``count`` are records
        self._sums = np.empty((1, 2, 2))  # of the velocities up to each record, and of their squares

    @classmethod
    def of(cls, time_s: Vector, mps: Array) -> "VelocityHistory":
        """Return the history of n records at ascending times, (n,), with starboard and forward velocity, (n, 2)."""
        made = cls()
        if len(time_s):
            made._count, made._time_s = len(time_s), time_s
            made._sums = np.cumsum(np.stack([mps, mps**2], axis=1), axis=0)
        return made

    def add(self, time_s: float, mps: Vector) -> None:
        """Add a record, (2,); one that comes late is put in its place."""
        row, end = self._before(time_s), self._count
        if end == len(self._time_s):  # twice the room, so that adding n records costs n
            self._time_s = np.resize(self._time_s, 2 * end + 1)
            self._sums = np.resize(self._sums, (2 * end + 1, 2, 2))
        gained: Array = np.array([mps, mps**2])
        self._time_s[row + 1 : end + 1] = self._time_s[row:end].copy()
        self._sums[row + 1 : end + 1] = self._sums[row:end] + gained
        self._time_s[row] = time_s
        self._sums[row] = gained + (self._sums[row - 1] if row else 0.0)
        self._count += 1

    def _before(self, time_s: float | Vector) -> Any:
        """Return how many records come at a time or before it."""
        return self._time_s[: self._count].searchsorted(time_s, side="right")

    def gaps(self, time_s: Vector) -> Mask:
        """Return which times, (n,), lie in a gap: the last record before them is not recent."""
        count = self._before(time_s)
        return (count > 0) & (time_s - self._time_s[np.maximum(count - 1, 0)] > LONGEST_GAP_S)

    def in_gap(self, time_s: float, walk_mps: float) -> UsualVelocity | None:
        """Return the process from a time on; None if the last record is recent or none came, or the walk is 0.

        ``walk_mps`` is the random walk of the velocity, its standard deviation after one second.
        """
        count = self._before(time_s)
        if not count or time_s - self._time_s[count - 1] <= LONGEST_GAP_S or not walk_mps:
            return None
        mean, square = self._sums[count - 1] / count
        span_s = float(self._time_s[count - 1] - self._time_s[0])
        variance = np.maximum(square - mean**2, 0.0)  # not below 0 by rounding
        variance = (ASSUMED_FOR_S * ASSUMED_SD_MPS**2 + span_s * variance) / (ASSUMED_FOR_S + span_s)
        return UsualVelocity(mean, np.sqrt(variance), 2 * variance / max(walk_mps**2, np.finfo(float).tiny))
