"""Which message types serve which sensor, and which of their fields are which quantity.

A type is known by the last part of its name and by its fields, not by its package: the same layout lives under many
packages. Sources: the .msg files of the ROS packages named, and the drivers that fill them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from usbldr.filters.types import Vector
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

Mask: TypeAlias = NDArray[np.bool_]  # (n,)
Recognised: TypeAlias = Literal["by type", "by type and name", "only when named"]


@dataclass(frozen=True, slots=True)
class Layout:
    """How messages of one type tell what one sensor measured."""

    type: str  # last part of the type's name, lower case
    required: Mapping[str, str]  # quantity -> field path
    optional: Mapping[str, str] = field(default_factory=dict[str, str])
    recognised: Recognised = "by type and name"
    defaults: Mapping[str, str] = field(default_factory=dict[str, str])  # configuration keys, unless the user says
    fixed: Mapping[str, str] = field(default_factory=dict[str, str])  # keys that the fields' own names settle

    def fits(self, topic: TopicInfo) -> bool:
        """Tell whether a topic has this type and these fields."""
        last = topic.type.rpartition("/")[2].lower()
        return last == self.type and all(topic.has(path) for path in self.required.values())


@dataclass(frozen=True, slots=True)
class Raw:
    """What a sensor's messages say, in their own units and frames, in the order of arrival."""

    log: Path
    topic: TopicInfo
    layout: Layout
    stamp_ns: Nanoseconds | None  # (n,) header stamps, 0 where unset; None: the type has no header
    received_ns: Nanoseconds  # (n,) log time
    values: Mapping[str, Column]  # quantity -> (n,)
    frame_id: str

    def number(self, quantity: str) -> Vector:
        """Return a quantity as floats, (n,); NaN where it is no finite number or the messages have no such field."""
        if quantity not in self.values:
            return np.full(len(self.received_ns), np.nan)
        values = np.asarray(self.values[quantity], dtype=np.float64)
        return np.where(np.isfinite(values), values, np.nan)


def _xyz(prefix: str) -> dict[str, str]:
    return {axis: f"{prefix}.{axis}" for axis in "xyz"}


def _plane_covariance(path: str, xx: int, xy: int, yy: int) -> dict[str, str]:
    return {"cov_xx": f"{path}.{xx}", "cov_xy": f"{path}.{xy}", "cov_yy": f"{path}.{yy}"}


def _own(*names: str) -> dict[str, str]:
    """Return the columns of our CSV, whose names are their quantities."""
    return {name: name for name in names}


FRD, ENU = {"axes": "FRD"}, {"convention": "ENU"}
TWIST = _xyz("twist.twist.linear")
POSE_COVARIANCE = _plane_covariance("pose.covariance", 0, 1, 7)
NAVSAT = {"lat_deg": "latitude", "lon_deg": "longitude"}
NAVSAT_MORE = _plane_covariance("position_covariance", 0, 1, 4) | {
    "status": "status.status",
    "covariance_type": "position_covariance_type",
}
ORIENTATION = {f"q{axis}": f"orientation.{axis}" for axis in "xyzw"}


def _orientation(prefix: str) -> dict[str, str]:
    return {name: f"{prefix}.{path}" for name, path in ORIENTATION.items()}


PLACES = (
    Layout("pointstamped", _xyz("point")),
    Layout("posestamped", _xyz("pose.position")),
    Layout("posewithcovariancestamped", _xyz("pose.pose.position"), POSE_COVARIANCE),
    Layout("odometry", _xyz("pose.pose.position"), POSE_COVARIANCE),
)
"""Local positions."""

OWN_ENU, OWN_LATLON = {"kind": "position", "frame": "ENU"}, {"kind": "latlon", "frame": "latlon"}
OWN_COVARIANCE = _own("sd_m", "cov_ee_m2", "cov_en_m2", "cov_nn_m2")


def _own_places(sensor: str) -> tuple[Layout, Layout]:
    """Return the layouts of our CSV for positions: east and north come before latitude and longitude."""
    geodetic = _own("lat_deg", "lon_deg")
    return (
        Layout(sensor, _own("east_m", "north_m"), geodetic | OWN_COVARIANCE, "by type", fixed=OWN_ENU),
        Layout(sensor, geodetic, OWN_COVARIANCE, "by type", fixed=OWN_LATLON),
    )


def _only_when_named(layouts: tuple[Layout, ...]) -> tuple[Layout, ...]:
    return tuple(Layout(k.type, k.required, k.optional, "only when named", k.defaults, k.fixed) for k in layouts)


