"""Follow the likeliest histories of false fixes in a row, in NumPy or in the compiled kernel.

A Markov chain of two states, correct and in a run with an offset of its own: D. Reid, "An algorithm for tracking
multiple targets", IEEE Trans. Automatic Control 24(6), 1979, doi:10.1109/TAC.1979.1102177. Histories that agree in the
last RECENT fixes, and nearly in the position, are one. Metres and seconds.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.identification.clusters import FAR, OFFSET_SD_M
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.noise import Noise
from usbldr.filters.types import Array, Indices, Mask, Vector

OFFSET_WALK_M = 0.1  # [m/√s] by judgement: an echo moves with the geometry, slowly
RATE_MPS = 0.1  # [m/s] each axis, by judgement: of an offset that grows
KINDS = ((60.0, 3600.0, OFFSET_SD_M), (20.0, 120.0, OFFSET_SD_M), (30.0, 60.0, 6.0), (600.0, 3600.0, OFFSET_SD_M))
"""Mean duration of a run [s], mean time between runs [s], sigma of an offset, each axis [m]: the likeliest is taken.

Of echoes, of frequent ones, of near ones, and of another beacon or antenna, which are long.
"""
HISTORIES = 10  # of each kind, and as many in a long run
RECENT = 10  # [fixes] by judgement: decisions that are older no longer distinguish two histories
CELL_BITS = 12  # fixed: of the square in which a position lies, in each direction
SEARCH = KERNEL.packer("Search")
CORRECT, BEGINS, CONTINUES = range(3)
RUN, OFFSET, RATE = slice(-4, None), slice(-4, -2), slice(-2, None)  # of the states, the last four are a run's


class HistorySearch(NamedTuple):
    """F fixes minus dead reckoning, linear in n states, of which the last four are those of a run."""

    residual_m: Array  # (F, 2)
    measurement_matrix: Array  # (F, 2, n) zero for a run: its states enter if there is one
    dt_s: Vector  # (F,) since the fix before
    fade: Vector  # (F,) of the correlated error since then
    drift_m2: Vector  # (F,) of dead reckoning since then, each axis
    noise: Noise  # covariances (J, F, 2, 2)
    bias: slice  # the states of the correlated error
    bias_m: float  # its sigma
    mean: Vector  # (n,) at the start
    cov: Array  # (n, n)
    gradual: bool  # a run may begin with a fix that is not far from the track
    cell_m: float  # histories whose positions lie in one square of this size may be one
    kinds: Array  # (k, 3) those of KINDS that are followed

    def backwards(self) -> "HistorySearch":
        """Return the search from the last fix to the first one, for positions that are not known at the start."""
        at_last = np.eye(len(self.mean))
        at_last[:2] = self.measurement_matrix[-1]
        at_last[:2, self.bias] = 0.0
        return self._replace(
            residual_m=self.residual_m[::-1],
            measurement_matrix=(self.measurement_matrix @ np.linalg.inv(at_last))[::-1],
            dt_s=np.roll(self.dt_s, -1)[::-1],
            fade=np.roll(self.fade, -1)[::-1],
            drift_m2=np.roll(self.drift_m2, -1)[::-1],
            noise=Noise(self.noise.probabilities, self.noise.cov[:, ::-1]),
            mean=at_last @ self.mean,
            cov=at_last @ self.cov @ at_last.T,
        )

    def followed(self) -> list["Followed"]:
        """Return the histories after each fix: the reference of the kernel."""
        kinds, n = len(self.kinds), len(self.mean)
        now = _Histories(
            np.zeros(kinds),
            np.tile(self.mean, (kinds, 1)),
            np.broadcast_to(self.cov, (kinds, n, n)),
            np.zeros(kinds, np.bool_),
            np.zeros(kinds, np.bool_),
            np.arange(kinds),
            *np.zeros((3, kinds), np.intp),
        )
        followed: list[Followed] = []
        for f, z in enumerate(self.residual_m):
            now = _predicted(now, self.bias, self.fade[f], self.bias_m, self.drift_m2[f], self.dt_s[f])
            noise = Noise(self.noise.probabilities, self.noise.cov[:, f])
            now, parent, decision = _updated(now, z, self.measurement_matrix[f], noise, self.dt_s[f], f, self)
            followed.append(Followed(now.log_weight, now.first, parent, decision, now.gradual))
        return followed


class Followed(NamedTuple):
    """N histories after a fix."""

    log_weight: Vector  # (N,)
    first: Indices  # (N,) how many of the first fixes are false
    parent: Indices  # (N,) the history before it
    decision: Indices  # (N,) what it takes the fix for: CORRECT, BEGINS or CONTINUES
    gradual: Mask  # (N,) the last fixes are false, from one on that was not far from the track


class _Histories(NamedTuple):
    """N histories with the state of each, n numbers."""

    log_weight: Vector  # (N,)
    mean: Array  # (N, n)
    cov: Array  # (N, n, n)
    in_run: Mask  # (N,)
    gradual: Mask  # (N,) no fix is correct since a run that began with one not far from the track
    kind: Indices  # (N,) row of the search's kinds
    recent: Indices  # (N,) the last RECENT decisions as bits
    first: Indices  # (N,) how many of the first fixes are false
    octave: Indices  # (N,) of the fix with which the run began, or the last one if it was long, counted from 1; 0: none


def _predicted(now: _Histories, bias: slice, fade: float, bias_m: float, drift_m2: float, dt_s: float) -> _Histories:
    mean, cov = now.mean.copy(), now.cov.copy()
    mean[:, bias] *= fade
    cov[:, bias] *= fade
    cov[:, :, bias] *= fade
    variance = np.einsum("nii->ni", cov)  # a view
    variance[:, :2] += drift_m2
    variance[:, bias] += (1 - fade**2) * bias_m**2
    mean[:, OFFSET] += dt_s * mean[:, RATE]
    cov[:, OFFSET] += dt_s * cov[:, RATE]
    cov[:, :, OFFSET] += dt_s * cov[:, :, RATE]
    variance[now.in_run, OFFSET] += OFFSET_WALK_M**2 * dt_s
    return now._replace(mean=mean, cov=cov)


def _updated(
    now: _Histories, z: Vector, H: Array, noise: Noise, dt_s: float, f: int, search: HistorySearch
) -> tuple[_Histories, Indices, Indices]:
    """Return the likeliest histories with this fix, the history before of each, and what each takes the fix for."""
    count, offset = len(now.log_weight), now.cov[:, :, OFFSET]
    decision, parent = np.divmod(np.arange(3 * count), count)
    cross = np.concatenate([now.cov @ H.T] * 3)  # (3 N, n, 2)
    e, S = z - now.mean @ H.T, H @ cross[:count]
    # two offsets of which none is known: that of a run that begins, and that of first fixes that were all false
    usual_m2 = search.kinds[now.kind, 2] ** 2
    begun = np.maximum(usual_m2, (e**2).sum(axis=1) / 2)
    apart = np.where((now.first == f) & (f > 0), begun - usual_m2, 0.0)
    begun_m2, apart_m2 = (variance[:, None, None] * np.eye(2) for variance in (begun, apart))
    shared = H @ offset
    cross[: 2 * count, RUN] = 0.0
    cross[:count, :2] += apart_m2
    cross[count : 2 * count, OFFSET] = begun_m2
    cross[2 * count :] += offset
    log_l, inverse, weighted = _by_mode(
        np.concatenate([e, e, e - now.mean[:, OFFSET]]),
        np.concatenate([S + apart_m2, S + begun_m2, S + shared + shared.transpose(0, 2, 1) + offset[:, OFFSET]]),
        noise,
    )
    of_fix = np.logaddexp.reduce(log_l, axis=0)
    near = _chi_square(e, S + noise.cov[0]) < FAR
    log_prior = _log_prior(now, search.kinds, dt_s, f)
    log_prior[BEGINS, near & (now.first < f) & (not search.gradual)] = -np.inf
    log_weight = of_fix + (now.log_weight + log_prior).ravel()
    # a tail as heavy as a scale that is not known
    log_weight[: 2 * count] += 0.5 * np.log(np.tile(usual_m2, 2) / np.concatenate([apart + usual_m2, begun]))
    recent = ((now.recent[parent] << 1) | (decision != CORRECT)) & (2**RECENT - 1)
    in_run = decision != CORRECT
    short = now.in_run[parent] & ~in_run & (now.recent[parent] != 2**RECENT - 1)
    octave = np.where(decision == BEGINS, (f + 1).bit_length(), np.where(short, 0, now.octave[parent]))
    first = now.first[parent] + (in_run & (now.first[parent] == f))
    cell = (np.floor(now.mean[parent, :2] / search.cell_m).astype(np.int64) & (2**CELL_BITS - 1)) @ [2**CELL_BITS, 1]
    kept, log_weight = _chosen(log_weight, now.kind[parent], recent, octave, np.where(in_run, 0, first), in_run, cell)
    decision, parent, cross = decision[kept], parent[kept], cross[kept]
    mean, cov = now.mean[parent], now.cov[parent]
    ended = decision != CONTINUES
    mean[ended, RUN] = 0.0
    cov[ended, RUN] = 0.0
    cov[ended, :, RUN] = 0.0
    cov[decision == CORRECT, :2, :2] += apart_m2[parent[decision == CORRECT]]
    cov[decision == BEGINS, OFFSET, OFFSET] = begun_m2[parent[decision == BEGINS]]
    cov[decision == BEGINS, RATE, RATE] = RATE_MPS**2 * np.eye(2)
    g, G = _correction(np.exp(log_l[:, kept] - of_fix[kept]), inverse[:, kept], weighted[:, kept])
    mean += (cross @ g[:, :, None])[:, :, 0]
    cov += cross @ G @ cross.transpose(0, 2, 1)
    slowly = in_run[kept] & (now.gradual[parent] | ((decision == BEGINS) & near[parent]))
    after = _Histories(
        log_weight, mean, cov, in_run[kept], slowly, now.kind[parent], recent[kept], first[kept], octave[kept]
    )
    return after, parent, decision


def _log_prior(now: _Histories, kinds: Array, dt_s: float, f: int) -> Array:
    """Return the log probability that each history takes the fix for correct, the first or another one of a run."""
    run_s, gap_s, _ = kinds[now.kind].T
    begins = run_s / (run_s + gap_s) if f == 0 else -np.expm1(-dt_s / gap_s)
    ends = np.where(now.in_run, -np.expm1(-dt_s / run_s), 1.0)
    with np.errstate(divide="ignore"):
        log_prior: Array = np.log([(1 - begins) * ends, begins * ends, 1 - ends])
    return log_prior


def _chosen(
    log_weight: Vector, kind: Indices, recent: Indices, octave: Indices, start: Indices, in_run: Mask, cell: Indices
) -> tuple[Indices, Vector]:
    """Return rows and weights of the likeliest HISTORIES of each kind, in a long run and else, and of some others.

    These are the likeliest long run of each octave and kind, the likeliest one that has ended, of each octave, and the
    likeliest false start, of each octave of its ``start`` fixes: many correct ones may have to follow until it is the
    likeliest of all. Of those that agree in the recent fixes, in the ``cell`` of the position and, of a long run, in
    its octave, the likeliest stands for all.
    """
    order = np.argsort(-log_weight, kind="stable")
    order = order[np.isfinite(log_weight[order])]
    long = recent[order] == 2**RECENT - 1
    of_long = np.where(long | ~in_run[order], octave[order], 0)
    code = ((kind[order] << RECENT | recent[order]) << 6 | of_long) << 2 * CELL_BITS | cell[
        order
    ]  # 12 bits of MAX_FIXES
    _, first, group = np.unique(code, return_index=True, return_inverse=True)
    top = log_weight[order[first]]
    total = top + np.log(np.bincount(group, np.exp(log_weight[order] - top[group])))
    kept, long = order[first], long[first]
    likeliest = np.argsort(-total, kind="stable")
    longest = likeliest[_first_of(np.where(long, kind[kept] << 6 | octave[kept], -1)[likeliest])]
    others = likeliest[~np.isin(likeliest, longest)]
    its_kind = 2 * kind[kept][others] + long[others]
    rows = [longest, *(others[its_kind == k][:HISTORIES] for k in range(2 * len(KINDS)))]
    for ended in (np.frexp(start[kept])[1], np.where(in_run[kept], 0, octave[kept])):  # octaves
        rows.append(likeliest[_first_of(np.where(ended > 0, ended, -1)[likeliest])])
    each = np.unique(np.concatenate(rows))
    return kept[each], total[each]


def _first_of(group: Indices) -> Indices:
    """Return the row of the first of each group; -1 is none."""
    groups, rows = np.unique(group, return_index=True)
    return rows[groups >= 0]


def _by_mode(e: Vector, S: Array, noise: Noise) -> tuple[Array, Array, Array]:
    """Return the log of each mode's part of the likelihood, (J, N), (S + R)^-1, (J, N, 2, 2), and its product by e."""
    inverse, det = _inverse(S + noise.cov[:, None])
    weighted = (inverse @ e[:, :, None])[..., 0]
    log_l = -0.5 * ((weighted * e).sum(axis=-1) + np.log(det)) - np.log(2 * np.pi)
    return log_l + np.log(noise.probabilities)[:, None], inverse, weighted


