"""ROS 1 bags as rosbags and rosbag write them, and as crashes leave them."""

import bz2
import functools
import struct
from itertools import permutations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from logs import losses, x_of
from recordings import ROS1, SECOND, T0, Row, message, saved, short_dive, twist, write_bag, write_payloads, yaw
from usbldr.io.decoding.collected import read_whole
from usbldr.io.formats.detect import open_reader
from usbldr.io.recordings.bag_log import BagLog
from usbldr.io.recordings.mcap_log import McapLog

TWIST_X = {"/dvl": ["header.stamp", "header.frame_id", "twist.linear.x"]}


def many() -> list[Row]:
    return [row for k in range(500) for row in (twist(T0 + k * SECOND // 10, float(k), 0.0), yaw(T0 + k, 3.0))]


@functools.cache
def made(compression: str, chunk_size: int) -> bytes:
    """Return the many messages, serialised once for each compression and size of chunks."""
    with TemporaryDirectory() as folder:
        return write_bag(Path(folder) / "a.bag", many(), compression, chunk_size).read_bytes()


def bag_of(file: Path, content: bytes | bytearray) -> BagLog:
    return BagLog(saved(file, content))


def index_of(bag: bytes) -> tuple[int, int]:
    """Return where a bag states the place of its index, and that place."""
    at = bag.index(b"index_pos=") + len(b"index_pos=")
    return at, *struct.unpack_from("<Q", bag, at)


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_every_compression_gives_the_same_columns(tmp_path: Path, compression: str) -> None:
    log = open_reader(saved(tmp_path / "a.bag", made(compression, 4096)))

    topics = {topic.name: topic for topic in log.topics()}
    dvl = read_whole(log, TWIST_X)["/dvl"]

    assert log.format == "ROS 1 bag"
    assert {name: topic.count for name, topic in topics.items()} == {"/dvl": 500, "/imu": 500}
    assert topics["/dvl"].type == "geometry_msgs/TwistStamped"
    np.testing.assert_array_equal(dvl.columns["header.stamp"], T0 + np.arange(500) * (SECOND // 10))
    np.testing.assert_array_equal(dvl.received_ns, dvl.columns["header.stamp"])
    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], np.arange(500.0))
    assert log.findings() == ()


def test_a_bag_that_was_never_closed_has_lost_nothing(tmp_path: Path) -> None:
    whole = made("none", 4096)
    at, end = index_of(whole)

    log = bag_of(tmp_path / "b.bag", whole[:at] + bytes(8) + whole[at + 8 : end])

    assert sum(topic.count for topic in log.topics()) == 1000
    (finding,) = log.findings()
    assert (finding.code, finding.lost_data) == ("UNINDEXED", False)
    assert finding.text == (
        "the bag was never closed, its index is missing; 1000 messages could be read, the last of "
        "2020-09-13T12:27:29.900Z (rosbag reindex repairs it)"
    )


def with_index_at(bag: bytes, shift: int) -> bytes:
    """Return a bag whose index is further back than its header says."""
    at, place = index_of(bag)
    return bag[:at] + struct.pack("<Q", place + shift) + bag[at + 8 :]


@pytest.mark.parametrize("left", [0, 0.5])
def test_a_chunk_that_decompresses_to_less_than_stated_is_lost_data(tmp_path: Path, left: float) -> None:
    rows = [twist(T0 + k * SECOND, float(k), 0.0) for k in range(100)]
    whole = write_bag(tmp_path / "a.bag", rows, "bz2").read_bytes()
    at = whole.index(b"BZh")
    (length,) = struct.unpack_from("<I", whole, at - 4)
    inside = bz2.decompress(whole[at : at + length])
    packed = bz2.compress(inside[: round(len(inside) * left)])
    bag = whole[: at - 4] + struct.pack("<I", len(packed)) + packed + whole[at + length :]
    log = bag_of(tmp_path / "b.bag", with_index_at(bag, len(packed) - length))

    x = x_of(log)

    np.testing.assert_array_equal(x, np.arange(len(x)))
    assert len(x) < 60
    (finding,) = log.findings()
    first = whole.index(b"op=\5") - 8
    assert finding.text == f"1 chunks are damaged, the first at byte {first}: {len(x)} of 100 messages could be read"
    assert finding.lost_data


def record_ends(bag: bytes) -> list[tuple[int, int]]:
    """Return where each record of a bag ends, and its op code."""
    ends: list[tuple[int, int]] = []
    at = 13
    while at < len(bag):
        (header,) = struct.unpack_from("<I", bag, at)
        op = bag[bag.index(b"\x04\0\0\0op=", at) + 7]
        (data,) = struct.unpack_from("<I", bag, at + 4 + header)
        at += 8 + header + data
        ends.append((at, op))
    return ends


def test_a_bag_cut_between_two_records_is_truncated(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "a.bag", [twist(T0 + k, float(k), 0.0) for k in range(3)], chunk_size=1).read_bytes()
    ends = record_ends(whole)
    assert [op for _, op in ends].count(5) == 3  # a chunk for each message
    found: list[tuple[int, bool]] = []
    for end, _ in ends[:-1]:
        log = bag_of(tmp_path / "b.bag", whole[:end])

        (finding,) = log.findings()
        assert finding.text.startswith(f"the bag is truncated or damaged at byte {end} of {end}: ")
        found.append((sum(topic.count for topic in log.topics()), finding.lost_data))

    assert found[:7] == [(0, True), (1, True), (1, True), (2, True), (2, True), (3, False), (3, False)]
    assert set(found[7:]) == {(3, False)}


CONNECTION = b"conn=\7\0\0\0"
TIME = b"time=\0\x10^_\n\0\0\0"  # 1,600,000,000 s and 10 ns


def fields(*texts: bytes) -> bytes:
    return b"".join(struct.pack("<I", len(text)) + text for text in texts)


def record(header: bytes, data: bytes) -> bytes:
    """A record by http://wiki.ros.org/Bags/Format/2.0."""
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def by_hand(file: Path, *messages: bytes) -> BagLog:
    """Write a bag of one chunk, with headings of connection 7 and these messages."""
    about = fields(b"type=std_msgs/Float64", b"md5sum=*", b"message_definition=float64 data")
    content = record(fields(b"op=\7", CONNECTION, b"topic=/hdg"), about) + b"".join(messages)
    head = fields(b"op=\5", b"compression=none", b"size=" + struct.pack("<I", len(content)))
    return bag_of(file, b"#ROSBAG V2.0\n" + record(head, content))


@pytest.mark.parametrize("more", [(), (b"latching=1",), (CONNECTION,)], ids=["plain", "a fourth field", "one twice"])
@pytest.mark.parametrize("order", list(permutations((b"op=\2", CONNECTION, TIME))))
def test_the_fields_of_a_message_come_in_any_order_with_others_between(tmp_path, order, more):
    header = fields(*order[:1], *more, *order[1:])

    log = by_hand(tmp_path / "a.bag", *(record(header, struct.pack("<d", 30.0 + k)) for k in range(3)))

    read = read_whole(log, {"/hdg": ["data"]})["/hdg"]
    assert read.columns["data"].tolist() == [30.0, 31.0, 32.0]
    assert read.received_ns.tolist() == [T0 + 10] * 3


HEADER = fields(b"op=\2", CONNECTION, TIME)
DAMAGED = {
    "longer than its chunk": struct.pack("<I", len(HEADER)) + HEADER + struct.pack("<Id", 9, 3.0),
    "a field twice, another cut": b"&\0\0\0" + fields(CONNECTION, CONNECTION, TIME) + struct.pack("<Id", 8, 3.0),
}


@pytest.mark.parametrize("damaged", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_message_is_none_and_is_reported(tmp_path: Path, damaged: bytes) -> None:
    log = by_hand(tmp_path / "a.bag", record(HEADER, struct.pack("<d", 30.0)), damaged)

    assert [topic.count for topic in log.topics()] == [1]
    assert read_whole(log, {"/hdg": ["data"]})["/hdg"].columns["data"].tolist() == [30.0]
    assert any(finding.code == "DAMAGED" and finding.lost_data for finding in log.findings())


@pytest.mark.parametrize("shift", [0, 49])  # the header says that the index is at the zeros, or behind them
def test_zeros_before_the_index_lose_nothing(tmp_path: Path, shift: int) -> None:
    whole = made("none", 4096)
    _, at = index_of(whole)
    log = bag_of(tmp_path / "b.bag", with_index_at(whole[:at] + bytes(49) + whole[at:], shift))

    np.testing.assert_array_equal(x_of(log), np.arange(500.0))
    (finding,) = log.findings()
    assert finding.text == f"the bag is damaged at byte {at} of {len(whole) + 49}: 1000 of 1000 messages could be read"
    assert (finding.code, finding.level) == ("DAMAGED", "warning")


@pytest.mark.parametrize("alteration", ["op", "connection"])
def test_messages_that_the_index_counts_and_the_chunks_lack_are_reported(tmp_path: Path, alteration: str) -> None:
    bent = bytearray(made("none", 4096))
    connection, op = b"\x09\0\0\0conn=\0\0\0\0", b"\x04\0\0\0op=\x02"
    message = bent.index(connection + op if connection + op in bent else op + connection, len(bent) // 2)
    if alteration == "op":
        bent[bent.index(op, message - 20) + 7] = 0x42
    else:
        bent[bent.index(connection, message - 20) + 9] = 7
    log = bag_of(tmp_path / "b.bag", bent)

    assert len(x_of(log)) == 499
    finding, *more = log.findings()
    surplus = "" if alteration == "op" else " and 1 are not in the bag's index"
    assert finding.text == f"1 of 1000 messages in the bag's index are missing{surplus}"
    assert finding.lost_data
    assert len(more) == (alteration == "connection")


def test_a_topic_that_is_spelt_in_two_ways_is_reported_and_no_second_topic(tmp_path: Path) -> None:
    whole = made("none", 1 << 20)
    again = whole.rindex(b"topic=/imu")
    log = bag_of(tmp_path / "b.bag", whole[: again + 7] + b"k" + whole[again + 8 :])

    assert {topic.name: topic.count for topic in log.topics()} == {"/dvl": 500, "/imu": 500}
    said = "1 connections are defined again as another topic or type; the first is used"
    assert losses(log.findings()) == {said: True}


def test_an_unknown_compression_is_named(tmp_path: Path) -> None:
    log = bag_of(tmp_path / "b.bag", made("none", 1 << 20).replace(b"compression=none", b"compression=zzzz"))

    assert sum(topic.count for topic in log.topics()) == 0
    (finding,) = log.findings()
    why = "1 chunks are damaged or use an unknown compression (zzzz), the first at byte 4109"
    assert finding.text == f"{why}: 0 of 1000 messages could be read"


def test_behind_a_break_reading_goes_on_at_the_next_chunk(tmp_path: Path) -> None:
    whole = made("lz4", 4096)
    at = whole.index(b"compression=lz4", len(whole) // 2)
    log = bag_of(tmp_path / "a.bag", whole[: at - 20] + bytes(20) + whole[at:])

    lost = sorted(set(range(500)) - set(map(int, x_of(log))))
    assert 5 < len(lost) < 100
    assert lost == list(range(lost[0], lost[-1] + 1))
    assert [(finding.code, finding.lost_data) for finding in log.findings()] == [("DAMAGED", True)]


def test_mcap_with_ros_1_messages_gives_what_the_bag_gives(tmp_path: Path) -> None:
    bag = BagLog(write_bag(tmp_path / "a.bag", short_dive()))
    wanted = TWIST_X | {"/imu": ["header.stamp", "orientation.z"], "/usbl": ["header.stamp", "point.x"]}
    for topic, paths in wanted.items():
        rows = [row for row in short_dive() if row[1] == topic]
        kind = rows[0][2]
        payloads = [bytes(ROS1.serialize_ros1(message(kind, values, ROS1), kind)) for *_, values in rows]
        schema = (kind.replace("/msg/", "/"), "ros1msg", ROS1.generate_msgdef(kind)[0].encode())
        file = write_payloads(tmp_path / "a.mcap", topic, "ros1", schema, payloads)

        ours, theirs = read_whole(McapLog(file), {topic: paths}), read_whole(bag, {topic: paths})

        np.testing.assert_array_equal(ours[topic].received_ns, theirs[topic].received_ns)
        for path in paths:
            assert len(ours[topic].columns[path]) == 11
            np.testing.assert_array_equal(ours[topic].columns[path], theirs[topic].columns[path])
