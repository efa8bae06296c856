"""Records that are no measurements of their own: they repeat the one before to the last bit, or lie between others.

What a sensor's noise and resolution allow is judged by how often it repeats itself otherwise. A sensor that rounds
coarsely, one that is polled more often than it measures, and one simulated without noise repeat themselves often.
"""

import numpy as np

from usbldr.filters.types import Array, Indices, Mask, Vector
from usbldr.io.conventions.positions import LONGEST_STILL_S, ROUNDING
from usbldr.io.messages.layouts import blocks

MIN_FRESH_RECORDS = 100  # that differ from the one before; fewer do not show a sensor's noise
MIN_FRESH_FIXES = 10  # the same of a USBL, which is never without noise
MAX_REPEAT_SHARE = 0.25  # [-] of values that are repeated at once; above, the sensor is polled, or hides its noise
FINE_SHARE = 0.005  # [-] the same: below, a sensor does not repeat itself by rounding
MAX_CHANCE = 1e-9  # [-] that some run of the log is as long by rounding: a calm stretch repeats more than the rest
MIN_REPEATS = 3  # fewer may be chance
REPEATS_OVER_CHANCE = 10.0  # [-] repeated fixes over those that rounding explains, so that rounding is no explanation
LINE_M = 0.01  # [m] off the line between neighbours: a fifth of the wavelength at 30 kHz, less than any fix scatters
KINK_M = 0.05  # [m] median of those off the line, the same wavelength: fixes scatter by more, rounding by less
ON_LINE_SHARE = 0.3  # [-] of fixes that are interpolated: a third if two of three rows are beside a measured one
MOST_EXTRAPOLATED = 0.5  # [-] of the fixes: if more lie on lines, the fixes may have no noise
CORNER_FIXES = 2  # [fixes] off the line in a row: a measured one, or the two beside it
CORNER_SHARE = 0.9  # [-] of the runs off the line that are as short: a turn and an outlier are longer
MIN_MOVING_MPS = 0.2  # [m/s] a slower vehicle can come to rest between two records
MAX_ACCELERATION_MPS2 = 2.5  # [m/s²] a quarter of gravity: no vehicle gains so much, and loses it at once


def repeated(values: Array) -> Mask:
    """Return which of the records (n, k) repeat the one before to the last bit, (n,)."""
    same = np.zeros(len(values), dtype=np.bool_)
    same[1:] = np.all(values[1:] == values[:-1], axis=1)
    return same


def runs(mask: Mask) -> tuple[Indices, Indices]:
    """Return the first record and the one after the last of each run of records (n,) in a mask."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).view(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def some_runs(mask: Mask, chosen: Mask) -> Mask:
    """Return the records (n,) of those runs in a mask that are chosen, (r,)."""
    first, end = runs(mask)
    found = mask.copy()
    found[mask] = np.repeat(chosen, end - first)
    return found


def noisy(values: Array) -> bool:
    """Tell whether noise exceeds motion in the changes from record to record, (n, k).

    Differences of third order exceed those of second order in white noise (by a factor of 1.8), and are far below them
    in a smooth motion. Rounding to single precision is no noise.
    """
    if len(values) < MIN_FRESH_RECORDS:
        return False
    second, third = (_median_difference(values, order) for order in (2, 3))
    return third > second > ROUNDING * float(max(values.max(), -values.min()))


def _median_difference(values: Array, order: int) -> float:
    """Return the median length of the differences of records (n, k)."""
    lengths = np.empty(len(values) - order)
    for rows in blocks(len(lengths)):
        near = values[rows.start : rows.stop + order]
        lengths[rows] = np.linalg.norm(np.diff(near, order, axis=0), axis=1)
    return float(np.median(lengths, overwrite_input=True))


def repeat_share(same: Mask) -> float:
    """Return the share of values that are repeated at least once, as Laplace's rule has it for all runs but one."""
    return max(len(runs(same)[0]), 1) / (np.count_nonzero(~same) + 2)


def stuck(time_s: Vector, values: Array) -> Mask:
    """Return which of the records (n, k), in order of time, have one value for longer than chance explains, (n,).

    The first of them may be a measurement or, after a restart of the sensor, the value of none.
    """
    same = repeated(values)
    share = repeat_share(same)
    if not same.any() or share > MAX_REPEAT_SHARE or not noisy(values[~same]):
        return np.zeros(len(same), dtype=np.bool_)
    first, end = runs(same)
    least = MIN_REPEATS if share <= FINE_SHARE else np.log(MAX_CHANCE / len(same)) / np.log(share)
    long = (end - first >= least) & (time_s[end - 1] - time_s[first - 1] > LONGEST_STILL_S)
    found = some_runs(same, long)
    found[:-1] |= found[1:]
    return found


