"""Measurement noise as a mixture of Gaussian modes: the one form that all mode updates accept.

A noise *family* (Gaussian, Mixture, Contamination, StudentT) makes the modes for a nominal covariance R: mode j has
probability probabilities[j] and is N(0, cov[j]); mode 0 is the nominal one. Eq. (23) of the paper is Mixture().
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np

from usbldr.filters.models.quantities import SHARE, Limits, Quantity
from usbldr.filters.types import Array, Mask, Vector

TO_SD = 1.4826  # fixed: 1-sigma over the median of the size, of a normal error
BISECTIONS = 30  # fixed: of a median, to 1e-9 of the largest sigma
MAX_NOMINAL_RATIO = 4.0  # of variances: of Student-t with 4 degrees of freedom, outliers are then beyond 3 sigma
ROUNDING = 1e-15  # fixed: of double precision; a smaller share of a variance is no number
LEAST_TAIL = 1e-300  # fixed: near the smallest number of double precision, 37 sigma


@dataclass(frozen=True, slots=True)
class Noise:
    """Modes of one measurement of k scalars."""

    probabilities: Array  # (J,) add to 1; (J, N) if each member of a bank has its own
    cov: Array  # (J, k, k) or (J, k, k, N), in the measurement's units squared
    per_scalar: bool = False  # uncorrelated scalars draw their modes independently

    @property
    def is_nominal(self) -> Mask:
        """Whether each mode is of good measurements, (J,): its sigma is at most twice that of mode 0."""
        return is_nominal(np.einsum("jkk...->j...", self.cov))

    @property
    def mixture_cov(self) -> Array:
        """Covariance of the whole mixture, (k, k): the R of a moment-matched Gaussian."""
        return np.einsum("j,jkl->kl", self.probabilities, self.cov)

    def blocks(self) -> tuple[slice, ...]:
        """Return the slices of scalars that share a mode: one each if their errors are independent, else all in one.

        Axes with modes of their own are updated one after the other: as `joint`, two axes of J modes have J² modes, of
        which the kernel holds 9, for the same track. In six dives of 400 s of the scenario paper, both ways differ by
        less than 0.1 mm (ekf, adf) and by -0.7 ± 4.1 mm (cpf, 100 particles).
        """
        k = self.cov.shape[1]
        if k == 1 or not self.per_scalar or self.cov[:, ~np.eye(k, dtype=np.bool_)].any():
            return (slice(0, k),)
        return tuple(slice(scalar, scalar + 1) for scalar in range(k))

    def block(self, scalars: slice) -> "Noise":
        """Return the modes of one of the blocks."""
        return Noise(self.probabilities, np.ascontiguousarray(self.cov[:, scalars, scalars]))

    def joint(self) -> "Noise":
        """Return the modes of both scalars together: if each draws its own, each pair of modes is a mode."""
        if len(self.blocks()) == 1:
            return self
        J = len(self.probabilities)
        cov = np.zeros((J * J, 2, 2))
        cov[:, 0, 0], cov[:, 1, 1] = np.repeat(self.cov[:, 0, 0], J), np.tile(self.cov[:, 1, 1], J)
        return Noise(np.outer(self.probabilities, self.probabilities).ravel(), cov)


def is_nominal(variance: Array) -> Mask:
    """Return which of J modes are of good measurements, for their summed variances: (J, ...) both."""
    return variance <= MAX_NOMINAL_RATIO * variance[0]


class NoiseFamily(Protocol):
    """The distribution of a sensor's noise, for any nominal covariance."""

    @property
    def per_scalar(self) -> bool:
        """Whether each scalar of a record draws its own mode; otherwise the record draws one for all."""
        ...

    def modes(self, R: Array) -> Noise:
        """Return the modes for the nominal covariance R, (k, k); of F measurements, (F, k, k), as (J, F, k, k)."""
        ...


@dataclass(frozen=True, slots=True)
class Gaussian:
    """N(0, R)."""

    per_scalar: bool = True

    def modes(self, R: Array) -> Noise:
        """Return the one mode."""
        return Noise(np.ones(1), R[None], self.per_scalar)


