"""What a survey says of a USBL's installation: what it settles, what it leaves open, and if the fit can be trusted.

Half of the fixes are fitted and the other half judged, both ways round, so that the scatter after the calibration is
that of fixes which the fit has not seen.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from usbldr.filters.types import Array, Mask, Vector
from usbldr.filters.usbl_survey.calibration import PRIOR_SD, Installation, Known, assumed, calibrated, expected, halves
from usbldr.filters.usbl_survey.geometry import NAMES, UsblSurvey, placed

SETTLED_SHARE = 0.25  # of the noise of one fix: an error this small adds 3 % to its scatter
RELATED = 0.25  # of an error's variance: others that, if known, halve its sigma are what it is not separated from
MOST_RELATED = 3  # others that halve it: on a circle, pitch needs heading, forward arm and latency of position
UNCHANGED = 0.5  # of the usual sigma before: nothing is known
MAX_FALSE_SHARE = 0.3  # by judgement: so many false fixes are a fault of their own
DISAGREEMENT = 31.3  # chi-square of 11 differences, 1 in 1000
MAX_PERCENT = 20.0  # of the slant range, by judgement: 8 deg along each axis, and no USBL is so bad
MADE_WORSE = 1.1  # by judgement: the scatter after over before
ABOVE_SIGMAS = 3.0  # of a depth below zero: 1 in 700 by chance; a fix upside down fits nearly as well
GENERAL_LEG = "run a box around the transponder at a distance of about its depth, both ways, and pass above it"
STATE_CLOCKS = "state --latency-sd if the clocks are synchronised"
BOTH_WAYS = "run legs at a horizontal distance of about the depth, both ways"
AT_OTHER_SPEED = f"run a leg at another speed, or stop, or {STATE_CLOCKS}"
LEGS: Mapping[frozenset[str], str] = {
    frozenset(names): leg
    for *names, leg in (
        ("mount_heading_deg", "arm_forward_m", "run straight legs towards the transponder and away from it"),
        ("scale", "depth_m", "run a leg at another horizontal distance, or state --transponder-depth"),
        ("mount_roll_deg", "arm_starboard_m", BOTH_WAYS),
        ("mount_pitch_deg", "arm_forward_m", BOTH_WAYS),
        ("attitude_latency_s", "mount_heading_deg", "turn to both sides"),
        ("position_latency_s", "arm_forward_m", AT_OTHER_SPEED),
        ("position_latency_s", "mount_heading_deg", AT_OTHER_SPEED),
        ("position_latency_s", f"run a leg at speed, or {STATE_CLOCKS}"),
        ("attitude_latency_s", f"turn, or wait for a sea that rolls the ship, or {STATE_CLOCKS}"),
    )
}
"""What separates two errors, or determines one that no other is like."""


class Scatter(NamedTuple):
    """Horizontal distances of the good fixes from where they should be."""

    drms_m: float
    cep50_m: float
    cep95_m: float
    drms_percent: float  # each as a share of the slant range, or of the horizontal one without depths
    cep50_percent: float
    cep95_percent: float  # NaN without a known head


class Parameter(NamedTuple):
    """One error of the installation, or a coordinate of the transponder."""

    name: str
    value: float
    sd: float
    effect_m: float  # of its sigma, on a fix at the median range
    open: bool
    rivals: tuple[str, ...]  # the open parameters that it is not separated from
    leg: str  # what would settle it


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found of an installation."""

    parameters: tuple[Parameter, ...]
    before: Scatter  # with the stated installation
    after: Scatter  # with the fitted one, each half by the fit of the other
    false_share: float
    disagreement: float  # chi-square of the differences between the fits of the halves
    result: Literal["good", "open", "bad"]
    why: str


def judged(survey: UsblSurvey, stated: Vector, known: Known) -> tuple[Verdict, Installation]:
    """Judge the fitted installation and return both; raise LogError as `calibrated` does."""
    fit = calibrated(survey, stated, known)
    sides = halves(len(survey))
    fits = [calibrated(survey.part(side), fit.values, known, starts=False) for side in sides]
    difference = fits[0].values - fits[1].values
    disagreement = float(difference @ np.linalg.solve(fits[0].cov + fits[1].cov, difference))
    positions = np.full((len(survey), 3), np.nan)
    for side, other in zip(sides, fits[::-1], strict=True):
        positions[side] = placed(survey.part(side), other.values)
    before = scatter(placed(survey, assumed(survey, stated)), survey.range_m, fit.good)
    after = scatter(positions, survey.range_m, fit.good)
    return decided(tuple(described(survey, fit)), before, after, fit.good, disagreement, DISAGREEMENT), fit


def planned(survey: UsblSurvey, values: Vector, known: Known, sd: tuple[float, float]) -> list[Parameter]:
    """Return what `judged` will say of a survey with Student-t errors of these sigmas (metres, radians)."""
    return described(survey, expected(survey, values, known, sd))


def scatter(positions_m: Array, range_m: Vector, good: Mask) -> Scatter:
    """Return the scatter of positions, east and north in (n, 2) or more columns, around their median."""
    there = good & np.isfinite(positions_m[:, :2]).all(axis=1)
    flat = positions_m[there, :2]
    return scatter_of(flat - np.median(flat, axis=0), range_m[there])


