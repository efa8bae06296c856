"""Positions of any kind as east and north on the local plane; GPS fixes as a whole table."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from usbldr.filters.errors import SettingError
from usbldr.filters.types import Array, Mask, Vector
from usbldr.io.axes import named_ned
from usbldr.io.conventions.converted import ConvertedTable, chosen_convention, converted_table, valid_mask
from usbldr.io.conventions.timestamps import times_of
from usbldr.io.decoding.nmea_kinds import ESTIMATED_QUALITIES, in_hemisphere
from usbldr.io.findings import Finding
from usbldr.io.geodesy import Origin, to_geodetic, to_plane
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.provenance import Convention
from usbldr.io.settings.sensor_sections import GpsSection
from usbldr.io.tables.csv_sheets import FULL_CIRCLE

UNDERWATER_M = 1.0  # an antenna so deep receives nothing, and waves are smaller
LONGEST_STILL_S = 5.0  # a receiver that repeats a fix to the last digit for longer has no new one
BEYOND_DEG = "beyond 90 or 360 degrees"
EXCHANGED = "latitude and longitude are probably exchanged"
GRID_M = 100_000.0  # no vehicle goes so far from the origin of its map, and eastings begin at 0.1 to 10 million
MAX_POSITION_M = 2e7  # half around the earth
MAX_POSITION_SD_M = 1e6  # a larger stated sigma means unknown
VARIANCES = ("cov_xx", "cov_yy", "cov_ee_m2", "cov_nn_m2")
IMC_NO_FIXES = (2, 3)  # fixed: dead reckoning, manual input
FIX_2D, FIX_3D = 2, 3  # fixed: types of fixes of MAVLink and ArduPilot; a status of ROS ends at 2, of NMEA 3 is rare
UBX_FIXES = (2, 3, 4)  # fixed: 2D, 3D, with dead reckoning; 5 is the time alone
ROUNDING = 1e-6  # fixed: relative, of numbers that were stored in single precision
MINUTES, SECONDS, TEN_MILLIONTHS = "ddmm.mmmm", "ddmmss.ss", "1e-7deg"  # fixed: notations of latitudes and longitudes
SD_OF_95_PERCENT = 1 / 2.4477  # fixed: a circle of 2.4477 sigma holds 95 % of a round normal distribution


def geodetic(raw: RawRecords) -> tuple[Vector, Vector]:
    """Return latitude and longitude in degrees, (n,) each, of any notation; with N, S, E or W beside, or a sign.

    If they have columns for these letters, values without a letter are NaN.
    """
    lat, lon = raw.number("lat_deg"), raw.number("lon_deg")
    notation = _notation(raw)
    if notation == MINUTES:
        lat, lon = (np.trunc(v / 100) + np.fmod(v, 100) / 60 for v in (lat, lon))
    elif notation == SECONDS:
        lat, lon = (
            np.trunc(v / 1e4) + np.trunc(np.fmod(v, 1e4) / 100) / 60 + np.fmod(v, 100) / 3600 for v in (lat, lon)
        )
    elif notation == TEN_MILLIONTHS:
        lat, lon = lat * 1e-7, lon * 1e-7
    if "lat_side" not in raw.values:
        return lat, lon
    south, west = ([in_hemisphere(1.0, str(side)) for side in raw.text(name)] for name in ("lat_side", "lon_side"))
    return np.abs(lat) * south, np.abs(lon) * west


def _notation(raw: RawRecords) -> str:
    """Return how latitudes and longitudes are written, "" in degrees, if one of them with a letter cannot be that.

    Without letters all must be possible in a notation, and most latitudes beyond what the one before it can state.
    """
    places = np.abs(np.column_stack([raw.number("lat_deg"), raw.number("lon_deg")]))  # (n, 2)
    if "lat_side" in raw.values:
        return SECONDS if np.any(places > [90_00, 180_00]) else MINUTES if np.any(places > [90, 180]) else ""
    places = places[np.isfinite(places).all(axis=1)]
    usual_lat = np.median(places[:, 0]) if len(places) else 0.0
    if usual_lat > 90_00:
        whole = (places <= [90e7, 180e7]) & (places == np.trunc(places))
        seconds = (places <= [90_00_00, 180_00_00]) & (np.fmod(places, 100) <= 60) & (np.fmod(places, 1e4) < 60_00)
        return TEN_MILLIONTHS if whole.all() else SECONDS if seconds.all() else ""
    minutes = (places <= [90_00, 180_00]) & (np.fmod(places, 100) <= 60)  # 59.99999 is written as 60.000
    return MINUTES if usual_lat > FULL_CIRCLE and minutes.all() else ""


def notation_of(raw: RawRecords) -> list[Convention]:
    """Return that angles are degrees and minutes, or 1e-7 degrees, if their values alone tell."""
    notation = "" if "lat_side" in raw.values else _notation(raw)
    return [Convention("unit", notation, "values")] if notation else []


def radian_findings(raw: RawRecords) -> list[Finding]:
    """Report latitudes and longitudes of columns without a unit that may be radians: all are within half a circle."""
    if not raw.layout.by_columns or "lat_side" in raw.values or raw.layout.scale.keys() & {"lat_deg", "lon_deg"}:
        return []
    lat, lon = raw.number("lat_deg"), raw.number("lon_deg")
    known = np.isfinite(lat + lon) & ((lat != 0) | (lon != 0))
    if not known.any() or np.any(np.abs(lat[known]) > np.pi / 2) or np.any(np.abs(lon[known]) > np.pi):
        return []
    text = (
        "latitudes within 1.571 and longitudes within 3.142 are degrees in the Gulf of Guinea, or radians: state the "
        'unit in columns, such as lat_deg = "lat [rad]", lon_deg = "lon [rad]" (or [deg])'
    )
    return [raw.finding("POSITION-RADIANS", text)]


def _pair(raw: RawRecords) -> tuple[Vector, Vector]:
    """Return the two numbers of each place, (n,): latitude and longitude, east and north, or x and y."""
    if "lat_deg" in raw.layout.required:
        return geodetic(raw)
    names = ("east_m", "north_m") if "east_m" in raw.layout.required else ("x", "y")
    return raw.number(names[0]), raw.number(names[1])


def place_causes(raw: RawRecords, frame: str = "") -> dict[str, Mask]:
    """Return by cause which positions (n,) are invalid by themselves; in the frame latlon, x and y are degrees."""
    a, b = _pair(raw)
    latlon = frame == "latlon" or "lat_deg" in raw.layout.required
    quality, status = raw.number("gga_quality"), raw.number("status")
    of_types = raw.topic.is_table and bool(np.any(status == FIX_3D))
    least, why = (FIX_2D, f"2, as {FIX_3D} is a type of fix") if of_types else (0, "0")
    causes = {
        "not a number": ~(np.isfinite(a) & np.isfinite(b)),
        f"without fix (status below {why})": status < least,
        "of negative variance": _negative_variance(raw),
        "estimated, entered by hand or simulated (quality 6, 7 or 8)": np.isin(quality, ESTIMATED_QUALITIES),
        "flagged invalid": raw.flagged_invalid,
    }
    if latlon:
        fix_names = np.char.replace(np.char.lower(raw.text("fix_name")), "gps_fix_type_", "")  # MAVLink's prefix
        by_name = np.char.startswith(fix_names, "no")
        ubx_type, flags = raw.number("ubx_fix_type"), raw.number("ubx_flags")
        by_ubx = ~np.isnan(ubx_type) & (~np.isin(ubx_type, UBX_FIXES) | (flags % 2 == 0))  # the lowest flag: valid
        by_type = (raw.number("fix_type") < FIX_2D) | by_ubx | np.isin(raw.number("imc_fix_type"), IMC_NO_FIXES)
        causes["without fix (by its quality)"] = (raw.number("quality") == 0) | (quality == 0) | by_type | by_name
        causes["at latitude and longitude 0"] = (a == 0) & (b == 0)
        causes[BEYOND_DEG] = (np.abs(a) > 90) | (np.abs(b) > 360)
        return causes
    return causes | off_plane_causes(a, b)


def exchanged_advice(raw: RawRecords, causes: Mapping[str, Mask]) -> str:
    """Return, as the end of a sentence, that latitudes and longitudes, which cannot be, could be if exchanged."""
    beyond = causes.get(BEYOND_DEG, np.zeros(1, np.bool_))
    lat, lon = _pair(raw)
    other_way = (np.abs(lon) <= 90) & (np.abs(lat) <= 360)
    return f"; {EXCHANGED}" if np.mean(beyond & other_way) > 0.5 else ""


def _negative_variance(raw: RawRecords) -> Mask:
    """Return which positions (n,) a negative variance marks as invalid.

    If all records have one, and no type of covariance beside it, it means that the variance is unknown.
    """
    negative: Mask = np.any([raw.number(name) < 0 for name in VARIANCES], axis=0)
    return negative & ((raw.number("covariance_type") > 0) | (not negative.all()))


def on_plane(raw: RawRecords, frame: str, origin: Origin | None) -> tuple[Vector, Vector]:
    """Return east and north, (n,) each, of positions whose frame is ENU, NED or latlon (x latitude, y longitude).

    Raises LogError for latitudes if the plane has no origin.
    """
    x, y = _pair(raw)
    if "east_m" in raw.layout.required:
        return x, y
    if frame != "latlon":
        return (y, x) if frame == "NED" else (x, y)
    if origin is None:
        causes = place_causes(raw, frame)  # if all are invalid, that is the reason
        valid_mask(raw, causes, "position", "left out", exchanged_advice(raw, causes))
        raise raw.fault(
            f"{raw.topic.name} holds latitudes and longitudes, but the plane has no origin; "
            "state origin_lat_deg and origin_lon_deg under [map]"
        )
    return to_plane(origin, x, y)


def grid_findings(raw: RawRecords, east_m: Vector, north_m: Vector) -> list[Finding]:
    """Return a finding if positions on the plane (n,) are so far from its origin that they must count from a grid's."""
    far_m = np.nanmedian(np.hypot(east_m, north_m)) if np.isfinite(east_m + north_m).any() else 0.0
    if far_m < GRID_M:
        return []
    text = (
        f"positions {far_m / 1000:.0f} km from their origin are eastings and northings of a grid: state its code, such "
        'as grid = "EPSG:32631" for UTM zone 31 north; without it, headings are wrong by the angle from true to grid '
        "north, up to some degrees"
    )
    return [raw.finding("GRID-UNKNOWN", text)]


