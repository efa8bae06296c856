"""The pass over the fixes in the compiled kernel; fix_pass.py holds the reference."""

import numpy as np

from usbldr.filters.estimators.gaussian_bank import GaussianBank
from usbldr.filters.identification import clusters
from usbldr.filters.identification.fix_pass import FixPass
from usbldr.filters.kernel import KERNEL
from usbldr.filters.types import Vector

PASS = KERNEL.packer("Pass")


def passed(fixes: FixPass, bank: GaussianBank) -> tuple[GaussianBank, Vector]:
    """Return what FixPass.over returns, from the kernel if it runs and has room for so many noise modes and states."""
    F, _, n, G = fixes.measurement_matrix.shape
    noise, limits = fixes.noise, KERNEL.limits
    if KERNEL.run_pass is None or len(noise.probabilities) > limits.modes or n > limits.states:
        return fixes.over(bank)
    sizes = (n, len(fixes.group), F, G, len(noise.probabilities), fixes.bias.start, noise.per_scalar)
    coded = PASS.pack(clusters.FAR, clusters.OFFSET_SD_M**2, np.log(clusters.NEGLIGIBLE), *sizes, 0)
    mean, cov, log_l = bank.mean.copy("C"), bank.cov.copy("C"), np.zeros(len(fixes.group))
    switching = np.column_stack(clusters.switching(fixes.dt_s))
    inputs = (fixes.residual_m, fixes.measurement_matrix, fixes.changes, fixes.group.astype(np.int64))
    tables = (noise.probabilities, noise.gain, noise.offset, fixes.cov_m2, fixes.counted.astype(np.float64), switching)
    arrays = (np.ascontiguousarray(array) for array in (*inputs, *tables))
    KERNEL.run_pass(KERNEL.variant, coded, mean, cov, log_l, *arrays)
    return bank._replace(mean=mean, cov=cov), log_l
