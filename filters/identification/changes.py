"""Find when sensors change within a log: compass and DVL, or the fixes.

A compass turns, the scale of a DVL jumps, or it measures through moving water for a while; fixes shift or come later.

From a change of dead reckoning on, its displacement is that of the vehicle times another complex factor. It may last
for a while; a change of the fixes is for good, since false_runs.py finds those that come back. Fixes minus dead
reckoning, as means of blocks without outliers, are Gaussian with a covariance of their noise, of the walk of dead
reckoning, and of every error that lasts for the whole log, all by their priors; a change adds a column for each number
that it has. Changes are added one at a time, the likeliest first, while the evidence for one more is strong in spite of
the many possible times: C. Bishop, "Pattern Recognition and Machine Learning", Springer 2006, section 3.5. If the
covariance does not explain what they leave, or if speeds would change by half for a while, the log is wrong in another
way, and there is none: a DVL that fails for a while is lost (lost_reckoning.py), and one may fail for good.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from usbldr.filters.identification.conclusions import FAR_SD
from usbldr.filters.identification.dr_usbl_fit import WIDE_LATENCIES_S, fit_rotation, segment_numbers
from usbldr.filters.identification.identification import MOST_OF_SCALE, STRONG_ODDS
from usbldr.filters.identification.linearisation import (
    BIAS_STATES,
    CURRENT_STATES,
    NO_ERROR,
    PASS_STATES,
    STEPS,
    Point,
    drift_variances_m2,
    linearised,
    near,
    prior_sds,
)
from usbldr.filters.models.noise import TO_SD, robust_sd
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.types import Array, Indices, Mask, Timeline, Vector

NEIGHBOURS = 7  # [fixes] before and after one: their median ignores a third of false ones
OUTLIER_SIGMAS = 4.0  # [-] beyond: a tail that is no longer Gaussian
BLOCK = 5  # [fixes] of a mean, at least: finer times say no more
MAX_BLOCKS = 300  # of a log: solving takes their number cubed
LEAST_BLOCKS = 10  # fewer do not distinguish a change from noise
FREE_SD = 3.0  # [-] of the factor of the whole log, any way round: other hypotheses find it
FREE_START_M = 1e3  # 1-sigma of each axis: says nothing of where the vehicle starts
SHARES = (0.25, 1.0)  # [-] of the stated correlated error of the fixes: the likelier is taken
LASTING_S = 20.0  # a shorter error is a jump of the position, which false fixes explain as well
REFINEMENTS = 5  # of the times in turn, each by two blocks at most
MAX_NIS = 2.0  # [-] per number: what the changes leave must be explained by noise
FACTOR_SD = 0.5  # [-] prior of a change of either part of the factor: 30 degrees, 50 %
SHIFT_SD_M = 20.0  # of the fixes, each axis: to another beacon, antenna or origin nearby
CURRENT_SD_MPS = 0.5  # of each axis, as of a current in SensorErrors
LATER_SD_S = 3.0  # of the fixes, by judgement: another computer or export

LEAST_PART = 0.3  # [-] of the fixes, by judgement: fewer that lie elsewhere are false (false_runs.py)
EARLIER = 0.45  # [-] of the fixes, by judgement: with so many the part before a change is right, as it was set up


class Kind(NamedTuple):
    """What may change: n numbers, of which a change has some."""

    states: Indices  # (n,) of PASS_STATES
    sds: Vector  # (n,) of a change
    parts: Array  # (k, n) 1: a change may have these together
    accumulates: bool  # over the way since the change
    free: bool  # nothing is known of them before the first change
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
    most=4,
)
OF_WATER = Kind(  # a DVL out of reach of the bottom measures through the water
    states=_numbers(*CURRENT_STATES),
    sds=np.full(2, CURRENT_SD_MPS),
    parts=np.array([[1.0, 1.0]]),
    accumulates=True,
    free=False,
    most=4,
)
OF_FIXES = Kind(
    states=_numbers("x", "y", "usbl_latency"),
    sds=np.array([SHIFT_SD_M, SHIFT_SD_M, LATER_SD_S]),
    parts=np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    accumulates=False,
    free=False,
    most=1,
)
KINDS = (OF_DEAD_RECKONING, OF_WATER, OF_FIXES)


class _Change(NamedTuple):
    """A change of some numbers of a kind."""

    fix: int  # before which it is
    parts: int  # of those of the kind


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

    @property
    def log_odds(self) -> Vector:
        """Against a change of each of the kind's parts, which may begin before any block, (k,)."""
        return np.log(len(self.first) * STRONG_ODDS ** self.kind.parts.sum(axis=1))


