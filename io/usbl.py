"""USBL fixes as east and north on the local plane, with their covariance.

A fix may come as latitude and longitude, as a position on the map, as an offset from a fixed head, or as slant range
and bearing (degrees clockwise from true north) from that head.
"""

from dataclasses import dataclass

import numpy as np

from usbldr.filters.errors import LogError, UsageError
from usbldr.filters.types import Array, Vector
from usbldr.io.conventions import Converted, converted, dropped, stated
from usbldr.io.geodesy import to_plane
from usbldr.io.log import Finding, Origin
from usbldr.io.messages import Raw
from usbldr.io.positions import message_covariance, on_plane, place_causes
from usbldr.io.sections import Head, UsblSection
from usbldr.io.times import times_of

LEAST_SD_M = 0.15  # no fix is trusted more: floor of the eigenvalues of a covariance
DEFAULT_SD_M, DEFAULT_SD_REL = 1.0, 0.02  # 2 % of the slant range, at least 1 m
STATE_HEAD = "state head = {...} under [usbl]"


@dataclass(frozen=True, slots=True)
class HeadPlace:
    """A fixed USBL head on the local plane."""

    east_m: float
    north_m: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class Depths:
    """The vehicle's depth over time, for turning slant ranges into horizontal ones."""

    time_ns: Vector  # (n,) as float64: to the microsecond is enough here
    depth_m: Vector

    def at(self, time_ns: Vector) -> Vector:
        """Return the depth at the times, NaN outside the log of depths."""
        return np.interp(time_ns, self.time_ns, self.depth_m, left=np.nan, right=np.nan)


def place_head(head: Head, origin: Origin | None) -> HeadPlace:
    """Return where the head is on the plane."""
    if head.east_m is not None and head.north_m is not None:
        return HeadPlace(head.east_m, head.north_m, head.depth_m)
    assert origin is not None, "a head with latitude and longitude gives the plane its origin"
    east, north = to_plane(origin, np.array([head.lat_deg], dtype=float), np.array([head.lon_deg], dtype=float))
    return HeadPlace(float(east[0]), float(north[0]), head.depth_m)


def usbl(raw: Raw, section: UsblSection, origin: Origin | None, depths: Depths | None) -> Converted:
    """Turn fixes to east and north with their covariance; those that are no numbers are left out.

    Raises LogError where none is left or where latitudes have no plane, UsageError where the section does not fit.
    """
    kind, kind_who, findings = stated(raw, "kind", section.kind, "position")
    by_frame = "NED" if "ned" in raw.frame_id.lower() else "ENU"
    times = times_of(raw, section.time, section.latency_s)
    head = place_head(section.head, origin) if section.head else None
    head_depth_m = head.depth_m if head else 0.0
    drop_m = (depths.at(times.time_ns.astype(float)) if depths else np.full(len(times.time_ns), np.nan)) - head_depth_m
    _check_kind(raw, kind)
    if kind != "position" and (section.frame or section.relative_to):
        text = f"{raw.topic.name}: frame and relative_to of the configuration are not used; its kind is {kind}"
        findings.append(Finding("KEY-UNUSED", text))
    said = [f"kind {kind} ({kind_who})"]
    frame = "ENU"

    if kind == "range_bearing":
        if head is None:
            raise LogError(f"{raw.log}: {raw.topic.name} holds ranges and bearings; {STATE_HEAD}")
        offset_east, offset_north, how, more = _from_range_and_bearing(raw, drop_m, head)
        east, north = head.east_m + offset_east, head.north_m + offset_north
        said.append(how)
        findings += more
        causes = {"not a number": ~(np.isfinite(east) & np.isfinite(north))}
    elif kind == "latlon":
        east, north = on_plane(raw, "latlon", origin)
        causes = place_causes(raw)
    else:
        frame, who, more = stated(raw, "frame", section.frame, by_frame)
        east, north = on_plane(raw, frame, origin)
        relative, relative_who, more_still = stated(raw, "relative_to", section.relative_to, "head" if head else "map")
        said += [
            f"frame {frame} ({'by frame_id' if who == 'default' and by_frame == 'NED' else who})",
            f"relative to the {relative} ({relative_who})",
        ]
        findings += [*more, *more_still]
        if relative == "head" and head is None:
            raise LogError(f"{raw.log}: {raw.topic.name} tells positions relative to the head; {STATE_HEAD}")
        if relative == "head" and head:
            drop_m = np.where(np.isfinite(raw.number("z")), raw.number("z"), drop_m)
            east, north = head.east_m + east, head.north_m + north
        causes = place_causes(raw)
    from_map = section.head is None or section.head.lat_deg is None  # not from a head of known latitude
    if kind != "latlon" and from_map and origin is not None and origin.source != "[map]":
        text = (
            f"{raw.topic.name}: positions on a map whose origin nobody states; taken for the {origin.source}'s "
            "(state origin_lat_deg and origin_lon_deg under [map])"
        )
        findings.append(Finding("MAP-UNKNOWN", text))
    good, invalid = dropped(raw, causes, "usbl", "left out")
    R, sd_said = _covariance(raw, section, frame, east, north, drop_m, head)
    columns = {
        "east_m": east,
        "north_m": north,
        "cov_ee_m2": R[:, 0, 0],
        "cov_en_m2": R[:, 0, 1],
        "cov_nn_m2": R[:, 1, 1],
    }
    said += [f"head at {head.east_m:.2f} m east, {head.north_m:.2f} m north (configuration)"] if head else []
    made = converted(raw, times, columns, [*said, sd_said], [*findings, *invalid])
    return Converted(made.table[good].reset_index(drop=True), made.conventions, made.findings)


