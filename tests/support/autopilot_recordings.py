"""Logs of autopilots, written by hand: telemetry logs with pymavlink's messages, onboard logs by their own layouts."""

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from recordings import T0, saved

COUNT = 60


def packets(version_1: bool = False) -> list[bytes]:
    """Return packets as a ground station stores them, each after its time."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    dvl = mavlink.MAVLink(None, srcSystem=255, srcComponent=0)
    found: list[bytes] = []
    for k in range(COUNT):
        moved = [0.2 + k / 100, -0.1, 0.01]
        messages = [
            (dvl, mavlink.MAVLink_vision_position_delta_message(k, 200_000, [0, 0, 0.1], moved, 90)),
            (sender, mavlink.MAVLink_attitude_message(1000 * k, 0.01, 0.02, k / 20, 0, 0, 0)),
            (sender, mavlink.MAVLink_gps_raw_int_message(k, 3, 476176249 + k, -1223610207, 0, 1, 1, 0, 0, 9)),
            (sender, mavlink.MAVLink_scaled_pressure2_message(k, 1500.5 + k, 0, 0)),
            (sender, mavlink.MAVLink_statustext_message(6, b"dive" + b"!" * (k % 3))),
        ]
        for owner, message in messages:
            time_us = T0 // 1000 + k * 1_000_000
            packed = bytes(message.pack(owner, force_mavlink1=version_1 and message.get_msgId() < 256))
            found.append(struct.pack(">Q", time_us) + packed)
    return found


def write_packets(file: Path, timed: Iterable[tuple[int, Any]]) -> Path:
    """Write messages of MAVLink by one sender, each behind its time, as a ground station stores them."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return saved(file, *(struct.pack(">Q", t // 1000) + bytes(message.pack(sender)) for t, message in timed))


def write_tlog(file: Path, version_1: bool = False) -> Path:
    file.write_bytes(b"".join(packets(version_1)))
    return file


Definition = tuple[int, str, str, str, str]  # number, name, codes, columns, units
DEFINITIONS: Sequence[Definition] = (
    (130, "ATT", "QccffC", "TimeUS,Roll,Pitch,DesYaw,Yaw,ErrYaw", "sddddd"),
    (131, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt", "s#-s-S-DUm"),
    (132, "BARO", "QBff", "TimeUS,I,Alt,Press", "s#mP"),
    (133, "VISO", "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf", "ssrrrmmm-"),
    (134, "MSG", "QZ", "TimeUS,Message", "s-"),
)
STRUCT = {
    "Q": "Q", "c": "h", "C": "H", "f": "f", "B": "B", "I": "I", "H": "H", "L": "i", "e": "i",
    "Z": "64s", "N": "16s", "n": "4s",
}  # fmt: skip


def fmt(number: int, name: str, codes: str, columns: str) -> bytes:
    size = 3 + struct.calcsize("<" + "".join(STRUCT[code] for code in codes))
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, name.encode(), codes.encode(), columns.encode())


def row(number: int, codes: str, *values: Any) -> bytes:
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(STRUCT[code] for code in codes), *values)


def onboard(gps: bool = True) -> list[bytes]:
    parts = [fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    parts += [fmt(129, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")]
    for number, name, codes, columns, units in DEFINITIONS:
        parts += [fmt(number, name, codes, columns), row(129, "QBNN", 1, number, units.encode(), b"-" * len(units))]
    codes_of = {number: codes for number, _, codes, _, _ in DEFINITIONS}
    for k in range(COUNT):
        t = 5_000_000 + 1_000_000 * k
        parts += [row(130, codes_of[130], t, 12, -34, 1.0, (350 + k) % 360 + 0.25, 7)]
        parts += [row(133, codes_of[133], t + 10, 200_000.0, 0, 0, 0, 0.2 + k / 100, -0.1, 0.01, 90.0 if k != 4 else 0)]
        if gps:
            week = (131, codes_of[131], t + 20, 0, 3 if k > 1 else 1, 100_000 + 1000 * k, 2200)
            parts += [row(*week, 9, 80, 476176249 + k, -1223610207, 1200)]
        parts += [row(132, codes_of[132], t + 30, instance, 0, 101325 + 1e4 * instance) for instance in (0, 1)]
        parts += [row(134, codes_of[134], t + 40, b"ArduSub V4.5")]
    return parts


def write_rows(file: Path, definition: Definition, rows: Iterable[Sequence[Any]]) -> Path:
    """Write an onboard log of messages of one kind."""
    number, name, codes, columns, _ = definition
    head = fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"), fmt(number, name, codes, columns)
    return saved(file, *head, *(row(number, codes, *values) for values in rows))


def write_bin(file: Path, parts: Sequence[bytes] | None = None) -> Path:
    file.write_bytes(b"".join(onboard() if parts is None else parts))
    return file
