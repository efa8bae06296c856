"""The sections of usbldr.toml as types: which keys there are, in which unit, and which values make no sense.

Every key that states an error of a sensor (mount_deg, bias_deg, scale_error, latency_s) is later subtracted from its
readings; declination_deg is added; angles are degrees clockwise. docs/configuration.md explains each key.
"""

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta, Struct

Positive: TypeAlias = Annotated[float, Meta(gt=0)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0)]
Share: TypeAlias = Annotated[float, Meta(gt=0, lt=1)]
Latency: TypeAlias = Annotated[float, Meta(ge=-86400, le=86400)]
Latitude: TypeAlias = Annotated[float, Meta(ge=-90, le=90)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=360)]
Deviation: TypeAlias = Annotated[float, Meta(ge=-30, le=30)]  # beyond, a reading no longer tells one heading
Lever: TypeAlias = tuple[float, float, float]  # starboard, forward, up, metres
Clock: TypeAlias = Literal["header", "log"]
Per: TypeAlias = Literal["scalar", "record"]
UsblColumn: TypeAlias = Literal[
    "x", "y", "z", "lat_deg", "lon_deg", "slant_range_m", "bearing_deg", "elevation_deg", "depth_m", "sd_m"
]
Time: TypeAlias = Literal["time_ns", "time_unix_s", "time_s", "received_ns", "received_unix_s"]


class Section(Struct, frozen=True):
    """A table of the file. A key that is not listed is refused."""


class GaussianNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="gaussian"):
    """N(0, R)."""

    per: Per | None = None


class MixtureNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="mixture"):
    """N(0, R), with probability ``share`` N(0, variance_ratio R)."""

    share: Share = 0.30
    variance_ratio: Annotated[float, Meta(gt=1)] = 10.0
    per: Per | None = None


class StudentNoise(Section, frozen=True, kw_only=True, tag_field="kind", tag="student-t"):
    """Student's t."""

    dof: Annotated[float, Meta(ge=2)] = 4.0  # below 2 the tails have no variance to match
    per: Per | None = None


class DvlContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_mps: Positive
    per: Per | None = None


class CompassContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_deg: Positive
    per: Per | None = None


class UsblContamination(Section, frozen=True, kw_only=True, tag_field="kind", tag="contamination"):
    """N(0, R), with probability ``share`` a gross error."""

    share: Share = 0.05
    sd_m: Positive = 10.0
    per: Per | None = None


DvlNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | DvlContamination
CompassNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | CompassContamination
UsblNoise: TypeAlias = GaussianNoise | MixtureNoise | StudentNoise | UsblContamination


class MapSection(Section, frozen=True, kw_only=True):
    """The point that the local plane touches."""

    origin_lat_deg: Latitude
    origin_lon_deg: Longitude


class DvlSection(Section, frozen=True, kw_only=True):
    """The Doppler velocity log."""

    topic: str | None = None
    columns: dict[Time | Literal["x", "y", "z", "sd_mps", "valid"], str] | None = None
    axes: str | None = None
    mount_deg: float = 0.0
    unit: Literal["m/s", "mm/s"] | None = None
    scale_error: Annotated[float, Meta(gt=-1)] = 0.0
    sd_mps: Positive | Literal["message"] | None = None
    sd_scale: Positive = 1.0
    min_good_beams: Annotated[int, Meta(ge=0)] | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    noise: DvlNoise | None = None

    def __post_init__(self) -> None:
        """Refuse axes that are no three directions at right angles."""
        if self.axes is not None:
            axis_signs(self.axes)


class CompassSection(Section, frozen=True, kw_only=True):
    """The heading sensor."""

    topic: str | None = None
    columns: dict[Time | Literal["heading", "sd_deg"], str] | None = None
    convention: Literal["ENU", "NED", "compass"] | None = None
    unit: Literal["deg", "rad"] | None = None
    bias_deg: float = 0.0
    deviation_sin_deg: Deviation = 0.0
    deviation_cos_deg: Deviation = 0.0
    declination_deg: float | Literal["auto"] | None = None
    sd_deg: Positive | Literal["message"] | None = None
    time: Clock | None = None
    latency_s: Latency = 0.0
    noise: CompassNoise | None = None


