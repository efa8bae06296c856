"""Findings on the fixes: gross errors, a stated sigma that is wrong, and whether they move as dead reckoning does."""

import numpy as np

from usbldr.filters.evaluation.noise_change import noise_change
from usbldr.filters.identification.dr_usbl_fit import (
    Points,
    as_points,
    dead_reckoned,
    fit_rotation,
    fix_points,
    residuals_m,
    segment_numbers,
    without_errors,
)
from usbldr.filters.identification.identification import Identification
from usbldr.filters.models.parameters import NOT_SMOOTHED
from usbldr.filters.replay.dead_reckoning import corrected
from usbldr.filters.types import Indices, Timeline, Vector
from usbldr.io.doctor.interpretations import InterpretationResult, reinterpret
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.findings import Finding
from usbldr.io.log import Log

TAIL_DOF = 4.0  # [-] degrees of freedom of a heavy-tailed but healthy USBL, which has no gross errors
TURN_RATIO = 10.0  # [-] of distances to the next fix and to a later one: the scatter of one place gives 1 to 3
TURN_SHARE = 1 / 3  # [-] of the fixes: more than outliers give, less than two places by chance, 0.44
MIN_TURNS = 20  # [fixes] by judgement: fewer show no turns
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


def motion_findings(
    log: Log, timeline: Timeline, result: InterpretationResult, found: Identification | None = None
) -> list[Finding]:
    """Report fixes that move unlike dead reckoning by its best interpretation, else a truth that moves unlike them.

    A ship's sensor moves otherwise. Movements are those within a minute, freed of the white noise of the fixes, which
    second differences show, and of the changes of sensors that are found, as of a DVL that measures through a current.
    """
    line, fit = reinterpret(log, timeline, result.best.flips), result.best.fit
    group = segment_numbers(line, line.fix_time_s)
    if found is not None and (found.parameters.changes or found.parameters.smoothing != NOT_SMOOTHED):
        line = corrected(line, found.parameters)
        fit = fit_rotation(line, group)
    latency_s = fit.latency_s
    track = np.exp(1j * fit.rotation_rad) * dead_reckoned(line, line.fix_time_s - latency_s)
    if (apart_m := apart_by_turns_m(fix_points(line) - track)) > THRESHOLDS.min_outlier_m:
        text = (
            f"fixes lie by turns in places {apart_m:.0f} m apart, as of two transponders or vehicles: state target "
            "under [usbl] if a column names them; else record each under a name of its own"
        )
        return [log.finding("USBL-TURNS", "usbl", text, None, apart_m, "m")]
    unlike, median = (
        unexplained_share(line.fix_time_s, track, fix_points(line), group, share)
        for share in (THRESHOLDS.sound_share, 0.5)
    )
    if unlike > THRESHOLDS.unlike_share:
        text = (
            "the fixes move unlike dead reckoning, so that they decide nothing about conventions and sensor "
            "errors: name the topic of this vehicle's transponder (--usbl TOPIC), not the ship's end or another "
            "vehicle's; else check DVL and heading"
        )
        return [log.finding("USBL-MOTION", "usbl", text)]
    truth = log.truth
    apart = any(one.code == "PLACES-APART" for one in log.findings)  # exchanged coordinates move otherwise, too
    if truth is None or apart or len(truth.time_s) < 2 or median > THRESHOLDS.unlike_share:
        return []  # fixes and dead reckoning agree too little to judge a truth
    time_s = line.fix_time_s - latency_s
    after = np.searchsorted(truth.time_s, time_s).clip(1, len(truth.time_s) - 1)
    known = np.diff(truth.time_s)[after - 1] <= truth.max_gap_s
    known &= (time_s >= truth.time_s[0]) & (time_s <= truth.time_s[-1])
    there = np.interp(time_s, truth.time_s, as_points(truth.position_m))
    unlike = unexplained_share(time_s, there, track, np.where(known, group, -1), 0.5)
    if unlike <= THRESHOLDS.unlike_share:
        return []
    text = (
        f"{truth.source}: the truth moves unlike the fixes of {log.topic_of('usbl')} and dead reckoning, which agree: "
        "it is of another vehicle, such as the ship (then perhaps topic of head under [usbl]); name another by --truth "
        "or --gps"
    )
    return [Finding("TRUTH-MOTION", text, truth.source)]


def apart_by_turns_m(beside: Points) -> float:
    """Return how far apart fixes lie that take turns between places, from their places beside a track; 0 if none do.

    The next one of a third of them is far away, and one of the three after that near. Of outliers, which do not lie
    together, a quarter of all at most: half of the correct ones, if these are half of all.
    """
    if len(beside) < MIN_TURNS:
        return 0.0
    next_m, *later_m = (np.abs(beside[k : len(beside) - 4 + k] - beside[:-4]) for k in range(1, 5))
    turns = next_m > TURN_RATIO * np.min(later_m, axis=0)
    return float(np.median(next_m[turns])) if turns.mean() > TURN_SHARE else 0.0


def unexplained_share(time_s: Vector, one: Points, other: Points, group: Indices, quantile: float) -> float:
    """Return the share of the squared movement of two tracks in which they differ; 0 if there is too little to see.

    It is the quantile of all movements.
    """
    apart = one - other
    later = np.searchsorted(time_s, time_s + THRESHOLDS.displacement_s)
    first = np.flatnonzero(later < len(time_s))
    first = first[(group[first] >= 0) & (group[first] == group[later[first]])]
    if len(first) < THRESHOLDS.min_displacements:
        return 0.0
    bends: Vector = np.abs(apart[1:-1] - (apart[:-2] + apart[2:]) / 2)[group[1:-1] >= 0]
    noise_m2 = 4 / 3 * float(np.median(bends)) ** 2  # of the difference of two fixes
    moved_m2 = np.maximum(*(np.abs(p[later[first]] - p[first]) ** 2 for p in (one, other)))
    changed_m2: Vector = np.abs(apart[later[first]] - apart[first]) ** 2
    if float(np.median(moved_m2)) <= THRESHOLDS.gross_sigmas**2 * noise_m2:
        return 0.0
    return float(np.quantile((changed_m2 - noise_m2) / np.maximum(moved_m2, 1e-9), quantile))