class FoundChanges(NamedTuple):
    """Changes, and what of a likelihood with them is owed to their freedom."""

    changes: tuple[SensorChange, ...] = ()  # ascending
    cost: float = 0.0  # log odds


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
    return timeline, _blocks_about(timeline, given, points)


def changes(timeline: Timeline, given: Parameters, blocks: Sequence[Blocks]) -> tuple[FoundChanges, ...]:
    """Return the changes of each of KINDS for which there is strong evidence; none if they do not describe the log."""
    of_kinds = ([one._replace(kind=kind) for one in blocks] for kind in KINDS if blocks)
    return tuple(_described(timeline, given, some) for some in of_kinds)


def _described(timeline: Timeline, given: Parameters, blocks: Sequence[Blocks]) -> FoundChanges:
    kind, best = blocks[0].kind, _best(blocks)
    if best.changes and kind.free:  # about the heading before the first one: another mixes heading and scale
        about = dict(zip(STEPS, best.blocks.about, strict=True))
        best = _best(_blocks_about(timeline, given, {near(about | {"heading_bias": float(best.errors[0, 0])})}))
    if not 0 < len(best.changes) <= kind.most or best.nis > MAX_NIS:
        return FoundChanges()
    of_kind = _as_errors if kind.free else _of_water if kind.accumulates else _of_fixes
    errors = of_kind(timeline, best)
    if any(max(1 + one.dvl_scale, 1 / (1 + one.dvl_scale)) > MOST_OF_SCALE for one in errors[:-1]):
        return FoundChanges()
    return FoundChanges(errors, best.cost)


def _among_neighbours(timeline: Timeline, given: Parameters) -> Mask:
    """Return which fixes lie where their neighbours do, (F,): without outliers, noise is Gaussian."""
    off_m = np.abs(off_neighbours_m(timeline, given))
    return np.all(off_m <= OUTLIER_SIGMAS * TO_SD * np.median(off_m, axis=0), axis=1)


def off_neighbours_m(timeline: Timeline, given: Parameters) -> Array:
    """Return how far each fix lies from the median of its neighbours, against dead reckoning, (F, 2)."""
    off_m = linearised(timeline, given.usbl_from_dvl_m, len(timeline.fix_time_s), NO_ERROR).residual_m
    around_m = np.pad(off_m, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="reflect")
    return off_m - np.median(sliding_window_view(around_m, 2 * NEIGHBOURS + 1, axis=0), axis=2)


class _Found(NamedTuple):
    """Changes found under one noise of the fixes."""

    blocks: Blocks
    changes: list[_Change]  # ascending
    explained: Vector  # (2 B,) residuals by their covariance
    nis: float  # per number
    log_evidence: float  # of the residuals, less the prior odds of the changes
    cost: float  # prior odds, and evidence that is less than the likelihood of the best sizes

    @property
    def errors(self) -> Array:
        """The numbers of the kind before the first change and after each, posterior means, (N + 1, n)."""
        kind = self.blocks.kind
        at_start = self.blocks.mean_matrix[:, :, kind.states].reshape(-1, len(kind.sds))
        columns = [at_start * (FREE_SD**2 if kind.free else 0.0)]
        columns += list(_changing(self.blocks, self.changes).swapaxes(0, 1) * kind.sds**2)
        errors: Array = np.cumsum([each.T @ self.explained for each in columns], axis=0)
        return errors


def _best(blocks: Sequence[Blocks]) -> _Found:
    return max(map(_found, blocks), key=lambda one: one.log_evidence)


def _blocks_about(timeline: Timeline, given: Parameters, points: set[Point]) -> list[Blocks]:
    return [blocks_about(timeline, given, point, share) for point in sorted(points) for share in SHARES]


