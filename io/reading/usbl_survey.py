"""Read a survey of a transponder that lies still: the fixes as the head measured them, and the motion of the ship."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from usbldr.filters.errors import LogError, SettingError, UsageError
from usbldr.filters.types import Array, Vector
from usbldr.filters.usbl_survey.geometry import UsblSurvey, ship_motion
from usbldr.io.conventions.attitude import roll_and_pitch_deg
from usbldr.io.conventions.clock_parts import in_time_order
from usbldr.io.conventions.compass import OF_HEAD, VERTICAL, compass
from usbldr.io.conventions.converted import ConvertedTable, chosen_convention, valid_mask
from usbldr.io.conventions.positions import gps
from usbldr.io.conventions.time_series import TimeSeries, time_series
from usbldr.io.conventions.timestamps import align_clocks, times_of
from usbldr.io.conventions.usbl import along_axes, along_sight
from usbldr.io.conventions.usbl_head import SHIP, SHIP_HEADING, fix_times, gyro_section, ship_choices
from usbldr.io.conventions.usbl_selection import fix_causes, kind_of_fixes, records_of_one, without_repeats
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.reader import Nanoseconds
from usbldr.io.reading.opening import Request, digest_paths, open_configured
from usbldr.io.reading.role_records import read_roles
from usbldr.io.reading.sensors import of_devices, plane_origin, roles_of
from usbldr.io.settings.sensor_sections import GpsSection, Head, UsblSection
from usbldr.io.stages import stage

UNNAMED_HEAD = Head(east_m=0.0, north_m=0.0)  # where fixes need none: no arm and no latency; its place is not used
MAX_GAP_S = 3.0  # [s] across which the ship's position and attitude are interpolated, as max_gap_s of a head
NEEDS = {
    "usbl": ("usbl", "fixes of the USBL (state topic under [usbl])"),
    SHIP: ("gps", "the ship's positions (state topic in head of [usbl])"),
    SHIP_HEADING: ("compass", "the ship's heading (state heading_topic in head of [usbl])"),
}
"""What a survey needs: the role that has it if the configuration names no head, and its words."""


class SurveyLog(NamedTuple):
    """A survey as it was read."""

    path: Path
    sha256: str
    configuration: Path | None
    survey: UsblSurvey
    stated: Vector  # (11,) the installation of the configuration, by geometry.NAMES
    level: bool  # whether the records of the ship hold roll and pitch
    level_stated: bool  # whether the configuration says that fixes are turned by them
    origin: Origin | None
    topics: Mapping[str, str]  # what is read -> topic
    findings: tuple[Finding, ...]


def is_dive(path: Path, request: Request) -> bool:
    """Return whether a log holds a DVL, and so a vehicle that moves; raise LogError if it cannot be opened."""
    opened = open_configured(path, request)
    return "dvl" in roles_of(opened.reader.topics(), request, opened).chosen


@stage("read the survey")
def read_usbl_survey(path: Path, request: Request) -> SurveyLog:
    """Read a survey; raise LogError if it lacks fixes, positions or headings, UsageError if settings do not fit.

    The ship's topics are those of the head in the configuration, else the GPS and the compass of the log.
    """
    opened = open_configured(path, request)
    configuration, reader = opened.configuration, opened.reader
    topics = reader.topics()
    roles = roles_of(topics, request, opened)
    choices = {needed: roles.chosen[role] for needed, (role, _) in NEEDS.items() if role in roles.chosen}
    choices |= ship_choices(path, topics, configuration.usbl.head, roles.chosen)
    for needed, (role, what) in NEEDS.items():
        if needed not in choices:
            raise roles.unresolved.get(role) or LogError(f"the survey lacks {what}", path=path)
    in_file, _ = read_roles(reader, choices, {}, tilted=True)
    of_devices(in_file, configuration)
    raws, found = in_time_order(in_file, frozenset(), request.part or configuration.part)
    raws, more = align_clocks(raws, frozenset())
    origin = plane_origin(configuration, raws)
    head = configuration.usbl.head or UNNAMED_HEAD
    receiver = configuration.gps if head.topic is None else GpsSection()
    gyro = configuration.compass
    if head.heading_topic is not None:
        gyro = msgspec.structs.replace(gyro_section(head), latency_s=0.0)
    try:
        position = gps(raws[SHIP], receiver, origin)
        attitude = compass(raws[SHIP_HEADING], gyro, origin, OF_HEAD)
        fixes, fix_findings = _fixes(raws["usbl"], configuration.usbl, origin)
    except SettingError as err:
        raise UsageError(err.text, path=opened.file or path) from err
    return SurveyLog(
        path,
        digest_paths(opened.paths),
        opened.file,
        _survey(fixes, position, attitude, head),
        stated_installation(configuration.usbl),
        attitude.attitude is not None,
        configuration.usbl.level,
        origin,
        {role: choice.topic.name for role, choice in choices.items()},
        (*reader.findings(), *roles.findings, *found, *more, *attitude.findings, *fix_findings),
    )


class _Fixes(NamedTuple):
    time_ns: Nanoseconds  # (n,)
    along_m: Array  # (n, 3) starboard, forward, up of the head; up is NaN if the fix has no elevation
    range_m: Vector  # (n,)
    two_way_s: Vector | None  # (n,) between question and reply; None: the fix is of one instant


def _fixes(raw: RawRecords, section: UsblSection, origin: Origin | None) -> tuple[_Fixes, list[Finding]]:
    """Return the valid fixes of the target as the head measured them."""
    raw, _, findings = records_of_one(raw, "usbl", section.target)
    kind, *_ = kind_of_fixes(raw, section, origin)
    raw, more = without_repeats(raw, kind, section)
    frame, _, _ = chosen_convention(raw, "frame", section.frame, "ENU")
    if kind == "latlon" or frame != "body":
        text = "its fixes are already turned to north; a calibration needs them along the head's own axes"
        raise raw.fault(f'{text} (state frame = "body" under [usbl] if they are)')
    if kind == "range_bearing":
        range_m, bearing = raw.number("slant_range_m"), np.radians(raw.number("bearing_deg"))
        down = np.sin(np.abs(np.radians(raw.number("elevation_deg"))))  # a transponder lies below the head
        along = along_sight(range_m, bearing, range_m * down)
    else:
        along, *_ = along_axes(raw, section)
        range_m = np.linalg.norm(along, axis=1)
        if not np.isfinite(range_m).any():
            raise raw.fault(f"{raw.topic.name} holds no slant range and no vertical part of its fixes")
    good, invalid = valid_mask(raw, fix_causes(raw), "usbl", "left out")
    good &= np.isfinite(range_m) & (range_m > 0)
    when = fix_times(raw, kind, section, times_of(raw, section.time, section.latency_s))
    time_ns = when.at_head_ns
    order = np.flatnonzero(good)[np.argsort(time_ns[good], kind="stable")]
    two_way_s = None if when.asked_ns is None else (time_ns - when.asked_ns)[order] / 1e9
    return _Fixes(time_ns[order], along[order], range_m[order], two_way_s), [*findings, *more, *invalid]


def _survey(fixes: _Fixes, position: ConvertedTable, attitude: ConvertedTable, head: Head) -> UsblSurvey:
    """Put fixes and ship on one clock, which begins with the first fix."""
    antenna = time_series(position, "gps", ["east_m", "north_m"])
    heading = time_series(attitude, "compass", ["heading_deg"])
    tilts = np.zeros((len(heading.time_ns), 2))
    if attitude.attitude is not None:
        vertical = time_series(attitude.attitude, "compass", VERTICAL).at(heading.time_ns)
        tilts = roll_and_pitch_deg(vertical)[:, ::-1]
    complete = np.isfinite(tilts).all(axis=1)
    heading = TimeSeries(heading.time_ns[complete], np.column_stack([heading.values, tilts])[complete])
    first_ns = int(fixes.time_ns[0])
    antenna_s, heading_s = ((series.time_ns - first_ns) / 1e9 for series in (antenna, heading))
    ship = ship_motion(antenna_s, antenna.values, heading_s, heading.values)
    there = np.column_stack([series.at(fixes.time_ns, MAX_GAP_S) for series in (antenna, heading)])
    with np.errstate(invalid="ignore"):
        direction = fixes.along_m / fixes.range_m[:, None]
    survey = UsblSurvey(
        time_s=(fixes.time_ns - first_ns) / 1e9,
        range_m=fixes.range_m,
        direction=np.where(np.isfinite(direction).all(axis=1, keepdims=True), direction, np.nan),
        bearing_rad=np.arctan2(fixes.along_m[:, 0], fixes.along_m[:, 1]),
        ship=ship,
        two_way_s=fixes.two_way_s,
        arm_up_m=head.lever_arm_m[2],
        antenna_up_m=-head.depth_m - head.lever_arm_m[2],
    )
    return survey.part(np.all(np.isfinite(there), axis=1))


def stated_installation(section: UsblSection) -> Vector:
    """Return the installation that a configuration states, (11,) by geometry.NAMES; the transponder's place is 0."""
    head = section.head or UNNAMED_HEAD
    mount = (section.mount_roll_deg, section.mount_pitch_deg, section.mount_deg)
    latencies = (head.heading_latency_s, head.latency_s)
    return np.array([*mount, section.sound_speed_scale, *head.lever_arm_m[:2], *latencies, 0.0, 0.0, 0.0])
