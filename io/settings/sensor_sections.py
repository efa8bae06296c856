"""The sections of usbldr.toml as types: their keys, units and valid values.

Every key that states an error of a sensor (mount_deg, bias_deg, scale_error, latency_s) is later subtracted from its
readings; declination_deg is added; angles are degrees clockwise. docs/configuration.md explains each key.
"""

import datetime
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from usbldr.io.axes import axis_signs
from usbldr.io.settings.noise_sections import (
    CalibrateSection,
    ClockStep,
    CompassNoise,
    Degrees,
    Depth,
    Deviation,
    DvlNoise,
    Factor,
    Gap,
    Latency,
    Latitude,
    Lever,
    Longitude,
    Metres,
    ProcessSection,
    SdDegrees,
    SdMetres,
    SdSpeed,
    Section,
    SpreadDegrees,
    SpreadMetres,
    StartSection,
    UsblNoise,
)

MIN_SCALE_ERROR, MAX_SCALE_ERROR = -0.9, 10.0  # of a DVL's scale_error: a larger one is a wrong unit
FIRST_YEAR, LAST_YEAR = 1970, 2115  # fixed: of times in nanoseconds since 1970
Clock: TypeAlias = Literal["header", "log"]
FixFlag: TypeAlias = Literal["fix_status", "fix_type", "quality"]
Place: TypeAlias = Literal[FixFlag, "x", "y", "lat_deg", "lon_deg", "lat_side", "lon_side", "sd_m"]
CompassColumn: TypeAlias = Literal["heading", "roll_deg", "pitch_deg", "qx", "qy", "qz", "qw", "sd_deg"]
UsblColumn: TypeAlias = Literal["z", "slant_range_m", "bearing_deg", "elevation_deg", "depth_m", "target"]
Elapsed: TypeAlias = Literal["time_ns", "time_unix_us", "time_unix_ms", "time_unix_s", "time_s"]
DayNumber: TypeAlias = Literal["time_datenum", "time_excel", "time_julian", "time_mjd"]
Stamp: TypeAlias = Literal[Elapsed, DayNumber, "time_labview", "time_ntp", "time_filetime", "time_ticks"]
Time: TypeAlias = Literal[Stamp, "received_ns", "received_unix_s", "time_format"]
TruthColumn: TypeAlias = Literal[Stamp, "x", "y", "lat_deg", "lon_deg", "sd_m"]
Flag: TypeAlias = Literal["valid", "error", "device"]


class MapSection(Section, frozen=True, kw_only=True):
    """The origin of the local plane."""

    origin_lat_deg: Latitude
    origin_lon_deg: Longitude


SoundSpeed = Annotated[float, Meta(ge=1000, le=2000)]  # in any water, m/s


class DvlSection(Section, frozen=True, kw_only=True):
    """The Doppler velocity log."""

    topic: str | None = None
    columns: dict[Time | Flag | Literal["x", "y", "z", "sd_mps"], str] | None = None
    device: str | int | None = None
    axes: str | None = None
    mount_deg: Degrees = 0.0
    unit: Literal["m/s", "cm/s", "mm/s", "km/h", "ft/s", "knots"] | None = None
    level: bool | None = None
    scale_error: Annotated[float, Meta(ge=MIN_SCALE_ERROR, le=MAX_SCALE_ERROR)] = 0.0
    sound_speed_mps: SoundSpeed | None = None
    assumed_sound_speed_mps: SoundSpeed | None = None
    sd_mps: SdSpeed | Literal["message"] | None = None
    sd_scale: Factor = 1.0
    track: Literal["bottom", "water"] = "bottom"
    min_good_beams: Annotated[int, Meta(ge=0, le=100)] | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    clock_step_s: ClockStep = 0.0
    noise: DvlNoise | None = None

    def __post_init__(self) -> None:
        if self.axes is not None:
            axis_signs(self.axes)
        if self.assumed_sound_speed_mps is not None and self.sound_speed_mps is None:
            raise ValueError("assumed_sound_speed_mps needs the true one beside it: state sound_speed_mps")


class CompassSection(Section, frozen=True, kw_only=True):
    """The heading sensor."""

    topic: str | None = None
    columns: dict[Time | Flag | CompassColumn, str] | None = None
    device: str | int | None = None
    convention: Literal["ENU", "NED", "compass"] | None = None
    unit: Literal["deg", "rad", "gon", "mil", "0.1deg", "0.01deg"] | None = None
    bias_deg: Degrees = 0.0
    deviation_sin_deg: Deviation = 0.0
    deviation_cos_deg: Deviation = 0.0
    declination_deg: Degrees | Literal["auto"] | None = None
    sd_deg: SdDegrees | Literal["message"] | None = None
    sd_scale: Factor = 1.0
    time: Clock | None = None
    latency_s: Latency = 0.0
    clock_step_s: ClockStep = 0.0
    noise: CompassNoise | None = None


