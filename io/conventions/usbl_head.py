"""The known end of a USBL's line of sight: the head, fixed or on a ship, or the beacon of a vehicle's own head.

Everything is taken at the time of validity of each fix: east, north and up in metres on the local plane, headings in
degrees clockwise from true north.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.frames import rotated
from usbldr.filters.models.parameters import LeverArm
from usbldr.filters.types import Array, Mask, Vector
from usbldr.io.conventions import positions
from usbldr.io.conventions.attitude import along_level_axes
from usbldr.io.conventions.compass import OF_HEAD, VERTICAL
from usbldr.io.conventions.compass import compass as compass_records
from usbldr.io.conventions.converted import ConvertedTable
from usbldr.io.conventions.map_north import on_plane_north
from usbldr.io.conventions.time_series import time_series
from usbldr.io.conventions.timestamps import Times
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_plane
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.messages.roles import TopicChoice, find_topic, topic_named
from usbldr.io.provenance import ChosenBy, Convention
from usbldr.io.reader import Nanoseconds, TopicInfo
from usbldr.io.settings.sensor_sections import Beacon, CompassSection, GpsSection, Head, UsblSection

SHIP, SHIP_HEADING = "ship", "ship's heading"  # roles of topics that the configuration names for the head
SHIP_SD_M = 3.0  # of a ship's receiver that states none
NO_ARM: LeverArm = (0.0, 0.0, 0.0)
SOUND_SPEED_MPS = 1500.0  # fixed: of sea water at 13 °C; what USBL systems assume unless another is set


@dataclass(frozen=True, slots=True)
class CarrierHeading:
    """The heading of the head's carrier, at the times of n fixes."""

    heading_deg: Vector  # (n,) NaN: not known
    sd_deg: Vector  # (n,)
    vertical: Array | None = None  # (n, 3) direction of up along its starboard, forward, up; None: not recorded
    conventions: tuple[Convention, ...] = ()
    findings: tuple[Finding, ...] = ()


def rotated_clockwise(vector_m: Array, angle_deg: Vector) -> Array:
    """Rotate vectors of starboard and forward, or of east and north, (n, 2), by angles, (n,)."""
    return rotated(-np.radians(angle_deg), vector_m)


@dataclass(frozen=True, slots=True)
class UsblReference:
    """Where the known end was at the times of n fixes."""

    place_m: Array  # (n, 2) east, north
    sd_m: Vector  # (n,) 1-sigma per axis
    depth_m: float
    carrier_heading: CarrierHeading
    arm_m: Array  # (n, 2) from a ship's antenna to its head
    sign: float  # 1: the offset points from here to the vehicle; -1: the vehicle's head measures the offset to here
    # latitude of the plane's origin if the place is known by latitude and longitude, so that it is certain; else None
    plane_lat_deg: float | None
    conventions: tuple[Convention, ...]
    findings: tuple[Finding, ...] = ()
    causes: Mapping[str, Mask] = field(default_factory=dict[str, Mask])  # by cause which fixes cannot be placed


def ship_choices(
    path: Path, topics: Sequence[TopicInfo], head: Head | None, chosen: Mapping[str, TopicChoice]
) -> dict[str, TopicChoice]:
    """Return the topics that the configuration names for the head; raise LogError or UsageError if not found.

    A topic that is ``chosen`` for the receiver or the compass, too, is read by the same columns.
    """
    names = {SHIP: ("gps", head.topic), SHIP_HEADING: ("compass", head.heading_topic)} if head is not None else {}
    found: dict[str, TopicChoice] = {}
    for ship, (role, name) in names.items():
        if name is not None:
            same = role in chosen and chosen[role].topic == find_topic(topics, name)
            found[ship] = chosen[role] if same else topic_named(path, topics, role, name, "configuration")
    return found


def usbl_reference(
    section: UsblSection,
    raws: Mapping[str, RawRecords],
    compass: ConvertedTable | None,
    origin: Origin | None,
    time_ns: Nanoseconds,
) -> UsblReference | None:
    """Return the known end at the times of validity (n,), None if the configuration has neither head nor beacon.

    ``compass`` is the vehicle's. Raises LogError if a ship's topic has no valid record.
    """
    if section.beacon is not None:
        return _fixed(section.beacon, _turning(compass, section, section.beacon.max_gap_s, time_ns), origin)
    if section.head is None:
        return None
    head = section.head
    if head.heading_deg is not None:
        turned_by = Convention("heading_deg", head.heading_deg, "configuration", "deg", of="head")
        sd_deg = np.full(len(time_ns), section.heading_sd_deg or 0.0)
        turning = CarrierHeading(np.full(len(time_ns), head.heading_deg), sd_deg, conventions=(turned_by,))
    else:
        gyro = raws.get(SHIP_HEADING)
        turned = compass_records(gyro, gyro_section(head), origin, OF_HEAD) if gyro else None
        turning = _turning(turned, section, head.max_gap_s, time_ns)
        if turned is not None:
            topic = Convention("topic", raws[SHIP_HEADING].topic.name, "configuration", of=SHIP_HEADING)
            how = (topic, *(replace(c, of=SHIP_HEADING) for c in turned.conventions))
            turning = replace(turning, conventions=how, findings=turned.findings)
    return _ship(head, turning, raws[SHIP], origin, time_ns) if SHIP in raws else _fixed(head, turning, origin)