def _found(blocks: Blocks) -> _Found:
    found: list[_Change] = []
    for _ in range(2 * blocks.kind.most):  # one that is added may make an earlier one needless
        added = _likeliest(blocks, found, blocks.first[blocks.kind.first :])
        if added is None:
            break
        found = _refined(blocks, [*found, added])
    cov, z = _with(blocks, found), blocks.residual_m
    explained, evidence = weighed(z, cov)
    _, likelihood = weighed(z - (cov - blocks.cov_m2) @ explained, blocks.cov_m2)  # without their posterior means
    odds, nis = float(sum(blocks.log_odds[one.parts] for one in found)), float(z @ explained) / len(z)
    return _Found(blocks, sorted(found), explained, nis, evidence - odds, likelihood - evidence + odds)


def weighed(residual_m: Vector, cov_m2: Array) -> tuple[Vector, float]:
    """Return residuals (n,) by their covariance (n, n), and their log likelihood, but for a constant."""
    explained: Vector = np.linalg.solve(cov_m2, residual_m).astype(np.float64)
    return explained, -0.5 * float(residual_m @ explained + np.linalg.slogdet(cov_m2)[1])


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
    sd |= {"x": FREE_START_M, "y": FREE_START_M, "usbl_latency": FAR_SD["latency_s"]}
    sd |= dict.fromkeys([*BIAS_STATES, *(() if given.water_track else CURRENT_STATES)], 0.0)
    sd |= {PASS_STATES[row]: FREE_SD for row in OF_DEAD_RECKONING.states}
    columns = H.reshape(2 * len(t), -1) * [sd[name] for name in PASS_STATES]

    found = Blocks(time_s, first, residual_m.ravel(), cov, log.measurement_matrix, H, about, share, OF_DEAD_RECKONING)
    heading = moved_by_changes(found, first[1:])[:, :, 0]
    columns = np.column_stack([columns, heading * np.sqrt(np.diff(t)) * errors.heading_walk_rad])
    return found._replace(cov_m2=cov + columns @ columns.T)


def moved_by_changes(blocks: Blocks, fixes: Indices) -> Array:
    """Return how a change before each of N fixes moves the blocks, per number of the kind, (2 B, N, n)."""
    size, kind = int(blocks.first[1]), blocks.kind
    moved_m, mean_moved_m = blocks.measurement_matrix[:, :, kind.states], blocks.mean_matrix[:, :, kind.states]
    own, count = fixes // size, len(blocks.first)
    later = (np.arange(count)[:, None] > own)[..., None, None]
    until_m = moved_m[fixes] * float(kind.accumulates)
    since = np.where(later, mean_moved_m[:, None] - until_m, 0.0)
    for n in np.flatnonzero(own < count):
        fix, end = fixes[n], (own[n] + 1) * size
        since[own[n], n] = np.sum(moved_m[fix:end] - until_m[n], axis=0) / size
    return since.transpose(0, 2, 1, 3).reshape(2 * count, len(fixes), len(kind.sds))


def _changing(blocks: Blocks, found: Sequence[_Change]) -> Array:
    """Return how changes move the blocks, per number of the kind that each has, (2 B, N, n)."""
    fixes = np.array([one.fix for one in found], np.intp)
    return moved_by_changes(blocks, fixes) * blocks.kind.parts[[one.parts for one in found]]


def _with(blocks: Blocks, found: Sequence[_Change]) -> Array:
    """Return the covariance of the blocks with changes."""
    columns = (_changing(blocks, found) * blocks.kind.sds).reshape(len(blocks.residual_m), -1)
    return blocks.cov_m2 + columns @ columns.T


def _refined(blocks: Blocks, found: list[_Change]) -> list[_Change]:
    """Return the changes at the likeliest times near them, but for those that the others make needless."""
    size = int(blocks.first[1])
    for _ in range(REFINEMENTS):
        before = sorted(found)
        for one in before:
            others = [other for other in found if other != one]
            near = np.arange(
                max(blocks.kind.first, one.fix - 2 * size), min(len(blocks.time_s), one.fix + 2 * size + 1)
            )
            moved = _likeliest(blocks, others, near)
            found = others if moved is None else [*others, moved]
        if sorted(found) == before:
            break
    return found