@dataclass(frozen=True, slots=True)
class Mixture:
    """N(0, R) with probability 1 - share, N(0, variance_ratio R) with probability share: eq. (23) of the paper."""

    share: Annotated[float, Quantity("share", SHARE)] = 0.30  # eq. (23) of the paper
    # eq. (23) of the paper
    variance_ratio: Annotated[float, Quantity("variance_ratio", Limits(1.0, 1e9, above=True))] = 10.0
    per_scalar: bool = True

    def modes(self, R: Array) -> Noise:
        """Return the two modes."""
        return Noise(np.array([1 - self.share, self.share]), np.array([R, self.variance_ratio * R]), self.per_scalar)


@dataclass(frozen=True, slots=True)
class Contamination:
    """N(0, R) with probability 1 - share, N(0, R + sd^2 I) with probability share: outliers of size sd."""

    # by judgement: about twice as many as on uib_field, 13 of 591 fixes
    share: Annotated[float, Quantity("share", SHARE)] = 0.05
    # [of the sensor] by judgement: between the scatter of fixes and 31 m, the worst on uib_field
    sd: Annotated[float, Quantity("sd_{unit}")] = 10.0
    per_scalar: bool = False

    def modes(self, R: Array) -> Noise:
        """Return the two modes, the usual one first."""
        cov = np.array([R, R + self.sd**2 * np.eye(R.shape[-1])])
        order = [0, 1] if self.share <= 0.5 else [1, 0]
        return Noise(np.array([1 - self.share, self.share])[order], cov[order], self.per_scalar)


FARTHEST = 30.0  # [sigma] of readings that a Student's t describes: beyond it they are of another place


@dataclass(frozen=True, slots=True)
class StudentT:
    """Student's t with ``dof`` degrees of freedom and scale R, as nine values of its Gamma-distributed precision.

    They are equally spaced in the logarithm of the precision, with weights by its density: the trapezoidal rule, within
    2 % of the density of one reading up to FARTHEST sigma, or as far as nine values reach for many degrees of freedom.
    """

    # [degrees of freedom] the usual choice: tails are heavy, and the variance is finite
    dof: Annotated[float, Quantity("dof", Limits(2.0, 1e6))] = 4.0
    per_scalar: bool = False

    def modes(self, R: Array) -> Noise:
        """Return the nine modes, the one nearest to the median precision first."""
        half = self.dof / 2
        high = math.log(chi_square_quantile(0.997, self.dof) / self.dof)
        # a reading of e sigma is predicted by precisions about (dof + 1) / (dof + e^2), with this spread of their log
        spread = math.sqrt(2 / (self.dof + 1))
        low = max(math.log((self.dof + 1) / (self.dof + FARTHEST**2)), high - 8 * 2 * spread)
        log_precision = np.linspace(low, high, 9)
        log_weight = half * (log_precision - np.exp(log_precision))
        weight = np.exp(log_weight - log_weight.max())
        median = math.log(chi_square_quantile(0.5, self.dof) / self.dof)
        order = np.argsort(np.abs(log_precision - median), kind="stable")
        precision = np.exp(log_precision[order]).reshape(-1, *[1] * R.ndim)
        return Noise(weight[order] / weight.sum(), R / precision, self.per_scalar)


FAMILIES: dict[str, type[Any]] = {
    "gaussian": Gaussian,
    "mixture": Mixture,
    "student-t": StudentT,
    "contamination": Contamination,
}
"""Each kind of noise that can be stated, a frozen dataclass whose numbers are Quantity; a new one needs one row."""


class BankNoise:
    """The noise of a sensor for N members of a bank, each with its own family of J modes.

    The modes of every family are affine in R: mode j has gain g_j R + offset o_j I.
    """

    def __init__(self, families: Sequence[NoiseFamily], sd_scales: Sequence[float]) -> None:
        none = [family.modes(np.zeros((1, 1))) for family in families]
        one = [family.modes(np.full((1, 1), scale**2)) for family, scale in zip(families, sd_scales, strict=True)]
        self.per_scalar = families[0].per_scalar
        self.probabilities = np.stack([noise.probabilities for noise in none], axis=1)  # (J, N)
        self.offset = np.stack([noise.cov[:, 0, 0] for noise in none], axis=1)
        self.gain = np.stack([noise.cov[:, 0, 0] for noise in one], axis=1) - self.offset

    def modes(self, R: Array) -> Noise:
        """Return every member's modes for the nominal covariance R, (k, k), or (k, k, N) if each has its own."""
        eye, of_each = np.eye(len(R))[:, :, None], R.reshape(*R.shape[:2], -1)
        cov = self.gain[:, None, None] * of_each + self.offset[:, None, None] * eye
        return Noise(self.probabilities, cov, self.per_scalar)