class Head(Section, frozen=True, kw_only=True):
    """The USBL head: fixed, or on a ship whose place and heading are topics of the log."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    east_m: float | None = None
    north_m: float | None = None
    depth_m: float = 0.0
    topic: str | None = None
    sd_m: NotNegative | None = None
    heading_deg: float | None = None
    heading_topic: str | None = None
    heading_convention: Literal["ENU", "NED", "compass"] | None = None
    heading_bias_deg: float = 0.0
    heading_declination_deg: float | Literal["auto"] | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    max_gap_s: Positive = 3.0

    def __post_init__(self) -> None:
        """Refuse a head that is nowhere or in two places, and one that cannot know its heading."""
        place = (self.lat_deg, self.lon_deg, self.east_m, self.north_m)
        if self.topic is not None and any(v is not None for v in place):
            raise ValueError("state either where the head is or the topic that tells it")
        if self.topic is None:
            refuse_nowhere(self.lat_deg, self.lon_deg, self.east_m, self.north_m)
        if self.heading_deg is not None and self.heading_topic is not None:
            raise ValueError("state either heading_deg or heading_topic")
        if any(self.lever_arm_m) and self.heading_deg is None and self.heading_topic is None:
            raise ValueError("a lever_arm_m is turned by the ship's heading; state heading_topic or heading_deg")


class Beacon(Section, frozen=True, kw_only=True):
    """A fixed beacon, where the vehicle carries the USBL head."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    east_m: float | None = None
    north_m: float | None = None
    depth_m: float = 0.0
    sd_m: NotNegative = 0.0
    max_gap_s: Positive = 3.0

    def __post_init__(self) -> None:
        """Refuse a beacon that is nowhere or in two places."""
        refuse_nowhere(self.lat_deg, self.lon_deg, self.east_m, self.north_m)


def refuse_nowhere(lat_deg: float | None, lon_deg: float | None, east_m: float | None, north_m: float | None) -> None:
    """Raise ValueError unless a place is stated, and in one way."""
    geodetic = lat_deg is not None and lon_deg is not None
    local = east_m is not None and north_m is not None
    given = [v for v in (lat_deg, lon_deg, east_m, north_m) if v is not None]
    if geodetic == local or len(given) != 2:
        raise ValueError("state either lat_deg and lon_deg or east_m and north_m")


class UsblSection(Section, frozen=True, kw_only=True):
    """The acoustic positioning system."""

    topic: str | None = None
    columns: dict[Time | UsblColumn, str] | None = None
    kind: Literal["position", "latlon", "range_bearing"] | None = None
    frame: Literal["ENU", "NED", "body"] | None = None
    relative_to: Literal["map", "head"] | None = None
    head: Head | None = None
    beacon: Beacon | None = None
    target: str | int | None = None
    axes: str | None = None
    mount_deg: float = 0.0
    sound_speed_scale: Positive = 1.0
    sd_m: Positive | Literal["message"] | None = None
    sd_scale: Positive = 1.0
    range_sd_m: NotNegative | None = None
    range_sd_rel: NotNegative | None = None
    bearing_sd_deg: Positive | None = None
    heading_sd_deg: NotNegative | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    noise: UsblNoise | None = None

    def __post_init__(self) -> None:
        """Refuse keys that contradict each other."""
        if self.axes is not None:
            axis_signs(self.axes)
        if self.head is not None and self.beacon is not None:
            raise ValueError("the head is either at a known place (head) or on the vehicle (beacon)")
        if self.beacon is not None and self.relative_to == "map":
            raise ValueError('a beacon is measured from the vehicle: relative_to cannot be "map"')
        if self.frame == "body" and self.relative_to == "map":
            raise ValueError('frame = "body" counts from the head: relative_to cannot be "map"')
        polar = [self.range_sd_m, self.range_sd_rel, self.bearing_sd_deg]
        if self.sd_m is not None and any(v is not None for v in polar):
            raise ValueError("sd_m excludes range_sd_m, range_sd_rel and bearing_sd_deg")
        known_end = self.head is not None or self.beacon is not None
        if any(v is not None for v in polar):
            if self.bearing_sd_deg is None or not (self.range_sd_m or self.range_sd_rel):
                raise ValueError("range_sd_m or range_sd_rel and bearing_sd_deg belong together")
            if not known_end:
                raise ValueError("range_sd_m, range_sd_rel and bearing_sd_deg need the head's position (head = {...})")
        if not known_end and (self.relative_to == "head" or self.kind == "range_bearing" or self.frame == "body"):
            raise ValueError("the head's position is missing (head = { lat_deg = ..., lon_deg = ..., depth_m = ... })")