class KnownEnd(Section, frozen=True, kw_only=True):
    """What a USBL's line of sight begins or ends at: by latitude and longitude, or by east and north."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    east_m: Metres | None = None
    north_m: Metres | None = None
    depth_m: Depth = 0.0

    def require_place(self) -> None:
        """Raise ValueError unless a position is stated in exactly one way."""
        stated = [getattr(self, key) is not None for key in ("lat_deg", "lon_deg", "east_m", "north_m")]
        if stated not in ([True, True, False, False], [False, False, True, True]):
            raise ValueError("state either lat_deg and lon_deg or east_m and north_m")


class Head(KnownEnd, frozen=True, kw_only=True):
    """The USBL head: fixed, or on a ship whose position and heading are topics of the log."""

    topic: str | None = None
    sd_m: SpreadMetres | None = None
    heading_deg: Degrees | None = None
    heading_topic: str | None = None
    heading_convention: Literal["ENU", "NED", "compass"] | None = None
    heading_bias_deg: Degrees = 0.0
    heading_declination_deg: Degrees | Literal["auto"] | None = None
    heading_latency_s: Latency = 0.0
    latency_s: Latency = 0.0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    max_gap_s: Gap = 3.0

    def __post_init__(self) -> None:
        place = (self.lat_deg, self.lon_deg, self.east_m, self.north_m)
        if self.topic is not None and any(v is not None for v in place):
            raise ValueError("state either the head's position or its topic")
        if self.topic is None:
            self.require_place()
        if self.heading_deg is not None and self.heading_topic is not None:
            raise ValueError("state either heading_deg or heading_topic")
        if any(self.lever_arm_m) and self.heading_deg is None and self.heading_topic is None:
            raise ValueError("lever_arm_m needs the ship's heading; state heading_topic or heading_deg")


class Beacon(KnownEnd, frozen=True, kw_only=True):
    """A fixed beacon, if the vehicle carries the USBL head."""

    sd_m: SpreadMetres = 0.0
    max_gap_s: Gap = 3.0

    def __post_init__(self) -> None:
        self.require_place()


class UsblSection(Section, frozen=True, kw_only=True):
    """The acoustic positioning system."""

    topic: str | None = None
    columns: dict[Time | Flag | Place | UsblColumn, str] | None = None
    kind: Literal["position", "latlon", "range_bearing"] | None = None
    frame: Literal["ENU", "NED", "body"] | None = None
    grid: str | None = None
    relative_to: Literal["map", "head"] | None = None
    head: Head | None = None
    beacon: Beacon | None = None
    target: str | int | None = None
    axes: str | None = None
    mount_deg: Degrees = 0.0
    mount_roll_deg: Degrees = 0.0
    mount_pitch_deg: Degrees = 0.0
    level: bool = False
    sound_speed_scale: Annotated[float, Meta(ge=0.5, le=2)] = 1.0
    stamped_at: Literal["position", "reply"] = "position"
    sound_speed_mps: SoundSpeed | None = None
    turnaround_s: Annotated[float, Meta(ge=0, le=60)] = 0.0
    sd_m: SdMetres | Literal["message"] | None = None
    sd_scale: Factor = 1.0
    range_sd_m: SpreadMetres | None = None
    range_sd_rel: Annotated[float, Meta(ge=0, le=10)] | None = None
    bearing_sd_deg: SdDegrees | None = None
    heading_sd_deg: SpreadDegrees | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    clock_step_s: ClockStep = 0.0
    noise: UsblNoise | None = None

    def __post_init__(self) -> None:
        if self.axes is not None:
            axis_signs(self.axes)
        if self.head is not None and self.beacon is not None:
            raise ValueError("state either head (at a known position) or beacon (the head is on the vehicle)")
        if self.beacon is not None and self.relative_to == "map":
            raise ValueError('fixes of a beacon are relative to the vehicle: relative_to cannot be "map"')
        if self.stamped_at != "reply" and (self.sound_speed_mps is not None or self.turnaround_s):
            raise ValueError('sound_speed_mps and turnaround_s need stamped_at = "reply"')
        if self.grid is not None and (self.frame == "body" or self.relative_to == "head" or self.beacon is not None):
            raise ValueError("positions on a grid do not count from the head: leave out grid, or frame and relative_to")
        if self.frame == "body" and self.relative_to == "map":
            raise ValueError('frame = "body" is relative to the head: relative_to cannot be "map"')
        polar = [self.range_sd_m, self.range_sd_rel, self.bearing_sd_deg]
        if self.sd_m is not None and any(v is not None for v in polar):
            raise ValueError("sd_m cannot be combined with range_sd_m, range_sd_rel or bearing_sd_deg")
        known_end = self.head is not None or self.beacon is not None
        if any(v is not None for v in polar):
            if self.bearing_sd_deg is None or not (self.range_sd_m or self.range_sd_rel):
                raise ValueError("state both bearing_sd_deg and range_sd_m or range_sd_rel")
            if not known_end:
                raise ValueError("range_sd_m, range_sd_rel and bearing_sd_deg need the head's position (head = {...})")
        if not known_end and (self.relative_to == "head" or self.kind == "range_bearing" or self.frame == "body"):
            raise ValueError(
                "the head's position is missing (head = { lat_deg = ..., lon_deg = ..., depth_m = ... }, or on a ship "
                "{ topic = ..., heading_topic = ... })"
            )


class GpsSection(Section, frozen=True, kw_only=True):
    """The satellite receiver: truth by default, used by the filter only in the windows of --aid."""

    topic: str | None = None
    columns: dict[Time | Flag | Place, str] | None = None
    device: str | int | None = None
    frame: Literal["ENU", "NED", "latlon"] | None = None
    grid: str | None = None
    sd_m: SdMetres | Literal["message"] | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    noise: UsblNoise | None = None


class DepthSection(Section, frozen=True, kw_only=True):
    """The pressure or depth sensor."""

    topic: str | None = None
    columns: dict[Time | Flag | Literal["depth_m", "pressure"], str] | None = None
    device: str | int | None = None
    unit: Literal["Pa", "hPa", "kPa", "dbar", "bar", "psi", "m"] | None = None
    surface_pa: Annotated[float, Meta(ge=0, le=1e7)] | None = None
    positive: Literal["down", "up"] | None = None
    time: Clock | None = None
    latency_s: Latency = 0.0


class TruthSection(Section, frozen=True, kw_only=True):
    """The reference that errors are measured against."""

    topic: str | None = None
    file: str | None = None
    kind: Literal["gps", "slam", "simulated", "other"] | None = None
    frame: Literal["ENU", "NED", "latlon"] | None = None
    grid: str | None = None
    skip_rows: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 0
    sd_m: SpreadMetres | None = None
    heading_sd_deg: SpreadDegrees = 0.0
    scale_sd: Annotated[float, Meta(ge=0, le=1)] = 0.0
    max_gap_s: Gap = 30.0
    latency_s: Latency = 0.0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    columns: dict[TruthColumn, str] | None = None

    def __post_init__(self) -> None:
        if self.topic is not None and self.file is not None:
            raise ValueError("state either topic or file")
        if self.topic is not None and self.columns is not None:
            raise ValueError("columns need file, not topic")


class FileSection(Section, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Another file of the same dive, or the log itself: its clock minus the clock of the dive, its missing date."""

    path: str
    clock_offset_s: Annotated[float, Meta(ge=-4e9, le=4e9)] = 0.0  # a clock may count from power-on, or 1900
    date: datetime.date | None = None

    def __post_init__(self) -> None:
        if self.date is not None and not FIRST_YEAR <= self.date.year <= LAST_YEAR:
            raise ValueError(f"date must lie between {FIRST_YEAR} and {LAST_YEAR}")


class Configuration(Section, frozen=True, kw_only=True):
    """A whole usbldr.toml; without a file, all defaults."""

    schema: Literal[1] = 1
    map: MapSection | None = None
    dvl: DvlSection = DvlSection()
    compass: CompassSection = CompassSection()
    usbl: UsblSection = UsblSection()
    gps: GpsSection = GpsSection()
    depth: DepthSection = DepthSection()
    truth: TruthSection = TruthSection()
    process: ProcessSection = ProcessSection()
    calibrate: CalibrateSection = CalibrateSection()
    start: StartSection | None = None
    file: tuple[FileSection, ...] = ()
    layouts: tuple[str, ...] = ()
    part: Annotated[int, Meta(ge=1)] | Literal["joined"] | None = None

    def topic(self, role: str) -> str | None:
        """Return the topic that the file names for a role; "none" disables the role."""
        return self.section(role).topic

    def columns(self, role: str) -> dict[str, str]:
        """Return quantity -> column of a CSV file, empty if none are stated."""
        return {str(key): name for key, name in (self.section(role).columns or {}).items()}

    def section(self, role: str) -> DvlSection | CompassSection | UsblSection | GpsSection | DepthSection:
        """Return the section of a role."""
        return getattr(self, role)
