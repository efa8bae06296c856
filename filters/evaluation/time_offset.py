"""The time offset between a track and the truth: by how much the truth's stamps are late, with its sigma.

A truth with stamps that are late by tau shows at t + tau where the vehicle was at t. The offset with the least mean
square distance between both is searched, after a constant shift is subtracted, and refined by Gauss-Newton steps; its
sigma comes from leaving out parts of the track (B. Efron's jackknife), as errors of neighbours are not independent.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.types import Array, Mask, Truth, Vector
from usbldr.filters.windows import columns_at

FARTHEST_S = 60.0  # [s] the search ends here, as that of the doctor for the clock of fixes
WIDEST_S = 1800.0  # [s] of the second search: hours are a time zone, and such sensors do not overlap
LEAST_APART_M = 10.0  # [m] a clock that is off by more than a minute moves a vehicle by more
FAR_RATIO = 0.25  # of the distance of the same points: among so many offsets half of it may vanish by chance
STEP_S = 1.0  # [s] of the search: a vehicle moves a metre or two in it
FAR_STEP_S = 4.0  # [s] of the second search, for distances of tens of metres
POINTS = 1000  # [points] of the track that the search uses: more do not change where its minimum is
PARTS = 8  # [-] of the track, left out one by one
LEAST_POINTS = 40  # [points] five in each part
SIGNIFICANT_SIGMAS = 4.0  # chance is below 1 in 10 000
LEAST_OFFSET_S = 0.3  # [s] less moves a vehicle by less than a fix scatters
EXPLAINED_SHARE = 0.5  # of the mean square distance: an offset that explains less is not its cause
LONGEST_ARM_M = 5.0  # [m] by judgement: a vehicle with an antenna and a transponder further apart is rare
LEAP_SECONDS, LEAP_TOLERANCE_S = 18.0, 1.5  # fixed: GPS time minus UTC since 2017


class TimeOffset(NamedTuple):
    """Stamps of the truth minus those of the track, and the RMS distance without and with it, in metres."""

    late_s: float
    sd_s: float
    rms_m: float
    corrected_m: float
    speed_mps: float = np.inf  # of the truth, RMS about its mean velocity

    @property
    def notable(self) -> bool:
        """Whether the offset is significant, and explains most of the distance."""
        beyond = abs(self.late_s) > max(SIGNIFICANT_SIGMAS * self.sd_s, LEAST_OFFSET_S)
        return beyond and self.corrected_m**2 < (1 - EXPLAINED_SHARE) * self.rms_m**2

    def sentence(self, truth: Truth, track: str = "the track", by_fixes: bool = False) -> str:
        """Return what the offset is, and what would correct it; fixes that are late make a track ``by_fixes`` late."""
        side = "late" if self.late_s > 0 else "early"
        leap = abs(abs(self.late_s) - LEAP_SECONDS) < LEAP_TOLERANCE_S
        why = f" (GPS time and UTC are {LEAP_SECONDS:g} s apart)" if leap else ""
        late = by_fixes and self.late_s < 0
        fixes = f"; if the truth's is, the fixes are late: add {-self.late_s:.2f} to latency_s under [usbl]" * late
        ahead_m = -self.late_s * self.speed_mps
        where = f"{abs(ahead_m):.1f} m {'ahead' if ahead_m > 0 else 'astern'}"
        point = f"; if both clocks are right, the truth may be of a point {where}: lever_arm_m under [{truth.section}]"
        if leap:
            point = ""
        elif abs(ahead_m) > LONGEST_ARM_M:
            place = "goes ahead, such as a ship that tows" if ahead_m > 0 else "follows"
            point = f"; if both clocks are right, the truth is of another vehicle that {place}"
        return (
            f"{truth.source}: stamps of the truth are {abs(self.late_s):.2f} ± {self.sd_s:.2f} s {side} against "
            f"{track}{why}; the RMS distance without a constant shift is {self.rms_m:.2f} m, and "
            f"{self.corrected_m:.2f} m with them corrected; if the sensors' clock is right, state "
            f"latency_s = {truth.latency_s + self.late_s:.2f} under [{truth.section}]{fixes}{point}"
        )


def time_offset(time_s: Vector, track_m: Array, truth: Truth) -> TimeOffset | None:
    """Return the offset of a truth against a track, (n,) ascending and (n, 2); None if too few points overlap.

    If offsets up to a minute leave a large distance, larger ones are tried that explain nearly all of it.
    """
    known = np.isfinite(track_m).all(axis=1)
    time_s, track_m = time_s[known], track_m[known]
    near = _offset(time_s, track_m, truth, FARTHEST_S, STEP_S)
    left_m = np.inf if near is None else near.corrected_m if near.notable else near.rms_m
    if left_m < LEAST_APART_M:
        return near
    far = _offset(time_s, track_m, truth, WIDEST_S, FAR_STEP_S)
    clear = far is not None and far.notable and far.corrected_m < FAR_RATIO * min(far.rms_m, left_m)
    return far if clear else near


def _offset(time_s: Vector, track_m: Array, truth: Truth, farthest_s: float, step_s: float) -> TimeOffset | None:
    """Return the offset that explains most, up to the farthest; distances are those of the points that it keeps."""
    some = np.unique(np.linspace(0, max(len(time_s) - 1, 0), min(POINTS, len(time_s))).astype(np.intp))
    t, points_m = time_s[some], track_m[some]
    offsets_s = np.arange(-farthest_s, farthest_s + step_s, step_s)
    tried = {float(s): rms for s in offsets_s if (rms := _rms_m(t, points_m, truth, s)) is not None}
    unmoved_m = _rms_m(time_s, track_m, truth, 0.0)
    if unmoved_m is None or not tried:
        return None
    late_s = min(tried, key=lambda s: (tried[s], abs(s)))
    for _ in range(3):  # quadratic convergence from within a step
        used, apart_m, velocity_mps = _apart(time_s, track_m, truth, late_s)
        if used.sum() < LEAST_POINTS or not np.any(velocity_mps):
            return None
        late_s += _gain(apart_m, velocity_mps)
    used, apart_m, velocity_mps = _apart(time_s, track_m, truth, late_s)
    parts = np.array_split(np.arange(int(used.sum())), PARTS)
    without = [_gain(np.delete(apart_m, part, 0), np.delete(velocity_mps, part, 0)) for part in parts]
    corrected_m = _rms_m(time_s, track_m, truth, late_s)
    sd_s = float(np.sqrt((PARTS - 1) * np.var(without)))
    if corrected_m is None or abs(late_s) > farthest_s:  # no minimum
        return None
    if farthest_s > FARTHEST_S:
        unmoved_m = _rms_m(time_s[used], track_m[used], truth, 0.0)
    speed_mps = float(np.sqrt(2 * np.mean(velocity_mps**2)))
    return None if unmoved_m is None else TimeOffset(late_s, sd_s, unmoved_m, corrected_m, speed_mps)


def _apart(time_s: Vector, track_m: Array, truth: Truth, late_s: float) -> tuple[Mask, Array, Array]:
    """Return which points lie within the truth, and there the distance of the two and the truth's velocity, centred."""
    at_s = time_s + late_s
    after = np.searchsorted(truth.time_s, at_s).clip(1, len(truth.time_s) - 1)
    gap_s = truth.time_s[after] - truth.time_s[after - 1]
    used = (at_s >= truth.time_s[0]) & (at_s <= truth.time_s[-1]) & (gap_s <= truth.max_gap_s)
    step_m = truth.position_m[after[used]] - truth.position_m[after[used] - 1]
    there_m = columns_at(at_s[used], truth.time_s, truth.position_m)
    return used, _centred(track_m[used] - there_m), _centred(step_m / gap_s[used, None])


def _rms_m(time_s: Vector, track_m: Array, truth: Truth, late_s: float) -> float | None:
    if len(truth.time_s) < 2:
        return None
    used, apart_m, _ = _apart(time_s, track_m, truth, late_s)
    enough = used.sum() >= max(LEAST_POINTS, len(time_s) // 2)
    return float(np.sqrt(2 * np.mean(apart_m**2))) if enough else None


def _centred(values: Array) -> Array:
    mean: Array = values.mean(axis=0) if len(values) else np.zeros(2)
    return values - mean


def _gain(apart_m: Array, velocity_mps: Array) -> float:
    """Return the least-squares time over which the velocity makes up the distance."""
    return float(np.sum(apart_m * velocity_mps) / max(np.sum(velocity_mps**2), 1e-12))
