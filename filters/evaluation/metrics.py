"""The numbers of an error report, by the names that they have in report.json: metres, seconds, per cent."""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Trajectory, Truth, Vector

_ABSOLUTE = ("mean", "median", "std", "min", "p95", "max")
METRICS = (
    *(f"{name}_{axis}_m" for axis in ("east", "north") for name in ("bias", "rmse", *(f"{n}_abs" for n in _ABSOLUTE))),
    *(f"{name}_horizontal_m" for name in ("rmse", *_ABSOLUTE, "final")),
    *("surfacing_error_m", "surfacing_percent", "distance_m", "drift_percent"),
    *("nees_mean", "nees_low", "nees_high", "independent_errors"),
    *("inside_1_sigma", "inside_2_sigma", "inside_3_sigma"),
    *("fixes_used", "fixes_down_weighted", "fixes_rejected", "longest_fix_gap_s"),
    *("ess_mean_ratio", "acceptance_mean", "matched", "coverage", "filter_time_s", "real_time_factor"),
)
"""Every metric by name; beside them nis_mean_, nis_expected_ and updates_<fate>_ for each sensor that was used."""

SURFACING_GAP_S = 30.0  # after a longer silence of the truth its next sample tells what the dive has cost


def error_metrics(error_m: Array) -> dict[str, float]:
    """Return the statistics of errors (M, 2): each axis signed and absolute, and the horizontal length."""
    found: dict[str, float] = {}
    for axis, e in zip(("east", "north"), error_m.T, strict=True):
        found[f"bias_{axis}_m"] = float(e.mean())
        for name, value in _statistics(np.abs(e)).items():
            found[f"rmse_{axis}_m" if name == "rmse" else f"{name}_abs_{axis}_m"] = value
    length = np.hypot(*error_m.T)
    found |= {f"{name}_horizontal_m": value for name, value in _statistics(length).items()}
    found["final_horizontal_m"] = float(length[-1])
    return found


def _statistics(e: Vector) -> dict[str, float]:
    """Return evo's statistics in its order, and the 95th percentile, of errors that have no sign."""
    return {
        "rmse": float(np.sqrt(np.mean(e**2))),
        "mean": float(e.mean()),
        "median": float(np.median(e)),
        "std": float(e.std()),
        "min": float(e.min()),
        "p95": float(np.percentile(e, 95)),
        "max": float(e.max()),
    }


def distance_travelled_m(trajectory: Trajectory) -> Vector | None:
    """Return the distance travelled since the track's start, (T,), metres; None where the track tells no speed.

    The estimated speed is integrated, not the track: corrections by fixes are no way made good.
    """
    u, v = trajectory.state("u"), trajectory.state("v")
    if u is None or v is None:
        return None
    speed = np.hypot(u, v)
    steps = (speed[1:] + speed[:-1]) / 2 * np.diff(trajectory.time_s)
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])


def run_metrics(trajectory: Trajectory) -> dict[str, float]:
    """Return what the run cost and how its particles fared."""
    found: dict[str, float] = {}
    if trajectory.seconds > 0:
        found["filter_time_s"] = trajectory.seconds
        found["real_time_factor"] = float(trajectory.time_s[-1] - trajectory.time_s[0]) / trajectory.seconds
    if trajectory.particles > 1 and trajectory.ess is not None and np.isfinite(trajectory.ess).any():
        found["ess_mean_ratio"] = float(np.nanmean(trajectory.ess)) / trajectory.particles
    if trajectory.acceptance is not None and np.isfinite(trajectory.acceptance).any():
        found["acceptance_mean"] = float(np.nanmean(trajectory.acceptance))
    return found


class Surfacing(NamedTuple):
    """The error at the first truth sample after a gap: what a dive without sight of the truth has cost."""

    time_s: float
    gap_s: float
    error_m: float
    distance_m: float  # travelled since the last truth sample; NaN where the track tells no speed
    percent: float  # error in per cent of that


def surfacings(
    time_s: Vector, position_m: Array, travelled_m: Vector | None, truth: Truth, start_s: float, end_s: float
) -> tuple[Surfacing, ...]:
    """Return each end of a truth gap over 30 s between start and end, with the track's error there.

    The one place where the track is interpolated, to the instant of the truth; where its own epochs are further apart
    than the truth's longest allowed gap, nothing is said.
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


def surfacing_metrics(found: tuple[Surfacing, ...]) -> dict[str, float]:
    """Return the mean over the surfacings, and their errors in per cent of the way between them."""
    if not found:
        return {}
    metrics = {"surfacing_error_m": float(np.mean([s.error_m for s in found]))}
    told = [s for s in found if s.distance_m > 0]
    if told:
        metrics["surfacing_percent"] = 100 * sum(s.error_m for s in told) / sum(s.distance_m for s in told)
    return metrics
