"""Residual of the first USBL fixes after an outage: the drift of dead reckoning, measured without truth.

Without fixes the covariance of the position grows. The residual in sigmas shows whether it grew enough, and the
correction shows whether the filter accepted the fixes: if it is over-confident, a robust likelihood takes them all for
outliers. Metres, east and north.
"""

import math

import numpy as np

from usbldr.filters.evaluation.consistency import nees
from usbldr.filters.frames import rotated
from usbldr.filters.models.calibration import STATES
from usbldr.filters.models.noise import TO_SD, chi_square_quantile
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.models.sensors import UsblFix
from usbldr.filters.models.states import MOTION_STATES, POSITION, StateLayout
from usbldr.filters.replay.position_fixes import usbl_fixes
from usbldr.filters.types import Array, OutageRecovery, Timeline, Vector
from usbldr.filters.windows import integrated

MAX_RECOVERY_FIXES, MIN_RECOVERY_FIXES = 5, 3  # fixes: their median tolerates two outliers in five
FALSE_ALARM_PROBABILITY = 0.001  # of a warning if the covariance is right


def outage_recoveries(
    timeline: Timeline, parameters: Parameters, layout: StateLayout, mean: Array, cov: Array
) -> tuple[OutageRecovery, ...]:
    """Return one recovery for each USBL outage that ended in the log.

    ``mean`` (K, n) and ``cov`` (K, n, n) are the filtered ones of each epoch, never smoothed ones.
    """
    fixes, t = usbl_fixes(timeline, parameters, layout), timeline.time_s
    usbl_outages = [outage for outage in timeline.outages if outage.sensor == "usbl"]
    constant = slice(len(MOTION_STATES), None)  # calibration states, which change by the fixes alone
    H = np.zeros((2, len(layout)))  # of a fix, without its latency
    H[[0, 1], POSITION] = 1.0
    for axis, row in enumerate(layout.existing(*STATES["usbl-bias"])):
        H[axis, row] = 1.0
    recoveries: list[OutageRecovery] = []
    for outage in usbl_outages:
        until_s = min((other.start_s for other in usbl_outages if other.start_s >= outage.end_s), default=t[-1])
        after = (fixes.time_s >= outage.end_s - 1e-9) & (fixes.time_s <= until_s + 1e-9)
        rows = np.flatnonzero(after)[:MAX_RECOVERY_FIXES]
        start, end = np.searchsorted(t, (outage.start_s, outage.end_s - 1e-9)).tolist()
        if len(rows) < MIN_RECOVERY_FIXES or not end:
            continue
        last = end - 1  # the epoch before the first fix
        predicted = mean.T.copy()  # the track without these fixes
        predicted[POSITION, last:] = mean[last, POSITION, None] + _displacement_m(mean[last:].T, t[last:])
        predicted[constant, last:] = mean[last, constant, None]
        epochs = np.searchsorted(t, fixes.time_s[rows] - 1e-9)
        models = (UsblFix(layout, s, fixes.lever_m) for s in (fixes.time_s[rows] - t[epochs]).tolist())
        predicted_m = [model.predict(predicted[:, k]) for model, k in zip(models, epochs, strict=True)]
        offsets_m = fixes.position_m[rows] - predicted_m
        median_residual_m = np.median(offsets_m, axis=0)
        stated_m2 = fixes.cov_m2[rows].mean(axis=0).diagonal()
        scatter_m2 = (TO_SD * np.median(np.abs(offsets_m - median_residual_m), axis=0)) ** 2
        median_m2 = math.pi / 2 / len(rows) * np.diag(np.maximum(stated_m2, scatter_m2))
        P = cov[[min(start, last), last]][:, POSITION][:, :, POSITION]
        start_m, end_m = np.sqrt(np.linalg.eigvalsh(P)[:, -1]).tolist()
        expected_m2 = H @ cov[last] @ H.T + median_m2
        sigmas = math.sqrt(float(nees(median_residual_m[None], expected_m2[None])[0]))
        residual_m = math.hypot(*median_residual_m)
        correction_m = math.hypot(*(mean[epochs[-1], POSITION] - predicted[POSITION, epochs[-1]]))
        spans = outage.start_s, outage.end_s, start_m, end_m
        recoveries.append(OutageRecovery(*spans, residual_m, sigmas, correction_m))
    return tuple(recoveries)


def _displacement_m(x: Array, time_s: Vector) -> Array:
    """Return the displacement since the first epoch, (2, K), from the velocity of the states, (n, K)."""
    return integrated(time_s, rotated(x[0], x[1:3].T)).T


def recovery_warning(one: OutageRecovery) -> str | None:
    """Return a warning if the residual exceeds what the covariance allows; None otherwise."""
    if one.sigmas**2 <= chi_square_quantile(1 - FALSE_ALARM_PROBABILITY, 2):
        return None
    return (
        f"after a USBL outage of {one.end_s - one.start_s:.0f} s the first fixes at {one.end_s:.1f} s are "
        f"{one.residual_m:.1f} m from the track ({one.sigmas:.1f} sigma) and moved it by {one.correction_m:.1f} m: "
        "check heading, mounting and scale of DVL and compass (usbldr doctor), and whether these fixes are outliers"
    )
