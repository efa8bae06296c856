"""PD0 files of Teledyne RDI's instruments: ensembles of a header, leaders and data, and positions beside them.

Sources: the PD0 output format of Teledyne's manuals (Pathfinder DVL Guide, tables 32 to 41), and Teledyne's ADCP
Coordinate Transformation for velocities along beams; WinRiver's blocks of GGA sentences, and VmDas' block of navigation
(VmDas User's Guide, binary navigation data format).
"""

import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from usbldr.io.decoding.nmea_kinds import in_hemisphere
from usbldr.io.findings import Finding
from usbldr.io.instruments.ensembles import ensembles, first_ensemble
from usbldr.io.instruments.records_log import RecordsLog, log_in_memory
from usbldr.io.reader import MAX_TIME_NS, Nanoseconds, Records

MARK = b"\x7f\x7f"  # fixed by the format: how each ensemble begins
HEAD_BYTES = 6  # fixed by the format: mark, size, number of data
FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK = 0x0000, 0x0080, 0x0600  # fixed: kinds of data
LEAST_BYTES: Mapping[int, int] = {FIXED_LEADER: 26, VARIABLE_LEADER: 20, BOTTOM_TRACK: 32}  # fixed: up to what is used
NO_VELOCITY = -32768  # fixed by the format
BEAM, INSTRUMENT = 0, 1  # fixed: codes of coordinates; 2 are a ship's, 3 the earth's
ANGLES_DEG = (15.0, 20.0, 30.0)  # fixed: of the beams from the axis, by their code
ANGLE_AT = 58  # fixed: the place of any other angle in the fixed leader, degrees
HUNDREDTH_NS = 10_000_000  # fixed
CENTURY = 80  # [years] of two digits below it are after 2000
NMEA, NAVIGATION = 0x2022, 0x2000  # fixed: kinds of data
GGA = struct.Struct(
    "<HHHd7s10sdcdcB"
)  # kind, 104, size, age [s] at the ensemble, name, time, latitude, longitude, quality
GGA_BLOCK = 104  # fixed by WinRiver
PLACES = struct.Struct(
    "<HBBHI12xIii12xH"
)  # kind, day, month, year, first fix, last fix, its latitude and longitude, flags
TICK_NS = 100_000  # fixed by VmDas: the unit of times of day
TURN = 180 / 2**31  # fixed by VmDas [deg]: the unit of angles
VALID = 0b10_0010  # fixed by VmDas: position and time are valid
DAY_NS = 86_400_000_000_000  # fixed
PLACED: Mapping[str, tuple[str, ...]] = {
    "/gga": ("latitude", "longitude", "quality"),
    "/navigation": ("header.stamp", "latitude", "longitude", "valid"),
}
"""The columns of positions."""
USED = np.dtype(
    [
        ("clock", "u1", 7),  # year, month, day, hour, minute, second, hundredths
        ("depth_dm", "<u2"),
        ("heading_cdeg", "<u2"),
        ("pattern", "u1"),  # of the beams
        ("angle_code", "u1"),
        ("coordinates", "u1"),
        ("angle_deg", "u1"),
        ("tracked", "u1"),  # whether there is bottom track
        ("range_cm", "<u2", 4),  # of the bottom, vertical, by beams; 0: unknown
        ("velocity_mmps", "<i2", 4),  # of the bottom, along beams or axes
        ("range_high", "u1", 4),  # in 65,536 cm, of newer instruments
    ]
)
"""What is used of an ensemble."""


def looks_like_pd0(head: bytes) -> bool:
    """Return whether a file begins with an ensemble, or within one."""
    return head.startswith(MARK) or first_ensemble(head, [MARK]) != b""


def pd0_log(file: Path) -> RecordsLog:
    """Return the log of a PD0 file: bottom track, heading and depth if they are not constant, and positions."""
    return log_in_memory(file, "PD0", "pd0", _read)


