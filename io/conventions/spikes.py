"""Spikes of DVL, compass and depth that no vehicle could follow, and jumps of the heading that stay.

A Hampel rule with a running median (F. R. Hampel, "The Influence Curve and its Role in Robust Estimation", J. Amer.
Statist. Assoc. 69, 1974, doi:10.1080/01621459.1974.10482962) finds records far from their neighbours. A running median
follows steps and steady turns exactly: they have no residual. A quick change of direction has one, so a spike must also
be further away than a vehicle moves there, and back, in the time between records.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pandas as pd

from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Indices, Mask, Vector
from usbldr.io.conventions.repeats import MAX_ACCELERATION_MPS2, runs, some_runs
from usbldr.io.messages.layouts import blocks

HALF_WINDOW_RECORDS = 6  # the median of 13 records endures bursts of 6
HALF_WINDOW_S = 1.0  # the same of a sensor faster than 6 Hz
SPIKE_RATIO = 10.0  # [-] deviation over the usual one: 6.7 sigma of normal noise
NOISE_RATIO = 5.0  # [-] usual deviations that noise adds to the change between two records: 3.4 sigma of one
MIN_SPIKE_DEG = 5.0  # smaller ones do little harm
MIN_SPIKE_MPS = 0.5  # [m/s] likewise
AGREEING = 0.8  # [-] by judgement: share of the records beside a jump that do not scatter
MIN_SPIKE_M = 2.0  # [m] likewise; waves at the surface are as high
MAX_CLIMB_MPS = 5.0  # [m/s] vehicles dive and climb at up to 3 m/s
MAX_TURN_DPS = 90.0  # [deg/s] 1.5 times the turn of a fast ROV


def velocity_spikes(time_s: Vector, velocity_mps: Array, reached: float = MAX_ACCELERATION_MPS2) -> Vector:
    """Return how far each velocity (n, 2) in m/s is from its neighbours', m/s (n,), 0 if a vehicle can follow it."""
    return _spikes(time_s, velocity_mps, reached, MIN_SPIKE_MPS)


def depth_spikes(time_s: Vector, depth_m: Vector) -> Mask:
    """Return which depths (n,) in m are so far from their neighbours' that no vehicle can follow, (n,)."""
    return _spikes(time_s, depth_m[:, None], MAX_CLIMB_MPS, MIN_SPIKE_M) > 0


def _spikes(time_s: Vector, values: Array, reached: float, least: float) -> Vector:
    """Return how far each of the values (n, k) is from its neighbours, (n,), 0 if a vehicle can follow it."""
    window = median_window(time_s)

    def excess(rows: Indices) -> Vector:
        change = np.linalg.norm(values[rows] - values[rows - 1], axis=1)
        return change - reached * (time_s[rows] - time_s[rows - 1])

    return _impossible(_off(values, window), window, least, excess)


def heading_spikes(time_s: Vector, heading_deg: Array, reached: float = MAX_TURN_DPS) -> Vector:
    """Return how far each heading (n, 1) is from its neighbours', degrees (n,), 0 if a vehicle can follow it."""
    heading_deg = heading_deg[:, 0]
    window, deviation = median_window(time_s), np.empty(len(heading_deg))
    for rows, near, inside in _windows(len(heading_deg), window):
        angle = np.radians(heading_deg[near])
        directions = _levels(np.column_stack([np.sin(angle), np.cos(angle)]), window)
        off = [np.abs(wrapped(angle - np.arctan2(*level.T))) for level in directions]
        deviation[rows] = np.degrees(np.fmin(*off))[inside]

    def excess(rows: Indices) -> Vector:
        change = np.abs(wrapped(heading_deg[rows] - heading_deg[rows - 1], 180.0))
        return change - reached * (time_s[rows] - time_s[rows - 1])

    return _impossible(deviation, window, MIN_SPIKE_DEG, excess)


