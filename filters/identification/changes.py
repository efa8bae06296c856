"""Find when sensors change within a log: compass and DVL, or the fixes.

A compass turns, the scale of a DVL jumps, or it measures through moving water for a while; fixes shift or come later.

From a change of dead reckoning on, its displacement is that of the vehicle times another complex factor. It may last
for a while; a change of the fixes is for good, since false_runs.py finds those that come back. Currents that cancel
each other are no currents: the fixes have drifted away, as by the gyro of a ship that turns, and come back. Changes are
added one at a time, the likeliest first, while the evidence for one more in the blocks of blocks.py is strong in spite
of the many possible times: C. Bishop, "Pattern Recognition and Machine Learning", Springer 2006, section 3.5. If the
covariance does not explain what they leave, or if speeds would change by half for a while, the log is wrong in another
way, and there is none: a DVL that fails for a while is lost (lost_reckoning.py), and one may fail for good.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.blocks import (
    FREE_SD,
    KINDS,
    OF_DEAD_RECKONING,
    OF_WATER,
    Blocks,
    blocks_about_each,
    moved_by_changes,
    weighed,
)
from usbldr.filters.identification.identification import MOST_OF_SCALE, STRONG_ODDS
from usbldr.filters.identification.linearisation import STEPS, near
from usbldr.filters.models.parameters import Parameters, SensorChange
from usbldr.filters.types import Array, Indices, Timeline, Vector

LASTING_S = 20.0  # a shorter error is a jump of the position, which false fixes explain as well
REFINEMENTS = 5  # of the times in turn, each by two blocks at most
MAX_NIS = 2.0  # [-] per number: what the changes leave must be explained by noise
LEAST_PART = 0.3  # [-] of the fixes, by judgement: fewer that lie elsewhere are false (false_runs.py)
EARLIER = 0.45  # [-] of the fixes, by judgement: with so many the part before a change is right, as it was set up


class _Change(NamedTuple):
    """A change of some numbers of a kind."""

    fix: int  # before which it is
    parts: int  # of those of the kind
    end: int  # the fix before which it has passed, or that behind the last one


class FoundChanges(NamedTuple):
    """Changes, and what of a likelihood with them is owed to their freedom."""

    changes: tuple[SensorChange, ...] = ()  # ascending
    cost: float = 0.0  # log odds
    drift_s: tuple[float, float] | None = None  # not these, but the fixes have drifted and come back, from when to when


def changes(timeline: Timeline, given: Parameters, blocks: Sequence[Blocks]) -> tuple[FoundChanges, ...]:
    """Return the changes of each of KINDS for which there is strong evidence; none if they do not describe the log."""
    kinds = [kind for kind in KINDS if not (given.water_track and kind is OF_WATER)]
    of_kinds = ([one._replace(kind=kind) for one in blocks] for kind in kinds if blocks)
    return tuple(_described(timeline, given, some) for some in of_kinds)


def about_longest_part(found: FoundChanges, end_s: float) -> FoundChanges:
    """Return changes of compass and DVL relative to the longest part of a log, so that constant errors are those of it.

    A DVL whose speeds change by half fails, perhaps for good: what was before is right.
    """
    parts = SensorChange(-math.inf, 0.0, 0.0), *found.changes
    if not any(one.heading_bias_rad or one.dvl_scale for one in parts) or any(
        max(1 + one.dvl_scale, 1 / (1 + one.dvl_scale)) > MOST_OF_SCALE for one in parts
    ):
        return found
    usual = parts[int(np.argmax(np.diff([0.0, *(one.start_s for one in found.changes), end_s])))]
    if usual is parts[0]:
        return found
    against = (
        one._replace(
            heading_bias_rad=math.remainder(one.heading_bias_rad - usual.heading_bias_rad, 2 * math.pi),
            dvl_scale=(1 + one.dvl_scale) / (1 + usual.dvl_scale) - 1,
        )
        for one in parts
    )
    return found._replace(changes=tuple(against))


def _described(timeline: Timeline, given: Parameters, blocks: Sequence[Blocks]) -> FoundChanges:
    kind, best = blocks[0].kind, _best(blocks)
    if best.changes and kind.free:  # about the heading before the first one: another mixes heading and scale
        about = dict(zip(STEPS, best.blocks.about, strict=True))
        best = _best(blocks_about_each(timeline, given, {near(about | {"heading_bias": float(best.errors[0, 0])})}))
    if not 0 < len(best.changes) <= kind.most or best.nis > MAX_NIS:
        return FoundChanges()
    of_kind = _as_errors if kind.free else _of_water if kind.accumulates else _of_fixes
    errors = of_kind(timeline, best)
    if any(max(1 + one.dvl_scale, 1 / (1 + one.dvl_scale)) > MOST_OF_SCALE for one in errors[:-1]):
        return FoundChanges()
    if kind.accumulates and (odds := _log_odds_of_return(timeline, best)) > math.log(STRONG_ODDS):
        drift_s = tuple(timeline.fix_time_s[[best.changes[0].fix, best.changes[-1].end]].tolist())
        return FoundChanges(errors, best.cost - odds, drift_s)
    return FoundChanges(errors, best.cost)


class _Found(NamedTuple):
    """Changes found under one noise of the fixes."""

    blocks: Blocks
    changes: list[_Change]  # ascending
    explained: Vector  # (2 B,) residuals by their covariance
    nis: float  # per number
    log_evidence: float  # of the residuals, less the prior odds of the changes
    cost: float  # prior odds, and evidence that is less than the likelihood of the best sizes

    @property
    def sizes(self) -> Array:
        """The numbers of each change, posterior means, (N, n)."""
        columns = _changing(self.blocks, self.changes) * self.blocks.kind.sds**2
        return np.einsum("bcn,b->cn", columns, self.explained)

    @property
    def errors(self) -> Array:
        """The numbers of the kind before the first change and after each that does not pass, (N + 1, n)."""
        kind = self.blocks.kind
        at_start = self.blocks.mean_matrix[:, :, kind.states].reshape(-1, len(kind.sds)) * kind.free * FREE_SD**2
        errors: Array = np.cumsum([at_start.T @ self.explained, *self.sizes], axis=0)
        return errors


def _best(blocks: Sequence[Blocks]) -> _Found:
    return max(map(_found, blocks), key=lambda one: one.log_evidence)


def _found(blocks: Blocks) -> _Found:
    found: list[_Change] = []
    for _ in range(2 * blocks.kind.most):  # one that is added may make an earlier one needless
        added = _likeliest(blocks, found, blocks.first[blocks.kind.first :], blocks.first)
        if added is None:
            break
        found = _refined(blocks, [*found, added])
    cov, z = _with(blocks, found), blocks.residual_m
    explained, evidence = weighed(z, cov)
    _, likelihood = weighed(z - (cov - blocks.cov_m2) @ explained, blocks.cov_m2)  # without their posterior means
    odds = sum(float(blocks.log_odds(*np.array([[one.fix], [one.end]]))[0, 0, one.parts]) for one in found)
    nis = float(z @ explained) / len(z)
    return _Found(blocks, sorted(found), explained, nis, evidence - odds, likelihood - evidence + odds)


def _changing(blocks: Blocks, found: Sequence[_Change]) -> Array:
    """Return how changes move the blocks, per number of the kind that each has, (2 B, N, n)."""
    begin, end = (np.array(fixes, np.intp) for fixes in ([one.fix for one in found], [one.end for one in found]))
    moved = moved_by_changes(blocks, begin) - moved_by_changes(blocks, end)
    return moved * blocks.kind.parts[[one.parts for one in found]]


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
            begins, ends = (np.arange(fix - 2 * size, fix + 2 * size + 1) for fix in (one.fix, one.end))
            begins = begins[(begins >= blocks.kind.first) & (begins < len(blocks.time_s))]
            moved = _likeliest(blocks, others, begins, ends[(ends > 0) & (ends < len(blocks.time_s))])
            found = others if moved is None else [*others, moved]
        if sorted(found) == before:
            break
    return found


def _likeliest(blocks: Blocks, found: Sequence[_Change], begins: Indices, ends: Indices) -> _Change | None:
    """Return one more change, the likeliest from one of some fixes on; None if the evidence for none is strong.

    It lasts, or passes before one of ``ends`` if its kind does; between two that pass, all is as usual for a while.
    """
    ends = np.append(ends[: len(ends) * blocks.kind.passes], len(blocks.time_s))
    time_s = np.append(blocks.time_s, np.inf)
    begin_s, end_s = time_s[begins, None], time_s[ends]
    possible = end_s - begin_s >= LASTING_S
    for one in found:
        if blocks.kind.passes:
            possible &= (end_s <= time_s[one.fix] - LASTING_S) | (begin_s >= time_s[one.end] + LASTING_S)
        else:
            possible &= np.abs(begin_s - time_s[one.fix]) >= LASTING_S
    if not possible.any():
        return None
    gain = _gains(blocks, found, begins, ends) - blocks.log_odds(begins, ends)
    gain[~possible] = -np.inf
    row, end, parts = np.unravel_index(np.argmax(gain), gain.shape)
    return _Change(int(begins[row]), int(parts), int(ends[end])) if gain[row, end, parts] >= 0 else None


def _gains(blocks: Blocks, found: Sequence[_Change], begins: Indices, ends: Indices) -> Array:
    """Return the gain in log evidence by one more change from N fixes to M, of each of k parts, (N, M, k)."""
    cov, parts, count, N = _with(blocks, found), blocks.kind.parts, len(blocks.kind.sds), len(begins)
    edges = moved_by_changes(blocks, np.append(begins, ends)) * blocks.kind.sds
    both = np.column_stack([blocks.residual_m, edges.reshape(len(cov), -1)])
    white: Array = np.linalg.solve(np.linalg.cholesky(cov), both).astype(np.float64)
    z, edges = white[:, 0], white[:, 1:].reshape(len(cov), -1, count)
    products: Array = np.tensordot(edges, edges, (0, 0)).swapaxes(1, 2)  # of all edges, (N + M, N + M, n, n)
    own: Array = np.einsum("eenc->enc", products)
    across = products[:N, N:]
    information: Array = own[:N, None] - across - across.swapaxes(2, 3) + own[N:]
    pull: Array = np.einsum("bea,b->ea", edges, z)
    pull = (pull[:N, None] - pull[N:])[:, :, None] * parts
    precision: Array = information[:, :, None] * parts[:, :, None] * parts[:, None, :] + np.eye(count)
    solved: Array = np.linalg.solve(precision, pull[..., None]).astype(np.float64)[..., 0]
    gain: Array = 0.5 * (np.einsum("nmka,nmka->nmk", pull, solved) - np.linalg.slogdet(precision)[1])
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
    steps = [(one.fix, size) for one, size in zip(found.changes, found.sizes, strict=True)]
    steps += [
        (one.end, -size)
        for (_, size), one in zip(steps, found.changes, strict=True)
        if one.end < len(timeline.fix_time_s)
    ]
    fixes, sizes = zip(*sorted(steps, key=lambda step: step[0]), strict=True)
    start_s, currents = timeline.fix_time_s[list(fixes)].tolist(), np.cumsum(sizes, axis=0).tolist()
    return tuple(SensorChange(t, 0.0, 0.0, current_mps=(e, n)) for t, (e, n) in zip(start_s, currents, strict=True))


def _log_odds_of_return(timeline: Timeline, found: _Found) -> float:
    """Return the log odds that currents cancel each other exactly, as those that stand for a drift of the fixes do.

    These are the odds of a displacement of zero, after against before the log is seen: J. Dickey, "The weighted
    likelihood ratio, linear hypotheses on normal location parameters", Annals Math. Stat. 42(1), 1971,
    doi:10.1214/aoms/1177693507. Currents in half of a log or more are no drift.
    """
    begin, end, count = found.changes[0].fix, found.changes[-1].end, len(timeline.fix_time_s)
    if len(found.changes) < 2 or end - begin >= count / 2 or end == count:
        return -math.inf
    kind_sds, N = found.blocks.kind.sds, len(found.changes)
    lasts_s = np.diff(timeline.fix_time_s[[(one.fix, one.end) for one in found.changes]], axis=1)[:, 0]
    seen = (_changing(found.blocks, found.changes) * kind_sds).reshape(-1, 2 * N)
    cov = np.eye(2 * N) - seen.T @ np.linalg.solve(_with(found.blocks, found.changes), seen)
    to_net = np.kron(lasts_s, np.diag(kind_sds))  # (2, 2 N) displacement by currents in units of their sigmas
    net_m, after_m2, before_m2 = lasts_s @ found.sizes, to_net @ cov @ to_net.T, to_net @ to_net.T
    ratio = np.linalg.slogdet(before_m2)[1] - np.linalg.slogdet(after_m2)[1]
    return float(ratio - net_m @ np.linalg.solve(after_m2, net_m)) / 2


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
