"""Evidence of handedness in the messages, not in the tables: types, gravity, frame names, the fixes' depth."""

import numpy as np

from usbldr.filters.types import Vector
from usbldr.io.axes import named_enu, named_ned
from usbldr.io.conventions.positions import UNDERWATER_M
from usbldr.io.doctor.interpretations import HandednessEvidence, recorded_value
from usbldr.io.doctor.thresholds import THRESHOLDS
from usbldr.io.log import Log

GRAVITY_FIELD = "linear_acceleration.z"  # of an Imu
RAW_FIELDS = {"compass": (GRAVITY_FIELD,)}
"""Fields to read in addition to those of the tables."""


def message_evidence(log: Log) -> list[HandednessEvidence]:
    """Return the messages' evidence on the mirror image: types, gravity, the fixes' depth, names of frames.

    A type that defines east and north may hold a depth as z, so z and the name of the frame count only without one.
    """
    fixes, frame = log.raws.get("usbl"), recorded_value(log, "usbl", "frame")
    if fixes is None or frame not in ("ENU", "NED"):
        return _gravity(log)
    if by_type := fixes.layout.defaults.get("frame"):
        return [HandednessEvidence(f"the fixes are {by_type} by their type", 2, frame != by_type), *_gravity(log)]
    found = _gravity(log)
    z = _median(fixes.number("z"))
    depth_m = float(np.median(log.tables["depth"]["depth_m"])) if "depth" in log.tables else 0.0
    if depth_m > UNDERWATER_M and abs(abs(z) - depth_m) < THRESHOLDS.fix_depth_tolerance * depth_m:
        implied, which = ("NED", "down") if z > 0 else ("ENU", "up")
        found.append(HandednessEvidence(f"depth: the fixes have z {which}", 2, frame != implied))
    for implied, named in (("ENU", named_enu), ("NED", named_ned)):
        if named(fixes.frame_id):
            found.append(HandednessEvidence(f'frame_id "{fixes.frame_id}"', 2, frame != implied))
    return found


def _gravity(log: Log) -> list[HandednessEvidence]:
    heading = log.raws.get("compass")
    z = _median(heading.number(GRAVITY_FIELD)) if heading else 0.0
    if heading is None or not abs(z) > THRESHOLDS.min_gravity_mps2:
        return []
    implied, which = ("NED", "down") if z < 0 else ("ENU", "up")
    name = f"gravity: {heading.topic.name} has z {which} ({z:+.1f} m/s^2 at rest)"
    return [HandednessEvidence(name, 1, recorded_value(log, "compass", "convention") != implied)]


def _median(values: Vector) -> float:
    """Return the median of the known values, 0 if none is known."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
