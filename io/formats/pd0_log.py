"""PD0 files of Teledyne RDI's instruments: ensembles of a header, leaders and data.

Sources: the PD0 output format of Teledyne's manuals (Pathfinder DVL Guide, tables 32 to 41), and Teledyne's ADCP
Coordinate Transformation for velocities along beams.
"""

import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.io.findings import Finding
from usbldr.io.formats.ensembles import ensembles, in_order, topics_of
from usbldr.io.formats.pd0_positions import NAVIGATION, NMEA, vmdas_fixes, winriver_fixes
from usbldr.io.reader import Records, TopicInfo

MARK = b"\x7f\x7f"  # fixed by the format: how each ensemble begins
HEAD_BYTES = 6  # fixed by the format: mark, size, number of data
FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK = 0x0000, 0x0080, 0x0600  # fixed: kinds of data
LEAST_BYTES: Mapping[int, int] = {FIXED_LEADER: 26, VARIABLE_LEADER: 20, BOTTOM_TRACK: 32}  # fixed: up to what is used
NO_VELOCITY = -32768  # fixed by the format
BEAM, INSTRUMENT = 0, 1  # fixed: codes of coordinates; 2 are a ship's, 3 the earth's
ANGLES_DEG: Mapping[int, float] = {0: 15.0, 1: 20.0, 2: 30.0}  # fixed: of the beams from the axis, by their code
ANGLE_AT = 58  # fixed: the place of any other angle in the fixed leader, degrees
CENTURY = 80  # [years] of two digits below it are after 2000
FIELDS: Mapping[str, tuple[str, ...]] = {
    "/bottom_track": ("x", "y", "z", "coordinates"),
    "/heading": ("heading_deg",),
    "/depth": ("depth_m",),
    "/gga": ("latitude", "longitude", "quality"),
    "/navigation": ("header.stamp", "latitude", "longitude", "valid"),
}


class BottomTrack(NamedTuple):
    """What is used of the bottom track of an ensemble."""

    velocity_mmps: tuple[int, int, int, int]  # of the bottom, along beams or axes
    coordinates: int
    beam_deg: float
    convex: bool


class Ensemble(NamedTuple):
    """What is used of an ensemble."""

    time_ns: int
    heading_deg: float
    depth_m: float
    track: BottomTrack | None


def looks_like_pd0(head: bytes) -> bool:
    """Return whether a file begins with an ensemble."""
    return head.startswith(MARK)


