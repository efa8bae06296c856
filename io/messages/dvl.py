"""What makes records of a Doppler velocity log invalid, and what their unit may be."""

import numpy as np

from usbldr.filters.types import Mask, Vector
from usbldr.io.messages.layouts import RawRecords
from usbldr.io.units import MPS_PER_UNIT

BEAM, EARTH = 0, 3  # of coordinate_mode
BOTTOM, WATER = 1, 2  # of velocity_mode and velocity_reference
MAX_SPEED_MPS = 20.0  # [m/s] no vehicle with a DVL, and no ship above it, goes so fast
USUAL_SPEED_MPS = 1.0  # [m/s] of a vehicle, within a factor three, by which units a factor ten apart are distinguished
TOO_FAST = f"faster than {MAX_SPEED_MPS:g} m/s"
FAST_SHARE = 0.1  # of records too fast, from which on a unit that nobody stated is wrong
FAST_SHARE_NAMED = 0.5  # the same of a unit that the names of columns state
NO_COORDINATES = "; velocities along beams or in earth axes cannot be used: record instrument or ship coordinates"


def dvl_causes(
    raw: RawRecords, speed_mps: Vector, least_beams: int | None, through_water: bool = False
) -> dict[str, Mask]:
    """Return by cause which DVL records (n,) are invalid, according to their message type.

    ``speed_mps`` = |v|; ``least_beams`` None: three if any record states its good beams; ``through_water``: bottom
    track is invalid instead of water track.
    """
    x, y, z = (raw.number(axis) for axis in "xyz")
    causes = {"not a number": ~(np.isfinite(x) & np.isfinite(y))}
    if "velocity_valid" in raw.values:
        causes["flagged invalid"] = (raw.number("velocity_valid") == 0) | (raw.number("y_valid") == 0)
    elif "status" in raw.values:
        causes["without status A"] = np.char.upper(raw.text("status")) != "A"
    else:
        causes["exactly zero"] = (x == 0) & (y == 0) & ((z == 0) | np.isnan(z))
    causes["over no interval"] = ~(raw.number("interval_us") > 0) & ("interval_us" in raw.values)
    causes["with a confidence of 0"] = raw.number("confidence") == 0
    causes["in beam coordinates"] = raw.number("coordinates") == BEAM
    causes["in earth coordinates"] = raw.number("coordinates") == EARTH
    beams = raw.number("good_beams")
    if least_beams is not None or np.any(beams > 0):
        least = 3 if least_beams is None else least_beams
        causes[f"fewer than {least} good beams"] = beams < least
    unwanted, mode = ("bottom track", BOTTOM) if through_water else ("water track", WATER)
    causes[unwanted] = raw.number("mode") == mode
    beams_valid = raw.number("beams_valid")
    if np.any(beams_valid == 1):
        causes["beam velocities flagged invalid"] = beams_valid == 0
    causes["negative covariance"] = raw.number("own_covariance") < 0
    causes[TOO_FAST] = speed_mps > MAX_SPEED_MPS
    return causes


def inverse_interval(raw: RawRecords) -> Vector:
    """Return the inverse of the interval in which each distance was travelled, 1/s, (n,); 1 for velocities."""
    if "interval_us" not in raw.values:
        return np.ones(len(raw.received_ns))
    interval_us = raw.number("interval_us")
    return 1e6 / np.where(interval_us > 0, interval_us, np.nan)


def in_other_unit(raw: RawRecords, causes: dict[str, Mask], least_share: float) -> bool:
    """Return whether too many records for m/s exceed 20 m/s: this share of those without another fault.

    One constant velocity does not count; a DVL without bottom lock writes such.
    """
    others = [mask for cause, mask in causes.items() if cause != TOO_FAST]
    known = ~np.any(others, axis=0)
    fast = known & causes[TOO_FAST]
    _, counts = np.unique(np.column_stack([raw.number("x"), raw.number("y")])[fast], axis=0, return_counts=True)
    often = np.sum(fast) >= max(3, least_share * np.sum(known))
    return bool(often and counts.max() <= np.sum(fast) / 2)


def usual_unit(speed_mps: Vector) -> str:
    """Return the unit in which too high speeds, (n,), would be those of a vehicle."""
    middle = max(float(np.median(speed_mps)), MAX_SPEED_MPS) if len(speed_mps) else MAX_SPEED_MPS
    return min(MPS_PER_UNIT, key=lambda unit: abs(np.log(middle * MPS_PER_UNIT[unit] / USUAL_SPEED_MPS)))


def dvl_advice(causes: dict[str, Mask], unit: str, columns: str) -> str:
    """Return the advice if no record is valid, as the end of a sentence; empty if there is none.

    ``unit``: the one that would explain too high speeds, empty if it is stated; ``columns``: what to state with it.
    """
    if np.mean(causes.get("water track", 0)) > 0.5:
        return '; to use velocities through the water and to estimate the current, state track = "water" under [dvl]'
    if any(np.any(causes[f"in {where} coordinates"]) for where in ("beam", "earth")):
        return NO_COORDINATES
    fast = np.mean(causes[TOO_FAST]) > 0.5 and unit
    return f'; if they are in {unit}, state {columns}unit = "{unit}" under [dvl]' if fast else ""