def off_plane_causes(east_m: Vector, north_m: Vector) -> dict[str, Mask]:
    """Return as a cause which places (n,) are beyond half the earth's circumference."""
    return {f"beyond {MAX_POSITION_M / 1000:.0f} km": np.fmax(np.abs(east_m), np.abs(north_m)) > MAX_POSITION_M}


def message_covariance(raw: RawRecords, frame: str) -> Array:
    """Return the covariance of east and north that the records state, (n, 2, 2); NaN if not stated.

    Of a pose in the frame latlon, x is the latitude: its variance is that of north. A matrix that is no covariance
    states none.
    """
    if "sd_m" in raw.values:
        return _round(raw.number("sd_m"))
    if "sd_east_m" in raw.values:
        ee, nn = raw.number("sd_east_m") ** 2, raw.number("sd_north_m") ** 2
        en = np.nan_to_num(raw.number("cov_en_m2"))
    elif "cov_ee_m2" in raw.values:
        ee, en, nn = (raw.number(f"cov_{axes}_m2") for axes in ("ee", "en", "nn"))
    else:
        ee, en, nn = (raw.number(f"cov_{axes}") for axes in ("xx", "xy", "yy"))
        if frame == "NED" or (frame == "latlon" and "lat_deg" not in raw.layout.required):
            ee, nn = nn, ee
    R = np.stack([ee, en, en, nn], axis=-1).reshape(-1, 2, 2)
    least, most = np.fmin(ee, nn), np.fmax(ee, nn)
    known = (least > 0) & (most <= MAX_POSITION_SD_M**2) & np.isfinite(ee + nn + en) & ~indefinite(ee, en, nn)
    unknown = ~known | (raw.number("covariance_type") == 0)
    return np.where(unknown[:, None, None], _round(raw.number("error_95_m") * SD_OF_95_PERCENT), R)


