"""Velocities between a jump and the jump back: of a DVL that tracks something else for a while, or nothing.

If no vehicle can jump so, they are false unless the fixes before and after them show that a simulated one did; if one
can, they are false if the fixes show that it did not, and those a minute away do not show that it did: near ones may be
false. The way between fixes is compared with that of dead reckoning with these velocities, and with those before and
after them, from which the vehicle may have differed as it usually does from its mean.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.models.noise import TO_SD
from usbldr.filters.types import Array, Indices, Mask, Vector
from usbldr.filters.windows import columns_at
from usbldr.io.conventions.repeats import MAX_ACCELERATION_MPS2
from usbldr.io.conventions.spikes import AGREEING, MIN_SPIKE_MPS, NOISE_RATIO, median_window
from usbldr.io.messages.layouts import blocks

MIN_JUMP_MPS = 0.1  # [m/s] 20 s of it displace a track by 2 m
RETURNING = 0.5  # [-] of a jump of the velocity, by judgement: what is left of it after the jump back
MIN_LOG_ODDS = 3.0  # log 20: strong evidence, as of sensor errors
FAR_S = ((60.0, 0.0), (0.0, 60.0))  # before and after a stretch, by judgement: false fixes in a row end by then
FIXES_BESIDE = 7  # before and after a stretch: their median endures two outliers
LEAST_BESIDE = 3  # [fixes] of a side: one or two false ones say nothing of a velocity
RIGHT = 0.5  # [-] of the way between fixes, by judgement: what right velocities leave of it, noise included, at most
DRIFTS_M = (0.03, 0.1, 0.3, 1.0, 3.0)  # [m/√s] of dead reckoning, from good to hardly any
FIX_DOF = 4.0  # [-] by judgement: of Student's t, as fixes have outliers
LONGEST_S = 300.0  # [s] by judgement, of a stretch that a vehicle can make: any velocity explains fixes far apart
DR_ERROR = 0.1  # [-] of the way, by judgement: of dead reckoning, if the log does not show it
EXPLAINED = 4.0  # [sigmas] off the fixes, by judgement: a way that is further off explains them no better than another


class Stretch(NamedTuple):
    """The records between a jump of the velocity and the jump back."""

    first: int
    end: int
    possible: bool  # a vehicle can make one of the jumps


class Fixes(NamedTuple):
    """F fixes, and the headings of n velocities."""

    time_s: Vector  # (F,)
    position_m: Array  # (F, 2) east, north
    stated_m2: float  # the variance of a fix
    yaw_rad: Vector  # (n,)
    way_m: Array  # (F, 2) of dead reckoning to each

    @classmethod
    def beside(
        cls, time_s: Vector, position_m: Array, stated_m2: float, velocities: tuple[Vector, Array, Vector]
    ) -> Self:
        """Make it of F fixes and of n velocities: times, m/s (n, 2) and headings in rad."""
        dvl_s, velocity_mps, yaw_rad = velocities
        way_m: Array = np.cumsum(rotated(-yaw_rad, velocity_mps) * np.gradient(dvl_s)[:, None], axis=0)
        return cls(time_s, position_m, stated_m2, yaw_rad, columns_at(time_s, dvl_s, way_m))

    def variance_m2(self) -> float:
        """Return the variance of a fix: the stated one, or the larger one that neighbours show."""
        bent_m = self.position_m[1:-1] - (self.position_m[:-2] + self.position_m[2:]) / 2  # 1.5 times that of a fix
        shown_m2 = (TO_SD * float(np.median(np.abs(bent_m)))) ** 2 / 1.5 if len(bent_m) else 0.0
        return max(self.stated_m2, shown_m2)

    def contradict(self, without: Self) -> bool:
        """Tell whether records are false without which dead reckoning has another way.

        It errs from fix to fix by a random walk, with false records by a larger one. If it is no better than none, its
        conventions are wrong, and nothing is shown.
        """
        ways_m = np.stack([self.way_m, without.way_m, np.zeros_like(self.way_m)])
        with_them, better, still = _log_likelihoods(self.time_s, self.position_m - ways_m, self.variance_m2()).tolist()
        return better > max(with_them, still) + MIN_LOG_ODDS


def false_velocities(time_s: Vector, velocity_mps: Array, fixes: Fixes | None) -> Mask:
    """Return which velocities (n, 2) in m/s lie between a jump and the jump back that the vehicle did not make, (n,).

    If most of them do, nothing says which are right, and none is returned.
    """
    false, stretches = np.zeros(len(time_s), dtype=np.bool_), stretches_between_jumps(time_s, velocity_mps)
    if fixes is None:
        for one in (one for one in stretches if not one.possible):
            false[one.first : one.end] = True
    elif stretches:
        judge = _Judge(time_s, velocity_mps.copy(), fixes, stretches)
        confirmed = MIN_LOG_ODDS + math.log(len(stretches))  # by chance, one of all may be likely
        for one in sorted(stretches, key=lambda one: one.end - one.first):  # one may lie within another
            judged = judge.trusts_most and time_s[one.end - 1] - time_s[one.first] < LONGEST_S
            least = -MIN_LOG_ODDS if not one.possible else confirmed if judged else math.inf
            far = min(judge.log_odds_against(one, *beside_s) for beside_s in FAR_S)
            if judge.log_odds_against(one) > least and far > min(least, 0.0):
                false[one.first : one.end] = True
                judge.leave_out(one)
    return false if 2 * np.count_nonzero(false) <= len(false) else np.zeros_like(false)


def _log_likelihoods(time_s: Vector, error_m: Array, variance_m2: float) -> Vector:
    """Return the log likelihood of errors of fixes against W ways (W, F, 2), each with its best random walk, (W,).

    A Kalman filter of the level, with Student's t for outliers.
    """
    walk_m2 = np.square(DRIFTS_M)[:, None]
    level_m, level_m2 = error_m[None, :, 0], np.full((len(DRIFTS_M), 1), variance_m2)
    total = np.zeros((len(DRIFTS_M), len(error_m)))
    for dt_s, now_m in zip(np.diff(time_s).tolist(), error_m[:, 1:].swapaxes(0, 1), strict=True):
        level_m2 = level_m2 + walk_m2 * dt_s
        of_both_m2 = level_m2 + variance_m2
        off_m = now_m - level_m
        ratio = np.sum(off_m**2, axis=2) / of_both_m2 / FIX_DOF
        total -= np.log(of_both_m2) + (FIX_DOF + 2) / 2 * np.log1p(ratio)
        level_m = level_m + (level_m2 / of_both_m2 / (1 + ratio))[:, :, None] * off_m
        level_m2 = level_m2 * variance_m2 / of_both_m2
    return total.max(axis=0)


def stretches_between_jumps(time_s: Vector, velocity_mps: Array) -> list[Stretch]:
    """Return where velocities (n, 2) in m/s jump by more than noise, and back.

    A jump is the difference of the medians after and before, between which the others scatter less.
    """
    step_mps = np.empty(max(len(time_s) - 1, 0))
    for rows in blocks(len(step_mps)):
        step_mps[rows] = np.linalg.norm(np.diff(velocity_mps[rows.start : rows.stop + 1], axis=0), axis=1)
    noise_mps = NOISE_RATIO * float(np.median(step_mps)) if (step_mps > MIN_JUMP_MPS).any() else 0.0
    half, least_mps = median_window(time_s) // 2, max(MIN_JUMP_MPS, noise_mps)
    found, begun = list[Stretch](), list[tuple[int, Vector, bool]]()
    for k in (np.flatnonzero(step_mps > least_mps) + 1).tolist():
        sides = velocity_mps[max(0, k - half) : k], velocity_mps[k : k + half]
        before, after = (np.median(side, axis=0) for side in sides)
        jump = after - before
        scatter = [np.linalg.norm(side - level, axis=1) for side, level in zip(sides, (before, after), strict=True)]
        size = float(np.linalg.norm(jump))
        if size < least_mps or max(float(np.quantile(one, AGREEING)) for one in scatter) > RETURNING * size:
            continue
        reached_mps = MAX_ACCELERATION_MPS2 * float(time_s[k] - time_s[k - 1]) + noise_mps
        possible = min(size, float(step_mps[k - 1])) < max(MIN_SPIKE_MPS, reached_mps)
        for at in range(len(begun) - 1, -1, -1):
            first, other, also_possible = begun[at]
            if np.linalg.norm(jump + other) < RETURNING * size:
                found.append(Stretch(first, k, possible or also_possible))
                del begun[at]
                break
        else:
            begun.append((k, jump, possible))
    return found


class _Judge:
    """Compares the ways between fixes with those of dead reckoning, with some velocities and without."""

    def __init__(self, time_s: Vector, velocity_mps: Array, fixes: Fixes, stretches: list[Stretch]) -> None:
        self._time_s, self._velocity_mps, self._fixes = time_s, velocity_mps, fixes
        self._dt_s = np.gradient(time_s)[:, None]
        self._row: Indices = np.clip(np.searchsorted(time_s, fixes.time_s), 0, len(time_s) - 1)  # of each fix
        self._fix_variance_m2 = fixes.variance_m2()
        inside = np.zeros(len(time_s), dtype=np.bool_)
        for one in stretches:
            inside[one.first : one.end] = True
        self._variance_m2ps2 = float(np.var(velocity_mps[~inside], axis=0).mean()) if not inside.all() else 0.0
        left_m2, way_m2 = self._left_by_most(min(map(self._span_s, stretches)))
        self.trusts_most = left_m2 < RIGHT**2 * way_m2
        of_dr_m2 = left_m2 - 4 * math.log(2) * self._fix_variance_m2  # the median of the noise of two fixes
        shown2 = max(of_dr_m2, self._fix_variance_m2) / max(way_m2, 1e-12)  # less is hidden by the noise
        self._dr_error2 = shown2 if self.trusts_most else DR_ERROR**2

    def _span_s(self, one: Stretch) -> float:
        return float(self._time_s[one.end - 1] - self._time_s[one.first])

    def _way_m(self, rows: slice, velocity_mps: Array) -> Array:
        return np.cumsum(rotated(-self._fixes.yaw_rad[rows], velocity_mps) * self._dt_s[rows], axis=0)

    def _left_by_most(self, span_s: float) -> tuple[float, float]:
        """Return the squares of what most velocities leave of the ways between fixes, and of these, m^2.

        With a wrong convention of the compass they leave more than the ways.
        """
        row, position_m = self._row, self._fixes.position_m
        later = np.searchsorted(self._fixes.time_s, self._fixes.time_s + span_s)
        start = np.flatnonzero(later < len(row))
        if not len(start):
            return math.inf, 0.0
        way_m = self._way_m(slice(None), self._velocity_mps)[row]
        of_fixes_m = position_m[later[start]] - position_m[start]
        error_m = way_m[later[start]] - way_m[start] - of_fixes_m
        return float(np.median(np.sum(error_m**2, axis=1))), float(np.median(np.sum(of_fixes_m**2, axis=1)))

    def _without(self, one: Stretch) -> Array:
        return np.median(self._velocity_mps[[max(one.first - 1, 0), min(one.end, len(self._time_s) - 1)]], axis=0)

    def leave_out(self, one: Stretch) -> None:
        """Take the velocities of a stretch for false."""
        self._velocity_mps[one.first : one.end] = self._without(one)

    def log_odds_against(self, one: Stretch, before_s: float = 0.0, after_s: float = 0.0) -> float:
        """Return the log odds of fixes so long before and after against the velocities of a stretch; 0: too few.

        Of a side that has no fixes so far away, the nearest ones count.
        """
        times_s, position_m = self._fixes.time_s, self._fixes.position_m
        began_s, ended_s = float(self._time_s[one.first]), float(self._time_s[one.end - 1])
        before, after = (int(np.searchsorted(times_s, at_s)) for at_s in (began_s - before_s, ended_s + after_s))
        before = before or int(np.searchsorted(times_s, began_s))
        after = after if after < len(times_s) else int(np.searchsorted(times_s, ended_s))
        count = min(FIXES_BESIDE, before, len(times_s) - after)
        if count < LEAST_BESIDE:
            return 0.0
        last, first = after + np.arange(count), before - 1 - np.arange(count)
        rows = slice(int(self._row[first[-1]]), int(self._row[last[-1]]) + 1)
        without = self._velocity_mps[rows].copy()
        without[one.first - rows.start : one.end - rows.start] = self._without(one)
        of_fixes_m = position_m[last] - position_m[first]
        errors_m = list[Array]()
        for velocity in (self._velocity_mps[rows], without):
            way_m = self._way_m(rows, velocity)
            between_m = way_m[self._row[last] - rows.start] - way_m[self._row[first] - rows.start]
            errors_m.append(between_m - of_fixes_m if self.trusts_most else _lengths(between_m) - _lengths(of_fixes_m))
        error_m = np.median(errors_m, axis=1)  # (2 ways, its axes)
        of_dr_m2 = self._dr_error2 * float(np.median(np.sum(of_fixes_m**2, axis=1)))
        variance_m2 = math.pi * self._fix_variance_m2 / count + of_dr_m2  # pi / 2: of a median
        of_both_m2 = variance_m2 + np.array([0.0, self._variance_m2ps2 * self._span_s(one) ** 2])
        squares = np.sum(error_m**2, axis=1) / of_both_m2
        cost = squares + error_m.shape[1] * np.log(of_both_m2)
        log_odds = float(cost[0] - cost[1]) / 2
        return log_odds if squares[1] < EXPLAINED**2 else min(log_odds, 0.0)


def _lengths(ways_m: Array) -> Array:
    """Return the lengths of n ways, (n, 1): all that counts if a convention may be wrong."""
    return np.linalg.norm(ways_m, axis=1, keepdims=True)
