"""A pass over all fixes for the members of a bank: its data, and the loop in NumPy, the reference of the kernel."""

from dataclasses import dataclass

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank, Projection
from usbldr.filters.estimators.mode_updates import collapse
from usbldr.filters.identification import clusters
from usbldr.filters.models.noise import BankNoise, Noise
from usbldr.filters.types import Array, Indices, Mask, Vector

BOTH_AXES = slice(0, 2)  # east and north of a fix


@dataclass(frozen=True, slots=True)
class FixPass:
    """F fixes minus dead reckoning, linear in n states, for N members that share G linearisations.

    Between fixes the correlated error decays and dead reckoning drifts. Metres and seconds.
    """

    residual_m: Array  # (F, 2, G)
    measurement_matrix: Array  # (F, 2, n, G)
    group: Indices  # (N,) linearisation of each member
    bias: slice  # rows of the correlated error
    changes: Array  # (3, F, N) decay of the correlated error, then the variances added to it and to the position
    noise: BankNoise
    cov_m2: Array  # (F, 2, 2) stated
    counted: Mask  # (F,) whether the likelihood of a fix counts
    dt_s: Vector  # (F,) since the fix before

    def over(self, bank: GaussianBank) -> tuple[GaussianBank, Vector]:
        """Return the bank after all fixes, and the log likelihood that each of the N members gives them."""
        N, total = len(self.group), np.zeros(len(self.group))
        begins, ends = clusters.switching(self.dt_s)
        for f, R in enumerate(self.cov_m2):
            bank = self._predicted(bank, f)
            modes, doubled = self.noise.modes(R), len(bank.log_weight) > N
            if doubled or clusters.far(self._projection(bank, f, BOTH_AXES), modes.cov[0]):
                bank = clusters.mixed(bank if doubled else clusters.both_hypotheses(bank), begins[f], ends[f])
                modes, doubled = Noise(np.tile(modes.probabilities, 2), np.tile(modes.cov, 2), modes.per_scalar), True
            for axes in modes.blocks():
                bank, log_l, *_ = collapse(bank, self._projection(bank, f, axes), modes.block(axes))
                if doubled:
                    bank, log_l = clusters.reweighted(bank, log_l)
                total += self.counted[f] * log_l
            if doubled and clusters.negligible(bank):
                bank = clusters.members(bank)
        return clusters.members(bank) if len(bank.log_weight) > N else bank, total

    def _projection(self, bank: GaussianBank, f: int, axes: slice) -> Projection:
        """Return these axes of a fix as the N members, or their 2 N hypotheses, predict it."""
        group = np.tile(self.group, len(bank.log_weight) // len(self.group))
        h = self.measurement_matrix[f, axes][:, :, group]
        cross = np.einsum("ijm,ajm->iam", bank.cov, h)
        innovation = self.residual_m[f, axes][:, group] - np.einsum("aim,im->am", h, bank.mean)
        return Projection(innovation, np.einsum("aim,ibm->abm", h, cross), cross)

    def _predicted(self, bank: GaussianBank, f: int) -> GaussianBank:
        """Return the bank of N members, or of their 2 N hypotheses, at fix f."""
        fade, bias_m2, drift_m2 = np.tile(self.changes[:, f], len(bank.log_weight) // len(self.group))
        mean, cov = bank.mean.copy(), bank.cov.copy()
        mean[self.bias] *= fade
        cov[self.bias] *= fade
        cov[:, self.bias] *= fade
        for rows, added in ((range(2), drift_m2), (range(self.bias.start, self.bias.stop), bias_m2)):
            cov[rows, rows] += added
        return bank._replace(mean=mean, cov=cov)
