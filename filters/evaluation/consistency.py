"""Does a filter's error have the size that the filter says? NEES, NIS, and a verdict in words.

NEES is the squared error of east and north normalised by its covariance: 2 on average where the covariance is right
(Y. Bar-Shalom, X. Rong Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section
5.4). The chi-square bounds there count independent errors; those of a navigation filter stay alike for many seconds,
so the bounds here use the effective number of independent ones.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from usbldr.filters.models.noise import chi_square_quantile
from usbldr.filters.types import OUTCOMES, Array, Trajectory, Vector

DOF = 2  # fixed: east and north
CONFIDENCE = 0.95  # of the bounds of NEES and NIS: the usual one
EXPECTED_COVERAGE = (0.683, 0.954, 0.997)  # fixed: of a normal error within 1, 2, 3 sigma of its axis
LEAST_VARIANCE_M2 = 1e-12  # a filter that claims to know better than a micrometre is taken to claim that


def nees(error_m: Array, cov_m2: Array) -> Vector:
    """Return e' P^-1 e for errors (M, 2) and their covariances (M, 2, 2): (M,)."""
    variance_m2, axes = np.linalg.eigh(cov_m2)
    along_m = np.einsum("mij,mi->mj", axes, error_m)
    return np.sum(along_m**2 / np.maximum(variance_m2, LEAST_VARIANCE_M2), axis=1)


def effective_number(whitened: Array) -> float:
    """Return how many independent errors the M correlated rows of (M, k) are worth for a mean of squares.

    G. V. Bayley and J. M. Hammersley, "The 'effective' number of independent observations in an autocorrelated time
    series", J. R. Stat. Soc. Suppl. 8(2), 1946: M / (1 + 2 sum (1 - lag/M) rho^2) for a variance; the sum ends where
    rho first falls to noise.
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


def nees_metrics(error_m: Array, cov_m2: Array) -> dict[str, float]:
    """Return the mean NEES with the bounds that a right covariance keeps in 95 of 100 runs."""
    known = np.isfinite(cov_m2).all(axis=(1, 2))
    if not known.any():
        return {}
    e, P = error_m[known], cov_m2[known]
    value = nees(e, P)
    independent = effective_number(e / sigmas(P))
    low, high = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
    return {
        "nees_mean": float(value.mean()),
        "nees_low": chi_square_quantile(low, DOF * independent) / independent,
        "nees_high": chi_square_quantile(high, DOF * independent) / independent,
        "independent_errors": independent,
    }


def sigma_coverage(error_m: Array, cov_m2: Array) -> dict[str, float]:
    """Return the share of the 2 M errors of an axis that lie within 1, 2 and 3 of that axis's sigmas."""
    known = np.isfinite(cov_m2).all(axis=(1, 2))
    if not known.any():
        return {}
    in_sigmas = np.abs(error_m[known]) / sigmas(cov_m2[known])
    return {f"inside_{k}_sigma": float(np.mean(in_sigmas <= k)) for k in (1, 2, 3)}


def sigmas(cov_m2: Array) -> Array:
    """Return the 1-sigma of east and north, (M, 2), of covariances (M, 2, 2)."""
    variance_m2: Array = np.diagonal(cov_m2, axis1=1, axis2=2)
    return np.sqrt(np.maximum(variance_m2, LEAST_VARIANCE_M2))


def innovation_metrics(trajectory: Trajectory) -> dict[str, float]:
    """Return per sensor the mean NIS, what it should be, and what became of the measurements.

    Rejected ones are left out of the mean: the filter itself says that its model is not theirs.
    """
    found: dict[str, float] = {}
    for sensor in sorted({update.sensor for update in trajectory.updates}):
        mine = [part for update in trajectory.updates if update.sensor == sensor for part in update.parts]
        taken = [update for update in mine if update.outcome != "rejected" and math.isfinite(update.nis)]
        if taken:
            found[f"nis_mean_{sensor}"] = float(np.mean([update.nis for update in taken]))
            found[f"nis_expected_{sensor}"] = float(np.mean([update.dof for update in taken]))
        found |= _counts(f"updates_{{}}_{sensor}", [update.outcome for update in mine])
    return found


def fix_counts(trajectory: Trajectory) -> dict[str, float]:
    """Return what became of the USBL fixes, and the longest time without a used one."""
    fixes = [update for update in trajectory.updates if update.sensor == "usbl"]
    if not fixes:
        return {}
    last = {update.time_s: update.outcome for update in fixes}  # of several fixes at the same instant
    used_s = [float(trajectory.time_s[0]), float(trajectory.time_s[-1])]
    used_s += [time_s for time_s, outcome in last.items() if outcome != "rejected"]
    counts = _counts("fixes_{}", [update.outcome for update in fixes])
    return {**counts, "longest_fix_gap_s": float(np.diff(np.sort(used_s)).max())}


def _counts(name: str, fates: Sequence[str]) -> dict[str, float]:
    return {name.format(fate.replace("-", "_")): float(fates.count(fate)) for fate in OUTCOMES}


def consistency_text(metrics: Mapping[str, float]) -> str:
    """Say in words whether the filter's sigmas are to be believed; "" where it states none.

    The number is how many times too small (over-confident) or too large (under-confident) they are.
    """
    if "nees_mean" not in metrics:
        return ""
    factor = math.sqrt(metrics["nees_mean"] / DOF)
    if metrics["nees_mean"] > metrics["nees_high"]:
        return f"over-confident by {factor:.1f}" if factor >= 1.05 else "slightly over-confident"
    if metrics["nees_mean"] < metrics["nees_low"]:
        return f"under-confident by {1 / max(factor, 1e-6):.1f}" if factor <= 1 / 1.05 else "slightly under-confident"
    return "consistent"