def _read(file: Path, findings: list[Finding]) -> Mapping[str, Records]:
    used = bytearray()
    places: dict[str, list[Sequence[float]]] = {topic: [] for topic in PLACED}
    count = 0
    for whole in ensembles(file, [MARK], findings):
        count += 1
        parts = _parts(whole)
        if row := _used(parts):
            used += row
            number = len(used) // USED.itemsize - 1
            places["/gga"] += winriver_fixes(parts.get(NMEA, []), number)
            places["/navigation"] += vmdas_fixes(parts.get(NAVIGATION, []), number)
    rows = np.frombuffer(used, USED)
    times, timed = _times_ns(rows["clock"].astype(np.int64))
    if unused := count - int(np.sum(timed)):
        findings.append(Finding("UNDECODED", f"{unused} ensembles have no leader or no valid time; left out"))
    placed = {topic: _placed(topic, found, times, timed) for topic, found in places.items() if found}
    return _records(rows[timed], times[timed]) | placed


def _parts(ensemble: bytes) -> dict[int, list[bytes]]:
    """Return the data of an ensemble by their kind, each with the number of its kind."""
    count = ensemble[5]
    starts = [int.from_bytes(ensemble[at : at + 2], "little") for at in range(HEAD_BYTES, HEAD_BYTES + 2 * count, 2)]
    found: dict[int, list[bytes]] = {}
    for start, end in zip(starts, [*starts[1:], len(ensemble)], strict=False):
        part = ensemble[start:end]
        found.setdefault(int.from_bytes(part[:2], "little"), []).append(part)
    return found


def _used(parts: Mapping[int, Sequence[bytes]]) -> bytes:
    """Return what is used of an ensemble, empty if it has no leaders."""
    fixed, leader, bottom = (_part(parts, kind) for kind in (FIXED_LEADER, VARIABLE_LEADER, BOTTOM_TRACK))
    if not fixed or not leader:
        return b""
    angle = fixed[ANGLE_AT : ANGLE_AT + 1] or b"\0"
    track = b"\1" + bottom[16:32] + bottom[77:81].ljust(4, b"\0") if bottom else bytes(21)
    return leader[4:11] + leader[16:20] + fixed[4:6] + fixed[25:26] + angle + track


def _part(parts: Mapping[int, Sequence[bytes]], kind: int) -> bytes:
    """Return the first data of a kind, empty if there are none or too few bytes."""
    part = parts.get(kind, (b"",))[0]
    return part if len(part) >= LEAST_BYTES[kind] else b""


def _times_ns(clock: NDArray[np.int64]) -> tuple[Nanoseconds, NDArray[np.bool_]]:
    """Return the times (n,) of clocks (n, 7), and which are valid."""
    year, month, day, hour, minute, second, hundredths = clock.T
    dates = pd.DataFrame({"year": year + np.where(year < CENTURY, 2000, 1900), "month": month, "day": day})
    midnights = pd.to_datetime(dates, errors="coerce").to_numpy(dtype="datetime64[s]")  # none: there is no such day
    good = ~np.isnat(midnights) & (hour < 24) & (minute < 60) & (second < 60)
    seconds = midnights.astype(np.int64) + (hour * 60 + minute) * 60 + second
    return (seconds * 100 + hundredths) * HUNDREDTH_NS, good


def _records(rows: NDArray[np.void], times: Nanoseconds) -> dict[str, Records]:
    tracked = rows["tracked"] == 1
    velocities, coordinates = instrument_velocities(rows[tracked])
    track = dict(zip("xyz", velocities.T, strict=True)) | {"coordinates": coordinates}
    return {
        "/bottom_track": Records(times[tracked], track | {"altitude": _altitudes_m(rows[tracked])}),
        "/heading": Records(times, {"heading_deg": rows["heading_cdeg"] / 100}),
        "/depth": Records(times, {"depth_m": rows["depth_dm"] / 10}),
    }