def indefinite(xx: Vector, xy: Vector, yy: Vector) -> Mask:
    """Return which symmetric matrices (n,) of positive variances have a negative eigenvalue, beyond rounding."""
    return (xx > 0) & (yy > 0) & (xy**2 > xx * yy * (1 + ROUNDING))


def _round(sd_m: Vector) -> Array:
    """Return covariances without a direction, (n, 2, 2); NaN unless 0 < sd_m <= MAX_POSITION_SD_M."""
    known = (sd_m > 0) & (sd_m <= MAX_POSITION_SD_M)
    return np.eye(2) * np.where(known, sd_m, np.nan)[:, None, None] ** 2


def heading_of_quaternion(xyzw: Array, frame: str) -> Vector:
    """Return headings (n,) in degrees of quaternions (n, 4) that turn x to the bow: from east in ENU, north in NED."""
    x, y, z, w = xyzw.T
    yaw_deg = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2)))
    heading_deg: Vector = np.mod(yaw_deg if frame == "NED" else 90.0 - yaw_deg, 360.0)
    return heading_deg


def pose_columns(raw: RawRecords, frame: str) -> dict[str, Vector]:
    """Return heading_deg, of poses unless all are the same, and starboard_mps and forward_mps of odometry, (n,) each.

    The axes of the vehicle are forward, left, up in ENU, and forward, starboard, down in NED (REP 103).
    """
    if "heading_deg" in raw.values:
        return {"heading_deg": raw.number("heading_deg")}
    if frame == "latlon" or "qw" not in raw.values:
        return {}
    heading_deg = heading_of_quaternion(np.column_stack([raw.number(f"q{axis}") for axis in "xyzw"]), frame)
    if not np.ptp(heading_deg) > 0:
        return {}
    if "vx" not in raw.values:
        return {"heading_deg": heading_deg}
    starboard_mps = raw.number("vy") if frame == "NED" else -raw.number("vy")
    return {"heading_deg": heading_deg, "starboard_mps": starboard_mps, "forward_mps": raw.number("vx")}


