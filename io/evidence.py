"""What only the messages of a log tell, beside its tables: raw numbers, gravity, names of frames, the fixes' depth."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from usbldr.filters.types import Vector
from usbldr.io.log import Log
from usbldr.io.messages import Raw, raw, wanted_paths
from usbldr.io.opening import Opened, Request
from usbldr.io.positions import UNDERWATER_M
from usbldr.io.read import roles_of
from usbldr.io.readings import Source, convention
from usbldr.io.topics import Choice

GRAVITY = "linear_acceleration.z"


def raws_of(opened: Opened, request: Request) -> dict[str, Raw]:
    """Read the chosen topics as their messages have them, with gravity where an Imu tells it."""
    reader = opened.reader
    topics = reader.topics()
    choices = roles_of(reader.path, topics, request, opened.configuration).chosen
    wanted: dict[str, list[str]] = {}
    for choice in choices.values():
        paths = wanted.setdefault(choice.topic.name, [])
        paths += [path for path in wanted_paths(choice.topic, choice.layout).values() if path not in paths]
    gravity = _with_gravity(choices)
    for name in gravity:
        wanted[name].append(GRAVITY)
    records = reader.read(wanted)
    made: dict[str, Raw] = {}
    for role, choice in choices.items():
        rows = records[choice.topic.name]
        one = raw(reader.path, choice.topic, choice.layout, rows)
        extra = {GRAVITY: rows.columns[GRAVITY]} if role == "compass" and choice.topic.name in gravity else {}
        made[role] = replace(one, values=dict(one.values) | extra)
    return made


def _with_gravity(choices: Mapping[str, Choice]) -> list[str]:
    topics = [choice.topic for role, choice in choices.items() if role == "compass"]
    return [topic.name for topic in topics if topic.has(GRAVITY) or "linear_acceleration" in topic.fields]


def sources_of(log: Log, raws: Mapping[str, Raw]) -> list[Source]:
    """Return what only the messages tell of the mirror image: gravity, the fixes' depth, names of frames."""
    found: list[Source] = []
    if "compass" in raws and GRAVITY in raws["compass"].values:
        z = _median(raws["compass"].number(GRAVITY))
        if abs(z) > 5.0:
            says, which = ("NED", "down") if z < 0 else ("ENU", "up")
            name = f"gravity: {raws['compass'].topic.name} has z {which} ({z:+.1f} m/s^2 at rest)"
            found.append(Source(name, 1, convention(log, "compass", "convention")[0] != says))
    frame = convention(log, "usbl", "frame")[0]
    if "usbl" in raws and frame in ("ENU", "NED"):
        z = _median(raws["usbl"].number("z"))
        depth_m = float(np.median(log.tables["depth"]["depth_m"])) if "depth" in log.tables else 0.0
        if depth_m > UNDERWATER_M and abs(abs(z) - depth_m) < 0.5 * depth_m:
            says, which = ("NED", "down") if z > 0 else ("ENU", "up")
            found.append(Source(f"depth: the fixes have z {which}", 2, frame != says))
        named = [says for says in ("ENU", "NED") if says.lower() in raws["usbl"].frame_id.lower()]
        found += [Source(f'frame_id "{raws["usbl"].frame_id}"', 2, frame != says) for says in named]
    return found


def _median(values: Vector) -> float:
    """Return the median of the known values, 0 where none is known."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
