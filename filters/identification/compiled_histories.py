"""The search for false fixes in a row in the compiled kernel; histories.py holds the reference."""

import numpy as np

from usbldr.filters.identification import clusters, histories
from usbldr.filters.identification.histories import KINDS, RECENT, Followed, HistorySearch
from usbldr.filters.kernel import KERNEL

SEARCH = KERNEL.packer("Search")


def followed(search: HistorySearch) -> list[Followed]:
    """Return what HistorySearch.followed returns, from the kernel if it runs and has room for so many."""
    (F, _, n), noise, limits = search.measurement_matrix.shape, search.noise, KERNEL.limits
    kinds, modes = len(KINDS), len(noise.probabilities)
    most = kinds * (2 * histories.HISTORIES + F.bit_length()) + 2 * F.bit_length()  # see _chosen
    if KERNEL.run_histories is None or n > limits.states or modes > limits.modes or most > limits.histories:
        return search.followed()
    searched = histories.OFFSET_WALK_M**2, histories.RATE_MPS**2, search.bias_m**2, search.cell_m
    sizes = n, F, modes, kinds, search.bias.start, histories.HISTORIES, RECENT, search.gradual
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
        np.array(KINDS),
    )
    arrays = (np.ascontiguousarray(array, np.float64) for array in inputs)
    KERNEL.run_histories(SEARCH.pack(clusters.FAR, *searched, *sizes), *arrays, log_weight, *rows, count)
    first, parent, decision, gradual = rows
    return [
        Followed(log_weight[f, :N], first[f, :N], parent[f, :N], decision[f, :N], gradual[f, :N] != 0)
        for f, N in enumerate(count.tolist())
    ]
