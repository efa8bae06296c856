"""Judge a track against the truth: which times, which alignment, which errors. Metres, east and north.

Truth is interpolated linearly to the track's own times, never the other way round: a truth of 0.4 Hz would otherwise
pick 0.4 Hz of the track. Times outside the truth, or inside one of its longer gaps, are left out and counted.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.evaluation.alignment import Alignment, fit_alignment
from usbldr.filters.evaluation.consistency import fix_counts, innovation_metrics, nees_metrics, sigma_coverage, sigmas
from usbldr.filters.evaluation.metrics import (
    Surfacing,
    distance_travelled_m,
    error_metrics,
    run_metrics,
    surfacing_metrics,
    surfacings,
)
from usbldr.filters.types import Array, Mask, Trajectory, Truth, Vector
from usbldr.filters.windows import TimeWindow, in_windows, windows_text

FEW_EPOCHS = 5  # with fewer, mean and RMS say next to nothing
LOW_COVERAGE = 0.8  # of the epochs that the truth covers: with less of them, a warning
LATE_FIRST_S = 5.0  # --align first joins two instants this far apart only with a warning


class Window(NamedTuple):
    """Which truth rows count: seconds from the log's start, both ends included."""

    start_s: float = -np.inf
    end_s: float = np.inf


WHOLE_LOG = Window()


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


@dataclass(frozen=True, slots=True)
class ErrorReport:
    """M scored epochs of one track, and every metric by its name in report.json."""

    filter: str
    truth_kind: str
    truth_source: str
    window: Window
    alignment: Alignment
    matching: Matching
    time_s: Vector  # (M,)
    estimate_m: Array  # (M, 2) east, north, after the alignment
    truth_m: Array  # (M, 2)
    truth_sd_m: Vector  # (M,) 1-sigma per axis; 0 where unknown
    cov_m2: Array | None  # (M, 2, 2) of the track alone, after the alignment
    surfacings: tuple[Surfacing, ...]
    aid: tuple[TimeWindow, ...]  # windows in which GPS aided the filter, so that nothing is scored there
    metrics: Mapping[str, float]  # a metric that does not apply is absent
    warnings: tuple[str, ...] = ()

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
        return None if self.cov_m2 is None else sigmas(_with_truth(self.cov_m2, self.truth_sd_m))


def evaluate(
    trajectory: Trajectory,
    truth: Truth,
    window: Window = WHOLE_LOG,
    align: str = "none",
    times_s: Vector | None = None,
    aid: tuple[TimeWindow, ...] = (),
) -> ErrorReport:
    """Score a track at those of its epochs that ``times_s`` names (None: all of them).

    A filter or dr is scored on the slow grid, ``timeline.time_s[timeline.slow]``; raw fixes each at its own stamp. The
    window chooses truth rows; what is scored lies between the first and the last row left, and outside the windows
    ``aid`` in which GPS aided the filter. Raise LogError where nothing is left to score.
    """
    rows = (truth.time_s >= window.start_s) & (truth.time_s <= window.end_s)
    if not np.any(rows):
        raise LogError(
            f"{truth.source}: no truth row between {window.start_s:g} and {window.end_s:g} s of the log "
            f"({len(truth.time_s)} rows, {_span(truth.time_s)}): choose other --start and --end, or check its clock"
        )
    row_s, row_m = truth.time_s[rows], truth.position_m[rows]

    t, track_m = trajectory.time_s, trajectory.position_m
    defined = np.isfinite(track_m[:, 0]) & np.isfinite(track_m[:, 1])
    wanted = np.ones(len(t), np.bool_) if times_s is None else _same_times(t, times_s)
    within = (t >= row_s[0]) & (t <= row_s[-1])
    gap = _inside_gap(t, row_s, truth.max_gap_s)
    aided = in_windows(t, aid)
    scored = wanted & within & ~gap & defined & ~aided
    if np.any(aided) and not np.any(scored):
        raise LogError(
            f"{trajectory.filter}: all of its epochs that the truth {truth.source} could judge lie in the windows that "
            f"GPS aids ({windows_text(aid)}): leave some of the log out of them"
        )
    if not np.any(scored):
        raise LogError(
            f"{trajectory.filter}: none of its epochs ({_span(t[wanted & defined])}) can be compared with the truth "
            f"{truth.source} ({_span(row_s)}, gaps over {truth.max_gap_s:g} s left out): check the two clocks "
            "(latency_s, clock_offset_s), --start and --end"
        )

    beyond = (t < window.start_s) | (t > window.end_s)
    candidates = len(t) if times_s is None else len(times_s)
    matching = Matching(
        candidates=candidates,
        matched=_count(scored),
        outside_window=_count(wanted & beyond),
        outside_truth=_count(wanted & ~beyond & ~within),
        in_gap=_count(wanted & within & gap & ~aided),
        aided=_count(wanted & within & aided),
        undefined=_count(wanted & within & ~gap & ~defined & ~aided) + candidates - _count(wanted),
        truth_rows=_rows_used(t[scored], row_s),
    )

    time_s = t[scored]
    truth_m = np.column_stack([np.interp(time_s, row_s, row_m[:, 0]), np.interp(time_s, row_s, row_m[:, 1])])
    first = int(np.flatnonzero(within & defined & ~aided)[0])
    first_row = int(np.argmin(in_windows(row_s, aid)))
    alignment = fit_alignment(align, track_m[first], row_m[first_row], track_m[scored], truth_m)
    estimate_m = alignment.points(track_m[scored])
    error_m = estimate_m - truth_m
    truth_sd_m = np.nan_to_num(np.interp(time_s, row_s, truth.sd_m[rows]))
    cov = trajectory.position_cov_m2
    cov_m2 = None if cov is None else alignment.covariances(cov[scored])

    travelled_m = distance_travelled_m(trajectory)
    found = surfacings(t, alignment.points(track_m), travelled_m, truth, *window)
    found = tuple(one for one in found if not in_windows(np.array([one.time_s]), aid)[0])
    metrics = {**error_metrics(error_m), **surfacing_metrics(found)}
    if travelled_m is not None:
        # unaligned, the error has grown since the track's start; aligned, since the alignment
        start = first if align != "none" else int(np.flatnonzero(defined)[0])
        metrics["distance_m"] = float(travelled_m[np.flatnonzero(scored)[-1]] - travelled_m[start])
        if trajectory.filter == "dr" and metrics["distance_m"] > 0:
            metrics["drift_percent"] = 100 * metrics["final_horizontal_m"] / metrics["distance_m"]
    if cov_m2 is not None:
        whole_m2 = _with_truth(cov_m2, truth_sd_m)
        metrics |= nees_metrics(error_m, whole_m2) | sigma_coverage(error_m, whole_m2)
    metrics |= innovation_metrics(trajectory) | fix_counts(trajectory) | run_metrics(trajectory)
    metrics |= {"matched": float(matching.matched), "coverage": matching.matched / matching.candidates}

    warnings = _warnings(matching, truth)
    if align == "first" and t[first] - row_s[first_row] > LATE_FIRST_S:
        late_s = t[first] - row_s[first_row]
        warnings += (
            f"--align first put the track's first epoch, {t[first]:.1f} s, on a truth row {late_s:.1f} s "
            "earlier: choose a --start at which both exist",
        )
    return ErrorReport(
        filter=trajectory.filter,
        truth_kind=truth.kind,
        truth_source=truth.source,
        window=window,
        alignment=alignment,
        matching=matching,
        time_s=time_s,
        estimate_m=estimate_m,
        truth_m=truth_m,
        truth_sd_m=truth_sd_m,
        cov_m2=cov_m2,
        surfacings=found,
        aid=aid,
        metrics=metrics,
        warnings=warnings,
    )