def copied_fixes(fixes_m: Array) -> Mask:
    """Return which fixes (n, 2), in order of time, are the one before sent again, (n,).

    Rounding makes single coordinates equal more often than both at once: it explains as many repeats as the product of
    the shares of pairs with one equal coordinate.
    """
    same = repeated(fixes_m)
    return same if _beyond_rounding(fixes_m[1:] == fixes_m[:-1]) else np.zeros_like(same)


def _beyond_rounding(equal: Mask) -> bool:
    """Tell whether both coordinates of fixes are equal to those expected more often than rounding explains, (n, 2)."""
    same = np.all(equal, axis=1)
    fresh = int(np.sum(~same))
    east, north = (np.count_nonzero(column & ~same) + 1.0 for column in equal.T)  # one equal coordinate
    by_rounding = (len(same) + 1) * east * north / (fresh + 2.0) ** 2
    return fresh >= MIN_FRESH_FIXES and int(same.sum()) >= max(MIN_REPEATS, REPEATS_OVER_CHANCE * by_rounding)


def extrapolated_fixes(time_s: Vector, fixes_m: Array) -> Mask:
    """Return which fixes (n, 2), in order of time, go on along a line at constant speed from those before, (n,).

    Software goes on so if no reply comes. Four on a line are none by chance, if rounding does not explain them.
    """
    found = np.zeros(len(time_s), dtype=np.bool_)
    if len(time_s) < MIN_FRESH_FIXES:
        return found
    near = np.abs(_off_line_m(time_s, fixes_m)) <= LINE_M
    on_line = np.all(near, axis=1)
    if on_line.mean() > MOST_EXTRAPOLATED or not _beyond_rounding(near):
        return found
    first, end = runs(on_line)
    on_line = some_runs(on_line, end - first > 1)
    found[1:-1] = on_line
    found[2:] |= on_line
    return found


def _off_line_m(time_s: Vector, fixes_m: Array) -> Array:
    """Return how far fixes (n, 2) lie from the line at constant speed between the one before and after, (n - 2, 2)."""
    both_s = np.maximum(time_s[2:] - time_s[:-2], np.finfo(float).tiny)  # stamps may be equal
    share = ((time_s[1:-1] - time_s[:-2]) / both_s)[:, None]
    return fixes_m[1:-1] - fixes_m[:-2] - share * (fixes_m[2:] - fixes_m[:-2])


def interpolated_fixes(time_s: Vector, fixes_m: Array) -> Mask:
    """Return which fixes (n, 2), in order of time, lie on the line between two others, (n,).

    They are rows of a table that was resampled. Of two rows beside a measured fix, the first stands for it.
    """
    between = np.zeros(len(time_s), dtype=np.bool_)
    if len(time_s) < MIN_FRESH_FIXES:
        return between
    off_m = np.linalg.norm(_off_line_m(time_s, fixes_m), axis=1)
    off_line = off_m > LINE_M
    if not off_line.any() or np.median(off_m[off_line]) < KINK_M:
        return between
    first, end = runs(off_line)
    corner = end - first <= CORNER_FIXES
    if off_line.mean() > 1 - ON_LINE_SHARE or len(first) < MIN_FRESH_FIXES or corner.mean() < CORNER_SHARE:
        return between
    between[1:-1] = ~off_line
    between[end[corner & (end - first == CORNER_FIXES)]] = True
    return between


def sudden_zeros(time_s: Vector, velocity_mps: Array) -> Mask:
    """Return which velocities (n, 2) are exactly 0 between records at speed, as a DVL without lock sends them, (n,).

    The records beside a run of zeros must be too fast for a vehicle that stops, at a border of the log those on one
    side. A coarse DVL shows exact zeros at rest, too: there the step must also be too large for the time it takes.
    """
    zero = np.all(velocity_mps == 0, axis=1)
    others = velocity_mps[~zero]
    same = repeated(others)
    if not zero.any() or not noisy(others[~same]):
        return np.zeros(len(zero), dtype=np.bool_)
    first, end = runs(zero)
    braking = 0.0 if repeat_share(same) <= FINE_SHARE else MAX_ACCELERATION_MPS2
    speed, last = np.linalg.norm(velocity_mps, axis=1), len(zero) - 1
    sides = [(first - 1, first, first > 0), (np.minimum(end, last), end - 1, end <= last)]
    fast = [
        ~inside | (speed[beside] > np.maximum(MIN_MOVING_MPS, braking * np.abs(time_s[beside] - time_s[edge])))
        for beside, edge, inside in sides
    ]
    return some_runs(zero, fast[0] & fast[1])