def scatter_of(off_m: Array, range_m: Vector) -> Scatter:
    """Return the scatter of offsets east and north, (n, 2), of fixes at these ranges, (n,)."""
    distance = np.hypot(off_m[:, 0], off_m[:, 1])
    sizes = (distance, 100 * distance / np.maximum(range_m, 1e-6))
    return Scatter(*(float(of) for one in sizes for of in (np.sqrt(np.mean(one**2)), *np.quantile(one, [0.5, 0.95]))))


def effects_m(survey: UsblSurvey) -> Vector:
    """Return how far a unit of each parameter moves a fix at the median range, metres, (11,)."""
    reach = float(np.median(survey.range_m))
    ship = survey.ship
    gone, times = np.diff(ship.smoothed_m, axis=0), ship.attitude_time_s
    speed = float(np.median(np.hypot(gone[:, 0], gone[:, 1]) / np.maximum(np.diff(ship.position_time_s), 1e-3)))
    rates = np.diff(ship.attitude_deg, axis=0) / np.maximum(np.diff(times), 1e-3)[:, None]
    turning = math.sqrt(float(np.mean(np.minimum((rates * rates) @ np.ones(3), 1e4))))  # jumps of records aside
    angle = math.radians(reach)
    return np.array([angle, angle, angle, reach, 1.0, 1.0, math.radians(turning) * reach, speed, 1.0, 1.0, 1.0])


def described(survey: UsblSurvey, fit: Installation) -> list[Parameter]:
    """Return each parameter with its sigma, and whether the survey leaves it open."""
    sd = fit.sd
    effects = sd * effects_m(survey)
    range_sd_m, angle_sd_rad, _ = fit.noise_sd
    noise_m = float(np.hypot(range_sd_m, angle_sd_rad * np.median(survey.range_m)))
    unsettled = (effects > SETTLED_SHARE * noise_m) | (sd > UNCHANGED * PRIOR_SD)
    groups = _groups(fit.cov / np.outer(sd, sd), np.flatnonzero(unsettled).tolist())
    rows = zip(NAMES, fit.values.tolist(), sd.tolist(), effects.tolist(), strict=True)
    return [Parameter(*row, bool(one), *groups.get(row[0], ((), ""))) for row, one in zip(rows, unsettled, strict=True)]


def _groups(correlation: Array, unsettled: list[int]) -> dict[str, tuple[tuple[str, ...], str]]:
    """Return the names of the others that each open parameter is not separated from, and the legs that separate them.

    East and north of the transponder follow from all others: they determine none.
    """
    together = {k: {k} for k in unsettled}
    causes = [k for k in unsettled if NAMES[k] not in ("east_m", "north_m")]
    for k in unsettled:
        joined = set[int]().union(*(together[j] for j in (k, *_related(correlation, k, causes))))
        together |= dict.fromkeys(joined, joined)
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for k, group in together.items():
        names = {NAMES[j] for j in group}
        legs = [leg for pair, leg in LEGS.items() if pair <= names and len(pair) == min(len(names), 2)]
        found[NAMES[k]] = tuple(NAMES[j] for j in sorted(group - {k})), "; ".join(dict.fromkeys(legs)) or GENERAL_LEG
    return found


def _related(correlation: Array, k: int, causes: list[int]) -> list[int]:
    """Return the fewest of the causes that would halve the sigma of a parameter if they were known; none if none do."""
    chosen: list[int] = []

    def left(known: list[int]) -> float:  # of its variance
        of = correlation[k, known]
        return 1.0 - float(of @ np.linalg.solve(correlation[np.ix_(known, known)], of))

    others = [j for j in causes if j != k]
    while len(chosen) < min(MOST_RELATED, len(others)):
        chosen.append(min((j for j in others if j not in chosen), key=lambda j: left([*chosen, j])))
        if left(chosen) < RELATED:
            return chosen
    return []


def decided(
    parameters: tuple[Parameter, ...], before: Scatter, after: Scatter, good: Mask, disagreement: float, most: float
) -> Verdict:
    """Return the verdict; above ``most``, two halves of the fixes give different installations."""
    false_share = 1.0 - float(good.mean())
    verdict = partial(Verdict, parameters, before, after, false_share, disagreement)
    depth = next((one for one in parameters if one.name == "depth_m"), None)
    if depth is not None and depth.value < -ABOVE_SIGMAS * depth.sd:
        above = "the head, or the surface if its depth is stated"
        return verdict("bad", f"the transponder lies {-depth.value:.1f} m above {above}: check the third of axes")
    if after.drms_percent > MAX_PERCENT:
        why = f"calibrated fixes still scatter by {after.drms_percent:.0f} % of their range: check axes and headings"
        return verdict("bad", why)
    if false_share > MAX_FALSE_SHARE:
        return verdict("bad", f"{false_share:.0%} of the fixes are false")
    if disagreement > most:
        why = "two halves of the fixes give different installations: the transponder of a survey or the head moved, "
        return verdict("bad", why + "or an error is at work that the fit does not know")
    if after.drms_m > MADE_WORSE * before.drms_m:
        return verdict("bad", "the fixes scatter more with the calibration than without it")
    unsettled = [one.name for one in parameters if one.open]
    if unsettled:
        return verdict("open", f"the fixes do not settle {', '.join(unsettled)}")
    return verdict("good", "the fixes settle every error of the installation")
