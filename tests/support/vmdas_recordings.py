"""Files of VmDas by the tables of its User's Guide, whose bytes count from 1: PD0 ensembles with navigation."""

from collections.abc import Mapping
from pathlib import Path

COUNT = 40
ZONE_S = -7 * 3600  # the clock of computer and instrument is that of a time zone
NAVIGATION_BYTES = 94  # 78 in the guide, and 16 more that VmDas writes
PLACES: Mapping[str, tuple[int, int]] = {  # of the first and the last byte
    "day": (3, 3),
    "month": (4, 4),
    "year": (5, 6),
    "first": (7, 10),
    "offset": (11, 14),
    "first latitude": (15, 18),
    "first longitude": (19, 22),
    "last": (23, 26),
    "latitude": (27, 30),
    "longitude": (31, 34),
    "flags": (47, 48),
}


def navigation(**fields: int) -> bytes:
    """Return a block of navigation; other bytes are 0x55."""
    block = bytearray(b"\x00\x20" + b"\x55" * (NAVIGATION_BYTES - 2))
    for name, value in fields.items():
        first, last = PLACES[name]
        block[first - 1 : last] = value.to_bytes(last - first + 1, "little", signed=value < 0)
    return bytes(block)


def fix(utc_s: int, flags: int = 0b110_0110_0011) -> bytes:
    """Return the navigation whose last fix is so many seconds after the midnight of 2020-08-19, at 48.125 N, 123 W.

    An angle of 180 degrees is 2^31.
    """
    day, of_day = divmod(utc_s, 86_400)
    north, west = round(48.125 / 180 * 2**31), -round(123 / 180 * 2**31)
    return navigation(
        day=19 + day,
        month=8,
        year=2020,
        first=of_day * 10_000 - 5_000,
        offset=ZONE_S * 1000,
        last=of_day * 10_000,
        latitude=north + utc_s % 1000,
        longitude=west,
        flags=flags,
    )


def pd0_ensemble(parts: list[bytes]) -> bytes:
    """Return an ensemble of PD0: header, places of its parts, the parts, the sum of all bytes."""
    starts = [6 + 2 * len(parts) + sum(map(len, parts[:k])) for k in range(len(parts))]
    size = starts[-1] + len(parts[-1])
    whole = b"\x7f\x7f" + size.to_bytes(2, "little") + bytes([0, len(parts)])
    whole += b"".join(start.to_bytes(2, "little") for start in starts) + b"".join(parts)
    return whole + (sum(whole) % 65536).to_bytes(2, "little")


def leaders(local_s: int, heading_cdeg: int) -> list[bytes]:
    """Return the leaders of an ensemble so many seconds after the midnight of 2020-08-19 of its own clock."""
    hour, minute, second = local_s // 3600, local_s // 60 % 60, local_s % 60
    variable = bytearray(b"\x80" + bytes(64))
    variable[4:11] = bytes([20, 8, 19, hour, minute, second, 25])
    variable[18:20] = heading_cdeg.to_bytes(2, "little")
    return [bytes(59), bytes(variable)]


def write_enx(file: Path, first_utc_s: int = 50_220) -> Path:
    """Write ensembles of each second without bottom track, each a quarter of a second after its last fix."""
    parts = [pd0_ensemble([*leaders(first_utc_s + k + ZONE_S, 23_405 + k), fix(first_utc_s + k)]) for k in range(COUNT)]
    file.write_bytes(b"".join(parts))
    return file
