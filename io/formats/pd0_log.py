"""PD0 files of Teledyne RDI's instruments: ensembles of a header, leaders and data, each with a checksum.

Sources: the PD0 output format of Teledyne's manuals (Pathfinder DVL Guide, tables 32 to 41), Teledyne's ADCP Coordinate
Transformation for velocities along beams, and WinRiver's blocks of GGA sentences.
"""

import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import cached_property
from mmap import mmap
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usbldr.io.findings import Finding
from usbldr.io.formats.files import mapped
from usbldr.io.reader import Column, Nanoseconds, Records, TopicInfo

MARK = b"\x7f\x7f"  # fixed by the format: how each ensemble begins
HEAD_BYTES, CHECKSUM_BYTES = 6, 2  # fixed by the format
FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK, NMEA = 0x0000, 0x0080, 0x0600, 0x2022  # fixed: kinds of data
LEAST_BYTES: Mapping[int, int] = {FIXED_LEADER: 26, VARIABLE_LEADER: 20, BOTTOM_TRACK: 32}  # fixed: up to what is used
NO_VELOCITY = -32768  # fixed by the format
BEAM, INSTRUMENT = 0, 1  # fixed: codes of coordinates; 2 are a ship's, 3 the earth's
ANGLES_DEG: Mapping[int, float] = {0: 15.0, 1: 20.0, 2: 30.0}  # fixed: of the beams from the axis, by their code
ANGLE_AT = 58  # fixed: the place of any other angle in the fixed leader, degrees
GGA = struct.Struct(
    "<HHHd7s10sdcdcB"
)  # kind, 104, size, age [s] at the ensemble, name, time, latitude, longitude, quality
GGA_BLOCK = 104  # fixed by WinRiver
CENTURY = 80  # [years] of two digits below it are after 2000
TYPES: Mapping[str, tuple[str, ...]] = {
    "/bottom_track": ("x", "y", "z", "coordinates"),
    "/heading": ("heading_deg",),
    "/depth": ("depth_m",),
    "/gga": ("latitude", "longitude", "quality"),
}


