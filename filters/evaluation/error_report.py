"""The result of an evaluation: what was compared with the truth, and every metric in typed parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.evaluation.alignment import Alignment, ConstantShift
from usbldr.filters.evaluation.consistency import FixUpdates, Nees, SensorUpdates, SigmaShares, Whiteness, sigmas
from usbldr.filters.evaluation.metrics import (
    AxisErrors,
    Coverage,
    HeadingErrors,
    Health,
    HorizontalErrors,
    Metric,
    RelativeError,
    Surfacing,
    SurfacingErrors,
    Travel,
    VelocityErrors,
    by_name,
    declared,
)
from usbldr.filters.types import Array, Vector
from usbldr.filters.windows import TimeWindow


class Window(NamedTuple):
    """Which truth rows are scored: seconds from the log's start, both ends included."""

    start_s: float = -np.inf
    end_s: float = np.inf


WHOLE_LOG = Window()


LOW_COVERAGE = 0.8  # of the epochs to be scored: with less of them, a warning


class Matching(NamedTuple):
    """How many of the track's times found a truth, and why the others did not."""

    candidates: int  # times to be scored
    matched: int
    outside_window: int  # before --start or after --end
    outside_truth: int  # in the window, but before its first or after its last truth row
    in_gap: int  # of the truth
    aided: int  # in a window in which GPS aided the filter
    undefined: int  # the track itself has no finite position there
    truth_rows: int  # distinct truth samples that the matched times rest on

    @property
    def asked(self) -> int:
        """How many times the user wants scored."""
        return self.candidates - self.outside_window - self.aided

    @property
    def low(self) -> bool:
        """Whether so few of them have a truth that the errors do not stand for the run."""
        return self.matched < LOW_COVERAGE * self.asked


@dataclass(frozen=True, slots=True)
class ErrorReport:
    """M scored epochs of one track, and its metrics in typed parts; a part that does not apply is None."""

    method: str
    label: str  # the method, and what was done to its track
    truth_kind: str
    truth_source: str
    window: Window
    alignment: Alignment
    matching: Matching
    time_s: Vector  # (M,)
    estimate_m: Array  # (M, 2) east, north, after the alignment
    truth_m: Array  # (M, 2)
    truth_cov_m2: Array  # (M, 2, 2) of the truth itself; 0 where unknown
    cov_m2: Array | None  # (M, 2, 2) of the track alone, after the alignment
    surfacings: tuple[Surfacing, ...]
    aid: tuple[TimeWindow, ...]  # windows in which GPS aided the filter, so that nothing is scored there
    east: AxisErrors
    north: AxisErrors
    horizontal: HorizontalErrors
    shift: ConstantShift
    surfacing: SurfacingErrors | None
    travel: Travel | None
    heading: HeadingErrors | None
    velocity: VelocityErrors | None
    nees: Nees | None
    sigma_shares: SigmaShares | None
    fixes: FixUpdates | None
    whiteness: Whiteness | None
    health: Health
    sensors: Mapping[str, SensorUpdates]  # by name
    warnings: tuple[str, ...] = ()
    relative: tuple[RelativeError, ...] = ()  # by the length of the segments
    place_unknown: bool = False  # the origin that places the truth on the map of the track is not stated
    clock_share: float = 1.0  # of the mean square distance, left once the stamps of the truth are corrected

    @property
    def judged(self) -> bool:
        """Whether the errors are free of an unknown shift: the place of the truth is stated, or a shift is fitted."""
        return not self.place_unknown or self.alignment.name in ("shift", "first", "rigid")

    @property
    def mostly_shift(self) -> bool:
        """Whether a constant shift, which no alignment took off, makes up most of the error."""
        return self.judged and self.alignment.name in ("none", "body") and self.shift.dominates

    @property
    def error_m(self) -> Array:
        """Estimate minus truth, (M, 2)."""
        return self.estimate_m - self.truth_m

    @property
    def horizontal_m(self) -> Vector:
        """Length of the error, (M,)."""
        return np.hypot(*self.error_m.T)

    @property
    def sd_m(self) -> Array | None:
        """1-sigma of the error of east and north, the truth's own share included, (M, 2), or None."""
        return None if self.cov_m2 is None else sigmas(self.cov_m2 + self.truth_cov_m2)

    @property
    def coverage(self) -> Coverage:
        """How much of the track was compared with the truth."""
        return Coverage(self.matching.matched, self.matching.matched / self.matching.candidates)

    def flat(self) -> dict[str, float | None]:
        """Return METRICS by name, None for one that does not apply, then those of each sensor that do apply."""
        found: dict[str, float | None] = {}
        for place, part in PARTS:
            found |= by_name(part, place, getattr(self, place))
        for sensor, updates in self.sensors.items():
            numbers = by_name(SensorUpdates, sensor, updates)
            found |= {name: number for name, number in numbers.items() if number is not None}
        return found


PARTS: tuple[tuple[str, type], ...] = (
    ("east", AxisErrors),
    ("north", AxisErrors),
    ("horizontal", HorizontalErrors),
    ("shift", ConstantShift),
    ("surfacing", SurfacingErrors),
    ("travel", Travel),
    ("heading", HeadingErrors),
    ("velocity", VelocityErrors),
    ("nees", Nees),
    ("sigma_shares", SigmaShares),
    ("fixes", FixUpdates),
    ("whiteness", Whiteness),
    ("health", Health),
    ("coverage", Coverage),
)
"""The typed parts of a report by their names there, in the order of report.json."""

METRICS: tuple[Metric, ...] = tuple(metric for place, part in PARTS for metric in declared(part, place).values())
"""Every metric of a report; beside them those of SensorUpdates for each sensor that was used."""
