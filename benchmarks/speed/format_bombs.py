"""Files of autopilots, Doppler logs, IMC messages, texts and tables that are made to exhaust memory or time."""

import gzip
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
import zstandard
from pyarrow import parquet

MB = 1 << 20
T0 = 1_600_000_000_000_000_000
Bomb = tuple[int, Callable[[Path], Path]]  # bytes that it decompresses to, and its writer

FMT = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 1, 11, b"T", b"Q", b"TimeUS")
"""The layout of a message of DataFlash that is a time alone."""
DEFINITIONS = b'<messages><message id="1" abbrev="A"></message></messages>'
ALOG = b"%% LOGSTART 1600000000.0\n"


def with_checksum(message: bytes, start: int, polynomial: int, value: int, more: bytes = b"") -> bytes:
    """Append a checksum of 16 bits, mirrored, of a message from a byte on, and of more bytes."""
    for byte in message[start:] + more:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (polynomial if value & 1 else 0)
    return message + struct.pack("<H", value)


PACKET = with_checksum(
    struct.pack(">Q", T0 // 1000) + bytes.fromhex("fd010000000101ffff7f00"), 9, 0x8408, 0xFFFF, b"\0"
)
"""A packet of MAVLink of an unknown definition, whose byte is 0."""
MESSAGE = with_checksum(struct.pack("<HHHdHBHB", 0xFE54, 1, 0, T0 / 1e9, 30, 0, 0, 0), 0, 0xA001, 0)
"""A message of IMC without fields."""


def ensemble() -> bytes:
    """Return the smallest ensemble of PD0 that holds a velocity."""
    fixed, bottom = bytes(26), b"\0\6" + bytes(30)
    leader = b"\x80\0" + bytes(2) + bytes([20, 9, 13, 12, 26, 40, 0]) + bytes(9)
    starts = (12, 12 + len(fixed), 12 + len(fixed) + len(leader))
    parts = fixed + leader + bottom
    whole = b"\x7f\x7f" + struct.pack("<HBB3H", 12 + len(parts), 0, 3, *starts) + parts
    return whole + struct.pack("<H", sum(whole) & 0xFFFF)


def repeated(file: Path, pack: Callable[[bytes], bytes], head: bytes, part: bytes, size: int) -> Path:
    """Write a head and a part many times, compressed in blocks of a megabyte."""
    block = part * (MB // len(part))
    file.write_bytes(pack(head + part) + pack(block) * (size // len(block)))
    return file


def lsf(file: Path, size: int, definitions: bytes = DEFINITIONS, name: str = "IMC.xml", part: bytes = b"") -> Path:
    """Write messages of IMC, one if there is no size to reach, and definitions beside them."""
    (file.parent / name).write_bytes(definitions)
    file.write_bytes(MESSAGE)
    return repeated(file, zstandard.compress, MESSAGE, part or MESSAGE, size) if size else file


ENTITIES = b"".join(b'<!ENTITY a%d "%s">' % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 10))
XML = b'<!DOCTYPE m [<!ENTITY a0 "aaaaaaaaaa">' + ENTITIES + b"]><messages>&a9;</messages>"
NESTED_XML = b"<a>" * 1_300_000


def text(file: Path, head: bytes, size: int) -> Path:
    file.write_bytes(head + b"9" * size + b"\n")
    return file


def nested_json(file: Path) -> Path:
    line = b'{"type": "velocity", "time_of_transmission": 1600000000000000, "vx": ' + b"[" * 900_000 + b"\n"
    file.write_bytes(b'{"type": "velocity", "time_of_transmission": 1600000000000000, "vx": 1.0}\n' + line)
    return file


def parquet_zeros(file: Path, size: int) -> Path:
    """Write a table whose two columns are one run each."""
    rows = MB
    table = pa.table({name: pa.array(np.zeros(rows, dtype=np.int64)) for name in ("time_ns", "heading_deg")})
    with parquet.ParquetWriter(file, table.schema) as writer:
        for _ in range(size // (16 * rows)):
            writer.write_table(table)
    return file


def parquet_text(file: Path, size: int) -> Path:
    """Write a table of two times, each a text of many megabytes."""
    times = pa.array(["0" * (size // 2)] * 2, pa.large_string())
    parquet.write_table(pa.table({"time_ns": times, "heading_deg": [1.0, 2.0]}), file, compression="zstd")
    return file


def hdf5_shape(file: Path, size: int, head: int = 0) -> Path:
    """Write columns that hold nothing but their length."""
    with h5py.File(file, "w", userblock_size=head) as content:
        for name in ("time_ns", "heading_deg"):
            content.create_dataset(f"compass/{name}", shape=(size // 8,), dtype="i8", chunks=(MB,))
    if head:
        with file.open("r+b") as content:
            content.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return file


def hdf5_chunk(file: Path, size: int) -> Path:
    """Write columns of ten rows in chunks that are far larger."""
    with h5py.File(file, "w") as content:
        for name in ("time_ns", "heading_deg"):
            column = {"shape": (10,), "maxshape": (None,), "chunks": (size // 8,), "compression": "gzip"}
            content.create_dataset(f"compass/{name}", dtype="i8", **column)[:] = np.arange(10)
    return file


def hdf5_gzip(file: Path, size: int) -> Path:
    """Write columns of ten rows whose chunks decompress to far more than they hold."""
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(MB)) for _ in range(size // MB)) + packer.flush()
    with h5py.File(file, "w") as content:
        for name in ("time_ns", "heading_deg"):
            column = content.create_dataset(f"compass/{name}", (10,), "i8", chunks=(10,), compression="gzip")
            column.id.write_direct_chunk((0,), packed)
    return file


def mat(file: Path, size: int) -> Path:
    zeros = np.zeros(size // 16)
    scipy.io.savemat(file, {"compass": {"time_ns": zeros, "heading_deg": zeros}}, do_compression=True, appendmat=False)
    return file


def nested_mat(file: Path, levels: int) -> Path:
    """Write a cell in a cell in a cell."""
    inner = b""
    for _ in range(levels):
        array = struct.pack("<II8sIIiiII", 6, 8, struct.pack("<II", 1, 0), 5, 8, 1, 1, 1, 0) + inner
        inner = struct.pack("<II", 14, len(array)) + array
    packed = zlib.compress(inner)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    file.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    return file


def format_bombs(giga: int) -> Mapping[str, Bomb]:
    """Return by name how much each file decompresses to, and its writer."""
    return {
        "tlog.zst, many packets": (
            giga // 4, lambda f: repeated(f, zstandard.compress, b"", PACKET, giga // 4)),
        "tlog.gz, many zeros": (giga // 4, lambda f: repeated(f, gzip.compress, PACKET, bytes(MB), giga // 4)),
        "BIN.zst, many messages": (
            giga // 4, lambda f: repeated(f, zstandard.compress, FMT, b"\xa3\x95\1" + bytes(8), giga // 4)),
        "PD0.zst, many ensembles": (giga // 4, lambda f: repeated(f, zstandard.compress, b"", ensemble(), giga // 4)),
        "PD0.zst, many headers": (
            giga // 4, lambda f: repeated(f, zstandard.compress, ensemble(), b"\x7f", giga // 4)),
        "tlog.zst, many beginnings": (
            giga // 4, lambda f: repeated(f, zstandard.compress, PACKET, b"\xfd", giga // 4)),
        "BIN.zst, many beginnings": (
            giga // 4, lambda f: repeated(f, zstandard.compress, FMT, b"\xa3\x95", giga // 4)),
        "lsf.zst, many beginnings": (
            giga // 4, lambda f: lsf(f, giga // 4, part=b"\x54\xfe")),
        "lsf.zst, many messages": (giga // 4, lambda f: lsf(f, giga // 4)),
        "alog.gz, many lines": (giga, lambda f: repeated(f, gzip.compress, ALOG, b"1.0 X app 1\n", giga)),
        "alog, one line": (0, lambda f: text(f, ALOG, 100 * MB)),
        "JSON lines, nested deeply": (0, nested_json),
        "IMC.xml.gz, many zeros": (giga, lambda f: lsf(f, 0, gzip.compress(b"<messages>" + bytes(giga)), "IMC.xml.gz")),
        "IMC.xml, entities of entities": (10 * giga, lambda f: lsf(f, 0, XML)),
        "IMC.xml, nested deeply": (0, lambda f: lsf(f, 0, NESTED_XML)),
        "Parquet, many rows": (giga, lambda f: parquet_zeros(f, giga)),
        "Parquet, two long texts": (giga, lambda f: parquet_text(f, giga)),
        "HDF5, long columns without data": (8 * giga, lambda f: hdf5_shape(f, 8 * giga)),
        "HDF5, a chunk larger than its column": (giga, lambda f: hdf5_chunk(f, giga)),
        "HDF5, a chunk that decompresses to more": (giga, lambda f: hdf5_gzip(f, giga)),
        ".mat 5, long columns": (giga, lambda f: mat(f, giga)),
        ".mat 5, cells in cells": (0, lambda f: nested_mat(f, 20_000)),
        ".mat 7.3, long columns without data": (8 * giga, lambda f: hdf5_shape(f, 8 * giga, 512)),
    }  # fmt: skip