def _check_kind(raw: Raw, kind: str) -> None:
    """Refuse a kind that the records cannot have."""
    have = {"latlon"} if "lat_deg" in raw.layout.required else {"position", "latlon"}
    have = {"range_bearing"} if "slant_range_m" in raw.layout.required else have
    if kind not in have:
        could = " or ".join(sorted(have))
        raise UsageError(f'{raw.log}: [usbl] kind = "{kind}": {raw.topic.name} ({raw.topic.type}) can only be {could}')


def _from_range_and_bearing(raw: Raw, drop_m: Vector, head: HeadPlace) -> tuple[Vector, Vector, str, list[Finding]]:
    """Return east and north from the head, (n,) each, and how the slant range became a horizontal one.

    The vehicle's depth comes first, then the fix's own, then its elevation; without any the range is taken as it is.
    """
    slant, bearing = raw.number("slant_range_m"), np.radians(raw.number("bearing_deg"))
    elevation, own_drop = np.radians(raw.number("elevation_deg")), raw.number("depth_m") - head.depth_m
    drop = np.where(np.isfinite(drop_m), drop_m, own_drop)
    by_depth = np.sqrt(np.maximum(slant**2 - drop**2, 0.0))
    by_elevation = np.where(np.isfinite(elevation), slant * np.cos(elevation), slant)
    horizontal = np.where(np.isfinite(drop), by_depth, by_elevation)
    findings: list[Finding] = []
    short = int(np.sum(slant < np.abs(drop)))
    if short:
        text = (
            f"{raw.topic.name}: {short} slant ranges are shorter than the depth below the head; taken as straight below"
        )
        findings.append(Finding("USBL-SHORT", text))
    counts = {
        "the vehicle's depth": np.isfinite(drop_m),
        "the fix's depth": ~np.isfinite(drop_m) & np.isfinite(own_drop),
        "the fix's elevation": ~np.isfinite(drop) & np.isfinite(elevation),
        "nothing (taken as horizontal)": ~np.isfinite(drop) & ~np.isfinite(elevation),
    }
    parts = ", ".join(f"{np.sum(mask)} by {what}" for what, mask in counts.items() if np.any(mask))
    return horizontal * np.sin(bearing), horizontal * np.cos(bearing), f"slant to horizontal range: {parts}", findings


def _covariance(
    raw: Raw,
    section: UsblSection,
    frame: str,
    east: Vector,
    north: Vector,
    drop_m: Vector,
    head: HeadPlace | None,
) -> tuple[Array, str]:
    """Return the covariance of each fix, (n, 2, 2), and where it comes from."""
    count = len(east)
    offset = np.stack([east - head.east_m, north - head.north_m], axis=-1) if head else np.full((count, 2), np.nan)
    slant = np.sqrt(np.sum(offset**2, axis=-1) + np.nan_to_num(drop_m) ** 2)
    if section.bearing_sd_deg is not None:
        range_m, rel = section.range_sd_m or 0.0, section.range_sd_rel or 0.0
        along, across = range_m**2 + (rel * slant) ** 2, (np.radians(section.bearing_sd_deg) * slant) ** 2
        said = f"range sd {range_m:g} m and {100 * rel:g} %, bearing sd {section.bearing_sd_deg:g} deg (configuration)"
        return floored(_along_and_across(offset, along, across)), said
    if isinstance(section.sd_m, float):
        return floored(np.tile(np.eye(2) * section.sd_m**2, (count, 1, 1))), f"sd {section.sd_m:g} m (configuration)"
    R = message_covariance(raw, frame)
    known = np.isfinite(R[:, 0, 0])
    default = np.fmax(DEFAULT_SD_M, DEFAULT_SD_REL * slant)  # fmax: 1 m where there is no head
    cov = np.where(known[:, None, None], R, np.eye(2) * (default**2)[:, None, None])
    guess = (
        f"{100 * DEFAULT_SD_REL:g} % of the slant range, at least {DEFAULT_SD_M:g} m" if head else f"{DEFAULT_SD_M:g} m"
    )
    who = "configuration" if section.sd_m == "message" else "default"
    if known.all():
        return floored(cov), f"covariance of the messages ({who})"
    if known.any():
        return floored(cov), f"covariance of {np.sum(known)} of {count} messages ({who}), else sd {guess} (default)"
    return floored(cov), f"sd {guess} (default)" + (": the messages state none" if section.sd_m == "message" else "")


def _along_and_across(offset: Array, along: Vector, across: Vector) -> Array:
    """Return U diag(along, across) U', U turning the first axis to the direction of the offset, (n, 2, 2)."""
    bearing = np.arctan2(offset[:, 0], offset[:, 1])
    c, s = np.cos(bearing), np.sin(bearing)
    ee, nn = along * s * s + across * c * c, along * c * c + across * s * s
    en = (along - across) * s * c
    return np.stack([ee, en, en, nn], axis=-1).reshape(-1, 2, 2)


def floored(R: Array) -> Array:
    """Raise the eigenvalues to LEAST_SD_M squared."""
    safe = np.where(np.isfinite(R), R, np.eye(2))  # of fixes that are left out
    values, U = np.linalg.eigh(safe)
    raised = np.einsum("nij,nj,nkj->nik", U, np.maximum(values, LEAST_SD_M**2), U)
    low = values[:, 0] < LEAST_SD_M**2
    return np.where(low[:, None, None], raised, safe)
