"""Switch between correct fixes and fixes that share a false offset, in a pass over all fixes.

Echoes or a second beacon give false fixes in a row, all with one offset. A pass without this model would take them for
drift of dead reckoning. Each of N members therefore has two hypotheses, without and with an offset, which a Markov
chain mixes before each fix: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with
Markovian switching coefficients", IEEE Trans. Automatic Control 33(8), 1988, doi:10.1109/9.1299. Metres and seconds.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection, inverse_and_logdet
from usbldr.filters.types import Array, Vector

OFFSET_SD_M = 30.0  # each axis, by judgement: echoes lie metres to tens of metres away
CLUSTER_S = 60.0  # mean duration, by judgement: the likelihood of a longer cluster falls slowly
BETWEEN_S = 3600.0  # mean time between clusters, by judgement: they are rarer than single outliers
FAR = 12.0  # [-] chi-square of two that 1 fix in 400 exceeds
NEGLIGIBLE = 1e-4  # [-] weight of a hypothesis, as that below which the filters drop theirs


class _Mixture(NamedTuple):
    """The part of one hypothesis that comes from another."""

    weight: Vector  # (N,)
    mean: Array  # (n, N)
    cov: Array  # (n, n, N)


def far(projection: Projection, R: Array) -> bool:
    """Return whether a fix lies so far from what a member predicts that it may begin a cluster.

    For a nearer one the hypothesis of an offset would have a weight below NEGLIGIBLE. ``R`` (2, 2, N) or (2, 2, 1).
    """
    inverse, _ = inverse_and_logdet((projection.cov + R)[None])
    e = projection.innovation
    return bool((e * np.einsum("kln,ln->kn", inverse[0], e)).sum(axis=0).max() > FAR)


def both_hypotheses(bank: GaussianBank) -> GaussianBank:
    """Return N members as 2 N hypotheses: first without an offset, then with one, which has no weight yet."""
    log_weight = np.repeat([0.0, np.log(np.finfo(float).tiny)], len(bank.log_weight))
    return GaussianBank(np.tile(bank.mean, 2), np.tile(bank.cov, 2), log_weight)


def negligible(bank: GaussianBank) -> bool:
    """Return whether no member has an offset: of the 2 N hypotheses the last N have hardly any weight."""
    return bool(_halves(bank.log_weight)[1].max() < np.log(NEGLIGIBLE))


def switching(dt_s: Vector) -> tuple[Vector, Vector]:
    """Return the probabilities that a cluster begins and that one ends within times, (F,) each."""
    return -np.expm1(-dt_s / BETWEEN_S), -np.expm1(-dt_s / CLUSTER_S)


def mixed(bank: GaussianBank, begins: float, ends: float) -> GaussianBank:
    """Return the 2 N hypotheses after a cluster may begin or end; the last two states are the offset, east and north.

    ``begins`` and ``ends``: probabilities, of ``switching``.
    """
    right, false = _both(bank)
    begun, ended = right.cov.copy(), _Mixture(false.weight * ends, false.mean.copy(), false.cov.copy())
    begun[[-2, -1], [-2, -1]] += OFFSET_SD_M**2
    ended.mean[-2:] = 0.0
    ended.cov[-2:] = 0.0
    ended.cov[:, -2:] = 0.0
    parts = (
        _merged(right._replace(weight=right.weight * (1 - begins)), ended),
        _merged(_Mixture(right.weight * begins, right.mean, begun), false._replace(weight=false.weight * (1 - ends))),
    )
    return GaussianBank(
        np.concatenate([part.mean for part in parts], axis=1),
        np.concatenate([part.cov for part in parts], axis=2),
        np.log(np.concatenate([part.weight for part in parts])),
    )


def reweighted(bank: GaussianBank, log_likelihood: Vector) -> tuple[GaussianBank, Vector]:
    """Return the 2 N hypotheses weighted by their likelihoods (2 N,), and the log likelihoods of the members (N,)."""
    joint = bank.log_weight + log_likelihood
    total = np.logaddexp(*_halves(joint))
    return bank._replace(log_weight=joint - np.concatenate([total, total])), total


def members(bank: GaussianBank) -> GaussianBank:
    """Return the N members, each the Gaussian of its two hypotheses."""
    merged = _merged(*_both(bank))
    return GaussianBank(merged.mean, merged.cov, np.log(merged.weight))


def _both(bank: GaussianBank) -> tuple[_Mixture, _Mixture]:
    """Return the two hypotheses of the members: without and with an offset."""
    parts = (_halves(array) for array in (np.exp(bank.log_weight), bank.mean, bank.cov))
    right, false = zip(*parts, strict=True)
    return _Mixture(*right), _Mixture(*false)


def _halves(array: Array) -> tuple[Array, Array]:
    """Return both halves of the last axis, which np.split does ten times slower."""
    middle = array.shape[-1] // 2
    return array[..., :middle], array[..., middle:]


def _merged(a: _Mixture, b: _Mixture) -> _Mixture:
    """Return the Gaussian with the mean and covariance of both parts."""
    weight = np.maximum(a.weight + b.weight, np.finfo(float).tiny)
    p, q = a.weight / weight, b.weight / weight
    apart = a.mean - b.mean
    return _Mixture(weight, p * a.mean + q * b.mean, p * a.cov + q * b.cov + p * q * apart[:, None] * apart)
