"""Whether a filter's errors have the size of its covariance: NEES, NIS, sigma coverage, and a verdict in words.

NEES is the squared error of east and north normalised by its covariance: 2 on average if the covariance is right
(Y. Bar-Shalom, X. Rong Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section
5.4). The chi-square bounds there count independent errors; those of a navigation filter stay correlated for many
seconds, so the bounds here use the effective number of independent errors.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.frames import rotated
from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.types import OUTCOMES, Array, Trajectory, Truth, Vector
from usbldr.filters.updates import UpdateTable

DOF = 2  # fixed: east and north
CONFIDENCE = 0.95  # of the bounds of NEES and NIS: the usual one
EXPECTED_COVERAGE = (0.683, 0.954, 0.997)  # fixed: of a normal error within 1, 2, 3 sigma of its axis
LEAST_VARIANCE_M2 = 1e-12  # (1 um)^2: the least variance that NEES divides by
LAGS = 20  # [fixes] half as many show a lever arm of 2 m a third less clearly, twice as many a third more
LEAST_FIXES = 5 * LAGS  # with fewer the last lags have too few pairs
WARNING_SIGMAS = 4.0  # of a sum; clean scenarios stay below 2


class Nees(NamedTuple):
    """The mean NEES, and the bounds that a right covariance keeps in 95 of 100 runs."""

    mean: Annotated[float, Metric("nees_mean", "Mean NEES of east and north; 2 is right.")]
    low: Annotated[float, Metric("nees_low", "Lower bound of the mean NEES of a right covariance.")]
    high: Annotated[float, Metric("nees_high", "Upper bound of the mean NEES of a right covariance.")]
    independent_errors: Annotated[float, Metric("independent_errors", "Effective number of independent errors.")]


class SigmaShares(NamedTuple):
    """The shares of the 2 M errors of an axis inside 1, 2 and 3 of that axis's sigmas."""

    inside_1: Annotated[float, Metric("inside_1_sigma", "Share of the errors inside 1 sigma.")]
    inside_2: Annotated[float, Metric("inside_2_sigma", "Share of the errors inside 2 sigma.")]
    inside_3: Annotated[float, Metric("inside_3_sigma", "Share of the errors inside 3 sigma.")]


class FixUpdates(NamedTuple):
    """What became of the USBL fixes."""

    used: Annotated[int, Metric("fixes_used", "USBL fixes used.")]
    down_weighted: Annotated[int, Metric("fixes_down_weighted", "USBL fixes that are likely outliers.")]
    rejected: Annotated[int, Metric("fixes_rejected", "USBL fixes rejected.")]
    longest_gap_s: Annotated[float, Metric("longest_fix_gap_s", "Longest time without a used fix.")]


class SensorUpdates(NamedTuple):
    """The updates of one sensor, with the NIS of all of them: it is the sum of the squared normal scores."""

    nis_mean: Annotated[float | None, Metric("nis_mean_{}", "Mean NIS of the {}, of all its updates.")]
    nis_expected: Annotated[float | None, Metric("nis_expected_{}", "What the mean NIS of the {} should be.")]
    used: Annotated[int, Metric("updates_used_{}", "Updates of the {} used.")]
    down_weighted: Annotated[int, Metric("updates_down_weighted_{}", "Updates of the {} that are likely outliers.")]
    rejected: Annotated[int, Metric("updates_rejected_{}", "Updates of the {} rejected.")]


def nees(error_m: Array, cov_m2: Array) -> Vector:
    """Return e' P^-1 e for errors (M, 2) and their covariances (M, 2, 2): (M,)."""
    variance_m2, axes = np.linalg.eigh(cov_m2)
    along_m = np.einsum("mij,mi->mj", axes, error_m)
    return np.sum(along_m**2 / np.maximum(variance_m2, LEAST_VARIANCE_M2), axis=1)


