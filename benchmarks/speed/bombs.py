"""Files made to exhaust memory or time: CPU time, peak memory and exit code of `usbldr info` on each.

$ python benchmarks/speed/bombs.py

docs/broken_files.md states the largest numbers.
"""

import argparse
import bz2
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import NoReturn

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
    options = argparse.ArgumentParser(description="Print the table as Markdown.")
    options.add_argument("--bombs", nargs="+", metavar="WORD", help="only those with one of these words in their names")
    options.add_argument("--info", help=argparse.SUPPRESS)
    arguments = options.parse_args()
    if arguments.info:
        info(arguments.info)
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # speed is a package
    from speed.format_bombs import format_bombs

    heads = ["file", "kB", "decompressed GB", "exit code", "CPU s", "MB"]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name, (size, make) in {**bombs(100 * MB, 1 << 30), **format_bombs(1 << 30)}.items():
        if arguments.bombs and not any(word in name for word in arguments.bombs):
            continue
        with tempfile.TemporaryDirectory() as folder:
            file = make(Path(folder) / "bomb")
            command = [sys.executable, __file__, "--info", str(file)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            packed = max(one.stat().st_size for one in Path(folder).iterdir()) / 1000
        cost = done.stdout.splitlines()[-1].split() if done.returncode == 0 else ["crash", "", ""]
        cells = [name, f"{packed:.0f}" if packed >= 1 else f"{packed:.1f}", f"{size / 1e9:.1f}", *cost]
        print(f"| {' | '.join(cells)} |", flush=True)


def info(file: str) -> NoReturn:
    """Run `usbldr info`; print its exit code, CPU seconds and peak memory in MB on the last line."""
    from usbldr_cli.main import main as usbldr

    sys.argv = ["usbldr", "info", file]
    code: object = 0
    try:
        usbldr()
    except SystemExit as end:
        code = end.code
    status = Path("/proc/self/status").read_text().splitlines()  # getrusage would count the parent's memory, too
    peak_kb = next(line for line in status if line.startswith("VmHWM:")).split()[1]
    print(f"\n{code} {time.process_time():.1f} {int(peak_kb) // 1024}")
    sys.exit(0)


if __name__ == "__main__":
    main()