def _fixed(end: Head | Beacon, turning: CarrierHeading, origin: Origin | None) -> UsblReference:
    """Return a head, or the beacon of the vehicle's own head, whose place the configuration states."""
    antenna = np.array(_place(end, origin))
    of, sign, lever_m = ("head", 1.0, end.lever_arm_m) if isinstance(end, Head) else ("beacon", -1.0, NO_ARM)
    plane_lat_deg = origin.lat_deg if origin is not None and end.lat_deg is not None else None
    arm = _arm(lever_m, turning, antenna, plane_lat_deg)
    at = zip(("east_m", "north_m"), antenna.tolist(), strict=True)
    return UsblReference(
        place_m=antenna + arm,
        sd_m=np.full(len(arm), end.sd_m or 0.0),
        depth_m=end.depth_m,
        carrier_heading=turning,
        arm_m=arm,
        sign=sign,
        plane_lat_deg=plane_lat_deg,
        conventions=(*(Convention(key, m, "configuration", "m", of=of) for key, m in at), *turning.conventions),
        findings=turning.findings,
    )


def _ship(
    head: Head, turning: CarrierHeading, ship: RawRecords, origin: Origin | None, time_ns: Nanoseconds
) -> UsblReference:
    made = positions.gps(ship, GpsSection(latency_s=head.latency_s), origin)
    there = time_series(made, "gps", ["east_m", "north_m", "sd_m"]).at(time_ns, head.max_gap_s)
    plane_lat_deg = origin.lat_deg if origin is not None and "lat_deg" in ship.layout.required else None
    arm = _arm(head.lever_arm_m, turning, there[:, :2], plane_lat_deg)
    place = there[:, :2] + arm
    recorded = np.where(np.isfinite(there[:, 2]), there[:, 2], SHIP_SD_M)
    sd = recorded if head.sd_m is None else np.full(len(place), head.sd_m)
    unknown = np.isnan(there[:, 0])
    causes: dict[str, Mask] = {f"without the ship's position within {head.max_gap_s:g} s": unknown}
    if any(head.lever_arm_m):
        causes[f"without the ship's heading within {head.max_gap_s:g} s"] = ~np.isfinite(turning.heading_deg)
    recorded_by: ChosenBy = "records" if np.isfinite(there[:, 2]).any() else "default"
    sd_by: ChosenBy = recorded_by if head.sd_m is None else "configuration"
    chosen = [
        Convention("topic", ship.topic.name, "configuration", of=SHIP),
        *(replace(c, of=SHIP) for c in made.conventions if c.key != "sd_m"),
        Convention("sd_m", float(np.median(sd)), sd_by, "m", of=SHIP),
    ]
    if any(head.lever_arm_m):
        chosen.append(Convention("lever_arm_m", str(list(head.lever_arm_m)), "configuration", "m", of="head"))
        if turning.vertical is not None:
            chosen.append(Convention("lever_arm", "roll and pitch of the ship", "records", of="head"))
    return UsblReference(
        place_m=place,
        sd_m=sd,
        depth_m=head.depth_m,
        carrier_heading=turning,
        arm_m=arm,
        sign=1.0,
        plane_lat_deg=plane_lat_deg,
        causes=causes,
        conventions=(*chosen, *turning.conventions),
        findings=(*made.findings, *turning.findings),
    )


def _arm(lever_m: LeverArm, turning: CarrierHeading, antenna_m: Array, plane_lat_deg: float | None) -> Array:
    """Return the lever arm from the antenna (n, 2) or (2,) to the head, east and north, (n, 2)."""
    count = len(turning.heading_deg)
    if not any(lever_m[:2] if turning.vertical is None else lever_m):
        return np.zeros((count, 2))
    arm_m = np.tile(lever_m, (count, 1))
    if turning.vertical is not None:  # the system may have levelled its fixes, but not the arm
        tilted_m = along_level_axes(arm_m, turning.vertical)
        arm_m = np.where(np.isfinite(tilted_m), tilted_m, arm_m)
    arm_m = rotated_clockwise(arm_m[:, :2], turning.heading_deg)
    return on_plane_north(arm_m, antenna_m, plane_lat_deg)


