"""Fixes that lie together beside a track: two beacons, or the two solutions of an ambiguous head.

The fixes that a track follows and those that it does not say two places, of which a log does not show the right one.
"""

from typing import NamedTuple

import numpy as np

from usbldr.filters.frames import rotated
from usbldr.filters.replay.dead_reckoning import MAJORITY, interpolate
from usbldr.filters.types import Array, Timeline, Vector

CODE = "RIVAL-FIXES"
LEAST_RIVALS = 0.5  # [-] of the fixes on the track, by judgement: with 6 % of them right, fewer are outliers
NEAR_SIGMAS = 5.0  # of a fix: beyond, it lies elsewhere


class RivalFixes(NamedTuple):
    """Fixes that lie together elsewhere."""

    offset_m: Vector  # (2,) from the track
    fixes: int
    on_track: int

    @property
    def cov_m2(self) -> Array:
        """What they leave open of the track, (2, 2): the more lie in one place, the likelier is it right."""
        rival, own = float(self.fixes) ** MAJORITY, float(self.on_track) ** MAJORITY
        return rival / (rival + own) * np.outer(self.offset_m, self.offset_m)

    @property
    def text(self) -> str:
        """Say where they lie, and what it means."""
        (east_m, north_m), away_m = self.offset_m.tolist(), float(np.hypot(*self.offset_m))
        bearing_deg = np.degrees(np.arctan2(east_m, north_m)) % 360
        return (
            f"{CODE}: {self.fixes} USBL fixes lie together {away_m:.0f} m off (at {bearing_deg:.0f}°) the track that "
            f"{self.on_track} others give: check for two beacons or targets, or a head with two solutions; the log "
            "does not show which fixes are right, and the track's sigma covers both"
        )


def rival_fixes(
    timeline: Timeline, position_m: Array, yaw_rad: Vector, lever_m: Vector, sd_scale: float
) -> RivalFixes | None:
    """Return the fixes that lie together elsewhere than K positions and yaws; None if they are few.

    ``lever_m`` (2,) is that of the transponder, ``sd_scale`` the factor on the sigmas of the fixes.
    """
    transponder_m = position_m + rotated(yaw_rad, lever_m)
    off_m = timeline.fix_m - interpolate(timeline, transponder_m, timeline.fix_time_s)
    near_m = NEAR_SIGMAS * sd_scale * np.sqrt(np.trace(timeline.fix_cov_m2, axis1=1, axis2=2) / 2)
    elsewhere = np.hypot(*off_m.T) > near_m
    on_track = int(np.count_nonzero(~elsewhere))
    least = max(LEAST_RIVALS * on_track, 1)
    if np.count_nonzero(elsewhere) < least or not np.isfinite(off_m).all():  # of a run that has diverged
        return None
    place_m: Vector = np.median(off_m[elsewhere], axis=0)
    count = int(np.count_nonzero(elsewhere & (np.hypot(*(off_m - place_m).T) < near_m)))
    apart = float(np.hypot(*place_m)) > 2 * float(np.median(near_m))
    return RivalFixes(place_m, count, on_track) if apart and count >= least else None
