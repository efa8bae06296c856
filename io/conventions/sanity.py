"""Contradictions within a log: times or places apart, a truth that jumps, is under water or repeated."""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view

from usbldr.filters.types import Indices, Truth, Vector
from usbldr.io.conventions import positions
from usbldr.io.conventions.repeats import MAX_ACCELERATION_MPS2, repeated, runs
from usbldr.io.conventions.spikes import SPIKE_RATIO
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.dvl import MAX_SPEED_MPS
from usbldr.io.messages.layouts import RawRecords, blocks
from usbldr.io.provenance import Provenance

ON_THE_PLANE = (("cov_xx", "cov_xy", "cov_yy"), ("cov_ee_m2", "cov_en_m2", "cov_nn_m2"))
VARIANCES = ("variance", "variance_deg2", "variance_rad2", "covariance", "cov_xx", "cov_yy", "cov_ee_m2", "cov_nn_m2")
LEAST_JUMP_M = 5.0  # [m] of a truth: corrections of a receiver are smaller, and do little harm
BESIDE = 3  # [rows] of a truth before and after one: their median endures single rows that lie off
UNKNOWN_VARIANCE = -1.0  # fixed: by the conventions of ROS
MAX_SEPARATION_M = 50_000.0  # no dive goes so far, and the plane is not accurate beyond


def truth_overlap_findings(truth: Truth, tables: Mapping[str, pd.DataFrame], start_ns: int) -> list[Finding]:
    """Report a truth that does not overlap the sensors in time."""
    times = [tables[role]["time_ns"] for role in ("dvl", "compass", "usbl") if role in tables]
    if not times:
        return []
    first_s, last_s = (min(t.min() for t in times) - start_ns) / 1e9, (max(t.max() for t in times) - start_ns) / 1e9
    if truth.time_s[-1] >= first_s and truth.time_s[0] <= last_s:
        return []
    span = f"{truth.time_s[0]:.1f} to {truth.time_s[-1]:.1f} s, the sensors {first_s:.1f} to {last_s:.1f} s"
    text = f"{truth.source}: truth and sensors do not overlap in time: it covers {span}"
    return [Finding("TRUTH-APART", text, truth.source)]


def truth_jump_findings(truth: Truth | None) -> list[Finding]:
    """Report rows of a truth between which its velocity changes more than any vehicle's, and than it usually scatters.

    The usual velocity is the running median. Rows that repeat the position before them are no evidence of when the
    vehicle was there.
    """
    if truth is None or len(truth.time_s) < 2:
        return []
    new = np.insert(np.any(np.diff(truth.position_m, axis=0) != 0, axis=1), 0, True)
    t, moved_m = truth.time_s[new], np.diff(truth.position_m[new], axis=0)
    dt_s, step_m = np.maximum(np.diff(t), 1e-3), np.linalg.norm(moved_m, axis=1)  # two rows may have one time
    jump = np.zeros(len(t) + 1, dtype=np.bool_)  # to each row from the one before it; none at the ends
    if len(step_m):
        around = np.pad(moved_m / dt_s[:, None], ((BESIDE, BESIDE), (0, 0)), mode="edge")
        usual_mps = np.median(sliding_window_view(around, 2 * BESIDE + 1, axis=0), axis=2)
        off_m = np.linalg.norm(moved_m - usual_mps * dt_s[:, None], axis=1)
        reached_m = np.minimum(MAX_ACCELERATION_MPS2 * dt_s, MAX_SPEED_MPS) * dt_s
        jump[1:-1] = off_m > np.maximum(reached_m + SPIKE_RATIO * np.median(off_m), LEAST_JUMP_M)
    single = np.flatnonzero(jump[:-1] & jump[1:])
    stays = np.setdiff1d(np.flatnonzero(jump), [*single, *(single + 1)])
    if not jump.any():
        return []
    parts: list[str] = []
    if len(stays):
        worst = stays[np.argmax(step_m[stays - 1])]
        times = f"jumps {len(stays)} times, at most by" if len(stays) > 1 else "jumps by"
        parts.append(f"the truth {times} {step_m[worst - 1]:.0f} m between {t[worst - 1]:.1f} and {t[worst]:.1f} s")
    if len(single):
        worst = single[np.argmax(step_m[single - 1])]
        off = f"{len(single)} single truth row{'s lie' if len(single) > 1 else ' lies'} off both neighbours"
        parts.append(f"{off}, at most by {step_m[worst - 1]:.0f} m at {t[worst]:.1f} s")
    text = f"{truth.source}: {' and '.join(parts)}, as no vehicle moves"
    far_m, row = max((float(step_m[k - 1]), int(k)) for k in np.flatnonzero(jump))
    return [Finding("TRUTH-JUMP", f"{text}: {_without(t, stays)}", truth.source, float(t[row]), far_m, "m")]


