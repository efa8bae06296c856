"""Eastings and northings of a survey grid, such as UTM, as latitudes and longitudes; pyproj knows the grids by code."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.types import Vector
from usbldr.io.axes import named_ned
from usbldr.io.file_access.optional_library import library
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import Convention
from usbldr.io.settings.sensor_sections import Configuration, GpsSection, TruthSection, UsblSection

WGS84 = "EPSG:4326"
LATLON = {"kind": "latlon", "frame": "latlon"}
Positions = TypeVar("Positions", UsblSection, GpsSection, TruthSection)


def grid_to_geodetic(grid: str, easting: Vector, northing: Vector, file: Path) -> tuple[Vector, Vector]:
    """Return latitude and longitude in degrees of WGS 84, (n,) each; NaN if a place is not on the grid.

    ``grid`` is a code of EPSG, or another name that pyproj knows; eastings and northings are in metres, whatever its
    unit. The place 0, 0 remains 0, 0: programs write it for no position. Raises SettingError for an unknown grid.
    """
    pyproj: Any = library("pyproj", "eastings and northings of a grid", "grid", file)
    try:
        system = pyproj.CRS.from_user_input(grid)
    except pyproj.exceptions.CRSError as err:
        raise SettingError(f'grid = "{grid}": pyproj knows no such code; epsg.io lists them') from err
    if not system.is_projected:
        raise SettingError(f'grid = "{grid}": {system.name} is no grid of eastings and northings')
    unit_m = system.axis_info[0].unit_conversion_factor
    off = pyproj.Transformer.from_crs(system, WGS84, always_xy=True)
    lon, lat = off.transform(easting / unit_m, northing / unit_m)
    nowhere = (easting == 0) & (northing == 0)
    lat, lon = (np.where(nowhere, 0.0, np.where(np.isfinite(degrees), degrees, np.nan)) for degrees in (lat, lon))
    return lat, lon


def off_grid(raw: RawRecords, section: Positions) -> tuple[RawRecords, Positions]:
    """Return records on the grid of their section as latitudes and longitudes, and the section without the grid.

    Raises SettingError if the records hold no x and y.
    """
    grid = section.grid or ""
    required = raw.layout.required
    names = next((pair for pair in (("x", "y"), ("east_m", "north_m")) if {*pair} <= {*required}), None)
    if names is None:
        raise SettingError(f'grid = "{grid}": {raw.topic.name} holds no eastings and northings')
    stated = raw.layout.fixed.get("frame") or section.frame
    ned = names[0] == "x" and (stated == "NED" if stated else named_ned(raw.frame_id))
    easting, northing = (raw.number(name) for name in (names[::-1] if ned else names))
    lat, lon = grid_to_geodetic(grid, easting, northing, raw.log)
    values: Mapping[str, Any] = {k: v for k, v in raw.values.items() if k not in names}
    values = {**values, "lat_deg": lat, "lon_deg": lon}
    needed = {k: v for k, v in required.items() if k not in names} | {"lat_deg": names[0], "lon_deg": names[1]}
    layout = replace(raw.layout, required=needed, fixed={**raw.layout.fixed, **LATLON})
    done: dict[str, Any] = {key: None for key in ("grid", "frame", "kind", "relative_to") if hasattr(section, key)}
    done |= {"kind": section.kind} if isinstance(section, TruthSection) else {}  # of the truth, not of its positions
    return replace(raw, layout=layout, values=values), msgspec.structs.replace(section, **done)


def off_grids(
    raws: Mapping[str, RawRecords], configuration: Configuration
) -> tuple[dict[str, RawRecords], Configuration, dict[str, Convention]]:
    """Return the records of fixes, GPS and truth off their grids, the configuration for the rest, and role -> grid.

    A truth that is the GPS has its grid.
    """
    made = dict(raws)
    sections: dict[str, Any] = {role: getattr(configuration, role) for role in ("usbl", "gps", "truth") if role in raws}
    same = {"gps", "truth"} <= {*raws} and raws["gps"].topic == raws["truth"].topic
    if same and configuration.truth.grid is None:
        sections["truth"] = msgspec.structs.replace(sections["truth"], grid=configuration.gps.grid)
    grids = {
        role: Convention("grid", section.grid, "configuration") for role, section in sections.items() if section.grid
    }
    for role in grids:
        try:
            made[role], sections[role] = off_grid(raws[role], sections[role])
        except SettingError as err:
            raise SettingError(f"[{role}] {err.text}") from err
    return made, msgspec.structs.replace(configuration, **sections), grids