def gps(raw: RawRecords, section: GpsSection, origin: Origin | None) -> ConvertedTable:
    """Turn GPS fixes, or another reference's positions, to east and north; fixes without validity are left out."""
    latlon = "lat_deg" in raw.layout.required
    by_name = "NED" if named_ned(raw.frame_id) else "ENU"
    frame, frame_chosen, findings = chosen_convention(raw, "frame", section.frame, by_name)
    if latlon != (frame == "latlon") and latlon:
        raise SettingError(f'frame = "{frame}": {raw.topic.name} holds latitudes and longitudes')
    causes = place_causes(raw, frame)
    good, invalid = valid_mask(raw, causes, "gps", "left out", exchanged_advice(raw, causes))
    east, north = on_plane(raw, frame, origin)
    covariance = message_covariance(raw, frame)
    sd = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
    sd_chosen = Convention("sd_m", "unknown", "records")
    if isinstance(section.sd_m, float):
        sd, sd_chosen = np.full(len(sd), section.sd_m), Convention("sd_m", section.sd_m, "configuration", "m")
    elif np.isfinite(sd).any():
        sd_chosen = Convention("sd_m", float(np.nanmedian(sd)), "records", "m", "median")
    lat, lon = geodetic(raw)
    if origin is not None and not np.isfinite(lat).any():
        lat, lon = to_geodetic(origin, east, north)
    columns = {"east_m": east, "north_m": north, "sd_m": sd, "lat_deg": lat, "lon_deg": lon}
    columns |= {"cov_ee_m2": covariance[:, 0, 0], "cov_en_m2": covariance[:, 0, 1], "cov_nn_m2": covariance[:, 1, 1]}
    columns |= pose_columns(raw, str(frame))
    times = times_of(raw, section.time, section.latency_s)
    chosen = [frame_chosen, *(notation_of(raw) if latlon else ()), sd_chosen]
    places = radian_findings(raw) if latlon else [] if frame == "latlon" else grid_findings(raw, east, north)
    made = converted_table(times, columns, chosen, [*findings, *invalid, *places])
    return replace(made.only(good), geodetic=frame == "latlon")
