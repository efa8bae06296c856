"""MCAP files as other writers make them, and as crashes leave them."""

import functools
import os
import random
import struct
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter

from logs import TWIST_X, counts, losses, refusal, x_of
from recordings import FLOAT64, ROS2, SECOND, T0, TWIST, Row, message, saved, twist, write_mcap, write_payloads, yaw
from usbldr.filters.errors import LogError
from usbldr.io.decoding.collected import read_whole
from usbldr.io.limits import VARIABLE
from usbldr.io.reading.read import read_log
from usbldr.io.recordings.mcap_log import McapLog

CONTAINERS = [*((True, compression) for compression in CompressionType), (False, CompressionType.NONE)]


def many() -> list[Row]:
    """1000 messages on one topic, every tenth of a second, x counting up; and a second topic."""
    return [row for k in range(1000) for row in (twist(T0 + k * SECOND // 10, float(k), 0.0), yaw(T0 + k, 3.0))]


@functools.cache
def made(*how: Any) -> bytes:
    with TemporaryDirectory() as folder:
        return write_mcap(Path(folder) / "a.mcap", many(), *how).read_bytes()


def written(file: Path, *how: Any) -> Path:
    """Write the many messages, serialised once for each kind of container: compression, chunked, size, summary."""
    file.write_bytes(made(*how))
    return file


def chunks_of(file: Path) -> list[ChunkIndex]:
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    return summary.chunk_indexes


def overwrite(file: Path, at: int, data: bytes) -> McapLog:
    whole = file.read_bytes()
    file.write_bytes(whole[:at] + data + whole[at + len(data) :])
    return McapLog(file)


def flip(file: Path, at: int, bits: int = 1) -> McapLog:
    return overwrite(file, at, bytes([file.read_bytes()[at] ^ bits]))


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize(("chunked", "compression"), CONTAINERS)
def test_every_kind_of_container_gives_the_same_columns(tmp_path, chunked, compression, summary, monkeypatch):
    file = written(tmp_path / "a.mcap", compression, chunked, 4096, summary)
    if chunked and summary:  # a file that agrees with its index is not scanned
        monkeypatch.setattr("usbldr.io.recordings.mcap_log.McapScan", None)
    log = McapLog(file)

    topics = {topic.name: topic for topic in log.topics()}
    read = read_whole(log, {**TWIST_X, "/imu": ["header.stamp"]})

    dvl = read["/dvl"]
    assert counts(log) == {"/dvl": 1000, "/imu": 1000}
    assert topics["/dvl"].type == TWIST
    assert topics["/dvl"].first_ns == T0
    assert topics["/dvl"].last_ns == T0 + 999 * SECOND // 10
    np.testing.assert_array_equal(dvl.columns["header.stamp"], T0 + np.arange(1000) * (SECOND // 10))
    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], np.arange(1000.0))
    np.testing.assert_array_equal(read["/imu"].columns["header.stamp"], T0 + np.arange(1000))
    assert dvl.columns["header.stamp"].dtype == np.int64
    assert log.findings() == ()


def test_chunks_without_a_wanted_message_are_not_looked_at(tmp_path: Path) -> None:
    rows = [twist(T0 + k * SECOND, float(k), 0.0) for k in range(500)]
    rows += [yaw(T0 + k * SECOND, 3.0) for k in range(500)]
    file = write_mcap(tmp_path / "a.mcap", rows, CompressionType.NONE, True, 4096)
    last = chunks_of(file)[-1]
    log = flip(file, last.chunk_start_offset + last.chunk_length // 2, 0x10)

    np.testing.assert_array_equal(x_of(log), np.arange(500.0))
    assert log.findings() == ()
    read_whole(log, {"/imu": ["header.stamp"]})
    assert [finding.code for finding in log.findings()] == ["CHECKSUM"]


def test_a_summary_with_a_wrong_checksum_is_not_used(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.ZSTD, True, 4096)
    at = file.read_bytes().rindex(b"/dvl")  # in the summary; the data are compressed

    assert counts(overwrite(file, at, b"/dvk")) == {"/dvl": 1000, "/imu": 1000}


@pytest.mark.parametrize("what", ["place", "time"])
def test_a_wrong_index_is_not_used(tmp_path: Path, what: str) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.ZSTD, True, 8192)
    index = min(chunks_of(file)[3].message_index_offsets.values()) + 9 + 2 + 4

    dvl = read_whole(flip(file, index + (8 if what == "place" else 0)), TWIST_X)["/dvl"]

    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], np.arange(1000.0))
    np.testing.assert_array_equal(dvl.received_ns, T0 + np.arange(1000) * (SECOND // 10))


def test_an_uncompressed_file_loses_only_the_message_it_is_cut_in(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.NONE)
    size = file.read_bytes().index(struct.pack("<d", 500.0))  # x of the 501st message
    os.truncate(file, size)
    log = McapLog(file)

    np.testing.assert_array_equal(x_of(log), np.arange(500.0))
    (finding,) = log.findings()
    assert finding.text.endswith(f"of {size}: 1000 messages could be read, the last 49.9 s after the first")
    assert finding.lost_data


def message_places(data: bytes) -> list[tuple[int, int]]:
    """Return where the messages of a file without chunks begin and end."""
    at, places = 8, list[tuple[int, int]]()
    while at < len(data) - 8:
        op, length = struct.unpack_from("<BQ", data, at)
        places += [(at, at + 9 + length)] * (op == 5)
        at += 9 + length
    return places


@settings(max_examples=40, deadline=None)
@given(
    place=st.integers(2000, 200_000),
    size=st.sampled_from([1, 8, 512, 4096]),
    kind=st.sampled_from(["zeros", "flipped", "noise"]),
    summary=st.booleans(),
)
@example(place=6671, size=8, kind="flipped", summary=False)  # of opcode and length
@example(place=6678, size=1, kind="flipped", summary=False)  # of a length, which then reaches into the next message
def test_behind_damage_a_file_without_chunks_is_read_on(place: int, size: int, kind: str, summary: bool) -> None:
    whole = made(CompressionType.NONE, False)
    messages = message_places(whole)
    place = min(place, messages[-20][0] - size)
    was = whole[place : place + size]
    now = {"zeros": bytes(size), "flipped": bytes(255 - k for k in was), "noise": random.Random(place).randbytes(size)}
    end = whole[place + size :] if summary else whole[place + size : messages[-1][1]]
    with TemporaryDirectory() as folder:
        log = McapLog(saved(Path(folder) / "a.mcap", whole[:place], now[kind], end))
        read = set(x_of(log))

    intact = {
        k / 2 for k, (start, stop) in enumerate(messages) if k % 2 == 0 and (stop <= place or start >= place + size)
    }
    assert intact <= read
    assert any(one.lost_data for one in log.findings()) or sum(counts(log).values()) == len(messages)


def test_what_looks_like_records_and_is_none_costs_nothing_that_precedes(tmp_path: Path) -> None:
    whole = made(CompressionType.NONE, False)
    cut = message_places(whole)[-500][0]
    like = (b"\x05" + struct.pack("<Q", 30) + bytes(30)) * 2 + b"\x05" + struct.pack("<Q", 1 << 31)
    log = McapLog(saved(tmp_path / "a.mcap", whole[:cut], b"\x05" + struct.pack("<Q", 1 << 40), like * 100_000))

    assert len(x_of(log)) == 750
    assert any(one.lost_data for one in log.findings())


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_behind_damage_a_file_of_chunks_without_its_index_is_read_on(tmp_path: Path, compression) -> None:
    """The length of a chunk is wrong; its own messages can be read if they are not compressed."""
    file = written(tmp_path / "a.mcap", compression, True, 4000)
    (_, second, *_), end = chunks_of(file), file.read_bytes().rindex(b"\x0f\x04")
    os.truncate(file, end)
    log = overwrite(file, second.chunk_start_offset + 1, struct.pack("<Q", 1 << 39))

    read = x_of(log)
    lost = set(range(1000)) - {*read}
    assert len(read) == len({*read})
    assert len(lost) == (0 if compression == CompressionType.NONE else 9)  # of 18 messages in 4000 bytes
    assert any(one.lost_data for one in log.findings())


def test_a_file_without_its_index_has_lost_nothing(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mcap")
    os.truncate(file, file.stat().st_size - 20)
    log = McapLog(file)

    assert counts(log) == {"/dvl": 1000, "/imu": 1000}
    (finding,) = log.findings()
    assert (finding.code, finding.lost_data) == ("TRUNCATED", False)
    assert finding.text == "the file's index is missing; all 2000 messages could be read"


@pytest.mark.parametrize("damaged", [0, 3])  # the first chunk holds the definitions
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("where", ["head", "middle"])
def test_a_destroyed_chunk_costs_only_its_own_messages(tmp_path, compression, damaged, where):
    file = written(tmp_path / "a.mcap", compression, True, 8192)
    chunk = chunks_of(file)[damaged]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    at, data = (chunk.chunk_start_offset, bytes(30)) if where == "head" else (middle, b"\xff" * 400)
    log = overwrite(file, at, data)

    x = x_of(log)
    (finding,) = log.findings()

    assert (finding.code, finding.lost_data) == ("DAMAGED", True)
    assert finding.text.startswith("1 chunks are damaged (logged between 2020-09-13T12:2")
    assert finding.text.endswith(" of 2000 messages could be read")
    lost = sorted(set(range(1000)) - set(map(int, x)))
    assert 5 < len(lost) < 100
    assert lost == list(range(lost[0], lost[-1] + 1))


@pytest.mark.parametrize("damaged", [0, 3])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_a_chunk_with_a_wrong_checksum_is_reported(tmp_path: Path, compression: CompressionType, damaged: int) -> None:
    file = written(tmp_path / "a.mcap", compression, True, 8192)
    log = flip(file, chunks_of(file)[damaged].chunk_start_offset + 9 + 8 + 8 + 8)  # opcode and length, two times, size

    np.testing.assert_array_equal(x_of(log), np.arange(1000.0))
    (finding,) = log.findings()
    assert (finding.code, finding.lost_data) == ("CHECKSUM", True)
    assert finding.text.startswith("the checksum of 1 chunks (logged between 2020-09-13T12:2")
    assert finding.text.endswith("is wrong, but all messages could be read: values may be altered")


def test_impossible_times_of_an_altered_chunk_and_of_its_message_are_left_out(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.NONE, True, 8192)
    end = chunks_of(file)[0].chunk_start_offset + 9 + 8
    message_time = file.read_bytes().index(struct.pack("<Q", T0), end)
    overwrite(file, end + 7, b"\xff")  # the year 2554
    log = overwrite(file, message_time + 7, b"\xff")

    assert len(x_of(log)) == 999
    assert "1 messages have an impossible log time; left out" in [finding.text for finding in log.findings()]


@pytest.mark.parametrize("alteration", ["opcode", "channel"])
def test_messages_that_the_statistics_count_and_the_data_lack_are_reported(tmp_path: Path, alteration: str) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.NONE, False)
    whole = file.read_bytes()
    head = b"\x05" + struct.pack("<QH", 22 + len(ROS2.serialize_cdr(message(TWIST, {}), TWIST)), 1)
    at = whole.index(head, len(whole) // 2)
    log = overwrite(file, at, b"\x7f") if alteration == "opcode" else overwrite(file, at + 9, b"\x02")

    assert len(x_of(log)) == 999
    finding = next(finding for finding in log.findings() if finding.code == "DAMAGED")
    more = "" if alteration == "opcode" else " and 1 are not in the file's statistics"
    assert finding.text == f"1 of 2000 messages in the file's statistics are missing{more}"
    assert finding.lost_data


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("statistics", [True, False])
@pytest.mark.parametrize("damaged", [True, False])
def test_a_summary_that_repeats_channels_without_schemas_hides_no_type(tmp_path, chunked, statistics, damaged):
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunked, repeat_schemas=False, use_statistics=statistics, chunk_size=100)
        writer.start()
        for k, topic in enumerate(("/heading", "/depth")):  # the second schema is in a later chunk than the first
            number = writer.register_channel(topic, "cdr", writer.register_schema(*FLOAT64))
            for i in range(10):
                writer.add_message(number, T0 + k + i, GOOD[:4] + struct.pack("<d", float(i)), T0 + k + i)
        writer.finish()
    if damaged:  # the end of the index
        file.write_bytes(file.read_bytes()[:-3])
    log = McapLog(file)

    expected = [("/heading", "std_msgs/msg/Float64", 10), ("/depth", "std_msgs/msg/Float64", 10)]
    assert [(topic.name, topic.type, topic.count) for topic in log.topics()] == expected
    read = read_whole(log, {"/heading": ["data"], "/depth": ["data"]})
    for topic in ("/heading", "/depth"):
        np.testing.assert_array_equal(read[topic].columns["data"], np.arange(10.0))
    assert not any(finding.lost_data for finding in log.findings())


REAL = struct.pack("<d", 12.5)
GOOD = b"\0\1\0\0" + REAL
UNFIT = "/heading: {} messages, the first of 2020-09-13T12:26:41.000Z, do not match their definition in the file"


@pytest.mark.parametrize(
    ("payloads", "said"),
    [
        ([GOOD, GOOD[:7], GOOD, b""], UNFIT.format(2)),
        *(([GOOD, bytes([0, byte, 0, 0]) + REAL], f"{UNFIT.format(1)}: they are in {name}, not plain CDR")
          for byte, name in ((3, "PL_CDR"), (7, "XCDR2"), (11, "XCDR2"))),
    ],
)  # fmt: skip
def test_messages_that_do_not_fit_their_definition_are_counted(tmp_path, payloads, said):
    log = McapLog(write_payloads(tmp_path / "a.mcap", "/heading", "cdr", FLOAT64, payloads))

    heading = read_whole(log, {"/heading": ["data"]})["/heading"]

    np.testing.assert_array_equal(heading.columns["data"], [12.5] * payloads.count(GOOD))
    assert losses(log.findings()) == {said: True}


def test_an_unknown_compression_is_named(tmp_path: Path) -> None:
    file = written(tmp_path / "a.mcap", CompressionType.ZSTD, True, 1 << 20)
    file.write_bytes(file.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0snap"))
    log = McapLog(file)

    assert len(x_of(log)) == 0
    (finding,) = log.findings()
    assert "1 chunks are damaged or use an unknown compression (snap) (logged between" in finding.text
    assert finding.text.endswith(": 0 of 2000 messages could be read")


def test_messages_that_decompress_to_too_much_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = zstandard.compress(bytes(2_000_000))
    file = write_payloads(tmp_path / "a.mcap", "/speed", "cdr", FLOAT64, [data, data])
    monkeypatch.setenv(VARIABLE, "0.01")
    log = McapLog(file)

    assert len(read_whole(log, {"/speed": ["data"]})["/speed"].received_ns) == 0
    (finding, _) = log.findings()
    assert finding.text.startswith("messages decompress to more than 1.34 MB each and are left out (--limits 10")


def test_records_of_a_later_version_are_passed_over(tmp_path: Path) -> None:
    whole = written(tmp_path / "a.mcap", CompressionType.NONE, False, 1 << 20, False).read_bytes()
    first_message = whole.index(b"\x05", 100)
    future = b"\x7f" + struct.pack("<Q", 5) + b"what?"
    while not whole[first_message : first_message + 9].endswith(b"\0" * 6):
        first_message = whole.index(b"\x05", first_message + 1)
    log = McapLog(saved(tmp_path / "b.mcap", whole[:first_message] + future + whole[first_message:]))

    assert len(x_of(log)) == 1000
    assert log.findings() == ()


def test_an_encoding_we_cannot_read_is_named_only_when_its_topic_is_wanted(tmp_path: Path) -> None:
    schema = ("foxglove.LocationFix", "flatbuffer", b"{}")
    file = write_payloads(tmp_path / "a.mcap", "/fix", "flatbuffer", schema, [b"{}"])
    log = McapLog(file)

    (topic,) = log.topics()
    assert topic.count == 1
    assert refusal(LogError, read_whole, log, {"/fix": ["latitude"]}).startswith(
        f"{file}: /fix cannot be read: encoding flatbuffer with flatbuffer definitions is not supported, only cdr with "
    )


LINE = "=" * 80
DEFINITION = f"""std_msgs/Header header
geometry_msgs/Vector3 velocity  # [m/s]
bool velocity_valid
float64 altitude
{LINE}
MSG: std_msgs/Header
{{}}
string frame_id
{LINE}
MSG: geometry_msgs/Vector3
"""
TIME = f"\n{LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


def defined(order: str, ros_1: bool) -> str:
    vector = "".join(f"float64 {axis}\n" for axis in order)
    stamp = "uint32 seq\ntime stamp" if ros_1 else "builtin_interfaces/Time stamp"
    return DEFINITION.format(stamp) + vector + TIME * (not ros_1)


def payload(time_ns: int, order: str, ros_1: bool) -> bytes:
    head = struct.pack("<I" * ros_1 + "iII", *[0] * ros_1, time_ns // SECOND, 0, int(not ros_1)) + bytes(not ros_1)
    head += b"" if ros_1 else bytes(-len(head) % 8)
    vector = struct.pack("<ddd?", *(dict(zip("xyz", (1.0, 0.25, 0.0), strict=True))[axis] for axis in order), True)
    return b"\0\1\0\0" * (not ros_1) + head + vector + bytes(7 * (not ros_1)) + struct.pack("<d", 5.0)


@pytest.mark.parametrize("ros_1", [True, False])
@pytest.mark.parametrize("second", ["yxz", "xyz"])
def test_messages_are_read_by_the_definition_of_their_own_channel(tmp_path: Path, ros_1: bool, second: str) -> None:
    """A type that was changed between two stretches of a log; comments are no change."""
    definitions = [defined("xyz", ros_1), defined(second, ros_1).replace("# [m/s]", "")]
    times = [T0 + k * SECOND for k in range(40)]
    if ros_1:
        with BagWriter(tmp_path / "a.bag") as bag:
            for order, definition, some in zip(("xyz", second), definitions, (times[:20], times[20:]), strict=True):
                to = bag.add_connection("/dvl", "my_msgs/msg/DVL", msgdef=definition, md5sum=order)
                for time_ns in some:
                    bag.write(to, time_ns, payload(time_ns, order, ros_1))
    else:
        with (tmp_path / "a.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2", library="by hand")
            for order, definition, some in zip(("xyz", second), definitions, (times[:20], times[20:]), strict=True):
                schema = writer.register_schema("my_msgs/msg/DVL", "ros2msg", definition.encode())
                channel = writer.register_channel("/dvl", "cdr", schema, {"order": definition})
                for time_ns in some:
                    writer.add_message(channel, time_ns, payload(time_ns, order, ros_1), time_ns)
            writer.finish()

    log = read_log(tmp_path / ("a.bag" if ros_1 else "a.mcap"))

    assert log.tables["dvl"]["forward_mps"].tolist() == [1.0] * 40
    assert log.tables["dvl"]["starboard_mps"].tolist() == [0.25] * 40
    assert (second == "yxz") == any(finding.code == "TOPIC-PARTS" for finding in log.findings)
