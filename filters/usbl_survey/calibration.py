"""Fit of a head's installation to the fixes of a transponder that lies still.

The residuals of range and angles have Student-t errors, whose sigmas are estimated with the installation, so that false
fixes count little. The covariance is that of an M-estimator with correlated residuals: it holds for noise of another
distribution, and for errors that last longer than one fix (Newey and West 1987, doi:10.2307/1913610).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Mask, Vector
from usbldr.filters.usbl_survey.geometry import LATENCIES, NAMES, PLACE, UsblSurvey, placed, residuals

DOF = 4.0  # of the errors' distribution: heavy tails, and 95 % of the information if they are normal
PRIOR_SD = np.array([10.0, 10.0, 180.0, 0.05, 30.0, 30.0, 1.0, 1.0, 1e5, 1e5, 1e4])
"""By NAMES: what an installation may have, wide enough for every ship; they decide only what a survey leaves open."""
STEP = np.array([0.01, 0.01, 0.01, 1e-5, 0.01, 0.01, 0.25, 1.0, 0.01, 0.01, 0.01])
"""Of differences, by NAMES. Over a shorter time, the noise of positions looks like speed, and tells a latency."""
HEADING = NAMES.index("mount_heading_deg")  # fixed
STARTS_DEG = tuple(range(0, 360, 45))  # of the mount's heading: within a quarter turn of any
FITTED = 4  # of the starts, those of the lowest costs: a transponder below has a mirror image
FIRST_ROUNDS = 15  # of Gauss-Newton steps from each start, by judgement: ten are usual
MAX_ROUNDS = 400  # of the steps after
FALSE_ROUNDS = 12  # of searches for false fixes: one or two are usual; with wrong axes or headings they find no end
MIN_CHANGE = 1e-4  # of a sigma: the fit has converged
MIN_FIXES = 40  # four for each parameter that a pattern can settle
AT_EDGE = 0.005  # [-] of the fixes, by judgement: so many may be false in every second round, at the very edge
FALSE_SIGMAS = 7.0  # of a residual: 2 in 1000 of good ones, by their heavy tails
RANGE, ANGLE = 0, 1  # kinds of residuals; bearing and elevation share a sigma
KINDS = np.array([RANGE, ANGLE, ANGLE])


class Known(NamedTuple):
    """What is known besides the fixes: values and 1-sigma by NAMES, each (11,)."""

    values: Vector
    sd: Vector


@dataclass(frozen=True, slots=True)
class Installation:
    """The fitted errors of an installation and the place of the transponder."""

    values: Vector  # (11,) by NAMES
    cov: Array  # (11, 11)
    noise_sd: Vector  # (3,) of ranges in metres, of bearings and elevations in radians
    good: Mask  # (n,) not a false fix

    @property
    def sd(self) -> Vector:
        """1-sigma by NAMES, (11,)."""
        return np.sqrt(np.diag(self.cov))


def assumed(survey: UsblSurvey, stated: Vector) -> Vector:
    """Return the values with the stated installation, and the transponder at the median of its fixes."""
    values = stated.copy()
    if np.isfinite(survey.direction).any():
        values[PLACE] = np.nanmedian(placed(survey, values), axis=0) * [1, 1, -1]
    else:
        east_north = np.nanmedian(survey.ship.positions(survey.time_s, 0.0), axis=0)
        values[PLACE] = [*east_north, float(np.nanmin(survey.range_m))]
    return values


def calibrated(survey: UsblSurvey, stated: Vector, known: Known, starts: bool = True) -> Installation:
    """Fit the installation; raise LogError if too few fixes remain, or the fit does not converge.

    ``stated`` (11,) is where the search begins: the configuration's values. With ``starts`` its heading is also tried
    in steps of 45 degrees, as a head may be mounted at any angle, and the transponder begins at the median of fixes.
    """
    usable = np.isfinite(residuals(survey, assumed(survey, stated))[:, :2]).all(axis=1).sum()
    if usable < MIN_FIXES:
        raise LogError(f"{usable} fixes have the ship's position and attitude; at least {MIN_FIXES} are needed")
    begun = [_begun(survey, stated)]
    if starts:
        turns = np.outer(STARTS_DEG, np.arange(len(NAMES)) == HEADING)
        begun = [_begun(survey, assumed(survey, stated + turn)) for turn in turns]
        begun = sorted(begun, key=lambda fit: cost(survey, fit, known))[:FITTED]
    fits = [_fitted(survey, one, known, FIRST_ROUNDS)[0] for one in begun]
    return _without_false(survey, min(fits, key=lambda fit: cost(survey, fit, known)), known)


def _without_false(survey: UsblSurvey, fit: Installation, known: Known) -> Installation:
    """Fit again without the false fixes until they are the same: many of them widen all sigmas, and look good then."""
    converged, changed = False, 0
    for _ in range(FALSE_ROUNDS):
        r = residuals(survey, fit.values)
        good: Mask = ~np.any(np.abs(r) > FALSE_SIGMAS * _median_sds(r), axis=1)
        good &= np.isfinite(r[:, :2]).all(axis=1)
        changed = int(np.sum(good != fit.good))
        if not changed:
            break
        if int(good.sum()) < MIN_FIXES:
            raise LogError(f"{int(good.sum())} of {len(good)} fixes agree with each other; {MIN_FIXES} are needed")
        fit, converged = _fitted(survey.part(good), fit, known)
        fit = replace(fit, good=good)
    if not converged or changed > AT_EDGE * len(survey):
        raise LogError(
            "the fit of the USBL's installation does not converge; check head, heading_topic, their conventions and "
            "axes, and if most fixes are false"
        )
    return _with_covariance(survey.part(fit.good), fit, known)


def levelled(survey: UsblSurvey, stated: Vector, known: Known) -> UsblSurvey:
    """Return the survey as it is, or as one whose fixes are level already: the better fit decides.

    Raises LogError as `calibrated` does.
    """
    surveys = (survey, replace(survey, level=True))
    fits = [calibrated(one, stated, known) for one in surveys]
    good = fits[0].good & fits[1].good
    costs = [cost(one.part(good), fit, known) for one, fit in zip(surveys, fits, strict=True)]
    return surveys[0] if costs[0] <= costs[1] else surveys[1]


def expected(survey: UsblSurvey, values: Vector, known: Known, sd: tuple[float, float]) -> Installation:
    """Return the fit to be expected of fixes whose Student-t errors have these sigmas (metres, radians)."""
    fit = Installation(values, np.eye(len(NAMES)), np.array(sd)[KINDS], np.ones(len(survey), dtype=np.bool_))
    _, G, _ = _in_sigmas(survey, fit)
    information = (DOF + 1) / (DOF + 3) * np.einsum("nki,nkj->ij", G, G)
    return replace(fit, cov=_inverse(information + np.diag(known.sd**-2.0)))


def _inverse(information: Array) -> Array:
    """Return the inverse of an information matrix, scaled first: its units differ by orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(information))
    inverse = np.asarray(np.linalg.inv(information * np.outer(scale, scale)), dtype=np.float64)
    return inverse * np.outer(scale, scale)


