"""ROS 1 bags as rosbags and rosbag write them, and as crashes leave them."""

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from recordings import ROS1, SECOND, T0, Row, message, short_dive, twist, write_bag, yaw
from usbldr.io.formats.bag_log import BagLog
from usbldr.io.formats.detect import open_log
from usbldr.io.formats.mcap_log import McapLog

TWIST_X = {"/dvl": ["header.stamp", "header.frame_id", "twist.linear.x"]}


def many() -> list[Row]:
    return [row for k in range(500) for row in (twist(T0 + k * SECOND // 10, float(k), 0.0), yaw(T0 + k, 3.0))]


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_every_compression_gives_the_same_columns(tmp_path: Path, compression: str) -> None:
    log = open_log(write_bag(tmp_path / "a.bag", many(), compression, 4096))

    topics = {topic.name: topic for topic in log.topics()}
    dvl = log.read(TWIST_X)["/dvl"]

    assert log.format == "ROS 1 bag"
    assert {name: topic.count for name, topic in topics.items()} == {"/dvl": 500, "/imu": 500}
    assert topics["/dvl"].type == "geometry_msgs/TwistStamped"
    np.testing.assert_array_equal(dvl.columns["header.stamp"], T0 + np.arange(500) * (SECOND // 10))
    np.testing.assert_array_equal(dvl.received_ns, dvl.columns["header.stamp"])
    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], np.arange(500.0))
    assert log.findings() == ()


def test_records_come_in_the_order_of_their_log_times(tmp_path: Path) -> None:
    rows = [twist(T0 + k * SECOND, float(k), 0.0) for k in (0, 3, 1, 2)]

    dvl = BagLog(write_bag(tmp_path / "a.bag", rows, chunk_size=1)).read(TWIST_X)["/dvl"]

    np.testing.assert_array_equal(dvl.columns["twist.linear.x"], [0, 1, 2, 3])


def test_a_bag_that_was_never_closed_has_lost_nothing(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "a.bag", many(), chunk_size=4096).read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    (end,) = struct.unpack_from("<Q", whole, at)
    file = tmp_path / "b.bag"
    file.write_bytes(whole[:at] + bytes(8) + whole[at + 8 : end])

    log = BagLog(file)

    assert sum(topic.count for topic in log.topics()) == 1000
    (finding,) = log.findings()
    assert (finding.code, finding.lost_data) == ("UNINDEXED", False)
    assert finding.text == (
        "the bag was never closed, its index is missing; 1000 messages could be read, the last of "
        "2020-09-13T12:27:29.900Z (rosbag reindex repairs it)"
    )


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_cut_anywhere_gives_an_unbroken_beginning_and_is_reported(tmp_path: Path, compression: str) -> None:
    whole = write_bag(tmp_path / "whole.bag", many(), compression, 8192).read_bytes()
    counts: list[int] = []
    for end in range(13, len(whole), max(1, len(whole) // 61)):
        file = tmp_path / "cut.bag"
        file.write_bytes(whole[:end])
        log = BagLog(file)

        names = [topic.name for topic in log.topics()]
        x = log.read(TWIST_X)["/dvl"].columns["twist.linear.x"] if "/dvl" in names else np.empty(0)

        np.testing.assert_array_equal(x, np.arange(float(len(x))))
        if end > 13:
            assert any(finding.lost_data for finding in log.findings()) or len(x) == 500, f"cut at {end}"
        counts.append(len(x))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == 500


def test_a_flipped_bit_costs_one_chunk(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "a.bag", many(), "bz2", 8192)
    bent = bytearray(file.read_bytes())
    bent[len(bent) // 3] ^= 0x10
    file.write_bytes(bent)

    log = BagLog(file)
    x = log.read(TWIST_X)["/dvl"].columns["twist.linear.x"]

    assert [(finding.code, finding.lost_data) for finding in log.findings()] == [("DAMAGED", True)]
    assert 400 < len(x) < 500
    assert set(x) < set(np.arange(500.0))


def test_an_unknown_compression_is_named(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "a.bag", many(), chunk_size=1 << 20).read_bytes()
    (tmp_path / "b.bag").write_bytes(whole.replace(b"compression=none", b"compression=zzzz"))
    log = BagLog(tmp_path / "b.bag")

    assert sum(topic.count for topic in log.topics()) == 0
    (finding,) = log.findings()
    assert finding.text == (
        "1 chunks are damaged or use an unknown compression (zzzz): 0 of 1000 messages could be read"
    )


def test_behind_a_break_reading_goes_on_at_the_next_chunk(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "a.bag", many(), "lz4", 4096)
    bent = bytearray(file.read_bytes())
    at = bent.index(b"compression=lz4", len(bent) // 2)
    bent[at - 20 : at] = bytes(20)
    file.write_bytes(bent)
    log = BagLog(file)

    x = log.read(TWIST_X)["/dvl"].columns["twist.linear.x"]

    lost = sorted(set(range(500)) - set(x.astype(int)))
    assert 5 < len(lost) < 100
    assert lost == list(range(lost[0], lost[-1] + 1))
    assert [(finding.code, finding.lost_data) for finding in log.findings()] == [("DAMAGED", True)]


def test_mcap_with_ros_1_messages_gives_what_the_bag_gives(tmp_path: Path) -> None:
    rows = short_dive()
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        channels: dict[str, int] = {}
        for log_ns, topic, type_name, values in rows:
            ros1_name = type_name.replace("/msg/", "/")
            if topic not in channels:
                definition, _ = ROS1.generate_msgdef(type_name)
                schema = writer.register_schema(ros1_name, "ros1msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            data = bytes(ROS1.serialize_ros1(message(type_name, values, ROS1), type_name))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    wanted = TWIST_X | {"/imu": ["header.stamp", "orientation.z"], "/usbl": ["header.stamp", "point.x"]}

    ours, theirs = McapLog(file).read(wanted), BagLog(write_bag(tmp_path / "a.bag", rows)).read(wanted)

    for topic in wanted:
        np.testing.assert_array_equal(ours[topic].received_ns, theirs[topic].received_ns)
        for path in wanted[topic]:
            assert len(ours[topic].columns[path]) == 11
            np.testing.assert_array_equal(ours[topic].columns[path], theirs[topic].columns[path])