def heading_jumps(time_s: Vector, heading_deg: Vector) -> tuple[Indices, Vector]:
    """Return the records (j,) to which the headings (n,) jump and stay there as no vehicle turns, and degrees (j,).

    A jump is the difference of the medians after and before, less the turn that goes on there: a record that is off
    alone is none, and beside records that scatter as widely themselves there is none.
    """
    turn, jumps = np.zeros(len(heading_deg)), dict[int, float]()
    for rows in blocks(len(turn) - 1):
        turn[rows.start + 1 : rows.stop + 1] = wrapped(np.diff(heading_deg[rows.start : rows.stop + 1]), 180.0)
    usual = float(np.median(np.abs(turn), overwrite_input=True)) if len(turn) else 0.0
    least = max(MIN_SPIKE_DEG, SPIKE_RATIO * usual)
    large = np.flatnonzero((turn > least) | (turn < -least))
    half, continuous = median_window(time_s) // 2, np.cumsum(turn) if len(large) else turn
    for k in large.tolist():
        around = np.arange(max(0, k - half), min(len(turn), k + half))
        least = max(MIN_SPIKE_DEG, SPIKE_RATIO * max(usual, float(np.median(np.abs(turn[around])))))
        possible = max(least, MAX_TURN_DPS * (time_s[k] - time_s[max(0, k - 1)]))
        if abs(turn[k]) <= possible:
            continue
        straight = continuous[around] - np.median(turn[around]) * around
        sides = straight[around < k], straight[around >= k]
        levels = [float(np.median(side)) for side in sides]
        step = wrapped(levels[1] - levels[0], 180.0)
        scatter = max(
            float(np.quantile(np.abs(side - level), AGREEING)) for side, level in zip(sides, levels, strict=True)
        )
        if abs(step) > possible and scatter < least:
            jumps[k] = float(step)
    return np.array(list(jumps), dtype=np.intp), np.array(list(jumps.values()))


def without_jumps(time_s: Vector, heading_deg: Vector, rows: Indices, jump_deg: Vector) -> Vector:
    """Return the headings (n,), degrees, without their jumps: the longest stretch stays, others are turned to fit."""
    offset = np.zeros(len(heading_deg))
    offset[rows] = jump_deg
    np.cumsum(offset, out=offset)
    edges = [0, *rows.tolist(), len(offset)]
    durations_s = [time_s[end - 1] - time_s[first] for first, end in pairwise(edges)]
    kept = edges[int(np.argmax(durations_s))]
    offset -= offset[kept]
    turned = np.subtract(heading_deg, offset, out=offset)
    return np.mod(turned, 360.0, out=turned)


def _impossible(deviation: Vector, window: int, least: float, excess: Callable[[Indices], Vector]) -> Vector:
    """Return the deviations (n,) from the median that are spikes, else 0.

    ``excess`` returns for rows from 1 on by how much each differs from the one before beyond what a vehicle can do.
    """
    if len(deviation) == 0:
        return deviation
    usual = float(np.median(deviation))
    far = np.zeros(len(deviation), dtype=np.bool_)
    for rows, near, inside in _windows(len(deviation), window):
        median = pd.Series(deviation[near]).rolling(window, center=True, min_periods=1).median().to_numpy()[inside]
        far[rows] = deviation[rows] > np.maximum(least, SPIKE_RATIO * np.fmax(median, usual))
    first, end = runs(far)
    too_fast = np.zeros(len(first), dtype=np.bool_)
    known = (first > 0) & (end < len(deviation))  # the ends show no way back
    too_fast[known] = (excess(first[known]) > NOISE_RATIO * usual) & (excess(end[known]) > NOISE_RATIO * usual)
    return np.multiply(deviation, some_runs(far, too_fast), out=deviation)


def median_window(time_s: Vector) -> int:
    """Return the odd number of records of the running median."""
    interval_s = float(np.median(np.diff(time_s), overwrite_input=True)) if len(time_s) > 1 else np.inf
    half = HALF_WINDOW_S / interval_s if interval_s > 0 else 0.0
    return 2 * max(HALF_WINDOW_RECORDS, round(half)) + 1


def _off(values: Array, window: int) -> Vector:
    """Return how far records (n, k) are from their neighbours: from the running median or the line, (n,)."""
    found = np.empty(len(values))
    for rows, near, inside in _windows(len(values), window):
        off = [np.linalg.norm(values[near] - level, axis=1) for level in _levels(values[near], window)]
        found[rows] = np.fmin(*off)[inside]
    return found


def _levels(values: Array, window: int) -> tuple[Array, Array]:
    """Return the running median of records (n, k), and the median of lines between records as far before and after.

    Where a turn or a climb begins, the running median is not on the way. At the ends there are no lines (NaN).
    """
    rolling = pd.DataFrame(values).rolling(window, center=True, min_periods=1).median().to_numpy()
    lines, half = np.full_like(values, np.nan), window // 2
    if (count := len(values) - 2 * half) > 0:
        far = np.linspace(1, half, HALF_WINDOW_RECORDS).round().astype(int).tolist()
        both = [(values[half - by :][:count] + values[half + by :][:count]) / 2 for by in far]
        lines[half : half + count] = np.median(both, axis=0)
    return rolling, lines


def _windows(count: int, window: int) -> Iterator[tuple[slice, slice, slice]]:
    """Yield blocks of records, each with all that its windows reach, and the block's place therein."""
    half = window // 2
    for rows in blocks(count):
        start = max(0, rows.start - half)
        yield rows, slice(start, rows.stop + half), slice(rows.start - start, rows.stop - start)
