"""Files of all formats, cut at any byte or with flipped bits, counted: nothing is lost or wrong without a word.

The short version is a test; `make fuzz` takes 1000 cuts and 1000 flips of each format and prints the table.
"""

import random
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from recordings import (
    ROS2,
    SECOND,
    T0,
    Row,
    message,
    point,
    twist,
    write_bag,
    write_csv,
    write_mcap,
    write_rosbag2,
    yaw,
)
from usbldr.filters.errors import UsbldrError
from usbldr.io.formats.detect import open_log

COUNT = 60  # [messages] of each topic
WANTED = {
    "/dvl": ["header.stamp", "twist.linear.x"],
    "/imu": ["header.stamp", "orientation.z"],
    "/usbl": ["header.stamp", "point.x"],
}
CSV_WANTED = {"/usbl": ["header.stamp", "east_m", "north_m"]}


def dive() -> list[Row]:
    """Return messages with numbers that all differ: a wrong value cannot be another's."""
    rows: list[Row] = []
    for k in range(COUNT):
        t = T0 + k * SECOND
        rows += [twist(t, 1 + k / 7, 0.5), yaw(t, 1 + k / 3), point(t, 1 + k / 11, 0.0)]
    return rows


def with_data_checksum(file: Path) -> Path:
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, enable_data_crcs=True)
        writer.start()
        channels: dict[str, int] = {}
        for time_ns, topic, type_name, values in dive():
            if topic not in channels:
                text, _ = ROS2.generate_msgdef(type_name, ros_version=2)
                channels[topic] = writer.register_channel(
                    topic, "cdr", writer.register_schema(type_name, "ros2msg", text.encode())
                )
            data = bytes(ROS2.serialize_cdr(message(type_name, values), type_name))
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()
    return file


def csv_file(folder: Path) -> Path:
    rng = random.Random(7)
    rows = (f"{T0 + k * SECOND},{rng.gauss(0, 100):.10f},{rng.gauss(0, 100):.10f}\n" for k in range(COUNT))
    return write_csv(folder / "a", usbl="time_ns,east_m,north_m\n" + "".join(rows)) / "usbl.csv"


class Format(NamedTuple):
    """A format, and what its own checksums and counts tell."""

    write: Callable[[Path], Path]
    flips_tell_values: bool = False  # it has checksums of all data
    flips_tell_loss: bool = False  # it has such, or counts


FORMATS: Mapping[str, Format] = {
    "mcap zstd": Format(lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.ZSTD, True, 4096), True, True),
    "mcap lz4": Format(lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.LZ4, True, 4096), True, True),
    "mcap uncompressed": Format(
        lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.NONE, True, 4096), True, True
    ),
    "mcap unchunked": Format(lambda d: write_mcap(d / "a.mcap", dive(), CompressionType.NONE, False), False, True),
    "mcap unchunked, checksum": Format(lambda d: with_data_checksum(d / "a.mcap"), True, True),
    "bag": Format(lambda d: write_bag(d / "a.bag", dive(), "none", 4096), False, True),
    "bag bz2": Format(lambda d: write_bag(d / "a.bag", dive(), "bz2", 4096), True, True),
    "bag lz4": Format(lambda d: write_bag(d / "a.bag", dive(), "lz4", 4096), False, True),
    "rosbag2": Format(lambda d: write_rosbag2(d / "a", dive()) / "a.db3"),
    "csv": Format(csv_file),
}


class Read(NamedTuple):
    """What was read of a file."""

    rows: Mapping[str, set[tuple[float, ...]]]
    said: bool  # that data were lost, or that it cannot be read at all


def read(path: Path, wanted: Mapping[str, list[str]]) -> Read:
    """Read the wanted topics as far as they are there."""
    rows: dict[str, set[tuple[float, ...]]] = {topic: set() for topic in wanted}
    try:
        log = open_log(path)
        present = {topic.name: topic for topic in log.topics()}
        ask = {
            topic: paths
            for topic, paths in wanted.items()
            if topic in present and all(present[topic].has(path) for path in paths)
        }
        unread = any(topic in present and present[topic].problem for topic in wanted)  # a problem is reported
        for topic, records in log.read(ask).items() if not unread else ():
            columns = [records.received_ns, *(records.columns[path] for path in wanted[topic])]
            rows[topic] = set(zip(*(column.tolist() for column in columns), strict=True))
        said = unread or len(ask) < len(wanted) or any(finding.lost_data for finding in log.findings())
    except UsbldrError:
        said = True
    return Read(rows, said)


def cut(whole: bytes, rng: random.Random) -> bytes:
    return whole[: rng.randrange(len(whole))]


def flipped(whole: bytes, rng: random.Random) -> bytes:
    bent = bytearray(whole)
    for _ in range(rng.choice([1, 1, 1, 5, 50])):
        bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
    return bytes(bent)


def counted(form: str, damage: Callable[[bytes, random.Random], bytes], cases: int, folder: Path) -> Counter[str]:
    """Return how often a damaged file was silently short or silently wrong, and the messages that were read."""
    file = FORMATS[form].write(folder)
    whole, wanted = file.read_bytes(), CSV_WANTED if form == "csv" else WANTED
    path = file.parent if form == "rosbag2" else file
    all_rows, rng, found = read(path, wanted).rows, random.Random(form), Counter[str]()
    assert all(len(rows) == COUNT for rows in all_rows.values())
    for _ in range(cases):
        spoilt = damage(whole, rng)
        file.write_bytes(spoilt)
        rows, said = read(path, wanted)
        wrong = any(rows[topic] - all_rows[topic] for topic in wanted)
        short = any(all_rows[topic] - rows[topic] for topic in wanted)
        at_a_line_end = form == "csv" and damage is cut and spoilt.endswith(b"\n")  # a whole file, to all appearances
        found["silently wrong"] += wrong and not said
        found["silently short"] += short and not wrong and not said and not at_a_line_end
        found["messages"] += sum(len(rows[topic] & all_rows[topic]) for topic in wanted)
        found["bytes"] += len(spoilt)
    found["of 100 messages read"] = round(100 * found["messages"] / (cases * COUNT * len(wanted)))
    found["of 100 bytes left"] = round(100 * found["bytes"] / (cases * len(whole)))
    return found


def judge(form: str, kind: str, found: Counter[str]) -> None:
    tells = FORMATS[form]
    print(f"{form:26} {kind:6} {dict(found)}")
    if kind == "cuts" or tells.flips_tell_values:
        assert found["silently wrong"] == 0
    if kind == "cuts" or tells.flips_tell_loss:
        assert found["silently short"] == 0


@pytest.mark.parametrize("kind", ["cuts", "flips"])
@pytest.mark.parametrize("form", FORMATS)
def test_no_damage_goes_unsaid(tmp_path: Path, form: str, kind: str) -> None:
    judge(form, kind, counted(form, cut if kind == "cuts" else flipped, 25, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cuts", "flips"])
@pytest.mark.parametrize("form", FORMATS)
def test_no_damage_of_a_thousand_goes_unsaid(tmp_path: Path, form: str, kind: str) -> None:
    judge(form, kind, counted(form, cut if kind == "cuts" else flipped, 1000, tmp_path))


def test_the_numbers_of_the_dive_all_differ() -> None:
    values = [row[3].get("twist.linear.x", row[3].get("point.x", row[3].get("orientation.z"))) for row in dive()]

    assert len(np.unique([round(float(value or 0.0), 12) for value in values])) > COUNT * 2
