"""Latitude and longitude to the local tangent plane and back: WGS84, by pymap3d, degrees and metres.

Everything is taken at height 0: over 10 km the plane departs from the sphere by 8 m, which moves a point by 1 cm.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, cast

import numpy as np
import pymap3d  # pyright: ignore[reportMissingTypeStubs]

from usbldr.filters.types import Vector

_forward = cast("Callable[..., Any]", pymap3d.geodetic2enu)  # pyright: ignore[reportUnknownMemberType]
_backward = cast("Callable[..., Any]", pymap3d.enu2geodetic)  # pyright: ignore[reportUnknownMemberType]


class OriginKind(StrEnum):
    """What states the origin, in the words of a report."""

    MAP = "[map]"
    HEAD = "usbl head"
    BEACON = "usbl beacon"
    FIRST_USBL = "first usbl fix"
    FIRST_GPS = "first gps fix"
    FIRST_TRUTH = "first truth fix"


@dataclass(frozen=True, slots=True)
class Origin:
    """The point that the local plane touches."""

    lat_deg: float
    lon_deg: float
    kind: OriginKind


def to_plane(origin: Origin, lat_deg: Vector, lon_deg: Vector) -> tuple[Vector, Vector]:
    """Return east and north in metres, (n,) each."""
    east, north, _ = _forward(lat_deg, lon_deg, np.zeros(len(lat_deg)), origin.lat_deg, origin.lon_deg, 0.0)
    return np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)


def to_geodetic(origin: Origin, east_m: Vector, north_m: Vector) -> tuple[Vector, Vector]:
    """Return latitude and longitude in degrees, (n,) each."""
    lat, lon, _ = _backward(east_m, north_m, np.zeros(len(east_m)), origin.lat_deg, origin.lon_deg, 0.0)
    return np.asarray(lat, dtype=np.float64), np.asarray(lon, dtype=np.float64)
