"""The pass over the fixes in the compiled kernel: usbl_likelihood.py holds the reference and the loop over clusters."""

from dataclasses import dataclass

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank
from usbldr.filters.identification import clusters
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.noise import BankNoise
from usbldr.filters.types import Array, Indices, Mask, Vector

PASS = KERNEL.packer("Pass")
WHOLE = 3  # fixed: axis of layout.h, both after the prediction


@dataclass(frozen=True, slots=True)
class CompiledFixes:
    """F fixes for M members that share G linearisations: what _Fixes, _Motion and BankNoise hold."""

    residual_m: Array  # (F, 2, G)
    measurement_matrix: Array  # (F, 2, n, G)
    group: Indices  # (M,)
    bias_row: int
    changes: Array  # (3, F, M)
    noise: BankNoise  # of the members
    cov_m2: Array  # (F, 2, 2)
    counted: Mask  # (F,) whether the likelihood of a fix counts

    @property
    def usable(self) -> bool:
        """Whether the kernel runs, and has room for so many noise modes and states."""
        J, n = len(self.noise.probabilities), self.measurement_matrix.shape[2]
        return KERNEL.run_pass is not None and KERNEL.limits.modes >= J and n <= KERNEL.limits.states

    def until_far(self, bank: GaussianBank, first: int) -> tuple[GaussianBank, Vector, int]:
        """Return the bank after the fixes from ``first`` on, their log likelihoods, and the first that was not used.

        That fix is so far from what a member predicts that it may begin a cluster.
        """
        return self._run(bank, first, len(self.cov_m2), WHOLE)

    def updated(self, bank: GaussianBank, f: int, axes: slice) -> tuple[GaussianBank, Vector]:
        """Return the predicted bank after these axes of a fix, and their log likelihoods."""
        axis = axes.start if axes.stop - axes.start == 1 else 2
        return self._run(bank, f, f + 1, axis)[:2]

    def _run(self, bank: GaussianBank, first: int, last: int, axis: int) -> tuple[GaussianBank, Vector, int]:
        F, _, n, G = self.measurement_matrix.shape
        N, M, noise = len(bank.log_weight), len(self.group), self.noise
        sizes = (n, N, F, M, G, len(noise.probabilities), self.bias_row, noise.per_scalar)
        coded = PASS.pack(clusters.FAR, *sizes, first, last, axis, 0)
        mean, cov, log_l = bank.mean.copy("C"), bank.cov.copy("C"), np.zeros(N)
        # a fix of a cluster is counted by whoever weighs the hypotheses
        counted = self.counted.astype(np.float64) if axis == WHOLE else np.ones(F)
        inputs = (self.residual_m, self.measurement_matrix, self.changes, self.group.astype(np.int64))
        tables = (noise.probabilities, noise.gain, noise.offset, self.cov_m2, counted)
        assert KERNEL.run_pass is not None
        arrays = (np.ascontiguousarray(array) for array in (*inputs, *tables))
        done = KERNEL.run_pass(KERNEL.variant, coded, mean, cov, log_l, *arrays)
        return bank._replace(mean=mean, cov=cov), log_l, done
