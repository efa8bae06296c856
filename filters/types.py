"""The values that travel between the packages: arrays in, arrays out, nothing mutable.

A Timeline goes into a filter, a Trajectory comes out, a Truth judges it. io/ builds and writes them; filters/ knows
nothing else of a log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]  # any shape, named where it is used
Vector: TypeAlias = NDArray[np.float64]  # (n,)
Indices: TypeAlias = NDArray[np.intp]  # (n,)
Mask: TypeAlias = NDArray[np.bool_]  # (n,)


@dataclass(frozen=True, slots=True)
class Outage:
    """A stretch of the log in which a sensor gave nothing, longer than its own rate explains."""

    sensor: str  # "dvl", "compass" or "usbl"
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Timeline:
    """DVL and compass on the fast grid (5 Hz), USBL fixes at their own times, the slow grid (1 Hz) of the errors.

    K epochs, F fixes. An epoch carries a DVL or compass measurement only from the records of its own interval
    [t_k - dt/2, t_k + dt/2), averaged; NaN elsewhere. A fix is never interpolated.
    """

    start_ns: int  # absolute time of time_s = 0, nanoseconds since 1970
    time_s: Vector  # (K,) k / fast rate
    slow: Indices  # (M,) the epochs at which errors are taken: time_s[slow] is the slow grid
    dvl_mps: Array  # (K, 2) starboard, forward; NaN: no record of its own
    dvl_count: Indices  # (K,) records averaged
    dvl_sd_mps: Vector  # (K,) one record's 1-sigma per axis
    yaw_rad: Vector  # (K,) psi, unwrapped over the whole log; NaN: no record of its own
    yaw_count: Indices  # (K,)
    yaw_sd_rad: Vector  # (K,) one record's 1-sigma
    dr_mps: Array  # (K, 2) starboard, forward for dead reckoning: interpolated across short gaps, held beyond
    dr_yaw_rad: Vector  # (K,) likewise
    fix_time_s: Vector  # (F,) time of validity, ascending
    fix_received_s: Vector  # (F,) when the vehicle knew of it
    fix_m: Array  # (F, 2) east, north
    fix_cov_m2: Array  # (F, 2, 2)
    gps_time_s: Vector  # (G,) surface or truth GPS, for starting dead reckoning, and in stated windows for a filter
    gps_m: Array  # (G, 2) east, north
    outages: tuple[Outage, ...] = ()
    gps_sd_m: Vector | None = None  # (G,) 1-sigma per axis; NaN, or None at all, where unknown

    def with_fixes(self, rows: Indices | Mask) -> "Timeline":
        """Return the timeline with these of its fixes alone, in this order; outages stay those of the log."""
        names = ("fix_time_s", "fix_received_s", "fix_m", "fix_cov_m2")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True, slots=True)
class Truth:
    """The reference track, T points, and what kind of truth it is."""

    time_s: Vector  # (T,) ascending, without repeats
    position_m: Array  # (T, 2) east, north
    sd_m: Vector  # (T,) 1-sigma per axis; NaN where unknown
    kind: str  # "gps", "slam", "simulated" or "other": printed beside every error
    source: str  # topic or file
    max_gap_s: float = 30.0  # errors are not taken inside longer gaps


OUTCOMES = ("used", "down-weighted", "rejected")  # of an update, from good to bad


class Update(NamedTuple):
    """What became of one measurement."""

    sensor: str  # "dvl", "compass", "usbl", "gps"
    axis: str  # "starboard", "forward", "yaw" or "position"; "east" or "north" of a part of a fix
    row: int  # which fix of the Timeline for USBL and GPS, which epoch otherwise
    time_s: float  # when it was used
    innovation: tuple[float, ...]  # measured minus predicted: m, m/s or rad; east and north of a fix
    innovation_sd: tuple[float, ...]  # 1-sigma of the innovation by the filter's own account
    nis: float  # innovation squared, normalised by its covariance under the whole noise model
    dof: int  # what nis should be on average
    outcome: str  # "used", "down-weighted" (more likely an outlier than not) or "rejected" (gate or guard)
    nominal_probability: float  # posterior probability of the nominal noise mode
    shift: tuple[float, ...] | None = None  # by which it moved each state; None where it told no position
    in_sequence: tuple["Update", ...] = ()  # of each axis of a fix, if they were taken one after the other

    @property
    def parts(self) -> "tuple[Update, ...]":
        """What was taken one after the other; the update itself if that was all at once."""
        return self.in_sequence or (self,)

    @classmethod
    def combined(cls, parts: Sequence["Update"]) -> "Update":
        """Return what became of a measurement that was taken in parts: their sums, and the worst of their outcomes."""
        first = parts[0]
        if len(parts) == 1:
            return first
        shifts = [part.shift for part in parts if part.shift is not None]
        return first._replace(
            axis="position",
            innovation=tuple(e for part in parts for e in part.innovation),
            innovation_sd=tuple(sd for part in parts for sd in part.innovation_sd),
            nis=sum(part.nis for part in parts),
            dof=sum(part.dof for part in parts),
            outcome=max((part.outcome for part in parts), key=OUTCOMES.index),
            nominal_probability=min(part.nominal_probability for part in parts),
            shift=tuple(map(sum, zip(*shifts, strict=True))) if shifts else None,
            in_sequence=tuple(parts),
        )


class Reacquisition(NamedTuple):
    """Fixes that told of another place than the track had, and what was made of them in the end."""

    since_s: float  # the first of them
    outage_s: float  # how long there had been no fix before; infinite at the start
    resolved_s: float  # when the track took the side that it kept
    refused: int  # fixes that the track did not follow while it was not clear
    jump_m: float  # the farthest that it jumped when it took another side; 0 where it did not
    accepted: bool  # the track went where the fixes told


class OutageRecovery(NamedTuple):
    """The end of a silence of the USBL, what its first fixes said of the track, and what they did to it."""

    start_s: float  # of the silence
    end_s: float
    sd_start_m: float  # 1-sigma of the position in its worst direction, when the silence began
    sd_end_m: float  # when it ended
    residual_m: float  # how far the first fixes lay from where the track then was, by their median
    sigmas: float  # the same in terms of what track and fixes claim together
    correction_m: float  # how far they moved the track


def track_label(method: str, smoothed: bool) -> str:
    """Return what to call the track of a method."""
    return f"{method} smoothed" if smoothed else method


@dataclass(frozen=True, slots=True)
class Trajectory:
    """An estimated track of T epochs in n states, and the story of its measurements.

    ``names`` label the states: psi (rad), u, v (m/s), r (rad/s), x, y (m), then calibration states. A plain track such
    as raw USBL has only x and y. ``cov`` is None where the method claims no uncertainty.
    """

    method: str
    names: tuple[str, ...]
    time_s: Vector  # (T,)
    mean: Array  # (T, n)
    cov: Array | None  # (T, n, n)
    updates: tuple[Update, ...] = ()
    ess: Vector | None = None  # (T,) effective number of particles, of N
    particles: int = 1  # fixed: of a filter without particles
    acceptance: Vector | None = None  # (T,) share of accepted moves; NaN where none was tried
    warnings: tuple[str, ...] = ()
    seconds: float = float("nan")  # wall time that the filter took
    reacquisitions: tuple[Reacquisition, ...] = ()
    recoveries: tuple[OutageRecovery, ...] = ()
    smoothed: bool = False  # each epoch is estimated from the whole dive

    @property
    def label(self) -> str:
        """What to call the track."""
        return track_label(self.method, self.smoothed)

    @property
    def position_m(self) -> Array:
        """East and north, (T, 2)."""
        return self.mean[:, [self.names.index("x"), self.names.index("y")]]

    @property
    def position_cov_m2(self) -> Array | None:
        """Covariance of east and north, (T, 2, 2), or None."""
        if self.cov is None:
            return None
        xy = [self.names.index("x"), self.names.index("y")]
        return self.cov[:, xy][:, :, xy]

    def state(self, name: str) -> Vector | None:
        """Return one state over time, (T,), or None where the track has no such state."""
        return self.mean[:, self.names.index(name)] if name in self.names else None
