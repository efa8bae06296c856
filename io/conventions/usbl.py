"""USBL fixes as east and north on the local plane, with their covariance.

A fix may come as latitude and longitude, as a position on the map, as an offset from the head, or as slant range and
bearing from the head. Offsets and bearings count from true north, or from the bow of the head's carrier: a ship, or
the vehicle itself, which then measures a fixed beacon. A fix that is rotated by the vehicle's heading depends on the
compass; the filter treats both as independent, and `reference_covariance` adds the effect of the heading's noise.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.types import Array, Mask, Vector
from usbldr.filters.usbl_survey.geometry import attitude_matrix
from usbldr.io.axes import axis_signs, named_frd, named_ned
from usbldr.io.conventions import positions
from usbldr.io.conventions.attitude import along_level_axes
from usbldr.io.conventions.converted import ConvertedTable, chosen_convention, converted_table, corrections, valid_mask
from usbldr.io.conventions.map_north import on_plane_north
from usbldr.io.conventions.time_series import time_series
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.conventions.usbl_covariance import (
    reference_covariance,
    sensor_covariance,
    stated_covariance,
    with_variance_floor,
)
from usbldr.io.conventions.usbl_head import (
    SHIP,
    SHIP_HEADING,
    UsblReference,
    fix_times,
    moved_by_head_m,
    rotated_clockwise,
    usbl_reference,
)
from usbldr.io.conventions.usbl_selection import fix_causes, kind_of_fixes, records_of_one, without_repeats
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, OriginKind
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import Convention
from usbldr.io.settings.sensor_sections import UsblSection

# optional, of fixes measured from a head: the line from there, the depth that made a slant range horizontal, and where
# the bow of the ship points
AWAY_COLUMNS, LEVELLED_COLUMN, SHIP_COLUMN = ("away_east_m", "away_north_m"), "levelled_by_m", "ship_heading_deg"
OF_HEAD_COLUMNS = (*AWAY_COLUMNS, LEVELLED_COLUMN, SHIP_COLUMN)
DEPTH_HELD_S = (
    5.0  # beyond the first and the last depth: vehicles dive by less than 1 m/s, and without it a fix is far off
)
HEADING_KEY = "heading_topic in head of [usbl]"
MAP_UNKNOWN = (
    "the map origin is not stated: errors against a truth in latitudes are those that remain after a constant shift "
    "(state origin_lat_deg and origin_lon_deg under [map], or the position of the USBL transceiver ([usbl] head) if "
    "fixes are relative to it)"
)
STATE_HEAD = "state head = {...} under [usbl], or beacon = {...} if the vehicle carries the head"


class PlacedFixes(NamedTuple):
    """The positions of n fixes, before the check for validity."""

    position_m: Array  # (n, 2) east, north
    turned_m: Array  # (n, 2) the part that a heading rotated
    vertical_m: Vector  # (n,) the vertical part of the line of sight, NaN unknown
    stated_m2: Array  # (n, 2, 2) covariance by the messages, NaN unknown
    causes: Mapping[str, Mask]
    conventions: list[Convention]
    findings: list[Finding]
    relative_to_reference: bool = False  # counted from the head or beacon, not from the map
    by_bow: bool = False  # counted from the bow of the head's carrier
    levelled_by_m: Vector | None = None  # depth that made a slant range a horizontal one; 0: it was not needed


def usbl(
    section: UsblSection, raws: Mapping[str, RawRecords], others: Mapping[str, ConvertedTable], origin: Origin | None
) -> ConvertedTable:
    """Turn fixes to east and north with their covariance; invalid ones are left out.

    ``raws`` are those of the USBL and of its head's ship, ``others`` the vehicle's compass and depths, by role. Raises
    LogError if none is left or latitudes have no plane, UsageError if the section does not fit.
    """
    raw, target, findings = records_of_one(raws["usbl"], "usbl", section.target)
    kind, kind_chosen, unused = kind_of_fixes(raw, section, origin)
    raw, more = without_repeats(raw, kind, section)
    when = fix_times(raw, kind, section, times_of(raw, section.time, section.latency_s, section.clock_step_s, "usbl"))
    times = when.times
    compass, depth = others.get("compass"), np.full(len(times.time_ns), np.nan)
    if "depth" in others:
        depth = time_series(others["depth"], "depth", ["depth_m"]).at(times.time_ns, held_s=DEPTH_HELD_S)[:, 0]
    end = usbl_reference(section, raws, compass, origin, when.at_head_ns)
    drop = depth - (end.depth_m if end else 0.0)
    if kind == "latlon":
        fixes = _on_map(raw, "latlon", origin, drop)._replace(conventions=positions.notation_of(raw))
        findings += positions.radian_findings(raw)
    elif kind == "range_bearing":
        fixes = _by_range(raw, section, end, drop)
    else:
        fixes = _by_position(raw, section, origin, end, drop)
    if end is not None and when.asked_ns is not None and when.slant_m is not None:
        asked = usbl_reference(section, raws, compass, origin, when.asked_ns)
        gone_m = end.place_m - asked.place_m if asked is not None else np.zeros_like(end.place_m)
        excess_m = moved_by_head_m(fixes.position_m - end.place_m, when.slant_m, gone_m)
        fixes = fixes._replace(position_m=fixes.position_m - excess_m)
    findings += [*more, *unused, *fixes.findings, *_unused(raw, section, kind, fixes), *(end.findings if end else ())]
    placed = kind == "latlon" or (end is not None and end.plane_lat_deg is not None)
    if not placed and origin is not None and origin.kind != OriginKind.MAP:
        findings.append(raw.finding("MAP-UNKNOWN", MAP_UNKNOWN))
    if kind == "position" and not fixes.relative_to_reference:
        findings += positions.grid_findings(raw, *fixes.position_m.T)
    causes = {**fixes.causes, **positions.off_plane_causes(*fixes.position_m.T)}
    good, invalid = valid_mask(raw, causes, "usbl", "left out", positions.exchanged_advice(raw, causes))
    line = fixes.position_m - (end.place_m if end else np.nan)
    levelled_m = fixes.levelled_by_m
    cov_m2, sd_chosen = sensor_covariance(section, fixes.stated_m2, line, fixes.vertical_m, levelled_m is not None)
    if end is not None and fixes.relative_to_reference:
        cov_m2 = cov_m2 + reference_covariance(end, fixes.turned_m)
    R = with_variance_floor(cov_m2)
    columns = {
        "east_m": fixes.position_m[:, 0],
        "north_m": fixes.position_m[:, 1],
        "cov_ee_m2": R[:, 0, 0],
        "cov_en_m2": R[:, 0, 1],
        "cov_nn_m2": R[:, 1, 1],
    }
    if end is not None:
        columns |= dict(zip(AWAY_COLUMNS, line.T, strict=True))
    if levelled_m is not None:
        columns[LEVELLED_COLUMN] = levelled_m
    if end is not None and SHIP in raws and SHIP_HEADING in raws:
        columns[SHIP_COLUMN] = end.carrier_heading.heading_deg
    chosen = [*target, kind_chosen, *when.conventions, *fixes.conventions]
    chosen += [*(end.conventions if end else ()), *sd_chosen]
    made = converted_table(times, columns, chosen, [*findings, *invalid])
    from_geodetic_end = end is not None and end.plane_lat_deg is not None and fixes.relative_to_reference
    return replace(made.only(good), geodetic=kind == "latlon" or from_geodetic_end)


def _on_map(raw: RawRecords, frame: str, origin: Origin | None, drop_m: Vector) -> PlacedFixes:
    """Place positions on the map, and latitudes."""
    position, R = np.column_stack(positions.on_plane(raw, frame, origin)), positions.message_covariance(raw, frame)
    return PlacedFixes(position, np.zeros_like(position), drop_m, R, fix_causes(raw, frame), [], [])


def _by_position(
    raw: RawRecords, section: UsblSection, origin: Origin | None, end: UsblReference | None, drop_m: Vector
) -> PlacedFixes:
    """Place offsets from the head or beacon, and positions on the map."""
    is_ned = named_ned(raw.frame_id)
    frame, frame_chosen, findings = chosen_convention(raw, "frame", section.frame, "NED" if is_ned else "ENU", is_ned)
    relative, counted, more = chosen_convention(raw, "relative_to", section.relative_to, "head" if end else "map")
    relative = "head" if frame == "body" else relative
    chosen = [frame_chosen, replace(counted, value=relative)]
    findings = [*findings, *more]
    if relative == "head" and end is None:
        raise raw.fault(f"{raw.topic.name} holds positions relative to the head; {STATE_HEAD}")
    if relative == "map" or end is None:
        return _on_map(raw, frame, origin, drop_m)._replace(conventions=chosen, findings=findings)
    axes = np.eye(2)
    if frame == "body":
        along, axes, axes_chosen, more = along_axes(raw, section)
        chosen, findings = [*chosen, axes_chosen], [*findings, *more]
        if _tilted(section):
            along[:, 2] = np.where(np.isfinite(along[:, 2]), along[:, 2], -drop_m)
        offset = _in_level_axes(section, end, along)[:, :2]
    else:
        offset = np.column_stack(positions.on_plane(raw, frame, origin))
    turn, more_chosen = _turn_deg(raw, section, end, frame)
    chosen += more_chosen
    R = stated_covariance(raw, frame, axes, turn)
    drop = np.where(np.isfinite(raw.number("z")), raw.number("z"), drop_m)
    offset = rotated_clockwise(offset, turn) * section.sound_speed_scale
    return _from_end(end, frame, PlacedFixes(offset, offset, drop, R, fix_causes(raw), chosen, findings))


def along_axes(raw: RawRecords, section: UsblSection) -> tuple[Array, Array, Convention, list[Finding]]:
    """Return fixes along starboard, forward, up of the instrument, (n, 3), and those of its axes x and y, (2, 2)."""
    by_frame = "FRD" if named_frd(raw.frame_id) else "FLU"
    names, chosen, findings = chosen_convention(raw, "axes", section.axes, by_frame)
    along, axes = np.zeros((len(raw.received_ns), 3)), np.zeros((3, 2))
    for column, (name, (axis, sign)) in enumerate(zip("xyz", axis_signs(names), strict=True)):
        along[:, axis] = sign * raw.number(name)
        if name != "z":
            axes[axis, column] = sign
    return along, axes[:2], chosen, findings


def along_sight(slant_m: Vector, bearing_rad: Vector, drop_m: Vector) -> Array:
    """Return fixes (n,) along starboard, forward, up of the instrument, (n, 3); level ones if the drop is unknown."""
    flat = np.sqrt(np.maximum(slant_m**2 - np.nan_to_num(drop_m) ** 2, 0.0))
    return np.column_stack([flat * np.sin(bearing_rad), flat * np.cos(bearing_rad), -drop_m])


def _tilted(section: UsblSection) -> bool:
    return section.level or section.mount_roll_deg != 0 or section.mount_pitch_deg != 0


def _in_level_axes(section: UsblSection, end: UsblReference, along: Array) -> Array:
    """Turn fixes along the instrument's axes, (n, 3), by its tilted mount, and by the ship's roll and pitch if stated.

    They are then along level starboard, forward, up of the ship; without any tilt they are returned as they are.
    """
    if not _tilted(section):
        return along
    mount = attitude_matrix(*np.array([[section.mount_deg], [section.mount_pitch_deg], [section.mount_roll_deg]]))[0]
    in_ship = along @ mount.T
    if not section.level:
        return in_ship
    if end.carrier_heading.vertical is None:
        raise SettingError(f"[usbl] level: no record of {HEADING_KEY} holds roll and pitch")
    return along_level_axes(in_ship, end.carrier_heading.vertical)


def _turn_deg(raw: RawRecords, section: UsblSection, end: UsblReference, frame: str) -> tuple[Vector, list[Convention]]:
    """Return how far the instrument is turned clockwise from north, (n,): by its mount, in a body frame by the bow.

    With it come the conventions of the mount and of the scale.
    """
    keys = ("mount_deg", "mount_roll_deg", "mount_pitch_deg")
    chosen = corrections("deg", **{key: float(getattr(section, key)) for key in keys})
    if section.level:
        chosen.append(Convention("level", "roll and pitch of the ship", "configuration"))
    if section.sound_speed_scale != 1:
        chosen.append(Convention("sound_speed_scale", section.sound_speed_scale, "configuration"))
    if frame != "body":
        return np.full(len(raw.received_ns), section.mount_deg), chosen
    if not np.isfinite(end.carrier_heading.heading_deg).any():
        why = "the vehicle has no compass" if section.beacon else "state heading_topic or heading_deg in head = {...}"
        raise raw.fault(f"{raw.topic.name} counts from the bow of the head's carrier: {why}")
    mount_deg = 0.0 if _tilted(section) else section.mount_deg  # a tilted mount is turned with its tilt
    from_bow = Convention("bearing_from", "bow", "configuration" if section.frame else "type")
    return end.carrier_heading.heading_deg + mount_deg, [from_bow, *chosen]


def _by_range(raw: RawRecords, section: UsblSection, end: UsblReference | None, drop_m: Vector) -> PlacedFixes:
    """Place slant ranges and bearings (clockwise from true north, in a body frame from the bow).

    The vehicle's depth comes first, then the fix's own, then its elevation; without any the range is taken as it is.
    """
    if end is None:
        raise raw.fault(f"{raw.topic.name} holds ranges and bearings; {STATE_HEAD}")
    frame, _, findings = chosen_convention(raw, "frame", section.frame, "ENU")
    slant = raw.number("slant_range_m") * section.sound_speed_scale
    bearing, elevation = raw.number("bearing_deg"), np.radians(raw.number("elevation_deg"))
    own_drop = raw.number("depth_m") - end.depth_m
    drop = np.where(np.isfinite(drop_m), drop_m, own_drop)
    by_depth = np.sqrt(np.maximum(slant**2 - drop**2, 0.0))
    by_elevation = np.where(np.isfinite(elevation), slant * np.cos(elevation), slant)
    horizontal = np.where(np.isfinite(drop), by_depth, by_elevation)
    if frame == "body" and _tilted(section):
        down = np.where(np.isfinite(elevation), slant * np.sin(np.abs(elevation)), drop)
        level = _in_level_axes(section, end, along_sight(slant, np.radians(bearing), down))
        bearing = np.degrees(np.arctan2(level[:, 0], level[:, 1]))
        horizontal = np.where(np.isfinite(drop), by_depth, np.hypot(level[:, 0], level[:, 1]))
    short = int(np.sum(slant < np.abs(drop)))
    if short:
        text = f"{short} slant ranges are shorter than the depth below the head; placed straight below"
        findings = [*findings, raw.finding("USBL-SHORT", text)]
    counts = {
        "the vehicle's depth": np.isfinite(drop_m),
        "the fix's depth": ~np.isfinite(drop_m) & np.isfinite(own_drop),
        "the fix's elevation": ~np.isfinite(drop) & np.isfinite(elevation),
        "nothing (taken as horizontal)": ~np.isfinite(drop) & ~np.isfinite(elevation),
    }
    chosen = [
        Convention("horizontal_range", what, "data", note=f"{np.sum(mask)} fixes")
        for what, mask in counts.items()
        if np.any(mask)
    ]
    turn, more_chosen = _turn_deg(raw, section, end, frame)
    chosen += more_chosen
    offset = rotated_clockwise(np.column_stack([np.zeros(len(slant)), horizontal]), bearing + turn)
    R = positions.message_covariance(raw, "ENU")
    made = PlacedFixes(offset, offset, drop, R, fix_causes(raw), chosen, findings, levelled_by_m=np.nan_to_num(drop))
    return _from_end(end, frame, made)


def _from_end(end: UsblReference, frame: str, fixes: PlacedFixes) -> PlacedFixes:
    """Put offsets onto the known end; the vehicle's own head measures where the beacon is from it."""
    away = end.sign * fixes.position_m
    at_head_m = end.place_m + (away if end.sign < 0 else 0.0)
    away = on_plane_north(away, at_head_m, end.plane_lat_deg)
    causes = {**fixes.causes, **end.causes}
    if frame == "body":
        causes["without a heading at their time"] = ~np.isfinite(end.carrier_heading.heading_deg)
    turned = end.arm_m + (away if frame == "body" else 0.0)
    return fixes._replace(
        position_m=end.place_m + away,
        turned_m=turned,
        causes=causes,
        relative_to_reference=True,
        by_bow=frame == "body",
    )


def _unused(raw: RawRecords, section: UsblSection, kind: str, fixes: PlacedFixes) -> list[Finding]:
    unused = {
        "frame": kind != "position" and section.frame is not None and not fixes.by_bow,
        "relative_to": kind != "position" and section.relative_to is not None,
        "axes": section.axes is not None and not (fixes.by_bow and kind == "position"),
        "mount_deg": section.mount_deg != 0 and not fixes.relative_to_reference,
        "level, mount_roll_deg or mount_pitch_deg": _tilted(section) and not fixes.by_bow,
        "sound_speed_scale": section.sound_speed_scale != 1 and not fixes.relative_to_reference,
    }
    keys = [key for key, has_no_effect in unused.items() if has_no_effect]
    text = f"{' and '.join(keys)} of the configuration are not used; its kind is {kind}"
    return [raw.finding("KEY-UNUSED", text)] if keys else []