def shown_sd(noise: Noise) -> float:
    """Return the 1-sigma that ``robust_sd`` shows on average for one scalar of each measurement, whatever its tails."""
    variance = noise.cov[:, 0, 0]
    sd = np.sqrt(variance[:, None] + variance).ravel()  # of differences
    probability = np.outer(noise.probabilities, noise.probabilities).ravel()
    low, high = 0.0, float(sd.max())
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        share = sum(p * math.erf(middle / one / math.sqrt(2)) for p, one in zip(probability, sd, strict=True))
        low, high = (middle, high) if share < 0.5 else (low, middle)
    return TO_SD * low / math.sqrt(2)


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the chi-square quantile by the Wilson-Hilferty cube, good to 1 % for 2 and more degrees of freedom.

    E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", PNAS 17(12), 1931, doi:10.1073/pnas.17.12.684.
    """
    z = normal_quantile(probability)
    return dof * max(1e-4, 1 - 2 / (9 * dof) + z * math.sqrt(2 / (9 * dof))) ** 3


def normal_quantile(probability: float) -> float:
    """Return the quantile of N(0, 1)."""
    from statistics import NormalDist  # the import takes 20 ms: only if a quantile is needed

    return NormalDist().inv_cdf(probability)


def robust_sd(differences: Sequence[float] | Vector) -> float:
    """Return the 1-sigma of one record from first differences of its series: 1.4826 MAD / sqrt(2).

    The median absolute deviation ignores the few large differences of manoeuvres and outliers; NaN if there are none.
    """
    d = np.asarray(differences, dtype=np.float64)
    d = d[np.isfinite(d)]
    return float(TO_SD * np.median(np.abs(d - np.median(d))) / math.sqrt(2)) if len(d) else float("nan")


def normal_scores(e: Vector, predicted: Array, noise: Noise) -> tuple[float, ...]:
    """Return independent normal scores of an innovation e (1,) or (2,), with predicted covariance H P H' (k, k).

    With noise modes the innovation is a mixture sum eps_j N(0, S_j), whose square over its variance has no fixed
    distribution: outliers of 10 m in the variance make good fixes look far too good. Rosenblatt's transform maps each
    scalar, given those before it, through its own distribution function to a quantile of N(0, 1). If the model is right
    the scores are independent N(0, 1), so their squares add to a chi-square value; for Gaussian noise that is
    e' S^-1 e. M. Rosenblatt, "Remarks on a multivariate transformation", Annals of Mathematical Statistics 23(3), 1952,
    doi:10.1214/aoms/1177729394. Raises LinAlgError if the covariance is singular.
    """
    S = predicted + noise.cov  # (J, k, k)
    if len(S) == 1:
        only: Array = S[0]
        return tuple(float(score) for score in np.linalg.solve(np.linalg.cholesky(only), e))
    variance, weight = S[:, 0, 0], noise.probabilities
    scores = (_score(float(e[0]), weight, np.zeros(len(S)), np.sqrt(variance)),)
    if len(e) == 1:
        return scores
    log_w = np.log(weight) - 0.5 * (e[0] ** 2 / variance + np.log(variance))  # of the modes, given the first scalar
    weight = np.exp(log_w - log_w.max())
    slope = S[:, 1, 0] / variance
    rest = S[:, 1, 1] - slope * S[:, 1, 0]
    if not (rest > ROUNDING * S[:, 1, 1]).all():
        raise np.linalg.LinAlgError("singular predicted covariance")
    return (*scores, _score(float(e[1]), weight / weight.sum(), slope * e[0], np.sqrt(rest)))


def _score(value: float, weight: Vector, mean: Vector, sd: Vector) -> float:
    """Return the quantile of N(0, 1) that the value has in sum w_j N(mean_j, sd_j^2)."""
    t = (value - mean) / (math.sqrt(2) * sd)
    below, above = (sum(w * math.erfc(x) / 2 for w, x in zip(weight, side.tolist(), strict=True)) for side in (-t, t))
    score = normal_quantile(max(float(min(below, above)), LEAST_TAIL))
    return score if below < above else -score