def _without(time_s: Vector, jumps: Indices) -> str:
    """Return what to do about jumps to these rows of a truth; without any, about single rows."""
    middle = len(time_s) / 2
    if len(jumps) and jumps[-1] < middle:
        return f"score what follows with --start {math.ceil(time_s[jumps[-1]])}"
    if len(jumps) and jumps[0] > middle:
        return f"score what comes before with --end {math.floor(time_s[jumps[0] - 1])}"
    return "errors near there are the truth's; leave these rows out of it"


def position_findings(
    tables: Mapping[str, pd.DataFrame], provenance: Mapping[str, Provenance], origin: Origin | None
) -> list[Finding]:
    """Report fixes, GPS and map origin that are too far apart for one dive."""
    places = {
        provenance[role].topic: np.median(tables[role][["east_m", "north_m"]].to_numpy(dtype=float), axis=0)
        for role in ("usbl", "gps")
        if role in tables
    }
    topics = " and ".join(places)
    if len(places) == 2 and (far_m := float(np.hypot(*np.subtract(*places.values())))) > MAX_SEPARATION_M:
        causes = "exchanged latitude and longitude, radians, or the [map] or head of another place"
        return [Finding("PLACES-APART", f"{topics} are {far_m / 1000:.0f} km apart: check for {causes}", topics)]
    far_m = max((float(np.hypot(*place)) for place in places.values()), default=0.0)
    if origin is None or far_m < MAX_SEPARATION_M:
        return []
    text = f"{topics}: {far_m / 1000:.0f} km from the map's origin ({origin.kind}), too far for a local plane"
    return [Finding("PLACES-APART", f"{text}: state the [map] of this dive", topics)]


def underwater_findings(tables: Mapping[str, pd.DataFrame], topic: str) -> list[Finding]:
    """Report GPS fixes of a topic below the surface: acoustic positions, or an old fix repeated."""
    if not {"gps", "depth"} <= tables.keys():
        return []
    gps_s: Vector = tables["gps"]["time_s"].to_numpy(dtype=float)
    known_s, known_m = tables["depth"][["time_s", "depth_m"]].to_numpy(dtype=float).T
    depth_m = np.interp(gps_s, known_s, known_m, left=np.nan, right=np.nan)
    wet = depth_m > positions.UNDERWATER_M
    if not wet.any():
        return []
    worst = int(np.nanargmax(depth_m))
    text = (
        f"{topic}: {wet.sum()} of {len(wet)} fixes were made under water, the deepest at {depth_m[worst]:.1f} m: "
        "they may be acoustic positions, which belong under [usbl], or repeats; do not use them as truth"
    )
    return [Finding("GPS-UNDERWATER", text, topic, float(gps_s[worst]), float(depth_m[worst]), "m")]


def repeated_fix_findings(table: pd.DataFrame, of: Provenance, start_ns: int) -> list[Finding]:
    """Report a receiver that repeats its last latitude and longitude to the last digit for long.

    ``table`` is in order of time_ns. Under water a receiver repeats its last fix, with new stamps.
    """
    if "lat_deg" not in table or of.convention("frame").value != "latlon":
        return []
    time_ns = table["time_ns"].to_numpy()
    places = table[["lat_deg", "lon_deg"]].to_numpy(dtype=float)
    first, last = (rows - 1 for rows in runs(repeated(places)))
    length_s = (time_ns[last] - time_ns[first]) / 1e9
    long = length_s > positions.LONGEST_STILL_S
    if not long.any():
        return []
    longest = int(np.argmax(length_s))
    from_s = (time_ns[first[longest]] - start_ns) / 1e9
    text = (
        f"{of.topic}: {np.sum((last - first)[long])} of {len(table)} fixes repeat the previous one to the last "
        f"digit for more than {positions.LONGEST_STILL_S:g} s, in {long.sum()} stretches, the longest "
        f"{length_s[longest]:.1f} s from {from_s:.1f} s on: the receiver may have been under water, or the positions "
        "are simulated"
    )
    return [Finding("GPS-REPEATED", text, of.topic)]


def covariance_findings(raws: Mapping[str, RawRecords]) -> list[Finding]:
    """Report covariances that are negative, but for the -1 that means unknown, or not positive semidefinite."""
    found: list[Finding] = []
    for raw in raws.values():
        count = len(raw.received_ns)
        if bad := sum(_invalid_covariances(raw.part(rows)) for rows in blocks(count)):
            name = raw.topic.name
            text = f"{name}: {bad} of {count} covariances are negative or not positive semidefinite"
            found.append(Finding("COVARIANCE-INVALID", f"{text}; they count as unknown", name))
    return found


def _invalid_covariances(raw: RawRecords) -> int:
    bad = np.zeros(len(raw.received_ns), dtype=np.bool_)
    for variance in (raw.number(name) for name in VARIANCES if name in raw.values):
        bad |= (variance < 0) & (variance != UNKNOWN_VARIANCE)
    for xx, xy, yy in (names for names in ON_THE_PLANE if set(names) <= set(raw.values)):
        bad |= positions.indefinite(raw.number(xx), raw.number(xy), raw.number(yy))
    return int(np.count_nonzero(bad))
