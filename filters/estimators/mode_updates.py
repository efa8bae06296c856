"""What a Gaussian makes of noise that has several modes: match it, gate it, or collapse the mixture that it leaves.

The fourth policy, drawing a mode for each particle, belongs to the particle filters (cpf.py).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from usbldr.filters.estimators.gaussian_bank import (
    GaussianBank,
    Projection,
    apply_gain,
    inverse_and_logdet,
    relinearised,
    update,
)
from usbldr.filters.models.noise import Noise, chi_square_quantile
from usbldr.filters.types import Array, Vector


class ModeLikelihoods(NamedTuple):
    """The J noise modes in the light of one measurement."""

    log_joint: Array  # (J, N) log of eps_j N(e; 0, S_j)
    log_likelihood: Vector  # (N,) predictive, of the measurement
    inverse: Array  # (J, k, k, N) S_j^-1
    scaled: Array  # (J, k, N) S_j^-1 e

    @property
    def probability(self) -> Array:
        """Posterior probability of each mode, (J, N)."""
        return np.exp(self.log_joint - self.log_likelihood)


def mode_likelihoods(seen: Projection, noise: Noise) -> ModeLikelihoods:
    """Weigh the modes of the noise against the innovation."""
    S = seen.cov + noise.cov.reshape(*noise.cov.shape[:3], -1)
    inverse, logdet = inverse_and_logdet(S)
    if len(seen.innovation) == 1:
        scaled = inverse[:, 0] * seen.innovation
        distance = scaled[:, 0] * seen.innovation[0]
    else:
        scaled = np.einsum("jkln,ln->jkn", inverse, seen.innovation)
        distance = np.einsum("jkn,kn->jn", scaled, seen.innovation)
    constant = np.log(noise.probabilities) - 0.5 * len(seen.innovation) * math.log(2 * math.pi)
    log_joint = constant.reshape(len(S), -1) - 0.5 * (logdet + distance)
    return ModeLikelihoods(log_joint, _log_sum(log_joint), inverse, scaled)


def _log_sum(logs: Array) -> Vector:
    """Return the log of the sum over the first axis."""
    if len(logs) == 1:
        return logs[0]
    top = logs.max(axis=0)
    return top + np.log(np.exp(logs - top).sum(axis=0))


class UpdateResult(NamedTuple):
    """A bank after a measurement."""

    bank: GaussianBank
    log_likelihood: Vector  # (N,)
    rejected: bool
    covariance_inflated: bool = False  # the bank was: its covariance was doubled until the measurement fitted


class ModeUpdate(Protocol):
    """How a bank takes a measurement whose noise has modes."""

    def __call__(self, bank: GaussianBank, seen: Projection, noise: Noise, consecutive_rejections: int) -> UpdateResult:
        """Return the bank after the measurement; so many of the same sensor were rejected just before."""
        ...


def moment_matched(bank: GaussianBank, seen: Projection, noise: Noise, consecutive_rejections: int) -> UpdateResult:
    """Take the whole mixture for one Gaussian of its covariance."""
    one = Noise(np.ones(1), noise.mixture_cov[None])
    return UpdateResult(
        update(bank, seen, noise.mixture_cov[:, :, None]), mode_likelihoods(seen, one).log_likelihood, False
    )


def collapse(bank: GaussianBank, seen: Projection, noise: Noise, consecutive_rejections: int) -> UpdateResult:
    """Keep the mean and covariance of the exact posterior mixture (assumed density filtering).

    With p_j the posterior mode probabilities: g = sum p_j S_j^-1 e, G = sum p_j (S_j^-1 - S_j^-1 e e' S_j^-1) + g g'.
    C. J. Masreliez, "Approximate non-Gaussian filtering with linear state and observation relations", IEEE Trans.
    Automatic Control 20(1), 1975, doi:10.1109/TAC.1975.1100882.
    """
    after, log_likelihood = _collapsed(bank, seen, noise)
    relinearised_seen = relinearised(bank, after, seen)
    if relinearised_seen is not None:
        after = after._replace(cov=_collapsed(bank, relinearised_seen, noise)[0].cov)
    return UpdateResult(after, log_likelihood, False)


def _collapsed(bank: GaussianBank, seen: Projection, noise: Noise) -> tuple[GaussianBank, Vector]:
    """Return the bank after the measurement, and its log likelihood."""
    seen_modes = mode_likelihoods(seen, noise)
    p = seen_modes.probability
    weighted = p[:, None] * seen_modes.scaled
    g = weighted.sum(axis=0)
    second = np.einsum("jkn,jln->kln", weighted, seen_modes.scaled)
    G = (p[:, None, None] * seen_modes.inverse).sum(axis=0) - second + g[:, None] * g[None]
    return apply_gain(bank, seen.cross, g, G), seen_modes.log_likelihood


@dataclass(frozen=True, slots=True)
class Gate:
    """Take the nominal mode alone and refuse what it finds less likely than ``1 - probability``.

    A gate that has locked itself out must recover: after ``patience`` refusals of one sensor in a row it is the filter
    that is refuted, so its covariance is doubled until the next reading passes. Fewer false fixes in a row never open
    the gate, however far they lie.
    """

    probability: float = 0.99  # the usual gate: it refuses one good reading in 100
    max_rejections: int = (
        10  # by judgement: half as many nearly double the error in the scenario multipath, twice as many change nothing
    )

    def __call__(self, bank: GaussianBank, seen: Projection, noise: Noise, consecutive_rejections: int) -> UpdateResult:
        """Return the bank, changed only if the reading passes."""
        nominal = Noise(np.ones(1), noise.cov[:1])
        alone = mode_likelihoods(seen, nominal)
        limit = chi_square_quantile(self.probability, len(seen.innovation))
        refused = _distance(alone, seen) > limit
        if refused and consecutive_rejections < self.max_rejections:
            return UpdateResult(bank, np.zeros(1), True)
        covariance_inflated = refused and bool(seen.cov.any())
        while refused and seen.cov.any():
            bank = bank._replace(cov=2 * bank.cov)
            seen = seen._replace(cov=2 * seen.cov, cross=2 * seen.cross)
            refused = _distance(mode_likelihoods(seen, nominal), seen) > limit
        return UpdateResult(
            update(bank, seen, nominal.cov[0, :, :, None]), alone.log_likelihood, False, covariance_inflated
        )


def _distance(alone: ModeLikelihoods, seen: Projection) -> float:
    """Return e' S^-1 e of a bank of one under the nominal mode."""
    return float(np.sum(alone.scaled[0] * seen.innovation))
