"""Errors, distances and particles of one track, as typed values: metres, seconds, per cent.

A field of a typed part declares its metric: the name in report.json, which way is better, and the meaning.
"""

from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args, get_type_hints

import numpy as np

from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Indices, Mask, Trajectory, Truth, Vector

SURFACING_GAP_S = 30.0  # after a longer gap of the truth, the error at its next sample is a surfacing error
Direction: TypeAlias = Literal["lower", "higher", "both"]  # which way is better; both: neither is
LENGTHS_M = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)  # three a decade
STEP_M = 5.0  # [m] of the way between two points that measure it: shorter ones would add the noise of a GPS
LEAST_SEGMENTS = 2.0  # of a length fit into the way, one behind the other


class Metric(NamedTuple):
    """One number of a report: {} in its name and meaning is the axis or the sensor."""

    name: str
    meaning: str
    direction: Direction = "both"


def declared(part: type, place: str) -> dict[str, Metric]:
    """Return the metric of each field of a typed part, of this axis or sensor."""
    hints: dict[str, Any] = get_type_hints(part, include_extras=True)
    found: dict[str, Metric] = {field: get_args(hint)[1] for field, hint in hints.items()}
    return {k: m._replace(name=m.name.format(place), meaning=m.meaning.format(place)) for k, m in found.items()}


def by_name(part: type, place: str, value: tuple[float | None, ...] | None) -> dict[str, float | None]:
    """Return a part's numbers by their names in report.json, all None for a part that does not apply."""
    names = [metric.name for metric in declared(part, place).values()]
    numbers = (None,) * len(names) if value is None else value
    return {name: None if n is None else float(n) for name, n in zip(names, numbers, strict=True)}


class AxisErrors(NamedTuple):
    """Errors along one axis, east or north."""

    bias_m: Annotated[float, Metric("bias_{}_m", "Signed mean of the {} error.")]
    rmse_m: Annotated[float, Metric("rmse_{}_m", "RMS of the {} error.", "lower")]
    mean_abs_m: Annotated[float, Metric("mean_abs_{}_m", "Mean of the absolute {} error.", "lower")]
    median_abs_m: Annotated[float, Metric("median_abs_{}_m", "Median of the absolute {} error.", "lower")]
    std_abs_m: Annotated[float, Metric("std_abs_{}_m", "Standard deviation of the absolute {} error.", "lower")]
    min_abs_m: Annotated[float, Metric("min_abs_{}_m", "Smallest absolute {} error.", "lower")]
    p95_abs_m: Annotated[float, Metric("p95_abs_{}_m", "95th percentile of the absolute {} error.", "lower")]
    max_abs_m: Annotated[float, Metric("max_abs_{}_m", "Largest absolute {} error.", "lower")]


class HorizontalErrors(NamedTuple):
    """Lengths of the errors in the plane."""

    rmse_m: Annotated[float, Metric("rmse_horizontal_m", "RMS of the horizontal error.", "lower")]
    mean_m: Annotated[float, Metric("mean_horizontal_m", "Mean horizontal error.", "lower")]
    median_m: Annotated[float, Metric("median_horizontal_m", "Median horizontal error, CEP50.", "lower")]
    std_m: Annotated[float, Metric("std_horizontal_m", "Standard deviation of the horizontal error.", "lower")]
    min_m: Annotated[float, Metric("min_horizontal_m", "Smallest horizontal error.", "lower")]
    p95_m: Annotated[float, Metric("p95_horizontal_m", "95th percentile of the horizontal error, CEP95.", "lower")]
    max_m: Annotated[float, Metric("max_horizontal_m", "Largest horizontal error.", "lower")]
    final_m: Annotated[float, Metric("final_horizontal_m", "Horizontal error of the last scored epoch.", "lower")]


class SurfacingErrors(NamedTuple):
    """Errors at the first truth samples after long gaps of the truth."""

    mean_m: Annotated[
        float, Metric("surfacing_error_m", "Mean error at the first truth sample after each long gap.", "lower")
    ]
    percent: Annotated[
        float | None, Metric("surfacing_percent", "Those errors over the distance travelled in the gaps.", "lower")
    ]


class Travel(NamedTuple):
    """How far the vehicle went, and how far dead reckoning drifted on the way."""

    distance_m: Annotated[float, Metric("distance_m", "Distance travelled by the estimated speed.")]
    drift_percent: Annotated[
        float | None, Metric("drift_percent", "Final error of dead reckoning over that distance.", "lower")
    ]


class Health(NamedTuple):
    """How the particles fared; None if there are none."""

    ess_mean_ratio: Annotated[
        float | None, Metric("ess_mean_ratio", "Mean effective number of particles over their number.")
    ]
    acceptance_mean: Annotated[
        float | None, Metric("acceptance_mean", "Mean share of the particles' moves that were accepted.")
    ]


