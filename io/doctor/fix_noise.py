"""Findings on the noise of the fixes: gross errors, and a stated sigma that is wrong. Uses no truth."""

import numpy as np

from usbldr.filters.evaluation.noise_change import noise_change
from usbldr.filters.identification.dr_usbl_fit import residuals_m, without_errors
from usbldr.filters.identification.identification import Identification
from usbldr.filters.types import Timeline, Vector
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log

TAIL_DOF = 4.0  # [-] degrees of freedom of a heavy-tailed but healthy USBL, which has no gross errors
MEDIAN_SIGMAS = float(np.sqrt(TAIL_DOF * (2 ** (2 / TAIL_DOF) - 1)))  # fixed: half of its fixes are further out


def fix_noise_findings(log: Log, timeline: Timeline, found: Identification) -> list[Finding]:
    """Report gross errors of fixes, and a stated sigma that is far from their scatter, once freed of other errors."""
    stated_m: Vector = np.sqrt(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)
    residual_m = residuals_m(without_errors(timeline, found))
    sigmas = residual_m / stated_m
    used = np.isfinite(sigmas)
    if not used.any():
        return _stated_sd(log, stated_m, found)
    sigmas = sigmas * MEDIAN_SIGMAS / max(float(np.median(sigmas[used])), 1e-9)
    outliers = _outliers(log, timeline.fix_time_s, residual_m, sigmas)
    findings = [*outliers, *_stated_sd(log, stated_m, found)]
    if any(one.fix_sd_scale != 1 for one in found.parameters.changes):  # a SENSOR-CHANGE says it
        return findings
    return findings + _change(log, timeline.fix_time_s, sigmas)


def _outliers(log: Log, fix_time_s: Vector, residual_m: Vector, sigmas: Vector) -> list[Finding]:
    used = np.isfinite(sigmas)
    gross = (sigmas > THRESHOLDS.gross_sigmas) & (residual_m > THRESHOLDS.min_outlier_m)
    if not gross.any() or not exceeds_heavy_tail(sigmas[used]):
        return []
    worst = int(np.argmax(np.where(gross, residual_m, 0.0)))
    far = f"more than {THRESHOLDS.gross_sigmas:g} sigma from dead reckoning fitted to the others"
    time_s, worst_m = float(fix_time_s[worst]), float(residual_m[worst])
    text = (
        f"{gross.sum()} of {used.sum()} fixes are gross outliers, {far} (worst: {worst_m:.1f} m at "
        f"{time_s:.1f} s); use a robust noise family (the default) or a gate"
    )
    return [log.finding("USBL-OUTLIERS", "usbl", text, time_s, worst_m, "m")]


def _change(log: Log, fix_time_s: Vector, sigmas: Vector) -> list[Finding]:
    """Report a change of the noise within the dive, from the distance of fixes to dead reckoning fitted to them."""
    change = noise_change(fix_time_s, sigmas**2 / 2)
    if change is None:
        return []
    advice = "if it grows with the range, state range_sd_rel and the head under [usbl]"
    text = f"the noise of the fixes {change.text}; {advice}"
    return [log.finding("USBL-NOISE-CHANGE", "usbl", text, change.time_s, change.factor, "times")]


def exceeds_heavy_tail(sigmas: Vector) -> bool:
    """Tell whether more fixes are far out, beyond any distance, than heavy-tailed noise explains.

    The number beyond a distance is compared with a Poisson distribution of the expected number m. Of the chance of at
    least k > m, the first term of the sum times (k + 1) / (k + 1 - m) is an upper bound. The share of a bivariate
    Student-t that is further out than s sigmas is (1 + s² / TAIL_DOF)^(-TAIL_DOF / 2).
    """
    ordered = np.sort(sigmas)[::-1]
    k, m = np.arange(1, len(sigmas) + 1), len(sigmas) * (1 + ordered**2 / TAIL_DOF) ** (-TAIL_DOF / 2)
    far = (ordered > THRESHOLDS.gross_sigmas) & (k > m)
    k, m, log_factorial = k[far], m[far], np.cumsum(np.log(k))[far]
    log_chance = k * np.log(m) - m - log_factorial + np.log((k + 1) / (k + 1 - m))
    return bool(np.any(log_chance < np.log(THRESHOLDS.chance)))


def _stated_sd(log: Log, stated_m: Vector, found: Identification) -> list[Finding]:
    ratio = found.parameters.usbl_sd_scale / log.parameters.usbl_sd_scale
    if 1 / THRESHOLDS.noise_ratio < ratio < THRESHOLDS.noise_ratio:
        return []
    median_m = float(np.median(stated_m))
    text = (
        f"fixes scatter by {ratio:.2g} times their stated sd (median {median_m:.2f} m), outliers and slower "
        f"errors not included; state sd_scale = {found.parameters.usbl_sd_scale:.2g} under [usbl]"
    )
    return [log.finding("USBL-NOISE", "usbl", text, None, ratio * median_m, "m")]
