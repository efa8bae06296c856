"""Immutable values that the packages exchange.

A Timeline goes into a filter, a Trajectory comes out, and is evaluated against a Truth. io/ builds and writes them;
filters/ has no other access to a log. Times are seconds since the start of the log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]  # any shape, named where it is used
Vector: TypeAlias = NDArray[np.float64]  # (n,)
Indices: TypeAlias = NDArray[np.intp]  # (n,)
Mask: TypeAlias = NDArray[np.bool_]  # (n,)


@dataclass(frozen=True, slots=True)
class Outage:
    """A stretch of the log without records of a sensor, longer than its rate explains."""

    sensor: str  # "dvl", "compass" or "usbl"
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """DVL and compass on the fast grid (5 Hz), USBL fixes at their own times, the slow grid (1 Hz) of the errors.

    K epochs, F fixes. An epoch carries a DVL or compass measurement only from the records of its own interval
    [t_k - dt/2, t_k + dt/2), averaged; NaN elsewhere. A fix is never interpolated.
    """

    start_ns: int  # absolute time of time_s = 0, nanoseconds since 1970
    time_s: Vector  # (K,) k / fast rate
    slow: Indices  # (M,) epochs of the slow grid, at which errors are evaluated
    dvl_mps: Array  # (K, 2) starboard, forward; NaN: no record in its interval
    dvl_count: Indices  # (K,) records averaged
    dvl_sd_mps: Vector  # (K,) one record's 1-sigma per axis
    yaw_rad: Vector  # (K,) psi, unwrapped over the whole log; NaN: no record in its interval
    yaw_count: Indices  # (K,)
    yaw_sd_rad: Vector  # (K,) one record's 1-sigma
    # (K, 2) starboard, forward for dead reckoning: interpolated across short gaps, the usual velocity in longer ones
    dr_mps: Array
    dr_yaw_rad: Vector  # (K,) likewise, but constant in longer gaps
    fix_time_s: Vector  # (F,) time of validity, ascending
    fix_received_s: Vector  # (F,) when it reached the vehicle
    fix_m: Array  # (F, 2) east, north
    fix_cov_m2: Array  # (F, 2, 2)
    gps_time_s: Vector  # (G,) surface or truth GPS, starts dead reckoning; aids a filter only in stated windows
    gps_m: Array  # (G, 2) east, north
    outages: tuple[Outage, ...] = ()
    gps_sd_m: Vector | None = None  # (G,) 1-sigma per axis; NaN, or None for all, if unknown
    fix_away_m: Array | None = None  # (F, 2) of a fix from the head or beacon that it was measured from; None: unknown
    fix_levelled_by_m: Vector | None = None  # (F,) depth that made its slant range horizontal; 0 or None: none
    fix_ship_yaw_rad: Vector | None = None  # (F,) psi of the ship that carries the head; NaN, or None for all: unknown
    fix_is_gps: Mask | None = None  # (F,) which are aiding GPS fixes, see position_fixes.with_gps_fixes; None: none

    def with_fixes(self, rows: Indices | Mask) -> "Timeline":
        """Return the timeline with these fixes only, in this order; outages are unchanged."""
        columns = {one.name: getattr(self, one.name) for one in fields(self) if one.name.startswith("fix_")}
        return replace(self, **{name: None if column is None else column[rows] for name, column in columns.items()})


@dataclass(frozen=True, slots=True)
class Truth:
    """The reference track of T points, and its kind."""

    time_s: Vector  # (T,) ascending, without repeats
    position_m: Array  # (T, 2) east, north
    sd_m: Vector  # (T,) 1-sigma per axis; NaN if unknown
    kind: str  # "gps", "slam", "simulated" or "other": printed beside every error
    source: str  # topic or file
    max_gap_s: float = 30.0  # no errors are evaluated inside longer gaps
    heading_sd_rad: float = 0.0  # 1-sigma of a turn of the whole track about its first point
    scale_sd: float = 0.0  # 1-sigma of the scale of the whole track, likewise
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # its antenna: starboard, forward, up of the reference point
    yaw_rad: Vector | None = None  # (T,) unwrapped; None: unknown
    velocity_mps: Array | None = None  # (T, 2) starboard, forward
    section: str = "gps"  # of the configuration, whose latency_s times it
    latency_s: float = 0.0  # stated there, and already subtracted
    place_unknown: bool = False  # its origin on the map of the fixes is not stated: errors share an unknown shift

    def only(self, rows: Mask) -> "Truth":
        """Return the truth with some of its points, (T,)."""
        return replace(
            self,
            time_s=self.time_s[rows],
            position_m=self.position_m[rows],
            sd_m=self.sd_m[rows],
            yaw_rad=None if self.yaw_rad is None else self.yaw_rad[rows],
            velocity_mps=None if self.velocity_mps is None else self.velocity_mps[rows],
        )


OUTCOMES = ("used", "down-weighted", "rejected")  # of an update, from good to bad


class Update(NamedTuple):
    """How one measurement was used: innovation, NIS and outcome."""

    sensor: str  # "dvl", "compass", "usbl", "gps"
    axis: str  # "starboard", "forward", "yaw" or "position"; "east" or "north" of a part of a fix
    row: int  # which fix of the Timeline for USBL and GPS, which epoch otherwise
    time_s: float  # when it was used
    innovation: tuple[float, ...]  # measured minus predicted: m, m/s or rad; east and north of a fix
    innovation_sd: tuple[float, ...]  # predicted 1-sigma of the innovation
    nis: float  # sum of the squared scores; chi-square of dof if the model is right, for every noise family
    dof: int  # number of scalars: the expected NIS
    outcome: str  # "used", "down-weighted" (more likely an outlier than not) or "rejected" (gate or guard)
    nominal_probability: float  # posterior probability that the measurement is no outlier, see Noise.is_nominal
    shift: tuple[float, ...] | None = None  # change of each state, (n,); None if not of a position fix
    in_sequence: tuple["Update", ...] = ()  # updates of the axes of a fix, if used in sequence
    nominal_sd: tuple[float, ...] = ()  # as innovation_sd, for a measurement of the nominal noise mode
    scores: tuple[float, ...] = ()  # of the innovation: independent N(0, 1) if the model is right, see noise.py

    @property
    def parts(self) -> "tuple[Update, ...]":
        """The updates of each axis if used in sequence; else the update itself."""
        return self.in_sequence or (self,)

    @classmethod
    def combined(cls, parts: Sequence["Update"]) -> "Update":
        """Return the update of a measurement that was used in parts: summed NIS and shift, worst outcome."""
        first = parts[0]
        if len(parts) == 1:
            return first
        shifts = [part.shift for part in parts if part.shift is not None]
        return first._replace(
            axis="position",
            innovation=tuple(e for part in parts for e in part.innovation),
            innovation_sd=tuple(sd for part in parts for sd in part.innovation_sd),
            nominal_sd=tuple(sd for part in parts for sd in part.nominal_sd),
            nis=sum(part.nis for part in parts),
            dof=sum(part.dof for part in parts),
            outcome=max((part.outcome for part in parts), key=OUTCOMES.index),
            nominal_probability=min(part.nominal_probability for part in parts),
            shift=tuple(map(sum, zip(*shifts, strict=True))) if shifts else None,
            in_sequence=tuple(parts),
            scores=tuple(score for part in parts for score in part.scores),
        )


class Reacquisition(NamedTuple):
    """Fixes that contradicted the track, and whether they were accepted in the end."""

    since_s: float  # time of the first of them
    outage_s: float  # time without fixes before; inf at the start
    resolved_s: float  # time of the decision
    refused: int  # fixes rejected until then
    jump_m: float  # largest jump of the track at a change of hypothesis; 0 without
    accepted: bool  # the track followed the fixes


class OutageRecovery(NamedTuple):
    """The end of a USBL outage: residual of its first fixes and their correction of the track."""

    start_s: float  # of the outage
    end_s: float
    sd_start_m: float  # largest 1-sigma of the position in any direction at the start
    sd_end_m: float  # the same at the end
    residual_m: float  # distance of the median of the first fixes from the predicted track
    sigmas: float  # the same, in sigmas of track and fixes together
    correction_m: float  # displacement of the track by these fixes


def track_label(method: str, smoothed: bool) -> str:
    """Return what to call the track of a method."""
    return f"{method} smoothed" if smoothed else method


@dataclass(frozen=True, slots=True)
class Trajectory:
    """An estimated track of T epochs in n states, with the updates of its measurements.

    ``names`` label the states: psi (rad), u, v (m/s), r (rad/s), x, y (m), then calibration states. A plain track such
    as raw USBL has only x and y. ``cov`` is None if the method has no covariance.
    """

    method: str
    names: tuple[str, ...]
    time_s: Vector  # (T,)
    mean: Array  # (T, n)
    cov: Array | None  # (T, n, n)
    updates: Sequence[Update] = ()  # of a filter's run: an UpdateTable
    ess: Vector | None = None  # (T,) effective number of particles, of N
    particles: int = 1  # fixed: of a filter without particles
    acceptance: Vector | None = None  # (T,) share of accepted moves; NaN if none was tried
    warnings: tuple[str, ...] = ()
    seconds: float = float("nan")  # wall time that the filter took
    reacquisitions: tuple[Reacquisition, ...] = ()
    recoveries: tuple[OutageRecovery, ...] = ()
    smoothed: bool = False  # each epoch is estimated from the whole dive
    matched_noise: bool = False  # every fix had the covariance of the whole noise mixture
    open_cov_m2: Array | None = None  # (T, 2, 2) the part of cov that no fix lessens: of numbers settled before the run

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
        xy = np.array([self.names.index("x"), self.names.index("y")])
        return self.cov[:, xy[:, None], xy]

    def state(self, name: str) -> Vector | None:
        """Return one state over time, (T,), or None if the track has no such state."""
        return self.mean[:, self.names.index(name)] if name in self.names else None
