"""Files of all formats, cut at any byte and bent at any bit: part of a log and a word about the rest, or one sentence.

What is read of a damaged file is never invented: where the container or the messages carry enough to tell, every value
is one of the whole file.
"""

import random
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

from commands import run
from recordings import SECOND, T0, Row, point, short_dive, twist, write_bag, write_csv, write_mcap, write_rosbag2, yaw
from usbldr.filters.errors import UsbldrError
from usbldr.io.formats.detect import open_log
from usbldr.io.log import Log
from usbldr.io.read import read_log

pytestmark = pytest.mark.slow


def dive() -> list[Row]:
    rows: list[Row] = []
    for k in range(120):
        t = T0 + k * SECOND
        rows += [twist(t, k / 64, 0.5), yaw(t, float(k)), point(t, float(k), 0.0)]
    return rows


CSV = "time_ns,starboard_mps,forward_mps\n" + "".join(f"{T0 + k * SECOND},0.5,{k / 64}\n" for k in range(120))
ROSTOPIC = "%time,field.header.stamp,field.twist.linear.x\n" + "".join(f"{T0 + k},{T0 + k},{k}\n" for k in range(120))
NMEA = "".join(  # a heading, a fix, and a GPS position, a second apart
    f"2020-09-13T22:{10 + k // 60}:{k % 60:02d}Z $HEHDT,{k}.0,T\n"
    f"$PSONLLD,22{10 + k // 60}{k % 60:02d}.00,2401,A,51.33{k:03d},-0.83,9.9,5.3,5.3,0.0,0.6,,,,\n"
    f"$GPGGA,22{10 + k // 60}{k % 60:02d}.00,5119.{k:05d},N,00049.8,W,2,12,0.6,-0.52,M,20.34,M,7.0,0907\n"
    for k in range(120)
)


def write_nmea(file: Path) -> Path:
    file.write_text(NMEA, encoding="ascii")
    return file


WRITERS: dict[str, Callable[[Path], Path]] = {
    "mcap zstd": lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.ZSTD, True, 4096),
    "mcap lz4": lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.LZ4, True, 4096),
    "mcap uncompressed": lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.NONE, True, 4096),
    "mcap unchunked": lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.NONE, False),
    "mcap without summary": lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.ZSTD, True, 4096, False),
    "bag": lambda d: write_bag(d / "a.bag", dive(), "none", 4096),
    "bag bz2": lambda d: write_bag(d / "a.bag", dive(), "bz2", 4096),
    "bag lz4": lambda d: write_bag(d / "a.bag", dive(), "lz4", 4096),
    "db3": lambda d: write_rosbag2(d / "a", dive()) / "a.db3",
    "rosbag2 mcap": lambda d: write_rosbag2(d / "a", dive(), StoragePlugin.MCAP) / "a.mcap",
    "rosbag2 metadata": lambda d: write_rosbag2(d / "a", short_dive()) / "metadata.yaml",
    "csv": lambda d: write_csv(d / "a", dvl=CSV) / "dvl.csv",
    "rostopic csv": lambda d: write_csv(d / "a", dvl=ROSTOPIC) / "dvl.csv",
    "nmea": lambda d: write_nmea(d / "a.nmea"),
}
CASES = 40  # of each kind


