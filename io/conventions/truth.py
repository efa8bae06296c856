"""The reference track: its table in order of time, and its frame if the fixes show it."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from usbldr.filters.errors import LogError
from usbldr.filters.types import Array, Mask, Truth, Vector
from usbldr.filters.windows import columns_at
from usbldr.io.findings import Finding
from usbldr.io.provenance import Provenance
from usbldr.io.settings.sensor_sections import TruthSection

LEAST_POINTS = 10  # [points] within a track, by which its frame is checked
CLEARLY_BETTER = 2.0  # times: a frame whose points fit so much better is not chance
VELOCITY = ("starboard_mps", "forward_mps")


def truth_from_table(rows: pd.DataFrame, source: str, start_ns: int, section: TruthSection, kind: str) -> Truth:
    """Return the truth of the rows of a table of positions, in order of time; raise LogError if there is none."""
    rows = rows[np.isfinite(rows["east_m"]) & np.isfinite(rows["north_m"])]
    if rows.empty:
        raise LogError(f"{source}: no truth row is left (skip_rows = {section.skip_rows})")
    yaw_rad = None
    if "heading_deg" in rows and np.isfinite(rows["heading_deg"]).all():
        yaw_rad = np.unwrap(-np.radians(rows["heading_deg"].to_numpy(dtype=float)))
    velocity = rows[[*VELOCITY]].to_numpy(dtype=float) if set(VELOCITY) <= set(rows) else None
    return Truth(
        time_s=(rows["time_ns"].to_numpy() - start_ns) / 1e9 - section.latency_s,
        position_m=rows[["east_m", "north_m"]].to_numpy(dtype=float),
        sd_m=rows["sd_m"].to_numpy(dtype=float) if section.sd_m is None else np.full(len(rows), section.sd_m),
        heading_sd_rad=math.radians(section.heading_sd_deg),
        scale_sd=section.scale_sd,
        kind=kind,
        source=source,
        max_gap_s=section.max_gap_s,
        lever_m=section.lever_arm_m,
        yaw_rad=yaw_rad,
        velocity_mps=velocity if velocity is not None and np.isfinite(velocity).all() else None,
    )


def by_fixes(
    truth: Truth, provenance: Provenance, fixes: pd.DataFrame, start_ns: int
) -> tuple[Truth, Provenance, list[Finding]]:
    """Exchange east and north of a truth whose frame is not stated if the fixes (usbl) then fit clearly better.

    Only its shape counts: a constant shift between both is taken off. The truth remains unknown to filters.
    """
    frame = provenance.convention("frame")
    time_s: Vector = (fixes["time_ns"].to_numpy(dtype=np.int64) - start_ns) / 1e9
    fix_m = fixes[["east_m", "north_m"]].to_numpy(dtype=float)
    apart_m = distances_if_exchanged(time_s, fix_m, truth.time_s, truth.position_m)
    if frame.chosen_by != "default" or apart_m is None:
        return truth, provenance, []
    as_read_m, exchanged_m = apart_m
    other = "NED" if frame.value == "ENU" else "ENU"
    conventions = tuple(replace(c, value=other, chosen_by="data") if c is frame else c for c in provenance.conventions)
    text = (
        f"{truth.source}: read as {other}, because the fixes then fit to {exchanged_m:.2g} m (median) instead of "
        f"{as_read_m:.2g} m; state --truth-frame or frame under [truth] if that is wrong"
    )
    turned = replace(
        truth,
        position_m=truth.position_m[:, ::-1],
        yaw_rad=None if truth.yaw_rad is None else -math.pi / 2 - truth.yaw_rad,
        velocity_mps=None if truth.velocity_mps is None else truth.velocity_mps * [-1, 1],
    )
    return turned, replace(provenance, conventions=conventions), [Finding("TRUTH-FRAME", text, truth.source)]


def distances_if_exchanged(
    time_s: Vector, point_m: Array, track_time_s: Vector, track_m: Array
) -> tuple[float, float] | None:
    """Return the median distance of points from a track, as it is and with its east and north exchanged.

    None unless they fit clearly better then, or if too few points lie within the track. Only shapes count: a constant
    shift between both is taken off.
    """
    among: Mask = (time_s >= track_time_s[0]) & (time_s <= track_time_s[-1])
    if among.sum() < LEAST_POINTS:
        return None
    there_m = columns_at(time_s[among], track_time_s, track_m)
    apart_m = (point_m[among] - one for one in (there_m, there_m[:, ::-1]))
    as_read_m, exchanged_m = (float(np.median(np.hypot(*(one - np.median(one, axis=0)).T))) for one in apart_m)
    return (as_read_m, exchanged_m) if exchanged_m * CLEARLY_BETTER < as_read_m else None