class Pd0Log:
    """A PD0 file."""

    format = "PD0"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._findings: list[Finding] = []

    @cached_property
    def _tables(self) -> Mapping[str, Records]:
        """Return the records of all topics that the file has; record what was lost."""
        found: list[Ensemble] = []
        places: dict[str, list[Sequence[float]]] = {"/gga": [], "/navigation": []}
        unused = 0
        for whole in ensembles(self.path, [MARK], self._findings):
            parts = _parts(whole)
            ensemble = _ensemble(parts)
            if ensemble is None:
                unused += 1
                continue
            found.append(ensemble)
            places["/gga"] += winriver_fixes(parts.get(NMEA, []), ensemble.time_ns)
            places["/navigation"] += vmdas_fixes(parts.get(NAVIGATION, []), ensemble.time_ns)
        if unused:
            text = f"{unused} ensembles have no leader or no valid time; left out"
            self._findings.append(Finding("UNDECODED", text))
        return _records(found) | {name: _placed(name, rows) for name, rows in places.items() if rows}

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics: bottom track, heading and depth if they are not constant, and positions."""
        return tuple(topics_of("pd0", FIELDS, self._tables))

    def read(self, wanted: Mapping[str, Sequence[str]]) -> Mapping[str, Records]:
        """Return the wanted columns."""
        return {topic: self._tables[topic].only(paths) for topic, paths in wanted.items()}

    def findings(self) -> tuple[Finding, ...]:
        """Report what is missing from the file."""
        _ = self._tables
        return tuple(self._findings)


def _parts(ensemble: bytes) -> dict[int, list[bytes]]:
    """Return the data of an ensemble by their kind, each with the number of its kind."""
    count = ensemble[5]
    starts = [int.from_bytes(ensemble[at : at + 2], "little") for at in range(HEAD_BYTES, HEAD_BYTES + 2 * count, 2)]
    found: dict[int, list[bytes]] = {}
    for start, end in zip(starts, [*starts[1:], len(ensemble)], strict=False):
        part = ensemble[start:end]
        found.setdefault(int.from_bytes(part[:2], "little"), []).append(part)
    return found


def _ensemble(parts: Mapping[int, Sequence[bytes]]) -> Ensemble | None:
    """Return what is used of an ensemble, None without leaders or a valid time."""
    fixed, leader, bottom = (_part(parts, kind) for kind in (FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK))
    if not fixed or not leader:
        return None
    year, month, day, hour, minute, second, hundredths = leader[4:11]
    try:
        moment = datetime(year + (2000 if year < CENTURY else 1900), month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    whole_s = (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    depth_dm, heading_cdeg = struct.unpack_from("<HH", leader, 16)
    return Ensemble(
        time_ns=(whole_s * 100 + hundredths) * 10_000_000,
        heading_deg=heading_cdeg / 100,
        depth_m=depth_dm / 10,
        track=_track(fixed, bottom) if bottom else None,
    )


def _part(parts: Mapping[int, Sequence[bytes]], kind: int) -> bytes:
    """Return the first data of a kind, empty if there are none or too few bytes."""
    part = parts.get(kind, (b"",))[0]
    return part if len(part) >= LEAST_BYTES[kind] else b""


def _track(fixed: bytes, bottom: bytes) -> BottomTrack:
    other_deg = float(fixed[ANGLE_AT]) if len(fixed) > ANGLE_AT else float("nan")
    one, two, three, four = struct.unpack_from("<4h", bottom, 24)
    return BottomTrack(
        velocity_mmps=(one, two, three, four),
        coordinates=fixed[25] >> 3 & 3,
        beam_deg=ANGLES_DEG.get(fixed[5] & 3, other_deg),
        convex=bool(fixed[4] & 8),
    )


def _records(found: Sequence[Ensemble]) -> dict[str, Records]:
    tables: dict[str, Records] = {}
    tracks = [(ensemble.time_ns, ensemble.track) for ensemble in found if ensemble.track]
    if tracks:
        velocities, coordinates = instrument_velocities([track for _, track in tracks])
        x, y, z = velocities.T
        columns = {"x": x, "y": y, "z": z, "coordinates": coordinates}
        tables["/bottom_track"] = in_order(np.array([time_ns for time_ns, _ in tracks]), columns)
    times = np.array([ensemble.time_ns for ensemble in found], dtype=np.int64)
    for topic, column in (("/heading", "heading_deg"), ("/depth", "depth_m")):
        values = np.array([getattr(ensemble, column) for ensemble in found])
        if len(values) and np.ptp(values) > 0:
            tables[topic] = in_order(times, {column: values})
    return tables


def _placed(topic: str, rows: Sequence[Sequence[float]]) -> Records:
    """Return positions, each a log time and the columns of the topic."""
    times, *columns = (np.array(column) for column in zip(*rows, strict=True))
    return in_order(times, dict(zip(FIELDS[topic], columns, strict=True)))


def instrument_velocities(tracks: Sequence[BottomTrack]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the velocities of the bottom in m/s, (n, 3), NaN if unknown, and their coordinates, (n,).

    Those along beams become those along the axes of the instrument: beams 1 and 2 lie in x, 4 and 3 in y.
    """
    raw = np.array([track.velocity_mmps for track in tracks], dtype=np.float64)
    raw = np.where(raw == NO_VELOCITY, np.nan, raw) / 1000
    coordinates = np.array([track.coordinates for track in tracks])
    angle = np.radians([track.beam_deg for track in tracks])
    sign = np.where([track.convex for track in tracks], 1.0, -1.0)
    one, two, three, four = raw.T
    x, y = (sign * (a - b) / (2 * np.sin(angle)) for a, b in ((one, two), (four, three)))
    along = np.stack([x, y, (one + two + three + four) / (4 * np.cos(angle))], axis=1)
    beams = coordinates == BEAM
    return np.where(beams[:, None], along, raw[:, :3]), np.where(beams, INSTRUMENT, coordinates)
