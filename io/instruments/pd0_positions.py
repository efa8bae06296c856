"""Positions in PD0 files, beside the ensembles of the instrument: those of WinRiver and of VmDas.

Sources: WinRiver's blocks of GGA sentences, and VmDas' block of navigation (VmDas User's Guide, binary navigation data
format).
"""

import struct
from collections.abc import Sequence
from datetime import UTC, datetime

from usbldr.io.decoding.nmea_kinds import in_hemisphere
from usbldr.io.reader import MAX_TIME_NS

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