def effective_number(whitened: Array) -> float:
    """Return the number of independent errors whose mean square varies as that of M correlated rows (M, k).

    G. V. Bayley and J. M. Hammersley, "The 'effective' number of independent observations in an autocorrelated time
    series", J. R. Stat. Soc. Suppl. 8(2), 1946: M / (1 + 2 sum (1 - lag/M) rho^2) for a variance; the sum ends where
    rho first falls to 0.
    """
    M = len(whitened)
    spectrum = np.abs(np.fft.rfft(whitened, 2 * M, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum.sum(axis=1))[:M]
    if not covariance[0] > 0:
        return float(M)
    rho = covariance / covariance[0]
    end = int(np.argmax(rho <= 0)) if (rho <= 0).any() else M
    lags = np.arange(1, end)
    return M / (1 + 2 * float(np.sum((1 - lags / M) * rho[1:end] ** 2)))


def nees_with_bounds(mean: float, independent: float) -> Nees:
    """Return a mean NEES of so many independent errors with its bounds."""
    tails = (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2
    low, high = (chi_square_quantile(p, DOF * independent) / independent for p in tails)
    return Nees(mean, low, high, independent)


def consistency(error_m: Array, cov_m2: Array) -> tuple[Nees, SigmaShares] | None:
    """Compare errors (M, 2) with their covariances (M, 2, 2); None if no covariance is known."""
    known = np.isfinite(cov_m2).all(axis=(1, 2))
    if not known.any():
        return None
    e, P = error_m[known], cov_m2[known]
    in_sigmas = e / sigmas(P)
    shares = SigmaShares(*(float(np.mean(np.abs(in_sigmas) <= k)) for k in (1, 2, 3)))
    return nees_with_bounds(float(nees(e, P).mean()), effective_number(in_sigmas)), shares


def truth_covariances(truth: Truth, points_m: Array, sd_m: Vector, from_m: Vector) -> Array:
    """Return the covariances of points of the truth, (M, 2, 2), with their sigma per axis, (M,).

    A truth that is turned or scaled as a whole is so about the point `from_m`: its sigmas grow with the distance.
    """
    away_m = points_m - from_m
    across_m = away_m @ np.array([[0.0, 1.0], [-1.0, 0.0]])  # (-north, east)
    return (
        sd_m[:, None, None] ** 2 * np.eye(2)
        + truth.heading_sd_rad**2 * across_m[:, :, None] * across_m[:, None, :]
        + truth.scale_sd**2 * away_m[:, :, None] * away_m[:, None, :]
    )


def sigmas(cov_m2: Array) -> Array:
    """Return the 1-sigma of east and north, (M, 2), of covariances (M, 2, 2)."""
    variance_m2: Array = np.diagonal(cov_m2, axis1=1, axis2=2)
    return np.sqrt(np.maximum(variance_m2, LEAST_VARIANCE_M2))


def sensor_updates(trajectory: Trajectory) -> dict[str, SensorUpdates]:
    """Return for each sensor, by name, the mean NIS, what it should be, and what became of the measurements."""
    table = UpdateTable.of(trajectory.updates)
    parts, found = table.parts, dict[str, SensorUpdates]()
    for sensor in table.sensors:
        mine = parts.sensor == table.names.index(sensor)
        judged = mine & np.isfinite(parts.nis)
        known = bool(judged.any())
        mean = float(parts.nis[judged].mean()) if known else None
        expected = float(parts.dof[judged].mean()) if known else None
        outcomes = np.bincount(parts.outcome[mine], minlength=len(OUTCOMES))
        found[sensor] = SensorUpdates(mean, expected, *outcomes.tolist())
    return found


def fix_updates(trajectory: Trajectory) -> FixUpdates | None:
    """Return what became of the fixes, and the longest time without a used one; None if there was none."""
    fixes = UpdateTable.of(trajectory.updates).of_sensor("usbl")
    if not len(fixes):
        return None
    outcomes = fixes.outcome.tolist()
    last = dict(zip(fixes.time_s.tolist(), outcomes, strict=True))  # of several fixes at the same instant
    used_s = [float(trajectory.time_s[0]), float(trajectory.time_s[-1])]
    used_s += [time_s for time_s, outcome in last.items() if outcome != "rejected"]
    used, down_weighted, rejected = map(outcomes.count, OUTCOMES)
    return FixUpdates(used, down_weighted, rejected, float(np.diff(np.sort(used_s)).max()))


def consistency_text(found: Nees | None, shift_removed: bool = False) -> str:
    """Return whether the filter's sigmas are consistent, too small or too large; "" if it has no covariance.

    If a constant shift was taken off the errors, the sigmas contain it: too large ones are then no fault.
    """
    if found is None:
        return ""
    factor = math.sqrt(found.mean / DOF)
    if found.mean > found.high:
        return f"sigmas too small by a factor of {_factor(factor)}" if factor >= 1.05 else "sigmas slightly too small"
    if found.mean < found.low:
        large = 1 / max(factor, 1e-6)
        contain = ", but they contain the shift that was taken off" if shift_removed else ""
        by = f"too large by a factor of {_factor(large)}" if large >= 1.05 else "slightly too large"
        return f"sigmas {by}{contain}"
    return "consistent"


def _factor(number: float) -> str:
    return f"{number:.1f}" if number < 10 else f"{number:.0f}"


class Whiteness(NamedTuple):
    """Autocorrelation of the used fixes' normal scores along and across the track: 0 if the model is right."""

    along: Annotated[float, Metric("fix_correlation_along", "Lag-1 autocorrelation of innovations along the track.")]
    across: Annotated[float, Metric("fix_correlation_across", "Lag-1 autocorrelation of innovations across the track.")]
    se: Annotated[float, Metric("fix_correlation_se", "Standard error of these correlations if the model is right.")]
    along_sigmas: Annotated[
        float, Metric("fix_persistence_along", "Sum of the autocorrelation along the track over 20 lags, in sigmas.")
    ]
    across_sigmas: Annotated[
        float, Metric("fix_persistence_across", "Sum of the autocorrelation across the track over 20 lags, in sigmas.")
    ]


def whiteness(trajectory: Trajectory) -> Whiteness | None:
    """Return whether the innovations of the fixes are white; None for a track without velocity and for few fixes.

    A right model leaves nothing to predict in the next innovation. The normal scores of the used fixes are turned into
    the direction of travel. A clock, a latency or a lever arm that is not modelled moves fixes along the track, a wrong
    heading across it: scores then keep their sign for many fixes. One pair of neighbours hardly shows this beside the
    noise of fixes, the sum over many lags does. R. Mehra, "On the identification of variances and adaptive Kalman
    filtering", IEEE Trans. Automatic Control 15(2), 1970, doi:10.1109/TAC.1970.1099422; the autocorrelations of N white
    values are independent N(0, 1/N).
    """
    psi, u, v = (trajectory.state(name) for name in ("psi", "u", "v"))
    fixes = UpdateTable.of(trajectory.updates).of_sensor("usbl")
    scores, time_s = fixes.vectors("scores"), fixes.time_s
    used = np.flatnonzero((fixes.outcome == "used") & np.isfinite(scores).all(axis=1))
    if psi is None or u is None or v is None or len(used) < LEAST_FIXES:
        return None
    used = used[np.argsort(time_s[used], kind="stable")]
    at = np.searchsorted(trajectory.time_s, time_s[used]).clip(max=len(psi) - 1)
    V = rotated(psi[at], np.column_stack([u, v])[at])
    turned = rotated(-np.arctan2(V[:, 1], V[:, 0]), scores[used])
    (along, along_sum), (across, across_sum) = (_autocorrelation(score) for score in turned.T)
    return Whiteness(along, across, 1 / math.sqrt(len(used)), along_sum, across_sum)


def _autocorrelation(score: Vector) -> tuple[float, float]:
    """Return the autocorrelation at lag 1, and its sum over the lags in standard errors."""
    power = max(float(score @ score), 1e-12)
    rho = [float(score[lag:] @ score[:-lag]) / power for lag in range(1, LAGS + 1)]
    return rho[0], sum(rho) * math.sqrt(len(score) / LAGS)


def whiteness_warning(found: Whiteness | None) -> str | None:
    """Return a warning if the innovations are correlated; None otherwise."""
    if found is None or max(found.along_sigmas, found.across_sigmas) <= WARNING_SIGMAS:
        return None
    causes = {
        "along": (found.along_sigmas, "a clock, a latency, a lever arm or the scale of the DVL"),
        "across": (found.across_sigmas, "the heading or the misalignment of the DVL"),
    }
    side, (sigmas, cause) = max(causes.items(), key=lambda item: item[1][0])
    return (
        f"innovations of the fixes are correlated {side} the track ({sigmas:.0f} sigma; white noise stays below "
        f"{WARNING_SIGMAS:.0f}): {cause}, or an error that the fixes share, is not modelled; the sigmas are too small"
    )
