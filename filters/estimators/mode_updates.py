"""How a Gaussian belief is updated with mixture noise: match its moments, gate, or collapse the posterior mixture.

Innovations e are (k, N), measured minus predicted; S_j = H P H' + R_j for noise mode j. The fourth way, drawing a mode
for each particle, belongs to the particle filters (cpf.py).
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
    """Likelihoods of the J noise modes given one measurement, for each of N members."""

    log_joint: Array  # (J, N) log of eps_j N(e; 0, S_j)
    log_likelihood: Vector  # (N,) predictive, of the measurement
    inverse: Array  # (J, k, k, N) S_j^-1
    scaled: Array  # (J, k, N) S_j^-1 e

    @property
    def probability(self) -> Array:
        """Posterior probability of each mode, (J, N)."""
        return np.exp(self.log_joint - self.log_likelihood)


def mode_likelihoods(projection: Projection, noise: Noise) -> ModeLikelihoods:
    """Return the likelihoods of the noise modes for the innovation."""
    S = projection.cov + noise.cov.reshape(*noise.cov.shape[:3], -1)
    inverse, logdet = inverse_and_logdet(S)
    if len(projection.innovation) == 1:
        scaled = inverse[:, 0] * projection.innovation
        distance = scaled[:, 0] * projection.innovation[0]
    else:
        scaled = np.einsum("jkln,ln->jkn", inverse, projection.innovation)
        distance = np.einsum("jkn,kn->jn", scaled, projection.innovation)
    constant = np.log(noise.probabilities) - 0.5 * len(projection.innovation) * math.log(2 * math.pi)
    # log eps_j - (k log 2 pi + log det S_j + e' S_j^-1 e) / 2
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


class ModeUpdate(Protocol):
    """How a bank is updated with a measurement whose noise has modes."""

    def __call__(self, bank: GaussianBank, projection: Projection, noise: Noise) -> UpdateResult:
        """Return the bank after the measurement."""
        ...


def moment_matched(bank: GaussianBank, projection: Projection, noise: Noise) -> UpdateResult:
    """Replace the noise mixture by one Gaussian with its covariance."""
    R = noise.mixture_cov
    log_likelihood = mode_likelihoods(projection, Noise(np.ones(1), R[None])).log_likelihood
    return UpdateResult(update(bank, projection, R[:, :, None]), log_likelihood, False)


def collapse(bank: GaussianBank, projection: Projection, noise: Noise) -> UpdateResult:
    """Keep the mean and covariance of the exact posterior mixture (assumed density filtering).

    With p_j the posterior mode probabilities: g = sum p_j S_j^-1 e, G = sum p_j (S_j^-1 - S_j^-1 e e' S_j^-1) + g g'.
    C. J. Masreliez, "Approximate non-Gaussian filtering with linear state and observation relations", IEEE Trans.
    Automatic Control 20(1), 1975, doi:10.1109/TAC.1975.1100882.
    """
    after, log_likelihood = _collapsed(bank, projection, noise)
    again = relinearised(bank, after, projection)
    if again is not None:
        after = after._replace(cov=_collapsed(bank, again, noise)[0].cov)
    return UpdateResult(after, log_likelihood, False)


def _collapsed(bank: GaussianBank, projection: Projection, noise: Noise) -> tuple[GaussianBank, Vector]:
    """Return the bank after the measurement, and its log likelihood."""
    modes = mode_likelihoods(projection, noise)
    p = modes.probability
    weighted = p[:, None] * modes.scaled
    g = weighted.sum(axis=0)  # sum p_j S_j^-1 e
    second = np.einsum("jkn,jln->kln", weighted, modes.scaled)  # sum p_j S_j^-1 e e' S_j^-1
    G = (p[:, None, None] * modes.inverse).sum(axis=0) - second + g[:, None] * g[None]
    # Masreliez: m = m- + P H' g, P = P- - P H' G H P
    return apply_gain(bank, projection, g, G), modes.log_likelihood


@dataclass(frozen=True, slots=True)
class Gate:
    """Use the nominal noise mode alone and reject measurements whose NIS is above its chi-square quantile."""

    probability: float = 0.99  # the usual gate: it rejects one inlier in 100

    def __call__(self, bank: GaussianBank, projection: Projection, noise: Noise) -> UpdateResult:
        """Return the bank, unchanged if the measurement is rejected."""
        nominal = Noise(np.ones(1), noise.cov[:1])
        nominal_mode = mode_likelihoods(projection, nominal)
        nis = float(np.sum(nominal_mode.scaled[0] * projection.innovation))  # e' S^-1 e of a bank of one
        if nis > chi_square_quantile(self.probability, len(projection.innovation)):
            return UpdateResult(bank, np.zeros(1), True)
        return UpdateResult(update(bank, projection, nominal.cov[0, :, :, None]), nominal_mode.log_likelihood, False)
