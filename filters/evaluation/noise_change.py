"""Noise that changes within a dive, and sigmas that are far from the innovations of a sensor.

A change of the variance shows in the cumulative sum of squares: C. Inclán and G. C. Tiao, "Use of Cumulative Sums of
Squares for Retrospective Detection of Changes of Variance", J. Am. Stat. Assoc. 89(427), 1994,
doi:10.1080/01621459.1994.10476824. The largest deviation from a straight line, by the standard deviation of a sum, has
Kolmogorov's distribution if nothing changes. Squares of neighbours may depend on each other: their autocorrelation
counts in that standard deviation.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Trajectory, Vector
from usbldr.filters.updates import UpdateTable

LEAST_VALUES = 60  # [values] fewer hardly show a factor of two
LEAST_PART = 15  # [values] before and after a change, for a median of each
LARGEST_SQUARE = 9.0  # [-] a score of 3 sigma: beyond, outliers would count as a change of the noise
LAGS = 30  # [values] over which neighbours may depend on each other
CHANCE = 1e-4  # of a change where there is none
NOTABLE_FACTOR = 1.5  # of the sigma: NEES is then wrong by more than 2
FAR_FACTOR = 2.0  # of the sigma of a whole sensor: the other half of the range that identification covers
STATED = {"dvl": "sd_mps", "compass": "sd_deg", "usbl": "sd_m or sd_scale", "gps": "sd_m"}


class NoiseChange(NamedTuple):
    """When noise changed, and by what factor its sigma grew."""

    time_s: float
    factor: float

    @property
    def text(self) -> str:
        """The change in words."""
        word = "grows" if self.factor > 1 else "falls"
        return f"{word} by a factor of {max(self.factor, 1 / self.factor):.1f} at about {self.time_s:.0f} s"


def noise_change(time_s: Vector, squares: Vector) -> NoiseChange | None:
    """Return the largest change of scores squared, (n,) ascending in time with mean 1; None without a notable one."""
    known = np.isfinite(squares)
    t, q = time_s[known], np.minimum(squares[known], LARGEST_SQUARE)
    n = len(q)
    if n < LEAST_VALUES or not q.any():
        return None
    count, total = np.arange(1, n), np.cumsum(q)[:-1]
    means = np.maximum([total / count, (q.sum() - total) / (n - count)], 1e-12)
    log_likelihood = -(count * np.log(means[0]) + (n - count) * np.log(means[1]))  # of two variances, by their border
    last = int(np.argmax(log_likelihood[LEAST_PART - 1 : n - LEAST_PART])) + LEAST_PART - 1  # before the change
    residual = q - np.repeat(means[:, last], [last + 1, n - last - 1])
    variance = max(_long_run_variance(residual), 1e-12)
    statistic = float(np.abs(total - count * q.mean()).max()) / math.sqrt(n * variance)
    typical = [max(float(np.median(part)), 1e-12) for part in (q[: last + 1], q[last + 1 :])]  # whatever is cut off
    factor = math.sqrt(typical[1] / typical[0])
    notable = max(factor, 1 / factor) > NOTABLE_FACTOR
    beyond = 2 * math.exp(-2 * statistic**2) < CHANCE
    return NoiseChange(float(t[last + 1]), factor) if beyond and notable else None


def _long_run_variance(values: Vector) -> float:
    """Return the variance of a sum of dependent values over their number (Bartlett's weights)."""
    lags = np.arange(1, min(LAGS, len(values) - 1))
    sums = [float(values[lag:] @ values[:-lag]) * (1 - lag / LAGS) for lag in lags.tolist()]
    return (float(values @ values) + 2 * sum(sums)) / len(values)


def noise_warnings(trajectory: Trajectory, false_fixes: Sequence[int] = ()) -> tuple[str, ...]:
    """Return what the innovations of a filter's run say against the noise that it assumed, by sensor.

    Rows of ``false_fixes``, which the run left out, say nothing of the noise.
    """
    table = UpdateTable.of(trajectory.updates)
    parts, texts = table.parts, list[str]()
    for sensor in table.sensors:
        mine = (parts.sensor == table.names.index(sensor)) & np.isfinite(parts.nis)
        mine &= ~np.isin(parts.row, false_fixes) | (sensor != "usbl")
        squares = parts.nis[mine] / parts.dof[mine]
        if len(squares) < LEAST_VALUES:
            continue
        order = np.argsort(parts.time_s[mine], kind="stable")
        if (change := noise_change(parts.time_s[mine][order], squares[order])) is not None:
            texts.append(
                f"the noise of the {sensor} {change.text} more than the filter takes into account: its sigmas "
                "are too small in one part and too large in the other"
            )
        if (mean := float(squares.mean())) > FAR_FACTOR**2:
            texts.append(
                f"innovations of the {sensor} are {math.sqrt(mean):.1f} times as large as their sigmas (NIS "
                f"{mean:.1f} per number, expected 1): state a larger {STATED.get(sensor, 'sigma')} under [{sensor}], "
                "or look for an error of that sensor"
            )
    return tuple(texts)