class GpsSection(Section, frozen=True, kw_only=True):
    """The satellite receiver: truth by default, a sensor of the filter only in the windows of --aid."""

    topic: str | None = None
    columns: dict[Time | Literal["x", "y", "lat_deg", "lon_deg", "sd_m"], str] | None = None
    frame: Literal["ENU", "NED", "latlon"] | None = None
    sd_m: Positive | Literal["message"] | None = None
    lever_arm_m: Lever = (0.0, 0.0, 0.0)
    time: Clock | None = None
    latency_s: Latency = 0.0
    noise: UsblNoise | None = None


class DepthSection(Section, frozen=True, kw_only=True):
    """The pressure or depth sensor."""

    topic: str | None = None
    columns: dict[Time | Literal["depth_m", "pressure"], str] | None = None
    unit: Literal["Pa", "hPa", "dbar", "bar", "m"] | None = None
    surface_pa: NotNegative | None = None
    positive: Literal["down", "up"] | None = None
    time: Clock | None = None
    latency_s: Latency = 0.0


class TruthSection(Section, frozen=True, kw_only=True):
    """The reference that errors are taken against."""

    topic: str | None = None
    file: str | None = None
    kind: Literal["gps", "slam", "simulated", "other"] | None = None
    frame: Literal["ENU", "NED", "latlon"] | None = None
    skip_rows: Annotated[int, Meta(ge=0)] = 0
    max_gap_s: Positive = 30.0
    columns: dict[Literal["time_ns", "time_unix_s", "time_s", "x", "y", "sd_m"], str] | None = None

    def __post_init__(self) -> None:
        """Refuse two sources."""
        if self.topic is not None and self.file is not None:
            raise ValueError("state either topic or file")
        if self.topic is not None and self.columns is not None:
            raise ValueError("columns belong to a file, not to a topic")


class ProcessSection(Section, frozen=True, kw_only=True):
    """Random walks of the motion model: 1-sigma after one second."""

    position_m: NotNegative | None = None
    heading_deg: NotNegative | None = None
    velocity_mps: NotNegative | None = None
    turn_rate_dps: NotNegative | None = None
    uncalibrated_m: NotNegative | None = None


class CalibrateSection(Section, frozen=True, kw_only=True):
    """Which errors of sensors are estimated, and their 1-sigma before anything is measured."""

    states: (
        Literal["auto"] | tuple[Literal["scale", "misalignment", "heading", "deviation", "latency", "usbl-bias"], ...]
    ) = ()
    scale_sd: Positive | None = None
    mount_sd_deg: Positive | None = None
    heading_sd_deg: Positive | None = None
    heading_walk_deg: NotNegative | None = None  # after one second
    deviation_sd_deg: Positive | None = None
    latency_sd_s: Positive | None = None
    usbl_bias_sd_m: Positive | None = None
    usbl_bias_time_s: Positive | None = None


class StartSection(Section, frozen=True, kw_only=True):
    """Where the vehicle is known to start, and how far off the first heading and velocity may be."""

    east_m: float
    north_m: float
    sd_m: Positive
    heading_sd_deg: Positive = 5.0
    velocity_sd_mps: Positive = 0.5
    turn_rate_sd_dps: Positive = 3.0


class FileSection(Section, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Another file of the same dive, or the log itself: its clock minus the clock of the dive."""

    path: str
    clock_offset_s: float = 0.0


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

    def topic(self, role: str) -> str | None:
        """Return the topic that the file names for a role; "none" switches the role off."""
        return self.section(role).topic

    def columns(self, role: str) -> dict[str, str]:
        """Return quantity -> column of a CSV file, empty where the file does not say."""
        return {str(key): name for key, name in (self.section(role).columns or {}).items()}

    def section(self, role: str) -> DvlSection | CompassSection | UsblSection | GpsSection | DepthSection:
        """Return the section of a role."""
        return getattr(self, role)


def axis_signs(axes: str) -> tuple[tuple[int, int], ...]:
    """Return for x, y and z which of (starboard, forward, up) it lies along, and with which sign.

    ``axes`` has one letter for each: F(orward), B(ackward), S(tarboard) or R(ight), P(ort) or L(eft), U(p), D(own).
    """
    letters = {
        "S": (0, 1),
        "R": (0, 1),
        "P": (0, -1),
        "L": (0, -1),
        "F": (1, 1),
        "B": (1, -1),
        "U": (2, 1),
        "D": (2, -1),
    }
    signs = tuple(letters.get(letter, (-1, 0)) for letter in axes.upper())
    if len(signs) != 3 or {axis for axis, _ in signs} != {0, 1, 2}:
        raise ValueError(
            f'axes = "{axes}" is not three directions at right angles; '
            "name where x, y and z point by one letter each: F or B, S (R) or P (L), U or D"
        )
    return signs