def _likeliest(blocks: Blocks, found: Sequence[_Change], fixes: Indices) -> _Change | None:
    """Return one more change, the likeliest before one of the fixes; None if the evidence for none is strong."""
    apart_s = np.abs(blocks.time_s[fixes, None] - blocks.time_s[[one.fix for one in found]])
    fixes = fixes[np.all(apart_s >= LASTING_S, axis=1)]
    if not len(fixes):
        return None
    gain = _gains(blocks, found, fixes) - blocks.log_odds
    row, parts = np.unravel_index(np.argmax(gain), gain.shape)
    return _Change(int(fixes[row]), int(parts)) if gain[row, parts] >= 0 else None


def _gains(blocks: Blocks, found: Sequence[_Change], fixes: Indices) -> Array:
    """Return the gain in log evidence by one more change before each of N fixes, of each of k parts, (N, k)."""
    cov, parts, count = _with(blocks, found), blocks.kind.parts, len(blocks.kind.sds)
    columns = (moved_by_changes(blocks, fixes) * blocks.kind.sds).reshape(len(cov), -1)
    both = np.column_stack([blocks.residual_m, columns])
    white: Array = np.linalg.solve(np.linalg.cholesky(cov), both).astype(np.float64)
    z, columns = white[:, 0], white[:, 1:].reshape(len(cov), len(fixes), count)
    information: Array = np.einsum("bna,bnc->nac", columns, columns)
    pull: Array = np.einsum("bna,b->na", columns, z)[:, None] * parts
    precision: Array = information[:, None] * parts[:, :, None] * parts[:, None, :] + np.eye(count)
    solved: Array = np.linalg.solve(precision, pull[..., None]).astype(np.float64)[..., 0]
    gain: Array = 0.5 * (np.einsum("nka,nka->nk", pull, solved) - np.linalg.slogdet(precision)[1])
    return gain


def _as_errors(timeline: Timeline, found: _Found) -> tuple[SensorChange, ...]:
    """Return the changes as errors of compass and DVL beyond those before the first, from posterior means."""
    heading, scale = found.errors.T
    mounted = dict(zip(STEPS, found.blocks.about, strict=True))["heading_bias"]
    factor = 1 - scale - 1j * (heading - mounted)  # on dead reckoning as it is mounted
    errors, q = list[SensorChange](), 1 + 0j
    for one, step in zip(found.changes, factor[1:] / factor[:-1], strict=True):
        turn = np.exp(1j * np.arcsin(np.clip(step.imag, -1.0, 1.0)))  # of a heading alone; linear, it adds a scale
        q *= step if OF_DEAD_RECKONING.parts[one.parts, 1] else step.real * turn
        start_s = float(timeline.fix_time_s[one.fix])
        errors.append(SensorChange(start_s, -float(np.angle(q)), float(1 / abs(q)) - 1))
    return tuple(errors)


def _of_water(timeline: Timeline, found: _Found) -> tuple[SensorChange, ...]:
    """Return the changes as currents through which the DVL measures."""
    start_s = timeline.fix_time_s[[one.fix for one in found.changes]].tolist()
    currents = found.errors[1:].tolist()
    return tuple(SensorChange(t, 0.0, 0.0, current_mps=(e, n)) for t, (e, n) in zip(start_s, currents, strict=True))


def _of_fixes(timeline: Timeline, found: _Found) -> tuple[SensorChange, ...]:
    """Return the change of the fixes as an error of the part with clearly fewer of them, or else of the later one.

    There is none if a part has so few that they are false.
    """
    (one,), (_, (east_m, north_m, late_s)) = found.changes, found.errors.tolist()
    start_s, count = float(timeline.fix_time_s[one.fix]), len(timeline.fix_time_s)
    if not late_s and min(one.fix, count - one.fix) < LEAST_PART * count:
        return ()
    change = SensorChange(start_s, 0.0, 0.0, fix_shift_m=(east_m, north_m), fix_late_s=late_s)
    if one.fix >= EARLIER * count:
        return (change,)
    before = SensorChange(-math.inf, 0.0, 0.0, fix_shift_m=(-east_m, -north_m), fix_late_s=-late_s)
    return before, SensorChange(start_s, 0.0, 0.0)
