"""What only the messages of a log tell, beside its tables: raw numbers, gravity, names of frames, the fixes' depth."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from usbldr.filters.types import Vector
from usbldr.io.axes import named_enu, named_ned
from usbldr.io.conventions.positions import UNDERWATER_M
from usbldr.io.doctor.interpretations import HandednessEvidence, recorded_convention
from usbldr.io.log import Log
from usbldr.io.messages.layouts import RawRecords, raw_records
from usbldr.io.opening import OpenedLog, Request
from usbldr.io.read import roles_of, wanted_fields

GRAVITY_FIELD = "linear_acceleration.z"


def read_raw_records(opened: OpenedLog, request: Request) -> dict[str, RawRecords]:
    """Read the chosen topics as their messages have them, with gravity where an Imu tells it."""
    reader = opened.reader
    topics = reader.topics()
    choices = roles_of(reader.path, topics, request, opened.configuration).chosen
    wanted = wanted_fields(choices)
    imu = choices["compass"].topic if "compass" in choices else None
    if imu is not None and imu.has(GRAVITY_FIELD):
        wanted[imu.name].append(GRAVITY_FIELD)
    records = reader.read(wanted)
    made = {role: raw_records(reader.path, c.topic, c.layout, records[c.topic.name]) for role, c in choices.items()}
    if imu is not None and imu.has(GRAVITY_FIELD):
        gravity = {GRAVITY_FIELD: records[imu.name].columns[GRAVITY_FIELD]}
        made["compass"] = replace(made["compass"], values=dict(made["compass"].values) | gravity)
    return made


def message_evidence(log: Log, raws: Mapping[str, RawRecords]) -> list[HandednessEvidence]:
    """Return what only the messages tell of the mirror image: types, gravity, the fixes' depth, names of frames.

    A modem that tells east and north may well tell a depth beside them: only where no type settles the frame is the
    sign of z, or the name of the frame, a word about it.
    """
    fixes, frame = raws.get("usbl"), recorded_convention(log, "usbl", "frame")[0]
    if fixes is None or frame not in ("ENU", "NED"):
        return _gravity(log, raws)
    if settled := fixes.layout.defaults.get("frame"):
        return [HandednessEvidence(f"the fixes are {settled} by their type", 2, frame != settled), *_gravity(log, raws)]
    found = _gravity(log, raws)
    z = _median(fixes.number("z"))
    depth_m = float(np.median(log.tables["depth"]["depth_m"])) if "depth" in log.tables else 0.0
    if depth_m > UNDERWATER_M and abs(abs(z) - depth_m) < 0.5 * depth_m:
        says, which = ("NED", "down") if z > 0 else ("ENU", "up")
        found.append(HandednessEvidence(f"depth: the fixes have z {which}", 2, frame != says))
    for says, named in (("ENU", named_enu), ("NED", named_ned)):
        if named(fixes.frame_id):
            found.append(HandednessEvidence(f'frame_id "{fixes.frame_id}"', 2, frame != says))
    return found


def _gravity(log: Log, raws: Mapping[str, RawRecords]) -> list[HandednessEvidence]:
    if "compass" not in raws or GRAVITY_FIELD not in raws["compass"].values:
        return []
    z = _median(raws["compass"].number(GRAVITY_FIELD))
    if not abs(z) > 5.0:
        return []
    says, which = ("NED", "down") if z < 0 else ("ENU", "up")
    name = f"gravity: {raws['compass'].topic.name} has z {which} ({z:+.1f} m/s^2 at rest)"
    return [HandednessEvidence(name, 1, recorded_convention(log, "compass", "convention")[0] != says)]


def _median(values: Vector) -> float:
    """Return the median of the known values, 0 where none is known."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
