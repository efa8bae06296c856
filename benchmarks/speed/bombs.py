"""Files of some kilobytes that decompress to gigabytes: CPU time, peak memory and exit code of `usbldr info` on each.

$ python benchmarks/speed/bombs.py
"""

import bz2
import resource
import sqlite3
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

MB = 1 << 20
T0 = 1_600_000_000_000_000_000
MAGIC = b"\x89MCAP0\r\n"
CSV, CSV_ROWS = b"time_ns,forward_mps,starboard_mps\n", b"1,2,3\n" * 200_000
COLUMNS = ",".join(f"c{k}" for k in range(250_001)).encode() + b"\n"
TWIST = "geometry_msgs/msg/TwistStamped"


def bz2_of(size: int) -> bytes:
    packer, block = bz2.BZ2Compressor(), bytes(MB)
    whole = b"".join(packer.compress(block) for _ in range(size // MB))
    return whole + packer.compress(bytes(size % MB)) + packer.flush()


def lz4_of(size: int) -> bytes:
    return bytes(lz4.frame.compress(bytes(size)))


def zstd_of(size: int) -> bytes:
    return zstandard.ZstdCompressor(19).compress(bytes(size))


def in_mcap(file: Path, compression: str, chunks: list[tuple[int, bytes]]) -> Path:
    """Write chunks with the size that each states."""

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    name = compression.encode()
    inside = b"".join(
        record(6, struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name + struct.pack("<Q", len(packed)) + packed)
        for size, packed in chunks
    )
    file.write_bytes(MAGIC + record(1, bytes(8)) + inside + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC)
    return file


def in_bag(file: Path, compression: str, chunks: list[tuple[int, bytes]]) -> Path:
    def field(name: bytes, value: bytes) -> bytes:
        return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value

    def record(header: bytes, data: bytes) -> bytes:
        return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data

    head = record(field(b"op", b"\3") + field(b"index_pos", bytes(8)), b"")
    inside = b"".join(
        record(
            field(b"op", b"\5") + field(b"compression", compression.encode()) + field(b"size", struct.pack("<I", size)),
            packed,
        )
        for size, packed in chunks
    )
    file.write_bytes(b"#ROSBAG V2.0\n" + head + inside)
    return file


def in_db3(file: Path, payloads: list[bytes], columns: str = "topic_id, timestamp, data") -> Path:
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)")
        database.execute(f"CREATE TABLE messages(id INTEGER PRIMARY KEY, {columns})")
        database.execute("INSERT INTO topics VALUES (1, '/dvl', ?, 'cdr')", (TWIST,))
        rows = [(T0 + k, payload) for k, payload in enumerate(payloads)]
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", rows)
    return file


def in_file(file: Path, pack: Callable[[bytes], bytes], head: bytes, block: bytes, count: int) -> Path:
    """Write a compressed file of a head and a block many times, each compressed alone."""
    file.write_bytes(pack(head) + pack(block) * count)
    return file


def in_mcap_in_file(file: Path, size: int, count: int) -> Path:
    """Write an MCAP file of many chunks and compress the whole."""
    file.write_bytes(zstandard.compress(in_mcap(file, "zstd", [(size, zstd_of(size))] * count).read_bytes()))
    return file


def bombs(chunk: int, giga: int) -> Mapping[str, tuple[int, Callable[[Path], Path]]]:
    """Return by name how much each file decompresses to, and its writer; ``chunk``: bytes of one of many chunks."""
    many = giga // chunk
    return {
        "bag bz2, one chunk": (giga, lambda f: in_bag(f, "bz2", [(0xFFFFFFFF, bz2_of(giga))])),
        "bag bz2, a chunk larger than stated": (giga, lambda f: in_bag(f, "bz2", [(1000, bz2_of(giga))])),
        "bag bz2, many chunks": (7 * giga, lambda f: in_bag(f, "bz2", [(chunk, bz2_of(chunk))] * 7 * many)),
        "bag lz4, many chunks": (2 * giga, lambda f: in_bag(f, "lz4", [(chunk, lz4_of(chunk))] * 2 * many)),
        "mcap zstd, one chunk": (giga, lambda f: in_mcap(f, "zstd", [(giga, zstd_of(giga))])),
        "mcap zstd, many chunks": (8 * giga, lambda f: in_mcap(f, "zstd", [(chunk, zstd_of(chunk))] * 8 * many)),
        "csv bz2, many rows": (giga, lambda f: in_file(f, bz2.compress, CSV, CSV_ROWS, giga // len(CSV_ROWS))),
        "csv zstd, many rows": (giga, lambda f: in_file(f, zstandard.compress, CSV, CSV_ROWS, giga // len(CSV_ROWS))),
        "csv zstd, many columns": (
            giga,
            lambda f: in_file(f, zstandard.compress, COLUMNS, b"1," * 250_000 + b"1\n", giga // 500_000),
        ),
        "mcap.bz2, many zeros": (giga, lambda f: in_file(f, bz2.compress, MAGIC, bytes(MB), giga // MB)),
        "mcap.zst, many zeros": (giga, lambda f: in_file(f, zstandard.compress, MAGIC, bytes(MB), giga // MB)),
        "mcap.zst, many chunks in a file": (8 * giga, lambda f: in_mcap_in_file(f, chunk, 8 * many)),
        "db3 zstd, many messages": (9 * giga, lambda f: in_db3(f, [zstd_of(chunk)] * 9 * many)),
        "db3 zstd, one message": (giga, lambda f: in_db3(f, [zstd_of(giga)])),
    }


def main() -> None:
    """Print a table."""
    print("| file | kB | decompressed GB | exit code | CPU s | MB |\n|---|---|---|---|---|---|")
    for name, (size, write) in bombs(100 * MB, 1 << 30).items():
        with tempfile.TemporaryDirectory() as folder:
            file = write(Path(folder) / "bomb")
            done = subprocess.run([sys.executable, __file__, str(file)], capture_output=True, text=True, check=False)
            code, seconds, peak = done.stdout.splitlines()[-1].split()
            packed = f"{file.stat().st_size / 1000:.0f} | {size / 1e9:.1f}"
            print(f"| {name} | {packed} | {code} | {seconds} | {peak} |", flush=True)


def info(file: str) -> None:
    """Run `usbldr info`; print its exit code, CPU seconds and peak memory in MB on the last line."""
    from usbldr_cli.main import main as usbldr

    sys.argv = ["usbldr", "info", file]
    try:
        usbldr()
    except SystemExit as end:
        used = resource.getrusage(resource.RUSAGE_SELF)
        print(f"\n{end.code} {used.ru_utime + used.ru_stime:.1f} {used.ru_maxrss // 1024}")


if __name__ == "__main__":
    info(sys.argv[1]) if len(sys.argv) > 1 else main()
