"""Files of Doppler logs written by the book: PD0, PD6, JSON lines."""

import json
import struct
from pathlib import Path
from typing import Any

from recordings import T0

COUNT = 40


def ensemble(
    k: int,
    coordinates: int,
    velocity: tuple[int, int, int, int],
    gga: bool = True,
    clock: str = "",
    heading: int | None = None,
    quality: int = 2,
) -> bytes:
    """Return an ensemble of a convex instrument with beams at 30 degrees that looks down.

    ``clock``: YYMMDDhhmmss and hundredths; ``heading``: hundredths of a degree; ``quality``: of the fix.
    """
    fixed = bytearray(59)
    fixed[4], fixed[5], fixed[25] = 0b0000_1011, 0b0100_0010, coordinates << 3
    variable = bytearray(65)
    variable[2:4] = struct.pack("<H", k)
    clock = clock or f"2009131226{k:02d}50"
    variable[4:11] = bytes(int(clock[place : place + 2]) for place in range(0, 14, 2))
    variable[14:20] = struct.pack("<HHH", 1500, 100 + k, (35_500 + 50 * k) % 36_000 if heading is None else heading)
    bottom = bytearray(81)
    bottom[16:24] = struct.pack("<4H", 4464, 0, 5464, 4964)  # with the next: 700, unknown, 710 and 705 m
    bottom[24:32] = struct.pack("<4h", *velocity)
    bottom[77:81] = b"\1\0\1\1"
    parts = [bytes(fixed), b"\x80\0" + bytes(variable[2:]), b"\0\6" + bytes(bottom[2:])]
    if gga:
        place = 64.5 + k * 1e-6, b"N", 149.0, b"W", quality
        block = struct.pack("<HHHd7s10sdcdcB", 0x2022, 104, 57, 0.25, b"$GPGGA\0", b"201423.00\0", *place) + bytes(20)
        parts.append(block)
    return pd0_ensemble(*parts)


def pd0_ensemble(*parts: bytes) -> bytes:
    """Return header, places of the parts, the parts, and the sum of all bytes."""
    start = 6 + 2 * len(parts)
    starts = [start + sum(map(len, parts[:i])) for i in range(len(parts))]
    size = start + sum(map(len, parts))
    whole = b"\x7f\x7f" + struct.pack(f"<HBB{len(parts)}H", size, 0, len(parts), *starts) + b"".join(parts)
    return whole + struct.pack("<H", sum(whole) & 0xFFFF)


def write_pd0(file: Path, coordinates: int = 1, velocity: tuple[int, int, int, int] = (250, -1500, 10, 0)) -> Path:
    file.write_bytes(b"".join(ensemble(k, coordinates, velocity) for k in range(COUNT)))
    return file


def pd6_group(k: int, velocity: str = "A", sensors: bool = True) -> list[str]:
    """Return a group as Water Linked's page shows it."""
    attitude = f":SA, +1.00, -2.00,{(355 + k / 2) % 360:6.2f}" if sensors else ":SA, +0.00, +0.00,  0.00"
    depth = 10 + k / 10 if sensors else 0.0
    return [
        attitude,
        f":TS,200913122640{k:02d}, 0.0, +0.0,{depth:6.1f},1475.0,  0",
        ":WI,    +0,    +0,    +0,    +0,V",
        f":BI,  +{100 + k},  -420, +2000,    +0,{velocity}",
        f":BS,  -420,  +{100 + k}, +2000,{velocity}",
        ":BE,    +0,    +0,    +0,V",
        ":BD,       +0.00,       +0.00,       +0.00,   5.32,  0.00",
    ]


def write_pd6(file: Path, **options: Any) -> Path:
    lines = [line for k in range(COUNT) for line in pd6_group(k, "V" if k == 3 else "A", **options)]
    file.write_text("\r\n".join(lines) + "\r\n", encoding="ascii", newline="")
    return file


def velocity(k: int) -> dict[str, Any]:
    """Return a report as Water Linked's page shows it."""
    us = T0 // 1000 + k * 100_000
    return {
        "time": 100.5, "vx": 0.5 + k / 100, "vy": -0.25, "vz": 0.125, "fom": 0.01, "covariance": [[1e-4, 0, 0]] * 3,
        "altitude": 2.5, "transducers": [{"id": 0, "velocity": 0.1, "beam_valid": True}] * 4,
        "velocity_valid": k != 3, "status": 0, "format": "json_v3.1", "type": "velocity",
        "time_of_validity": us - 50_000, "time_of_transmission": us,
    }  # fmt: skip


def position(k: int) -> dict[str, Any]:
    fields = {"ts": 49056.809, "x": 1.0, "y": 2.0, "z": 3.0, "std": 0.01, "roll": 0.1, "pitch": 0.2, "yaw": 10.0 + k}
    return {**fields, "type": "position_local", "status": 0, "format": "json_v3.1"}


def write_json(file: Path) -> Path:
    lines = [json.dumps(report) for k in range(COUNT) for report in (velocity(k), position(k))]
    lines.insert(5, json.dumps({"response_to": "get_config", "type": "response", "result": {"speed_of_sound": 1475.0}}))
    file.write_text("".join(line + "\r\n" for line in lines), encoding="utf-8", newline="")
    return file