def read_whatever(path: Path) -> Log | None:
    """Read a log; return None where it is refused in one sentence. Anything but that is a failure."""
    sentence, log = f"{path}: ", None
    try:
        for topic in open_log(path).topics():
            assert topic.count >= 0
        log = read_log(path)
    except UsbldrError as fault:
        sentence = str(fault)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence
    return log


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_cut_at_any_byte_is_no_traceback(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    path = file.parent if file.name == "metadata.yaml" else file
    whole = file.read_bytes()
    rng = random.Random(kind)
    ends = [0, 1, 7, 8, 9, 13, len(whole) - 1, len(whole) - 8, *(rng.randrange(len(whole)) for _ in range(CASES))]

    for end in ends:
        file.write_bytes(whole[:end])
        log = read_whatever(path)

        if log is not None and kind not in ("csv", "rostopic csv", "nmea", "rosbag2 metadata"):
            said = [finding for finding in log.findings if finding.code in ("TRUNCATED", "DAMAGED", "UNINDEXED")]
            assert said, f"cut at {end}"
            full = all(provenance.used == 120 for provenance in log.provenance.values()) and len(log.tables) == 3
            assert full or any(finding.lost_data for finding in said), f"cut at {end}"


@pytest.mark.parametrize("kind", WRITERS)
def test_any_bit_flipped_is_no_traceback(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    path = file.parent if file.name == "metadata.yaml" else file
    whole = file.read_bytes()
    rng = random.Random(kind)

    for case in range(CASES):
        bent = bytearray(whole)
        for _ in range(rng.choice([1, 1, 1, 5, 50])):
            bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
        file.write_bytes(bent)
        log = read_whatever(path)

        checked = kind in ("mcap zstd", "mcap lz4", "mcap uncompressed", "mcap without summary", "bag bz2")
        if log is not None and checked and "dvl" in log.tables:
            forward = log.tables["dvl"]["forward_mps"].to_numpy()
            assert set(forward) <= set(np.arange(120) / 64) | {0.5}, f"case {case}"


@pytest.mark.parametrize("kind", WRITERS)
def test_a_stretch_of_nonsense_is_no_traceback(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    path = file.parent if file.name == "metadata.yaml" else file
    whole = file.read_bytes()
    rng = random.Random(kind)

    for _ in range(CASES // 2):
        at, length = rng.randrange(len(whole)), rng.choice([4, 64, 3000])
        nonsense = rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length, b""])
        file.write_bytes(whole[:at] + nonsense + whole[at + length :])
        read_whatever(path)


def test_odd_files_that_others_made_may_be_damaged_too(field_logs: Path, tmp_path: Path) -> None:
    files = sorted(
        path for path in (field_logs / "reader_zoo").rglob("*.*") if path.suffix in (".mcap", ".bag", ".db3")
    )
    rng = random.Random(0)

    for file in files:
        whole = file.read_bytes()
        for case in range(4):
            bent = bytearray(whole[: rng.randrange(len(whole))] if case % 2 else whole)
            for _ in range(rng.choice([1, 20])):
                bent[rng.randrange(len(bent) or 1)] ^= 1 << rng.randrange(8)
            damaged = tmp_path / file.name
            damaged.write_bytes(bent)
            read_whatever(damaged)
    assert len(files) > 25


def damaged(whole: bytes, rng: random.Random) -> bytes:
    """Cut a file, bend some of its bits, or overwrite a stretch of it."""
    bent = bytearray(whole)
    how = rng.choice(["cut", "bits", "stretch"])
    if how == "cut":
        return bytes(bent[: rng.randrange(len(whole))])
    if how == "bits":
        for _ in range(rng.choice([1, 5, 50])):
            bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
        return bytes(bent)
    at, length = rng.randrange(len(whole)), rng.choice([4, 64, 3000])
    return whole[:at] + rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length]) + whole[at + length :]


def every_command(log: Path, out: Path) -> None:
    """Run what reads a log: exit code 0 or 1 and a page, else one sentence with the code of its class."""
    replayed = ["replay", str(log), "--filter", "ekf", "--force", "--quiet", "--output", str(out / "run")]
    init = ["init", str(log), "--force", "--output", str(out / "found.toml")]
    for command in (["info", str(log)], ["doctor", str(log)], init, replayed):
        done = run(*command)
        if isinstance(done.exception, UsbldrError):
            assert done.exception.exit_code in (2, 3), done.exception
        else:
            assert done.return_value in (None, 0, 1, 3), (command, done.return_value)


@pytest.mark.parametrize("kind", WRITERS)
def test_every_command_bears_a_damaged_file(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    path = file.parent if file.name == "metadata.yaml" else file
    whole, rng = file.read_bytes(), random.Random(kind)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(12):
        file.write_bytes(damaged(whole, rng))
        every_command(path, tmp_path)

    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 400_000


@pytest.mark.parametrize("kind", ["mcap zstd", "bag bz2", "db3", "nmea"])
def test_pictures_of_a_damaged_file_are_drawn_or_it_is_refused(tmp_path: Path, kind: str) -> None:
    file = WRITERS[kind](tmp_path)
    whole, rng = file.read_bytes(), random.Random(kind)

    for _ in range(4):
        file.write_bytes(damaged(whole, rng))
        run("replay", str(file), "--filter", "dr", "--force", "--quiet", "--output", str(tmp_path / "run"))