def _begun(survey: UsblSurvey, values: Vector) -> Installation:
    none = np.zeros(len(survey), dtype=bool)
    return Installation(values, np.eye(len(NAMES)), _median_sds(residuals(survey, values)), none)


def _median_sds(r: Array) -> Vector:
    """Return the sigmas, (3,), by the medians of residuals (n, 3), which hold with many false fixes."""
    sd = [np.nanmedian(np.abs(part)) / 0.6745 for part in (r[:, 0], r[:, 1:])]
    return np.maximum(sd, [1e-3, 1e-6])[KINDS]


def _in_sigmas(survey: UsblSurvey, fit: Installation) -> tuple[Array, Array, Mask]:
    """Return residuals (n, 3) and derivatives (n, 3, 11) over the sigmas, and which are known; 0 where they are not."""
    r, J = residuals(survey, fit.values), _derivatives(survey, fit.values)
    there = np.isfinite(r) & np.isfinite(J).all(axis=2)
    sd = fit.noise_sd
    return np.where(there, r, 0.0) / sd, np.where(there[..., None], J, 0.0) / sd[None, :, None], there


def cost(survey: UsblSurvey, fit: Installation, known: Known) -> float:
    """Return minus the log posterior, but for a constant."""
    z = residuals(survey, fit.values) / fit.noise_sd
    tails = (DOF + 1) / 2 * np.log1p(z**2 / DOF) + np.log(fit.noise_sd)
    return float(np.nansum(tails) + 0.5 * np.sum(((fit.values - known.values) / known.sd) ** 2))