class Coverage(NamedTuple):
    """How much of the track was compared with the truth."""

    matched: Annotated[int, Metric("matched", "Epochs compared with the truth.")]
    share: Annotated[float, Metric("coverage", "Share of the epochs compared with the truth.", direction="higher")]


def axis_errors(e: Vector) -> AxisErrors:
    """Return the statistics of the signed errors of one axis, (M,)."""
    return AxisErrors(float(e.mean()), *_statistics(np.abs(e)))


def horizontal_errors(error_m: Array) -> HorizontalErrors:
    """Return the statistics of the lengths of errors (M, 2)."""
    length = np.hypot(*error_m.T)
    return HorizontalErrors(*_statistics(length), float(length[-1]))


def rms(e: Vector) -> float:
    """Return the root mean square of errors (M,)."""
    return float(np.sqrt(np.mean(e**2)))


def _statistics(e: Vector) -> tuple[float, float, float, float, float, float, float]:
    """Return rmse, mean, median, std, min, 95th percentile and max of errors that have no sign."""
    return (
        rms(e),
        float(e.mean()),
        float(np.median(e)),
        float(e.std()),
        float(e.min()),
        float(np.percentile(e, 95)),
        float(e.max()),
    )


def distance_travelled_m(trajectory: Trajectory) -> Vector | None:
    """Return the distance travelled since the track's start, (T,), metres; None if the track has no speed.

    The estimated speed is integrated, not the track: corrections by fixes are no way made good.
    """
    u, v = trajectory.state("u"), trajectory.state("v")
    if u is None or v is None:
        return None
    speed = np.hypot(u, v)
    steps = (speed[1:] + speed[:-1]) / 2 * np.diff(trajectory.time_s)
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])


def health(trajectory: Trajectory) -> Health:
    """Return how the particles fared."""
    ess = acceptance = None
    if trajectory.particles > 1 and trajectory.ess is not None and np.isfinite(trajectory.ess).any():
        ess = float(np.nanmean(trajectory.ess)) / trajectory.particles
    if trajectory.acceptance is not None and np.isfinite(trajectory.acceptance).any():
        acceptance = float(np.nanmean(trajectory.acceptance))
    return Health(ess, acceptance)


class Surfacing(NamedTuple):
    """The error at the first truth sample after a gap: what a dive without sight of the truth has cost."""

    time_s: float
    gap_s: float
    error_m: float
    distance_m: float  # travelled since the last truth sample; NaN if the track has no speed
    percent: float  # error in per cent of that


def surfacings(
    time_s: Vector, position_m: Array, travelled_m: Vector | None, truth: Truth, start_s: float, end_s: float
) -> tuple[Surfacing, ...]:
    """Return each end of a truth gap over 30 s between start and end, with the track's error there.

    The one place where the track is interpolated, to the instant of the truth. If its own epochs are further apart
    than the truth's longest allowed gap, there is no error.
    """
    known = np.isfinite(position_m).all(axis=1)
    t, track_m = time_s[known], position_m[known]
    found: list[Surfacing] = []
    for row in np.flatnonzero(np.diff(truth.time_s) > SURFACING_GAP_S) + 1:
        left, up = float(truth.time_s[row - 1]), float(truth.time_s[row])
        after = int(np.searchsorted(t, up))
        if not (start_s <= up <= end_s and after < len(t)):
            continue
        before = max(after - 1, 0)
        if t[after] != up and (t[before] > up or t[after] - t[before] > truth.max_gap_s):
            continue
        there = np.array([np.interp(up, t, track_m[:, 0]), np.interp(up, t, track_m[:, 1])])
        error = float(np.hypot(*(there - truth.position_m[row])))
        way = float("nan")
        if travelled_m is not None:
            way = float(np.interp(up, time_s, travelled_m) - np.interp(left, time_s, travelled_m))
        found.append(Surfacing(up, up - left, error, way, 100 * error / way if way > 0 else float("nan")))
    return tuple(found)


def surfacing_errors(found: tuple[Surfacing, ...]) -> SurfacingErrors | None:
    """Return the statistics of the surfacings, None if there is none."""
    if not found:
        return None
    moved = [s for s in found if s.distance_m > 0]
    percent = 100 * sum(s.error_m for s in moved) / sum(s.distance_m for s in moved) if moved else None
    return SurfacingErrors(float(np.mean([s.error_m for s in found])), percent)


