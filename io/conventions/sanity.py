"""Contradictions within a log: times or places apart, a truth under water or repeated."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from usbldr.filters.types import Truth
from usbldr.io.conventions import positions
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import Provenance

ON_THE_PLANE = (("cov_xx", "cov_xy", "cov_yy"), ("cov_ee_m2", "cov_en_m2", "cov_nn_m2"))
VARIANCES = ("variance", "variance_deg2", "variance_rad2", "covariance", "cov_xx", "cov_yy", "cov_ee_m2", "cov_nn_m2")
UNKNOWN_VARIANCE = -1.0  # fixed: by the conventions of ROS
MAX_SEPARATION_M = 50_000.0  # no dive goes so far, and the plane is not accurate beyond


def truth_overlap_findings(truth: Truth | None, tables: Mapping[str, pd.DataFrame], start_ns: int) -> list[Finding]:
    """Report a truth that does not overlap the sensors in time."""
    times = [tables[role]["time_ns"] for role in ("dvl", "compass", "usbl") if role in tables]
    if truth is None or not times:
        return []
    first_s, last_s = (min(t.min() for t in times) - start_ns) / 1e9, (max(t.max() for t in times) - start_ns) / 1e9
    if truth.time_s[-1] >= first_s and truth.time_s[0] <= last_s:
        return []
    span = f"{truth.time_s[0]:.1f} to {truth.time_s[-1]:.1f} s, the sensors {first_s:.1f} to {last_s:.1f} s"
    text = f"{truth.source}: truth and sensors do not overlap in time: it covers {span}"
    return [Finding("TRUTH-APART", text, truth.source)]


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
    text = f"{topics}: {far_m / 1000:.0f} km from the map's origin ({origin.source}), too far for a local plane"
    return [Finding("PLACES-APART", f"{text}: state the [map] of this dive", topics)]


def truth_underwater_findings(
    truth: Truth, provenance: Mapping[str, Provenance], tables: Mapping[str, pd.DataFrame]
) -> list[Finding]:
    """Report GPS fixes below the surface."""
    if not {"gps", "depth"} <= tables.keys() or truth.source != provenance["gps"].topic:
        return []
    depth_m = positions.depths_of(tables["gps"], tables["depth"], "time_ns")
    text = positions.underwater_text(truth.source, depth_m)
    return [Finding("GPS-UNDERWATER", text, truth.source)] if text else []


def repeated_fix_findings(table: pd.DataFrame, of: Provenance, start_ns: int) -> list[Finding]:
    """Report a receiver that repeats its last fix."""
    degrees = "lat_deg" in table and of.convention("frame").value == "latlon"
    text = positions.repeated_fix_text(of.topic, table, start_ns) if degrees else ""
    return [Finding("GPS-REPEATED", text, of.topic)] if text else []


def covariance_findings(raws: Mapping[str, RawRecords]) -> list[Finding]:
    """Report covariances that are negative, but for the -1 that means unknown, or not positive semidefinite."""
    found: list[Finding] = []
    for raw in raws.values():
        bad = np.zeros(len(raw.received_ns), dtype=np.bool_)
        for variance in (raw.number(name) for name in VARIANCES if name in raw.values):
            bad |= (variance < 0) & (variance != UNKNOWN_VARIANCE)
        for xx, xy, yy in (names for names in ON_THE_PLANE if set(names) <= set(raw.values)):
            bad |= positions.indefinite(raw.number(xx), raw.number(xy), raw.number(yy))
        if bad.any():
            name = raw.topic.name
            text = f"{name}: {bad.sum()} of {len(bad)} covariances are negative or not positive semidefinite"
            found.append(Finding("COVARIANCE-INVALID", f"{text}; they count as unknown", name))
    return found
