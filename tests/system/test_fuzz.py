"""Files of all formats, cut at any byte or with flipped bits: part of a log and a finding on the rest, or one sentence.

What is read of a damaged file is never invented: where the container or the messages carry enough to tell, every value
is one of the whole file.
"""

import random
import resource
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

from commands import run
from damage import cut, flipped
from recordings import SECOND, T0, Row, point, short_dive, twist, write_bag, write_csv, write_mcap, write_rosbag2, yaw
from usbldr.filters.errors import UsbldrError
from usbldr.io.formats.detect import open_log
from usbldr.io.log import Log
from usbldr.io.reading.read import read_log

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


class Target(NamedTuple):
    """A file to spoil, and what is then asked to read."""

    kind: str
    file: Path
    whole: bytes
    rng: random.Random

    @property
    def path(self) -> Path:
        return self.file.parent if self.file.name == "metadata.yaml" else self.file


@pytest.fixture(params=WRITERS)
def target(request: pytest.FixtureRequest, tmp_path: Path) -> Target:
    file = WRITERS[request.param](tmp_path)
    return Target(request.param, file, file.read_bytes(), random.Random(request.param))


def overwritten(whole: bytes, rng: random.Random) -> bytes:
    """Put nonsense into a stretch of a file, or take it out."""
    at, length = rng.randrange(len(whole)), rng.choice([4, 64, 3000])
    nonsense = rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length, b""])
    return whole[:at] + nonsense + whole[at + length :]


def damaged(whole: bytes, rng: random.Random) -> bytes:
    return rng.choice([cut, flipped, overwritten])(whole, rng)


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


def test_a_file_cut_at_any_byte_is_no_traceback(target: Target) -> None:
    size = len(target.whole)
    ends = [0, 1, 7, 8, 9, 13, size - 1, size - 8, *(target.rng.randrange(size) for _ in range(CASES))]

    for end in ends:
        target.file.write_bytes(target.whole[:end])
        log = read_whatever(target.path)

        if log is not None and target.kind not in ("csv", "rostopic csv", "nmea", "rosbag2 metadata"):
            said = [finding for finding in log.findings if finding.code in ("TRUNCATED", "DAMAGED", "UNINDEXED")]
            assert said, f"cut at {end}"
            full = all(provenance.used == 120 for provenance in log.provenance.values()) and len(log.tables) == 3
            assert full or any(finding.lost_data for finding in said), f"cut at {end}"


def test_any_bit_flipped_is_no_traceback(target: Target) -> None:
    for case in range(CASES):
        target.file.write_bytes(flipped(target.whole, target.rng))
        log = read_whatever(target.path)

        checked = target.kind in ("mcap zstd", "mcap lz4", "mcap uncompressed", "mcap without summary", "bag bz2")
        if log is not None and checked and "dvl" in log.tables:
            forward = log.tables["dvl"]["forward_mps"].to_numpy()
            said = any(finding.code == "CHECKSUM" for finding in log.findings)
            assert said or set(forward) <= set(np.arange(120) / 64) | {0.5}, f"case {case}"


def test_a_stretch_of_nonsense_is_no_traceback(target: Target) -> None:
    for _ in range(CASES // 2):
        target.file.write_bytes(overwritten(target.whole, target.rng))
        read_whatever(target.path)


def test_odd_files_that_others_made_may_be_damaged_too(field_logs: Path, tmp_path: Path) -> None:
    zoo = (field_logs / "reader_zoo").rglob("*.*")
    files = sorted(path for path in zoo if path.suffix in (".mcap", ".bag", ".db3"))
    rng = random.Random(0)

    for file in files:
        for _ in range(4):
            (tmp_path / file.name).write_bytes(damaged(file.read_bytes(), rng))
            read_whatever(tmp_path / file.name)
    assert len(files) > 25


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


def test_every_command_bears_a_damaged_file(target: Target, tmp_path: Path) -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(12):
        target.file.write_bytes(damaged(target.whole, target.rng))
        every_command(target.path, tmp_path)

    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 400_000


@pytest.mark.parametrize("target", ["mcap zstd", "bag bz2", "db3", "nmea"], indirect=True)
def test_pictures_of_a_damaged_file_are_drawn_or_it_is_refused(target: Target, tmp_path: Path) -> None:
    for _ in range(4):
        target.file.write_bytes(damaged(target.whole, target.rng))
        run("replay", target.file, "--filter", "dr", "--force", "--quiet", "--output", tmp_path / "run")