LAYOUTS: Mapping[str, tuple[Layout, ...]] = {
    "dvl": (
        Layout(
            "dvl",  # marine_acoustic_msgs/Dvl: x forward, z where the DVL points; a covariance of -1 is only unknown
            _xyz("velocity") | {"covariance": "velocity_covar.0", "good_beams": "num_good_beams"},
            {"mode": "velocity_mode", "beams_valid": "beam_velocities_valid"},
            "by type",
            FRD,
        ),
        Layout(
            "dvl",  # Water Linked's and dvl_msgs/DVL, with and without covariance
            _xyz("velocity") | {"velocity_valid": "velocity_valid"},
            {
                "covariance": "covariance.0",
                "sd": "fom",
                "validity_us": "time_of_validity",
                "transmission_us": "time_of_transmission",
            },
            "by type",
            FRD,
        ),
        Layout("twistwithcovariancestamped", TWIST, {"own_covariance": "twist.covariance.0"}),
        Layout("odometry", TWIST, {"own_covariance": "twist.covariance.0"}),
        Layout("twiststamped", _xyz("twist.linear")),
        Layout(
            "dvl",
            {"x": "starboard_mps", "y": "forward_mps"},
            {"z": "up_mps", "sd": "sd_mps", "velocity_valid": "valid"},
            "by type",
            fixed={"axes": "SFU", "unit": "m/s"},
        ),
        Layout("dvl", _own("x", "y"), {"z": "z", "sd": "sd_mps", "velocity_valid": "valid"}, "by type"),
    ),
    "compass": (
        Layout(
            "imu",
            ORIENTATION,
            {"own_covariance": "orientation_covariance.0", "yaw_variance": "orientation_covariance.8"},
            "by type",
            ENU,
        ),
        Layout("float64", {"angle": "data"}, defaults={"convention": "compass"}),
        Layout("float32", {"angle": "data"}, defaults={"convention": "compass"}),
        *_only_when_named(
            (
                Layout("posestamped", _orientation("pose"), defaults=ENU),
                Layout("posewithcovariancestamped", _orientation("pose.pose"), defaults=ENU),
                Layout("odometry", _orientation("pose.pose"), defaults=ENU),
            )
        ),
        Layout(
            "compass",
            {"angle": "heading_deg"},
            _own("sd_deg"),
            "by type",
            fixed={"convention": "compass", "unit": "deg"},
        ),
        Layout("compass", {"angle": "heading"}, _own("sd_deg"), "by type", {"convention": "compass"}),
    ),
    "usbl": (
        *PLACES,
        Layout("navsatfix", NAVSAT, NAVSAT_MORE, defaults={"kind": "latlon"}),
        *_own_places("usbl"),
        Layout(
            "usbl",
            _own("slant_range_m", "bearing_deg"),
            _own("elevation_deg", "depth_m") | OWN_COVARIANCE,
            "by type",
            fixed={"kind": "range_bearing"},
        ),
        Layout("usbl", _own("x", "y"), _own("z", "sd_m"), "by type"),
    ),
    "gps": (
        Layout("navsatfix", NAVSAT, NAVSAT_MORE, "by type", {"frame": "latlon"}),
        *_only_when_named(PLACES),
        *_own_places("gps"),
        Layout("gps", _own("x", "y"), _own("sd_m"), "by type"),
    ),
    "depth": (
        Layout("fluidpressure", {"pressure": "fluid_pressure"}, recognised="by type", defaults={"unit": "Pa"}),
        Layout("float64", {"depth": "data"}, defaults={"unit": "m"}),
        Layout("float32", {"depth": "data"}, defaults={"unit": "m"}),
        Layout("depth", _own("pressure"), recognised="by type", defaults={"unit": "Pa"}),
        Layout("depth", {"depth": "depth_m"}, recognised="by type", fixed={"unit": "m", "positive": "down"}),
    ),
    "truth": (
        Layout("navsatfix", NAVSAT, NAVSAT_MORE, "only when named", {"frame": "latlon"}),
        *_only_when_named(PLACES),
        *_own_places("gps"),
        *_own_places("truth"),
    ),
}
"""A type that serves a role is one line. The first that fits a topic is taken.

Files of our own columns, and those whose columns the configuration names, have the sensor for their type.
"""


def layout_of(role: str, topic: TopicInfo) -> Layout | None:
    """Return how the topic serves the role, None if it can't."""
    return next((layout for layout in LAYOUTS[role] if layout.fits(topic)), None)


def wanted_paths(topic: TopicInfo, layout: Layout) -> dict[str, str]:
    """Return quantity -> field path for all that the topic has of a layout, and its header."""
    paths = dict(layout.required) | {q: path for q, path in layout.optional.items() if topic.has(path)}
    return paths | {path: path for path in ("header.stamp", "header.frame_id") if topic.has(path)}


def raw(log: Path, topic: TopicInfo, layout: Layout, records: Records) -> Raw:
    """Name the columns of a topic by quantity."""
    paths = wanted_paths(topic, layout)
    frames = records.columns.get("header.frame_id", np.array([""]))
    return Raw(
        log=log,
        topic=topic,
        layout=layout,
        stamp_ns=records.columns.get("header.stamp"),
        received_ns=records.received_ns,
        values={quantity: records.columns[path] for quantity, path in paths.items()},
        frame_id=str(frames[0]) if len(frames) else "",
    )


def dvl_causes(raw: Raw, speed_mps: Vector, least_beams: int | None) -> dict[str, Mask]:
    """Return by cause which DVL records (n,) are invalid, by what their family of messages says.

    ``speed_mps`` = |v|; ``least_beams`` None: three where any record tells its good beams at all.
    """
    x, y, z = (raw.number(axis) for axis in "xyz")
    causes = {"not a number": ~(np.isfinite(x) & np.isfinite(y))}
    if "velocity_valid" in raw.values:
        causes["flagged invalid"] = raw.number("velocity_valid") == 0
    else:
        causes["exactly zero"] = (x == 0) & (y == 0) & ((z == 0) | np.isnan(z))
    beams = raw.number("good_beams")
    if least_beams is not None or np.any(beams > 0):
        least = 3 if least_beams is None else least_beams
        causes[f"fewer than {least} good beams"] = beams < least
    causes["water track"] = raw.number("mode") == 2
    beams_valid = raw.number("beams_valid")
    if np.any(beams_valid == 1):
        causes["beam velocities flagged invalid"] = beams_valid == 0
    causes["negative covariance"] = raw.number("own_covariance") < 0
    causes["faster than 20 m/s"] = speed_mps > 20.0
    return causes