def _warnings(matching: Matching, truth: Truth) -> tuple[str, ...]:
    """Say a low coverage, unless the user chose it by the window, and a track that broke off."""
    found: list[str] = []
    asked = matching.candidates - matching.outside_window - matching.aided
    if matching.matched < LOW_COVERAGE * asked:
        outside = f"{matching.outside_truth} lie before or after it" if matching.outside_truth else ""
        gaps = f"{matching.in_gap} in its gaps over {truth.max_gap_s:g} s" if matching.in_gap else ""
        why = ", ".join(filter(None, (outside, gaps)))
        found.append(f"only {matching.matched} of {asked} epochs could be compared with the truth{why and ': '}{why}")
    if matching.matched < FEW_EPOCHS:
        found.append(f"these numbers rest on {matching.matched} of the track's epochs alone: they say next to nothing")
    if matching.undefined:
        found.append(f"the track has no position at {matching.undefined} epochs; they are left out of the errors")
    return tuple(found)


def _with_truth(cov_m2: Array, truth_sd_m: Vector) -> Array:
    return cov_m2 + truth_sd_m[:, None, None] ** 2 * np.eye(2)


def _count(mask: Mask) -> int:
    return int(np.count_nonzero(mask))


def _span(time_s: Vector) -> str:
    return f"{time_s[0]:.1f} to {time_s[-1]:.1f} s" if len(time_s) else "none at all"


def _same_times(track_s: Vector, wanted_s: Vector) -> Mask:
    """Return which of the track's times are wanted; grids agree to a microsecond."""
    return np.isin(np.round(track_s * 1e6), np.round(wanted_s * 1e6))


def _inside_gap(time_s: Vector, row_s: Vector, longest_s: float) -> Mask:
    """Return which times lie strictly between two truth rows further apart than ``longest_s``."""
    before = np.clip(np.searchsorted(row_s, time_s, side="right") - 1, 0, len(row_s) - 1)
    after = np.clip(np.searchsorted(row_s, time_s, side="left"), 0, len(row_s) - 1)
    return row_s[after] - row_s[before] > longest_s


def _rows_used(time_s: Vector, row_s: Vector) -> int:
    before = np.searchsorted(row_s, time_s, side="right") - 1
    after = np.searchsorted(row_s, time_s, side="left")
    return len(np.unique(np.concatenate([before, after])))
