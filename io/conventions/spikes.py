"""Spikes of DVL and compass that no vehicle could follow, and jumps of the heading that stay.

A Hampel rule with a running median (F. R. Hampel, "The Influence Curve and its Role in Robust Estimation", J. Amer.
Statist. Assoc. 69, 1974, doi:10.1080/01621459.1974.10482962) finds records far from their neighbours. A running median
follows steps and steady turns exactly: they have no residual. A quick change of direction has one, so a spike must also
be further away than a vehicle moves there, and back, in the time between records.
"""

from itertools import pairwise

import numpy as np
import pandas as pd

from usbldr.filters.frames import wrapped
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions.repeats import MAX_ACCELERATION_MPS2, runs
from usbldr.io.messages.layouts import BLOCK_RECORDS

HALF_WINDOW_RECORDS = 6  # the median of 13 records endures bursts of 6
HALF_WINDOW_S = 1.0  # the same of a sensor faster than 6 Hz
SPIKE_RATIO = 10.0  # [-] deviation over the usual one: 6.7 sigma of normal noise
NOISE_RATIO = 5.0  # [-] usual deviations that noise adds to the change between two records: 3.4 sigma of one
MIN_SPIKE_DEG = 5.0  # smaller ones do little harm
MIN_SPIKE_MPS = 0.5  # [m/s] likewise
MAX_TURN_DPS = 90.0  # [deg/s] 1.5 times the turn of a fast ROV


def velocity_spikes(time_s: Vector, velocity_mps: Array) -> Vector:
    """Return how far each velocity (n, 2) in m/s is from its neighbours', m/s (n,), 0 if a vehicle can follow it."""
    window = _window(time_s)
    median = np.column_stack([_running_median(v, window) for v in velocity_mps.T])
    deviation: Vector = np.linalg.norm(velocity_mps - median, axis=1)
    change: Vector = np.linalg.norm(np.diff(velocity_mps, axis=0), axis=1)
    return _impossible(deviation, window, MIN_SPIKE_MPS, change, MAX_ACCELERATION_MPS2 * np.diff(time_s))


def heading_spikes(time_s: Vector, heading_deg: Vector) -> Vector:
    """Return how far each heading (n,) is from its neighbours', degrees (n,), 0 if a vehicle can follow it."""
    window, angle = _window(time_s), np.radians(heading_deg)
    median = np.arctan2(_running_median(np.sin(angle), window), _running_median(np.cos(angle), window))
    deviation = np.degrees(np.abs(wrapped(angle - median)))
    return _impossible(deviation, window, MIN_SPIKE_DEG, _turns_deg(heading_deg), MAX_TURN_DPS * np.diff(time_s))


def heading_jumps_deg(time_s: Vector, heading_deg: Vector) -> Vector:
    """Return by how much the heading jumps to each record and stays there, degrees (n,), 0 if a vehicle can turn so.

    A jump is the difference of the medians after and before, less the turn that goes on there: a record that is off
    alone is none.
    """
    turn = wrapped(np.diff(heading_deg, prepend=heading_deg[:1]), 180.0)
    usual = float(np.median(np.abs(turn))) if len(turn) else 0.0
    possible = np.maximum(max(MIN_SPIKE_DEG, SPIKE_RATIO * usual), MAX_TURN_DPS * np.diff(time_s, prepend=time_s[:1]))
    half, continuous, jumps = _window(time_s) // 2, np.cumsum(turn), np.zeros_like(turn)
    for k in np.flatnonzero(np.abs(turn) > possible):
        around = np.arange(max(0, k - half), min(len(turn), k + half))
        straight = continuous[around] - np.median(turn[around]) * around
        step = wrapped(np.median(straight[around >= k]) - np.median(straight[around < k]), 180.0)
        jumps[k] = step if abs(step) > possible[k] else 0.0
    return jumps


def without_heading_jumps(time_s: Vector, heading_deg: Vector) -> Vector:
    """Return the headings (n,), degrees, without their jumps: the longest stretch stays, others are turned to fit."""
    steps = heading_jumps_deg(time_s, heading_deg)
    offset = np.cumsum(steps)
    edges = [0, *np.flatnonzero(steps).tolist(), len(offset)]
    durations_s = [time_s[end - 1] - time_s[first] for first, end in pairwise(edges)]
    kept = edges[int(np.argmax(durations_s))]
    return (heading_deg - (offset - offset[kept])) % 360.0


def _impossible(deviation: Vector, window: int, least: float, change: Vector, possible: Vector) -> Vector:
    """Return the deviations (n,) from the median that are spikes, else 0.

    ``change`` (n - 1,) is from record to record, ``possible`` what a vehicle can do in that time, without noise.
    """
    if len(deviation) == 0:
        return deviation
    usual = float(np.median(deviation))
    far = deviation > np.maximum(least, SPIKE_RATIO * np.fmax(_running_median(deviation, window), usual))
    first, end = runs(far)
    too_fast = np.concatenate([[False], change > possible + NOISE_RATIO * usual, [False]])  # the ends show no way back
    spikes = np.zeros_like(deviation)
    spikes[far] = np.repeat(too_fast[first] & too_fast[end], end - first)
    return spikes * deviation


def _window(time_s: Vector) -> int:
    """Return the odd number of records of the running median."""
    interval_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    half = HALF_WINDOW_S / interval_s if interval_s > 0 else 0.0
    return 2 * max(HALF_WINDOW_RECORDS, round(half)) + 1


def _running_median(values: Vector, window: int) -> Vector:
    """Return the median of each record's neighbours, (n,); windows at the borders are shorter."""
    half, found = window // 2, np.empty_like(values)
    for first in range(0, len(values), BLOCK_RECORDS):
        end, before = first + BLOCK_RECORDS, min(first, half)
        near = pd.Series(values[first - before : end + half]).rolling(window, center=True, min_periods=1)
        found[first:end] = near.median().to_numpy()[before : before + len(found[first:end])]
    return found


def _turns_deg(heading_deg: Vector) -> Vector:
    """Return the angles from record to record without sign, degrees (n - 1,)."""
    return np.abs(wrapped(np.diff(heading_deg), 180.0))