def _chi_square(e: Array, S: Array) -> Vector:
    """Return how far innovations (N, 2) are from zero by their covariances (N, 2, 2)."""
    inverse, _ = _inverse(S)
    return ((inverse @ e[:, :, None])[..., 0] * e).sum(axis=-1)


def _inverse(S: Array) -> tuple[Array, Array]:
    """Return the inverses and the determinants of symmetric matrices (..., 2, 2)."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    det = a * c - b * b
    return np.stack([c, -b, -b, a], axis=-1).reshape(S.shape) / det[..., None, None], det


def _correction(p: Array, inverse: Array, weighted: Array) -> tuple[Array, Array]:
    """Return g and G of the moment-matched update: mean + C g, covariance + C G C^T with the cross covariance C."""
    g = np.einsum("jn,jna->na", p, weighted)
    outer = weighted[..., :, None] * weighted[..., None, :] - inverse
    return g, np.einsum("jn,jnab->nab", p, outer) - g[:, :, None] * g[:, None, :]


def followed(search: HistorySearch) -> list[Followed]:
    """Return what HistorySearch.followed returns, from the kernel if it runs and has room for so many."""
    (F, _, n), noise, limits = search.measurement_matrix.shape, search.noise, KERNEL.limits
    kinds, modes = len(search.kinds), len(noise.probabilities)
    most = kinds * (2 * HISTORIES + F.bit_length()) + 2 * F.bit_length()  # see _chosen
    if KERNEL.run_histories is None or n > limits.states or modes > limits.modes or most > limits.histories:
        return search.followed()
    searched = OFFSET_WALK_M**2, RATE_MPS**2, search.bias_m**2, search.cell_m
    sizes = n, F, modes, kinds, search.bias.start, HISTORIES, RECENT, search.gradual
    log_weight, rows, count = (
        np.empty((F, limits.histories)),
        np.empty((4, F, limits.histories), np.int64),
        np.empty(F, np.int64),
    )
    inputs = (
        search.residual_m,
        search.measurement_matrix,
        np.column_stack([search.dt_s, search.fade, search.drift_m2]),
        noise.probabilities,
        noise.cov,
        np.tile(search.mean, (kinds, 1)),
        np.tile(search.cov, (kinds, 1, 1)),
        search.kinds,
    )
    arrays = (np.ascontiguousarray(array, np.float64) for array in inputs)
    KERNEL.run_histories(KERNEL.variant, SEARCH.pack(FAR, *searched, *sizes), *arrays, log_weight, *rows, count)
    first, parent, decision, gradual = rows
    return [
        Followed(log_weight[f, :N], first[f, :N], parent[f, :N], decision[f, :N], gradual[f, :N] != 0)
        for f, N in enumerate(count.tolist())
    ]