def _fitted(
    survey: UsblSurvey, begun: Installation, known: Known, rounds: int = MAX_ROUNDS
) -> tuple[Installation, bool]:
    """Return the fit by reweighted Gauss-Newton steps with Levenberg's damping, and whether it converged."""
    fit, lowest, damping = begun, cost(survey, begun, known), 1e-3
    for _ in range(rounds):
        z, G, there = _in_sigmas(survey, fit)
        w = (DOF + 1) / (DOF + z**2) * there
        H = np.einsum("nk,nki,nkj->ij", w, G, G) + np.diag(known.sd**-2.0)
        g = np.einsum("nk,nki,nk->i", w, G, z) + (fit.values - known.values) / known.sd**2
        step: Vector = -_inverse(H + damping * np.diag(np.diag(H))) @ g
        values = fit.values + step
        moved = _with_noise(survey, values, w, fit)
        trial = cost(survey, moved, known)
        if not trial < lowest + 1e-9:
            damping = max(damping * 10, 1e-6)
            if damping > 1e9:  # records have noise, and so has the cost: no step lowers it
                return fit, bool(np.isfinite(lowest))
            continue
        small = np.max(np.abs(step) * np.sqrt(np.diag(H))) < MIN_CHANGE * 10 and lowest - trial < 1e-3
        fit, lowest, damping = moved, trial, damping / 10
        if small:
            return fit, True
    return fit, False


def _with_noise(survey: UsblSurvey, values: Vector, weights: Array, fit: Installation) -> Installation:
    """Return the fit at these values with the sigmas that are most likely for its residuals, by the weights (n, 3)."""
    r = residuals(survey, values)
    parts = [(r[:, 0], weights[:, 0]), (r[:, 1:], weights[:, 1:])]
    sd = [np.sqrt(np.nansum(w * part**2) / np.sum(w > 0)) for part, w in parts]
    return replace(fit, values=values, noise_sd=np.maximum(sd, [1e-4, 1e-7])[KINDS])


def _derivatives(survey: UsblSurvey, values: Vector) -> Array:
    """Return the derivatives of the residuals by the parameters, (n, 3, 11)."""
    moved = [residuals(survey, values + step) - residuals(survey, values - step) for step in np.diag(STEP)]
    return np.stack(moved, axis=-1) / (2 * STEP)


def _with_covariance(survey: UsblSurvey, fit: Installation, known: Known) -> Installation:
    z, G, there = _in_sigmas(survey, fit)
    slope = (DOF + 1) * (DOF - z**2) / (DOF + z**2) ** 2 * there
    pull = (DOF + 1) * z / (DOF + z**2)
    prior = np.diag(known.sd**-2.0)
    # the mean slope of each kind: single slopes are negative at false fixes
    mean_slope = np.array([slope[:, kind == KINDS].sum() / there[:, kind == KINDS].sum() for kind in (RANGE, ANGLE)])
    bread = _inverse(np.einsum("k,nki,nkj->ij", mean_slope[KINDS], G, G) + prior)
    cov = bread @ (long_run(np.einsum("nk,nki->ni", pull, G)) + prior) @ bread
    values = fit.values.copy()
    values[HEADING] = wrapped(float(values[HEADING]), 180.0)
    return replace(fit, values=values, cov=cov)


def long_run(scores: Array) -> Array:
    """Return the covariance of the sum of correlated scores (n, d), by Bartlett's window (Newey and West)."""
    n = len(scores)
    lags = int(4 * (n / 100) ** (2 / 9))
    whole = scores.T @ scores
    for lag in range(1, lags + 1):
        shifted = scores[lag:].T @ scores[:-lag]
        whole = whole + (1 - lag / (lags + 1)) * (shifted + shifted.T)
    return whole


def halves(fixes: int) -> tuple[Mask, Mask]:
    """Return two halves of so many fixes, (n,) each: every second of twenty stretches of equal numbers."""
    number = np.arange(fixes) * 20 // max(fixes, 1)
    return number % 2 == 0, number % 2 == 1


def known_of(
    stated: Vector, depth_m: float | None = None, depth_sd_m: float = 0.0, latency_sd_s: float | None = None
) -> Known:
    """Return what is known before a survey: the priors, how late records may be, and the transponder's depth."""
    values, sd = stated.copy(), PRIOR_SD.copy()
    values[PLACE] = 0.0
    if latency_sd_s is not None:
        sd[LATENCIES] = max(latency_sd_s, 1e-3)
    if depth_m is not None:
        values[10], sd[10] = depth_m, max(depth_sd_m, 1e-3)
    return Known(values, sd)
