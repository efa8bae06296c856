"""Part a log into blocks of fixes minus dead reckoning, as which errors of sensors are sought.

Means of blocks without outliers are Gaussian with a covariance of their noise, of the walk of dead reckoning, and of
every error that lasts for the whole log, all by their priors; a change adds a column for each number that it has.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from usbldr.filters.identification.conclusions import FAR_SD
from usbldr.filters.identification.dr_usbl_fit import WIDE_LATENCIES_S, fit_rotation, segment_numbers
from usbldr.filters.identification.identification import STRONG_ODDS
from usbldr.filters.identification.linearisation import (
    BIAS_STATES,
    CURRENT_STATES,
    NO_ERROR,
    PASS_STATES,
    Point,
    drift_variances_m2,
    linearised,
    near,
    prior_sds,
)
from usbldr.filters.models.noise import TO_SD, robust_sd
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.types import Array, Indices, Mask, Timeline, Vector

NEIGHBOURS = 7  # [fixes] before and after one: their median ignores a third of false ones
OUTLIER_SIGMAS = 4.0  # [-] beyond: a tail that is no longer Gaussian
BLOCK = 5  # [fixes] of a mean, at least: finer times say no more
MAX_BLOCKS = 300  # of a log: solving takes their number cubed
LEAST_BLOCKS = 10  # fewer do not distinguish a change from noise
FREE_SD = 3.0  # [-] of the factor of the whole log, any way round: other hypotheses find it
FREE_START_M = 1e3  # 1-sigma of each axis: says nothing of where the vehicle starts
SHARES = (0.25, 1.0)  # [-] of the stated correlated error of the fixes: the likelier is taken
FACTOR_SD = 0.5  # [-] prior of a change of either part of the factor: 30 degrees, 50 %
SHIFT_SD_M = 20.0  # of the fixes, each axis: to another beacon, antenna or origin nearby
CURRENT_SD_MPS = 0.5  # of each axis, as of a current in SensorErrors
LATER_SD_S = 3.0  # of the fixes, by judgement: another computer or export


class Kind(NamedTuple):
    """What may change: n numbers, of which a change has some."""

    states: Indices  # (n,) of PASS_STATES
    sds: Vector  # (n,) of a change
    parts: Array  # (k, n) 1: a change may have these together
    accumulates: bool  # over the way since the change
    free: bool  # nothing is known of them before the first change
    passes: bool  # it may end, and then they are as before
    most: int  # [changes] a log of more is not described by them

    @property
    def first(self) -> int:
        """The first fix before which it may change: what is free before may as well begin there."""
        return 0 if self.accumulates and not self.free else 1


def _numbers(*states: str) -> Indices:
    return np.array([PASS_STATES.index(state) for state in states])


OF_DEAD_RECKONING = Kind(
    states=_numbers("heading_bias", "dvl_scale"),
    sds=np.full(2, FACTOR_SD),
    parts=np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]),
    accumulates=True,
    free=True,
    passes=False,
    most=4,
)
OF_WATER = Kind(  # a DVL out of reach of the bottom measures through the water
    states=_numbers(*CURRENT_STATES),
    sds=np.full(2, CURRENT_SD_MPS),
    parts=np.array([[1.0, 1.0]]),
    accumulates=True,
    free=False,
    passes=True,
    most=2,
)
OF_FIXES = Kind(
    states=_numbers("x", "y", "usbl_latency"),
    sds=np.array([SHIFT_SD_M, SHIFT_SD_M, LATER_SD_S]),
    parts=np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    accumulates=False,
    free=False,
    passes=False,
    most=1,
)
KINDS = (OF_DEAD_RECKONING, OF_WATER, OF_FIXES)


class Blocks(NamedTuple):
    """B blocks of fixes minus dead reckoning."""

    time_s: Vector  # (F,) of every fix
    first: Indices  # (B,) fix of each
    residual_m: Vector  # (2 B,) east and north of each in turn
    cov_m2: Array  # (2 B, 2 B)
    measurement_matrix: Array  # (F, 2, P) H of every fix: how PASS_STATES move it
    mean_matrix: Array  # (B, 2, P)
    about: Point  # at which they are linear
    share: float  # of the stated correlated error of the fixes
    kind: Kind

    def log_odds(self, begins: Indices, ends: Indices) -> Array:
        """Against a change from N fixes to M, of each of the kind's parts, (N, M, k).

        It may begin or end before any block; the first and the last one are no choice of a time.
        """
        at_begin = np.where((begins <= self.first[1]) & (self.kind.first == 0), 1, len(self.first))
        at_end = np.where(ends == len(self.time_s), 1, len(self.first))
        return np.log(np.multiply.outer(np.outer(at_begin, at_end), STRONG_ODDS ** self.kind.parts.sum(axis=1)))


def blocks_of(timeline: Timeline, given: Parameters) -> tuple[Timeline, Sequence[Blocks]]:
    """Return the timeline without outliers, and its blocks about each likely point; none of too few fixes."""
    if len(timeline.fix_time_s) < BLOCK * LEAST_BLOCKS:
        return timeline, ()
    timeline = timeline.with_fixes(_among_neighbours(timeline, given))
    group = segment_numbers(timeline, timeline.fix_time_s)
    points = {NO_ERROR}
    if np.any(group >= 0):
        fit = fit_rotation(timeline, group, WIDE_LATENCIES_S)
        mounted = {"heading_bias": -fit.rotation_rad}
        points = {near(mounted | {"usbl_latency": late_s}) for late_s in (0.0, fit.latency_s)}  # not linear in turns
    return timeline, blocks_about_each(timeline, given, points)


def blocks_about_each(timeline: Timeline, given: Parameters, points: set[Point]) -> list[Blocks]:
    """Return the blocks about each point, with each of SHARES."""
    return [blocks_about(timeline, given, point, share) for point in sorted(points) for share in SHARES]


def _among_neighbours(timeline: Timeline, given: Parameters) -> Mask:
    """Return which fixes lie where their neighbours do, (F,): without outliers, noise is Gaussian."""
    off_m = np.abs(off_neighbours_m(timeline, given))
    return np.all(off_m <= OUTLIER_SIGMAS * TO_SD * np.median(off_m, axis=0), axis=1)


def off_neighbours_m(timeline: Timeline, given: Parameters) -> Array:
    """Return how far each fix lies from the median of its neighbours, against dead reckoning, (F, 2)."""
    off_m = linearised(timeline, given.usbl_from_dvl_m, len(timeline.fix_time_s), NO_ERROR).residual_m
    around_m = np.vstack([_continued(off_m[::-1])[::-1], off_m, _continued(off_m)])
    return off_m - np.median(sliding_window_view(around_m, 2 * NEIGHBOURS + 1, axis=0), axis=2)


def _continued(off_m: Array) -> Array:
    """Return NEIGHBOURS more values on the line through the last ones, which endures false ones, (NEIGHBOURS, 2).

    P. Sen, "Estimates of the regression coefficient based on Kendall's tau", J. American Statistical Association
    63(324), 1968, doi:10.1080/01621459.1968.10480934.
    """
    last = off_m[-2 * NEIGHBOURS - 1 :]
    i, j = np.triu_indices(len(last), 1)
    slope = np.median((last[j] - last[i]) / (j - i)[:, None], axis=0)
    level = np.median(last - np.outer(np.arange(len(last)), slope), axis=0)
    line_m: Array = level + np.outer(len(last) + np.arange(NEIGHBOURS), slope)
    return line_m


def blocks_about(timeline: Timeline, given: Parameters, about: Point, share: float) -> Blocks:
    """Return the blocks of a timeline, linear about a point, with a share of the stated correlated error."""
    time_s, count = timeline.fix_time_s, len(timeline.fix_time_s)
    log = linearised(timeline, given.usbl_from_dvl_m, count, about)
    size = max(BLOCK, math.ceil(count / MAX_BLOCKS))
    first = np.arange(0, count - size + 1, size)
    rows = first[:, None] + np.arange(size)
    residual_m = log.residual_m[rows].mean(axis=1)
    t = time_s[rows].mean(axis=1)
    H = log.measurement_matrix[rows].mean(axis=1)

    sigma_m, step_m = np.linalg.cholesky(timeline.fix_cov_m2[1:]), np.diff(log.residual_m, axis=0)[..., None]
    steps: Vector = np.linalg.solve(sigma_m, step_m).ravel().astype(np.float64)
    white_m2 = timeline.fix_cov_m2[rows].mean(axis=1) * (robust_sd(steps) ** 2 / size)
    errors = given.errors
    walked_m2 = np.cumsum(drift_variances_m2(timeline, t, [given], [True])[:, 0])
    shared_m2 = (share * errors.usbl_bias_m) ** 2 * np.exp(-np.abs(t[:, None] - t) / errors.usbl_bias_s)
    cov = np.einsum("ij,ab->iajb", np.minimum(walked_m2[:, None], walked_m2) + shared_m2, np.eye(2))
    blocks = np.arange(len(t))
    cov[blocks, :, blocks] += white_m2
    cov = cov.reshape(2 * len(t), -1)

    sd = {**dict.fromkeys(PASS_STATES, 0.0), **prior_sds(given)}
    sd |= {"x": FREE_START_M, "y": FREE_START_M, "usbl_latency": FAR_SD["latency"]}
    sd |= dict.fromkeys([*BIAS_STATES, *(() if given.water_track else CURRENT_STATES)], 0.0)
    sd |= {PASS_STATES[row]: FREE_SD for row in OF_DEAD_RECKONING.states}
    columns = H.reshape(2 * len(t), -1) * [sd[name] for name in PASS_STATES]

    found = Blocks(time_s, first, residual_m.ravel(), cov, log.measurement_matrix, H, about, share, OF_DEAD_RECKONING)
    heading = moved_by_changes(found, first[1:])[:, :, 0]
    columns = np.column_stack([columns, heading * np.sqrt(np.diff(t)) * errors.heading_walk_rad])
    return found._replace(cov_m2=cov + columns @ columns.T)


def moved_by_changes(blocks: Blocks, fixes: Indices) -> Array:
    """Return how a change before each of N fixes moves the blocks, per number of the kind, (2 B, N, n).

    One behind the last fix does not.
    """
    size, kind = int(blocks.first[1]), blocks.kind
    moved_m, mean_moved_m = blocks.measurement_matrix[:, :, kind.states], blocks.mean_matrix[:, :, kind.states]
    own, count = fixes // size, len(blocks.first)
    later = (np.arange(count)[:, None] > own)[..., None, None]
    until_m = moved_m[np.minimum(fixes, len(moved_m) - 1)] * float(kind.accumulates)
    since = np.where(later, mean_moved_m[:, None] - until_m, 0.0)
    for n in np.flatnonzero(own < count):
        fix, end = fixes[n], (own[n] + 1) * size
        since[own[n], n] = np.sum(moved_m[fix:end] - until_m[n], axis=0) / size
    return since.transpose(0, 2, 1, 3).reshape(2 * count, len(fixes), len(kind.sds))


def weighed(residual_m: Vector, cov_m2: Array) -> tuple[Vector, float]:
    """Return residuals (n,) by their covariance (n, n), and their log likelihood, but for a constant."""
    explained: Vector = np.linalg.solve(cov_m2, residual_m).astype(np.float64)
    return explained, -0.5 * float(residual_m @ explained + np.linalg.slogdet(cov_m2)[1])
