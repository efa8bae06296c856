"""Errors, distances and particles of one track, as typed values: metres, seconds, per cent.

A field of a typed part declares its metric: the name in report.json, which way is better, and the meaning.
"""

from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args, get_type_hints

import numpy as np

from usbldr.filters.types import Array, Trajectory, Truth, Vector

SURFACING_GAP_S = 30.0  # after a longer gap of the truth, the error at its next sample is a surfacing error
Direction: TypeAlias = Literal["lower", "higher", "both"]  # which way is better; both: neither is


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
    rmse_m: Annotated[float, Metric("rmse_{}_m", "Root mean square of the {} error.", "lower")]
    mean_abs_m: Annotated[float, Metric("mean_abs_{}_m", "Mean of the absolute {} error.", "lower")]
    median_abs_m: Annotated[float, Metric("median_abs_{}_m", "Median of the absolute {} error.", "lower")]
    std_abs_m: Annotated[float, Metric("std_abs_{}_m", "Standard deviation of the absolute {} error.", "lower")]
    min_abs_m: Annotated[float, Metric("min_abs_{}_m", "Smallest absolute {} error.", "lower")]
    p95_abs_m: Annotated[float, Metric("p95_abs_{}_m", "95th percentile of the absolute {} error.", "lower")]
    max_abs_m: Annotated[float, Metric("max_abs_{}_m", "Largest absolute {} error.", "lower")]


class HorizontalErrors(NamedTuple):
    """Lengths of the errors in the plane."""

    rmse_m: Annotated[float, Metric("rmse_horizontal_m", "Root mean square of the horizontal error.", "lower")]
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
