"""Position fixes: USBL, and GPS in the windows in which it aids the filter instead of being its truth.

The paper's introduction names such a vehicle: it navigates by GPS, AHRS and DVL and surfaces for fixes. Outside these
windows GPS is the truth and never reaches a filter. A window is a pair of seconds since the start of the log,
both ends included.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import LogError
from usbldr.filters.frames import rotated
from usbldr.filters.models.noise import TO_SD, NoiseFamily
from usbldr.filters.models.parameters import LeverArm, Parameters
from usbldr.filters.models.states import StateLayout
from usbldr.filters.replay.dead_reckoning import rival_share
from usbldr.filters.types import Array, Indices, Timeline, Vector
from usbldr.filters.windows import TimeWindow, columns_at, in_windows, windows_text

DEFAULT_GPS_SD_M = 3.0  # if the log states none
RIVALS = "RIVAL-FIXES"
LEAST_RIVALS = 0.5  # [-] of the fixes on the track, by judgement: with 6 % of them right, fewer are outliers
NEAR_SIGMAS = 5.0  # of a fix: beyond, it lies elsewhere
APART_SIGMAS = 6.0  # [-] of the scatter of each group: halves of normal noise are 2.3 apart, those of a sine 3.8
LEAST_GROUPED = 20  # [fixes] by judgement: fewer show no two groups


class PositionFixes(NamedTuple):
    """F fixes of one sensor as a filter uses them, by time of validity."""

    sensor: str  # "usbl" or "gps"
    row: Indices  # (F,) which fix of the Timeline
    time_s: Vector  # (F,)
    received_s: Vector  # (F,) when it reached the vehicle
    position_m: Array  # (F, 2) east, north
    cov_m2: Array  # (F, 2, 2)
    family: NoiseFamily
    lever_m: LeverArm  # the transponder or the antenna on the vehicle
    layout: StateLayout  # with the error states of this sensor


def usbl_fixes(timeline: Timeline, parameters: Parameters, layout: StateLayout) -> PositionFixes:
    """Return the USBL fixes without those that are false."""
    rows = np.setdiff1d(np.arange(len(timeline.fix_time_s)), parameters.false_fixes)
    return _usbl_fixes(timeline, parameters, layout, rows)


def false_fixes(timeline: Timeline, parameters: Parameters, layout: StateLayout) -> PositionFixes:
    """Return the USBL fixes that a run leaves out."""
    return _usbl_fixes(timeline, parameters, layout, np.array(parameters.false_fixes, dtype=np.intp))


def _usbl_fixes(timeline: Timeline, parameters: Parameters, layout: StateLayout, rows: Indices) -> PositionFixes:
    cov_m2 = parameters.usbl_sd_scale**2 * timeline.fix_cov_m2[rows]
    fixes = (rows, timeline.fix_time_s[rows], timeline.fix_received_s[rows], timeline.fix_m[rows], cov_m2)
    return PositionFixes("usbl", *fixes, parameters.usbl, parameters.usbl_lever_m, layout)


def gps_fixes(timeline: Timeline, parameters: Parameters) -> PositionFixes:
    """Return the GPS fixes inside the windows; no sensor error applies to them."""
    rows = np.flatnonzero(in_windows(timeline.gps_time_s, parameters.aid))
    sd_m = np.full(len(rows), DEFAULT_GPS_SD_M) if timeline.gps_sd_m is None else timeline.gps_sd_m[rows]
    sd_m = np.where(sd_m > 0, sd_m, DEFAULT_GPS_SD_M)
    t, cov_m2 = timeline.gps_time_s[rows], sd_m[:, None, None] ** 2 * np.eye(2)
    return PositionFixes(
        "gps", rows, t, t, timeline.gps_m[rows], cov_m2, parameters.gps, parameters.gps_lever_m, StateLayout()
    )


def with_gps_fixes(timeline: Timeline, parameters: Parameters) -> Timeline:
    """Return the timeline with the aiding GPS fixes among those of the USBL, as positions of the transponder.

    Their covariance is divided by the factor that the parameters have for those of the USBL.
    """
    gps, count = gps_fixes(timeline, parameters), len(timeline.fix_time_s)
    if not len(gps.time_s):
        return timeline
    yaw = np.interp(gps.time_s, timeline.time_s, timeline.dr_yaw_rad)
    arm_m = rotated(yaw, np.array(gps.lever_m[:2]) - parameters.usbl_lever_m[:2])
    away_m, depth_m, none = timeline.fix_away_m, timeline.fix_levelled_by_m, np.zeros_like(gps.position_m)
    ship_rad = timeline.fix_ship_yaw_rad
    time_s = np.append(timeline.fix_time_s, gps.time_s)
    every = replace(
        timeline,
        fix_time_s=time_s,
        fix_received_s=np.append(timeline.fix_received_s, gps.received_s),
        fix_m=np.vstack([timeline.fix_m, gps.position_m - arm_m]),
        fix_cov_m2=np.vstack([timeline.fix_cov_m2, gps.cov_m2 / parameters.usbl_sd_scale**2]),
        fix_away_m=None if away_m is None else np.vstack([away_m, none]),
        fix_levelled_by_m=None if depth_m is None else np.append(depth_m, none[:, 0]),
        fix_ship_yaw_rad=None if ship_rad is None else np.append(ship_rad, none[:, 0] * np.nan),
        fix_is_gps=np.arange(len(time_s)) >= count,
    )
    return every.with_fixes(np.argsort(time_s, kind="stable"))


def require_gps(timeline: Timeline, windows: Sequence[TimeWindow], source: str) -> None:
    """Raise LogError for a window in which the log has no GPS fix of the run."""
    t = timeline.gps_time_s[timeline.gps_time_s <= timeline.time_s[-1]]
    for window in windows:
        if not in_windows(t, [window]).any():
            there = f"it has GPS fixes from {t[0]:.1f} to {t[-1]:.1f} s" if len(t) else "it has no GPS fixes"
            raise LogError(f"{source}: no GPS fix to aid a filter from {windows_text([window])} of the log ({there})")


class RivalFixes(NamedTuple):
    """Fixes that lie together in two places: two beacons, or the two solutions of an ambiguous head.

    A track follows some of them, or goes between both; a log does not show which are right.
    """

    offset_m: Vector  # (2,) of the rivals from the track
    fixes: int
    others_m: Vector  # (2,) of the others from the track: 0 if it follows them
    others: int

    @property
    def cov_m2(self) -> Array:
        """What they leave open of the track, (2, 2): the more lie in one place, the likelier is it right."""
        share = rival_share(self.fixes, self.others)
        return share * np.outer(self.offset_m, self.offset_m) + (1 - share) * np.outer(self.others_m, self.others_m)

    @property
    def text(self) -> str:
        """Say where they lie, and what it means."""
        (east_m, north_m), away_m = self.offset_m.tolist(), float(np.hypot(*self.offset_m))
        bearing_deg = np.degrees(np.arctan2(east_m, north_m)) % 360
        lie = f"lie together {away_m:.0f} m off (at {bearing_deg:.0f}°) the track that {self.others} others give"
        if self.others_m.any():
            apart_m = float(np.hypot(*(self.offset_m - self.others_m)))
            lie = f"and {self.others} others lie in two places {apart_m:.0f} m apart, the track between them"
        return (
            f"{RIVALS}: {self.fixes} USBL fixes {lie}: check for two beacons or targets, or a head with two solutions; "
            "the log does not show which fixes are right, and the track's sigma covers both"
        )


def rival_fixes(
    timeline: Timeline, position_m: Array, yaw_rad: Vector, lever_m: Vector, sd_scale: float
) -> RivalFixes | None:
    """Return the fixes that lie together elsewhere than the others, for K positions and yaws; None if they are few.

    ``lever_m`` (2,) is that of the transponder, ``sd_scale`` the factor on the sigmas of the fixes.
    """
    off_m = _off_track_m(timeline, position_m, yaw_rad, lever_m)
    if not np.isfinite(off_m).all():  # of a run that has diverged
        return None
    near_m = NEAR_SIGMAS * sd_scale * np.sqrt(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)
    elsewhere = np.hypot(*off_m.T) > near_m
    on_track = int(np.count_nonzero(~elsewhere))
    least = max(LEAST_RIVALS * max(on_track, int(np.count_nonzero(elsewhere))), 1)
    place_m: Vector = np.median(off_m[elsewhere], axis=0) if elsewhere.any() else np.zeros(2)
    count = int(np.count_nonzero(elsewhere & (np.hypot(*(off_m - place_m).T) < near_m)))
    if count >= least and np.hypot(*place_m) > 2 * np.median(near_m):
        return RivalFixes(place_m, count, np.zeros(2), on_track)
    return _on_both_sides(off_m)


def _on_both_sides(off_m: Array) -> RivalFixes | None:
    """Return the fixes of the smaller of two groups beside a track, of fixes (F, 2); None if they are no two groups.

    Their scatter about two places has then become the noise of the fixes.
    """
    if len(off_m) < LEAST_GROUPED:
        return None
    away_m = np.hypot(*off_m.T)
    usual = off_m[away_m <= NEAR_SIGMAS * np.median(away_m)]  # no outliers
    axis = np.linalg.svd(usual - usual.mean(axis=0), full_matrices=False)[2][0]
    along_m = off_m @ axis
    high = along_m > np.percentile(usual @ axis, (10, 90)).mean()
    fewer, more = sorted((high, ~high), key=np.count_nonzero)
    if np.count_nonzero(fewer) < LEAST_RIVALS * np.count_nonzero(more):
        return None
    place_m, others_m = (np.median(off_m[group], axis=0) for group in (fewer, more))
    scatter_m = max(TO_SD * np.median(np.abs(along_m[g] - np.median(along_m[g]))) for g in (fewer, more))
    if np.hypot(*(place_m - others_m)) < APART_SIGMAS * scatter_m:
        return None
    return RivalFixes(place_m, int(fewer.sum()), others_m, int(more.sum()))


def false_run_covariance_m2(
    timeline: Timeline, position_m: Array, yaw_rad: Vector, lever_m: Vector, false_fixes: Indices
) -> Array:
    """Return what false fixes in a row leave open of the positions at K epochs, (K, 2, 2), while each run lasts.

    They may be right, and dead reckoning wrong before and after them: the more they are, the likelier.
    """
    off_m, cov_m2 = _off_track_m(timeline, position_m, yaw_rad, lever_m), np.zeros((len(position_m), 2, 2))
    for run in np.split(false_fixes, np.flatnonzero(np.diff(false_fixes) > 1) + 1):
        if len(run):
            begin, end = np.searchsorted(timeline.time_s, timeline.fix_time_s[run[[0, -1]]])
            share, offset_m = rival_share(len(run), len(off_m) - len(false_fixes)), np.median(off_m[run], axis=0)
            cov_m2[begin : end + 1] += share * np.outer(offset_m, offset_m)
    return cov_m2


def _off_track_m(timeline: Timeline, position_m: Array, yaw_rad: Vector, lever_m: Vector) -> Array:
    """Return how far each fix lies from a track, (F, 2); ``lever_m`` is that of the transponder."""
    transponder_m = position_m + rotated(yaw_rad, lever_m)
    off_m: Array = timeline.fix_m - columns_at(timeline.fix_time_s, timeline.time_s, transponder_m)
    return off_m
