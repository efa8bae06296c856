"""Whether the innovations of the fixes are white: a right model leaves nothing to predict in the next one.

The normal scores of the used fixes are turned into the direction of travel. A clock, a latency or a lever arm that is
not modelled moves fixes along the track, a wrong heading across it: scores then keep their sign for many fixes. One
pair of neighbours hardly shows this beside the noise of fixes, the sum over many lags does. R. Mehra, "On the
identification of variances and adaptive Kalman filtering", IEEE Trans. Automatic Control 15(2), 1970,
doi:10.1109/TAC.1970.1099422; the autocorrelations of N white values are independent N(0, 1/N).
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from usbldr.filters.evaluation.metrics import Metric
from usbldr.filters.frames import rotated
from usbldr.filters.types import Trajectory, Vector
from usbldr.filters.updates import UpdateTable

LAGS = 20  # [fixes] half as many show a lever arm of 2 m a third less clearly, twice as many a third more
LEAST_FIXES = 5 * LAGS  # with fewer the last lags have too few pairs
WARNING_SIGMAS = 4.0  # of a sum; clean scenarios stay below 2


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
    """Return the autocorrelation of the USBL fixes; None for a track without velocity and for few fixes."""
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