class Ensemble(NamedTuple):
    """What is used of an ensemble."""

    time_ns: int
    velocity_mmps: tuple[int, int, int, int]  # of the bottom, along beams or axes
    coordinates: int
    beam_deg: float
    convex: bool
    heading_deg: float
    depth_m: float


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
    def _data(self) -> mmap:
        return mapped(self.path)

    @cached_property
    def _tables(self) -> Mapping[str, Records]:
        """Return the records of all topics that the file has; record what was lost."""
        data, at, lost, first_lost = self._data, 0, 0, -1
        ensembles: list[Ensemble] = []
        fixes: list[tuple[int, float, float, int]] = []
        unused = 0
        while at < len(data):
            size = self._size(at)
            if size:
                parts = _parts(data[at : at + size])
                ensemble = _ensemble(parts)
                if ensemble is None:
                    unused += 1
                else:
                    ensembles.append(ensemble)
                    fixes += _fixes(parts.get(NMEA, []), ensemble.time_ns)
                at += size + CHECKSUM_BYTES
                continue
            following = self._next(at + 1)
            first_lost, lost = (at if first_lost < 0 else first_lost), lost + following - at
            at = following
        if lost:
            text = f"{lost} of {len(data)} bytes, from byte {first_lost} on, are damaged or cut"
            self._findings.append(Finding("DAMAGED", f"{text}; their ensembles are missing", lost_data=True))
        if unused:
            text = f"{unused} ensembles have no leader, no bottom track or no valid time; left out"
            self._findings.append(Finding("UNDECODED", text))
        return _records(ensembles, fixes)

    def _size(self, at: int) -> int:
        """Return the size of the ensemble at a byte without its checksum, 0 if there is no whole one."""
        data = self._data
        head = data[at : at + HEAD_BYTES]
        size = int.from_bytes(head[2:4], "little")
        end = at + size
        if len(head) < HEAD_BYTES or head[:2] != MARK or size < HEAD_BYTES or end + CHECKSUM_BYTES > len(data):
            return 0
        total = int(np.frombuffer(data[at:end], np.uint8).sum(dtype=np.uint32)) & 0xFFFF
        return size if total == int.from_bytes(data[end : end + CHECKSUM_BYTES], "little") else 0

    def _next(self, at: int) -> int:
        """Return the first byte from which an ensemble follows, else the end of the file."""
        while (at := self._data.find(MARK, at)) >= 0:
            if self._size(at):
                return at
            at += 1
        return len(self._data)

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics: bottom track, heading and depth if they are not constant, and GGA sentences."""
        return tuple(
            TopicInfo(
                name,
                f"pd0/pd0_{name[1:]}",
                "pd0",
                len(records.received_ns),
                int(records.received_ns[0]),
                int(records.received_ns[-1]),
                TYPES[name],
            )
            for name, records in self._tables.items()
        )

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
    for start, end in zip(starts, [*starts[1:], len(ensemble)], strict=True):
        part = ensemble[start:end]
        found.setdefault(int.from_bytes(part[:2], "little"), []).append(part)
    return found


def _ensemble(parts: Mapping[int, Sequence[bytes]]) -> Ensemble | None:
    """Return what is used of an ensemble, None without bottom track, leaders or a valid time."""
    if any(kind not in parts or len(parts[kind][0]) < least for kind, least in LEAST_BYTES.items()):
        return None
    (fixed, *_), (leader, *_), (bottom, *_) = (parts[kind] for kind in (FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK))
    year, month, day, hour, minute, second, hundredths = leader[4:11]
    try:
        moment = datetime(year + (2000 if year < CENTURY else 1900), month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    whole_s = (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    code = fixed[5] & 3
    other_deg = float(fixed[ANGLE_AT]) if len(fixed) > ANGLE_AT else float("nan")
    one, two, three, four = struct.unpack_from("<4h", bottom, 24)
    depth_dm, heading_cdeg = struct.unpack_from("<HH", leader, 16)
    return Ensemble(
        time_ns=(whole_s * 100 + hundredths) * 10_000_000,
        velocity_mmps=(one, two, three, four),
        coordinates=fixed[25] >> 3 & 3,
        beam_deg=ANGLES_DEG.get(code, other_deg),
        convex=bool(fixed[4] & 8),
        heading_deg=heading_cdeg / 100,
        depth_m=depth_dm / 10,
    )


def _fixes(blocks: Sequence[bytes], time_ns: int) -> list[tuple[int, float, float, int]]:
    """Return log time, latitude, longitude and quality of WinRiver's GGA sentences.

    A block states how long before the ensemble it arrived; so fixes and velocities are timed by one clock.
    """
    found: list[tuple[int, float, float, int]] = []
    for block in blocks:
        if len(block) < GGA.size or int.from_bytes(block[2:4], "little") != GGA_BLOCK:
            continue
        _, _, _, age_s, _, _, lat, south, lon, west, quality = GGA.unpack_from(block)
        if not abs(age_s) < 60:  # also NaN; an ensemble takes seconds at most
            continue
        signs = (-1 if south == b"S" else 1), (-1 if west == b"W" else 1)
        found.append((time_ns - round(age_s * 1e9), signs[0] * lat, signs[1] * lon, quality))
    return found


def _records(ensembles: Sequence[Ensemble], fixes: Sequence[tuple[int, float, float, int]]) -> dict[str, Records]:
    found: dict[str, Records] = {}
    if ensembles:
        times = np.array([ensemble.time_ns for ensemble in ensembles], dtype=np.int64)
        velocities, coordinates = instrument_velocities(ensembles)
        x, y, z = velocities.T
        found["/bottom_track"] = _sorted(times, {"x": x, "y": y, "z": z, "coordinates": coordinates})
        heading, depth = (np.array([getattr(e, name) for e in ensembles]) for name in ("heading_deg", "depth_m"))
        if np.ptp(heading) > 0:
            found["/heading"] = _sorted(times, {"heading_deg": heading})
        if np.ptp(depth) > 0:
            found["/depth"] = _sorted(times, {"depth_m": depth})
    if fixes:
        times, lat, lon, quality = (np.array(column) for column in zip(*fixes, strict=True))
        found["/gga"] = _sorted(times, {"latitude": lat, "longitude": lon, "quality": quality})
    return found


def _sorted(times: Nanoseconds, columns: Mapping[str, Column]) -> Records:
    order = np.argsort(times, kind="stable")
    return Records(times[order], {name: column[order] for name, column in columns.items()})


def instrument_velocities(ensembles: Sequence[Ensemble]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the velocities of the bottom in m/s, (n, 3), NaN if unknown, and their coordinates, (n,).

    Those along beams become those along the axes of the instrument: beams 1 and 2 lie in x, 4 and 3 in y.
    """
    raw = np.array([ensemble.velocity_mmps for ensemble in ensembles], dtype=np.float64)
    raw = np.where(raw == NO_VELOCITY, np.nan, raw) / 1000
    coordinates = np.array([ensemble.coordinates for ensemble in ensembles])
    angle = np.radians([ensemble.beam_deg for ensemble in ensembles])
    sign = np.where([ensemble.convex for ensemble in ensembles], 1.0, -1.0)
    one, two, three, four = raw.T
    x, y = (sign * (a - b) / (2 * np.sin(angle)) for a, b in ((one, two), (four, three)))
    along = np.stack([x, y, (one + two + three + four) / (4 * np.cos(angle))], axis=1)
    beams = coordinates == BEAM
    return np.where(beams[:, None], along, raw[:, :3]), np.where(beams, INSTRUMENT, coordinates)
