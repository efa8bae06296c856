"""Fisher information of a measurement's noise: the most that one measurement can contribute to any estimator.

For noise of density p about a prediction it is the integral of p'p'/p, in one over the unit squared: 1/R for N(0, R),
and 0.529/R for each scalar of eq. (23) (0.589/R if both axes of a fix share their mode).

The integrals are sums over a grid of points c sinh(t), evenly spaced in t: fine where the narrowest mode bends the
density and as far out as the widest reaches. For smooth integrands that fall off like these the error of such a sum
vanishes exponentially with the spacing: L. Trefethen and J. Weideman, "The exponentially convergent trapezoidal rule",
SIAM Review 56(3), 2014, doi:10.1137/130932132.
"""

import functools

import numpy as np

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Noise
from usbldr.filters.types import Array, Vector

GRID_SPACING = 0.1  # in t; the information is then good to 1e-6 (tests/filters/bounds/test_fisher.py)
GRID_SIGMAS = 9.0  # of the widest mode


def fisher_information(noise: Noise) -> Array:
    """Return the Fisher information of one measurement of k scalars, (k, k), in one over its units squared.

    The work grows as 150^k, so k is 1 or 2. Raises UsageError for noise without variance.
    """
    nominal: Array = noise.cov[0]
    try:
        root = np.linalg.cholesky(nominal)
    except np.linalg.LinAlgError as err:
        raise UsageError("no bound exists if a sensor has no noise: set its sigmas above 0") from err
    unroot = np.linalg.inv(root).astype(np.float64, copy=False)
    whitened = unroot @ noise.cov @ unroot.T
    # a mixture of multiples of R is the same for each R once whitened; rounding makes it so to the bit
    information = _whitened_information(_rounded(noise.probabilities), _rounded(whitened), whitened.shape)
    return unroot.T @ information @ unroot


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.11e}") for value in values.ravel().tolist())


@functools.lru_cache(maxsize=4096)
def _whitened_information(shares: tuple[float, ...], flat: tuple[float, ...], shape: tuple[int, ...]) -> Array:
    """Return the information of modes given as numbers, so that equal ones are computed once."""
    modes = np.array(flat).reshape(shape)
    widest = modes[np.argmax(np.trace(modes, axis1=1, axis2=2))]
    axes: Array = np.linalg.eigh(widest).eigenvectors  # turned so that a lengthy mode lies along the grid
    R: Array = axes.T @ modes @ axes
    inverse, logdet = np.linalg.inv(R), np.linalg.slogdet(R).logabsdet
    narrow = np.sqrt(1 / np.einsum("jkk->jk", inverse).max(axis=0))
    wide = np.sqrt(np.einsum("jkk->jk", R).max(axis=0))
    points, weights = _grid(narrow, wide)
    scores = np.einsum("jkl,ml->jkm", inverse, points)  # minus the gradient of each mode's log density
    log_p = np.log(shares)[:, None] - 0.5 * (logdet[:, None] + np.einsum("jkm,mk->jm", scores, points))
    top = log_p.max(axis=0)
    p = np.exp(log_p - top)
    total = p.sum(axis=0)
    score = np.einsum("jm,jkm->km", p / total, scores)
    density = np.exp(top) * total * (2 * np.pi) ** (-len(axes) / 2)
    return axes @ ((score * (density * weights)) @ score.T) @ axes.T


def _grid(narrow: Vector, wide: Vector) -> tuple[Array, Vector]:
    """Return the product grid of each axis' points c sinh(t), (m, k), and their weights, (m,)."""
    values: list[Vector] = []
    steps: list[Vector] = []
    for c, reach in zip(narrow, GRID_SIGMAS * wide, strict=True):
        count = int(np.ceil(np.arcsinh(reach / c) / GRID_SPACING))
        t = GRID_SPACING * np.arange(-count, count + 1)
        values.append(c * np.sinh(t))
        steps.append(GRID_SPACING * c * np.cosh(t))
    points = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, len(values))
    return points, np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, len(steps)).prod(axis=1)