def _altitudes_m(rows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the mean range to the bottom of the beams that see it, (n,), NaN if none does."""
    range_m = (rows["range_cm"] + 65536.0 * rows["range_high"]) / 100
    seen = np.count_nonzero(range_m, axis=1)
    return np.where(seen > 0, range_m.sum(axis=1) / np.maximum(seen, 1), np.nan)


def _placed(topic: str, found: Sequence[Sequence[float]], times: Nanoseconds, timed: NDArray[np.bool_]) -> Records:
    """Return positions, each the number of an ensemble, the time before it in ns, and the columns of the topic."""
    numbers, before_ns, *columns = (np.array(column) for column in zip(*found, strict=True))
    good = timed[numbers]
    kept = {name: column[good] for name, column in zip(PLACED[topic], columns, strict=True)}
    return Records((times[numbers] - before_ns)[good], kept)


def instrument_velocities(rows: NDArray[np.void]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the velocities of the bottom in m/s, (n, 3), NaN if unknown, and their coordinates, (n,).

    Those along beams become those along the axes of the instrument: beams 1 and 2 lie in x, 4 and 3 in y.
    """
    raw = rows["velocity_mmps"].astype(np.float64)
    raw = np.where(raw == NO_VELOCITY, np.nan, raw) / 1000
    coordinates = rows["coordinates"].astype(np.int64) >> 3 & 3
    code = rows["angle_code"] & 3
    angle_deg = np.where(code < len(ANGLES_DEG), np.take(ANGLES_DEG, code, mode="clip"), rows["angle_deg"])
    angle = np.radians(np.where(angle_deg > 0, angle_deg, np.nan))
    sign = np.where(rows["pattern"] & 8, 1.0, -1.0)
    one, two, three, four = raw.T
    x, y = (sign * (a - b) / (2 * np.sin(angle)) for a, b in ((one, two), (four, three)))
    along = np.stack([x, y, (one + two + three + four) / (4 * np.cos(angle))], axis=1)
    beams = coordinates == BEAM
    return np.where(beams[:, None], along, raw[:, :3]), np.where(beams, INSTRUMENT, coordinates)


def winriver_fixes(blocks: Sequence[bytes], number: int) -> list[tuple[int, int, float, float, int]]:
    """Return the number of their ensemble, the time before it in ns, and latitude, longitude, quality of GGA sentences.

    A block states how long before the ensemble it arrived; so fixes and velocities are timed by one clock.
    """
    found: list[tuple[int, int, float, float, int]] = []
    for block in blocks:
        if len(block) < GGA.size or int.from_bytes(block[2:4], "little") != GGA_BLOCK:
            continue
        _, _, _, age_s, _, _, lat, south, lon, west, quality = GGA.unpack_from(block)
        if not abs(age_s) < 60:  # also NaN; an ensemble takes seconds at most
            continue
        place = in_hemisphere(lat, south.decode("latin-1")), in_hemisphere(lon, west.decode("latin-1"))
        found.append((number, round(age_s * 1e9), *place, quality))
    return found


def vmdas_fixes(blocks: Sequence[bytes], number: int) -> list[tuple[int, int, int, float, float, int]]:
    """Return the number of an ensemble, 0 ns, and UTC, latitude, longitude, validity of the last fix before it.

    So its log time is that of the ensemble. A last fix before the first is of the next day.
    """
    found: list[tuple[int, int, int, float, float, int]] = []
    for block in blocks:
        if len(block) < PLACES.size:
            continue
        _, day, month, year, first, last, lat, lon, flags = PLACES.unpack_from(block)
        try:
            midnight_s = int(datetime(year, month, day, tzinfo=UTC).timestamp())
        except ValueError:
            continue
        stamp_ns = midnight_s * 10**9 + (last < first) * DAY_NS + last * TICK_NS
        if abs(stamp_ns) < MAX_TIME_NS:
            found.append((number, 0, stamp_ns, lat * TURN, lon * TURN, int(flags & VALID == VALID)))
    return found