def _turning(
    made: ConvertedTable | None, section: UsblSection, longest_gap_s: float, time_ns: Nanoseconds
) -> CarrierHeading:
    there = np.full((len(time_ns), 2), np.nan)
    up = None
    if made is not None:
        there = time_series(made, "compass", ["heading_deg", "sd_deg"]).at(time_ns, longest_gap_s)
        if made.attitude is not None:
            up = time_series(made.attitude, "compass", VERTICAL).at(time_ns, longest_gap_s)
    sd = there[:, 1] if section.heading_sd_deg is None else np.full(len(there), section.heading_sd_deg)
    return CarrierHeading(there[:, 0], sd, up)


def gyro_section(head: Head) -> CompassSection:
    """Return how the ship's heading is read."""
    return CompassSection(
        convention=head.heading_convention,
        bias_deg=head.heading_bias_deg,
        declination_deg=head.heading_declination_deg,
        latency_s=head.heading_latency_s,
    )


def _place(end: Head | Beacon, origin: Origin | None) -> tuple[float, float]:
    if end.east_m is not None and end.north_m is not None:
        return end.east_m, end.north_m
    assert origin is not None, "a head or beacon with latitude and longitude gives the plane its origin"
    east, north = to_plane(origin, np.array([end.lat_deg], dtype=float), np.array([end.lon_deg], dtype=float))
    return float(east[0]), float(north[0])


@dataclass(frozen=True, slots=True)
class FixTimes:
    """When the head and the vehicle were where n fixes say."""

    times: Times  # its time_ns is when the vehicle was there
    at_head_ns: Nanoseconds  # (n,) when the bearing was measured
    asked_ns: Nanoseconds | None = None  # (n,) when the head sent; None: the fix is of one instant
    slant_m: Vector | None = None  # (n,)
    conventions: tuple[Convention, ...] = ()


def fix_times(raw: RawRecords, kind: str, section: UsblSection, times: Times) -> FixTimes:
    """Return the times of fixes by what their stamps are; raise SettingError if a reply has no range.

    Of a fix whose stamp is the arrival of the reply at the head, the bearing is that of the arrival, and the range is
    the mean of the ways out and back; the vehicle was there when it replied, range / sound speed before. See H. Medwin
    and C. Clay, "Fundamentals of Acoustical Oceanography", 1998, section 1.2, for the speed.
    """
    if section.stamped_at != "reply":
        return FixTimes(times, times.time_ns)
    if kind == "latlon" or section.head is None or section.relative_to == "map":
        raise SettingError('[usbl] stamped_at = "reply" needs fixes that count from a head; state head')
    offset = [raw.number("slant_range_m")] if kind == "range_bearing" else [np.nan_to_num(raw.number(c)) for c in "xyz"]
    slant_m = np.nan_to_num(np.sqrt(sum(part**2 for part in offset))) * section.sound_speed_scale
    speed = section.sound_speed_mps or SOUND_SPEED_MPS
    way_ns = np.rint(1e9 * slant_m / speed).astype(np.int64)
    asked_ns = times.time_ns - 2 * way_ns - round(1e9 * section.turnaround_s)
    chosen_by = "default" if section.sound_speed_mps is None else "configuration"
    chosen = (
        Convention("stamped_at", "reply", "configuration", note=f"one way {np.median(way_ns) / 1e9:.3f} s, median"),
        Convention("sound_speed_mps", speed, chosen_by, "m/s"),
        Convention("turnaround_s", section.turnaround_s, "configuration" if section.turnaround_s else "default", "s"),
    )
    return FixTimes(replace(times, time_ns=times.time_ns - way_ns), times.time_ns, asked_ns, slant_m, chosen)


def moved_by_head_m(away_m: Array, slant_m: Vector, gone_m: Array) -> Array:
    """Return by how much positions are too far, (n, 2): the head went ``gone_m`` (n, 2) between question and reply.

    ``away_m`` (n, 2) points from the head, when it received the reply, to the position. The way out was longer by the
    part of ``gone_m`` along the line of sight, and the range is the mean of both ways.
    """
    along = np.divide(away_m, slant_m[:, None], out=np.zeros_like(away_m), where=slant_m[:, None] > 0)
    return along * np.nan_to_num(np.sum(along * gone_m, axis=1, keepdims=True)) / 2