class HeadingErrors(NamedTuple):
    """Errors of the estimated heading, clockwise."""

    bias_deg: Annotated[float, Metric("bias_heading_deg", "Signed mean of the heading error, clockwise.")]
    rmse_deg: Annotated[float, Metric("rmse_heading_deg", "RMS of the heading error.", "lower")]
    max_abs_deg: Annotated[float, Metric("max_abs_heading_deg", "Largest absolute heading error.", "lower")]


class VelocityErrors(NamedTuple):
    """Errors of the estimated velocity along the axes of the vehicle."""

    bias_starboard_mps: Annotated[float, Metric("bias_starboard_mps", "Signed mean error of the starboard velocity.")]
    rmse_starboard_mps: Annotated[float, Metric("rmse_starboard_mps", "RMS error of the starboard velocity.", "lower")]
    bias_forward_mps: Annotated[float, Metric("bias_forward_mps", "Signed mean error of the forward velocity.")]
    rmse_forward_mps: Annotated[float, Metric("rmse_forward_mps", "RMS error of the forward velocity.", "lower")]


def heading_errors(track: Trajectory, scored: Mask, truth: Truth, rotation_rad: float) -> HeadingErrors | None:
    """Return the statistics at the scored epochs of a track that an alignment has turned; None if one has no yaw."""
    yaw_rad = track.state("psi")
    if yaw_rad is None or truth.yaw_rad is None:
        return None
    true_rad = np.interp(track.time_s[scored], truth.time_s, truth.yaw_rad)
    error_deg = -np.degrees(wrapped(yaw_rad[scored] + rotation_rad - true_rad))
    return HeadingErrors(float(error_deg.mean()), rms(error_deg), float(np.abs(error_deg).max()))


def velocity_errors(track: Trajectory, scored: Mask, truth: Truth) -> VelocityErrors | None:
    """Return the statistics at the scored epochs; None if the track or the truth has no velocity."""
    u_mps, v_mps = track.state("u"), track.state("v")
    if u_mps is None or v_mps is None or truth.velocity_mps is None:
        return None
    time_s = track.time_s[scored]
    starboard: Vector = u_mps[scored] - np.interp(time_s, truth.time_s, truth.velocity_mps[:, 0])
    forward: Vector = v_mps[scored] - np.interp(time_s, truth.time_s, truth.velocity_mps[:, 1])
    return VelocityErrors(float(starboard.mean()), rms(starboard), float(forward.mean()), rms(forward))


class RelativeError(NamedTuple):
    """The error over all segments of one length, in percent of the distance travelled."""

    length_m: float
    mean_percent: float
    rms_percent: float
    p95_percent: float
    segments: int  # one from each scored epoch, so that they overlap


def relative_errors(time_s: Vector, error_m: Array, truth_m: Array, max_gap_s: float) -> tuple[RelativeError, ...]:
    """Return the relative errors of each length that fits, of M epochs with errors and truth (M, 2).

    The distance travelled is that of the truth. A segment does not cross a gap longer than ``max_gap_s``.

    The change of the error over a segment does not depend on a constant shift, so it judges a track whose map origin is
    unknown. Navigators call it percent of distance travelled; evo and KITTI measure it likewise (A. Geiger, P. Lenz, R.
    Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012,
    doi:10.1109/CVPR.2012.6248074), but turn each segment onto the truth, which hides a wrong heading.
    """
    way_m = distance_m(truth_m)
    gaps = np.concatenate([[0], np.cumsum(np.diff(time_s) > max_gap_s)])
    found: list[RelativeError] = []
    for length_m in LENGTHS_M:
        if way_m[-1] < LEAST_SEGMENTS * length_m:
            break
        end: Indices = np.searchsorted(way_m, way_m + length_m)
        start = np.flatnonzero(end < len(way_m))
        start = start[gaps[start] == gaps[end[start]]]
        if not len(start):
            continue
        end = end[start]
        change_m: Vector = np.hypot(*(error_m[end] - error_m[start]).T)
        percent = 100 * change_m / (way_m[end] - way_m[start])
        rms = float(np.sqrt(np.mean(percent**2)))
        found.append(RelativeError(length_m, float(percent.mean()), rms, float(np.percentile(percent, 95)), len(start)))
    return tuple(found)


def distance_m(position_m: Array) -> Vector:
    """Return the distance travelled at M positions (M, 2), (M,): between points at least STEP_M apart, else by time."""
    rows = [0]
    for row, place_m in enumerate(position_m):
        if np.hypot(*(place_m - position_m[rows[-1]])) >= STEP_M:
            rows.append(row)
    steps_m = np.hypot(*np.diff(position_m[rows], axis=0).T)
    return np.interp(np.arange(len(position_m)), rows, np.concatenate([[0.0], np.cumsum(steps_m)]))
