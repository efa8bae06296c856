"""Messages read by their layout: rosbags' own decoder, message by message, is the oracle."""

import random
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from chance import anything
from recordings import fields
from usbldr.io.decoding.cdr import RosDecoder, ros_decoder
from usbldr.io.decoding.columns import concatenated

ODD = fields("bool flag", "int16 small", "string first", "float64 wide", "uint8[3] three", "float32[] many")
ODD += fields("string[] names", "geometry_msgs/Point[] points", "time_free_msgs/Inner[] inners")
ODD += fields("builtin_interfaces/Time[] times", "int64 last", "uint64 huge", "string second")
ODD += fields("time_free_msgs/Inner inner", "builtin_interfaces/Time when")
INNER = "uint8 a\nfloat64 b\nstring[2] pair\nchar c\nbyte d\nfloat32[] row\nbuiltin_interfaces/Time t\nstring s\n"
TYPES = [f"sensor_msgs/msg/{name}" for name in ("Imu", "NavSatFix", "JointState", "BatteryState")]
TYPES += ["nav_msgs/msg/Odometry", "diagnostic_msgs/msg/DiagnosticArray"]
TYPES += ["std_msgs/msg/String", "std_msgs/msg/Float64MultiArray", "odd_msgs/msg/Odd"]


def store_of(ros_version: int) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(INNER, "time_free_msgs/msg/Inner"))
    store.register(get_types_from_msg(ODD, "odd_msgs/msg/Odd"))
    return store


STORES = {1: store_of(1), 2: store_of(2)}


def messages(ros_version: int, type_name: str, count: int, most: int) -> tuple[RosDecoder, list[bytes], list[Any]]:
    store, rng = STORES[ros_version], random.Random(type_name)
    made = [anything(store, (Nodetype.NAME, type_name), rng, most) for _ in range(count)]
    definition = store.generate_msgdef(type_name, ros_version=ros_version)[0].encode()
    if ros_version == 1:
        payloads = [bytes(store.serialize_ros1(one, type_name)) for one in made]
        return ros_decoder(type_name, definition, "ros1"), payloads, made
    return ros_decoder(type_name, definition), [bytes(store.serialize_cdr(one, type_name)) for one in made], made


def value(message: Any, path: str) -> Any:
    for part in path.split("."):
        message = message[int(part)] if part.isdecimal() else getattr(message, part)
    return message.sec * 10**9 + message.nanosec if hasattr(message, "nanosec") else message


def paths_of(store: Typestore, type_name: str, prefix: str = "") -> dict[str, Any]:
    """List all fields below a type, of arrays those of element 0 and 2, and what absent ones are."""
    paths: dict[str, Any] = {}
    for field, (node, what) in store.fielddefs[type_name][1]:
        is_array = node not in (Nodetype.BASE, Nodetype.NAME)
        kind, name = what[0] if is_array else (node, what)
        for path in [f"{prefix}{field}.0", f"{prefix}{field}.2"] if is_array else [prefix + field]:
            if kind is Nodetype.BASE:
                paths[path] = "" if name[0] == "string" else np.nan
            elif str(name).endswith("/Time"):
                paths[path] = 0
            else:
                paths |= paths_of(store, str(name), path + ".")
    return paths


def columns(decoder: RosDecoder, payloads: Sequence[bytes], paths: Sequence[str]) -> tuple[list[int], dict[str, Any]]:
    """Return which messages were read, in order, and their columns."""
    read = concatenated(decoder.pieces(payloads, paths), paths)
    order = np.argsort(read.rows)
    return read.rows[order].tolist(), {path: column[order] for path, column in read.columns.items()}


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize("most", [0, 1, 3])
@pytest.mark.parametrize("type_name", TYPES)
def test_columns_are_what_was_written(ros_version: int, type_name: str, most: int) -> None:
    decoder, payloads, made = messages(ros_version, type_name, 60, most)
    paths = paths_of(STORES[ros_version], type_name)

    rows, read = columns(decoder, payloads, list(paths))

    assert rows == list(range(60))
    assert {re.sub(r"\.\d+$", "", path.replace(".2.", ".0.")) for path in paths} == {*decoder.fields}
    for path, absent in paths.items():
        for row, message in enumerate(made):
            try:
                expected = value(message, path)
            except IndexError:
                expected = absent
            np.testing.assert_array_equal(read[path][row], expected, err_msg=f"{path} of message {row}")
    alone = [decoder.extractor(list(paths))(payload) for payload in payloads]  # one by one, as what has no layout
    for path, values in zip(paths, zip(*(one or () for one in alone), strict=True), strict=True):
        np.testing.assert_array_equal(values, read[path], err_msg=path)


def test_messages_of_one_layout_need_no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    decoder, payloads, made = messages(2, "sensor_msgs/msg/Imu", 50, 0)
    monkeypatch.setattr(Typestore, "deserialize_cdr", None)

    rows, read = columns(decoder, payloads, ["orientation.z", "header.stamp", "orientation_covariance.8"])

    assert rows == list(range(50))
    assert read["header.stamp"].dtype == np.int64
    np.testing.assert_array_equal(read["orientation.z"], [one.orientation.z for one in made])


def test_messages_of_other_lengths_may_be_among_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Same size, other lengths: "ab", "" and "", "ab" move a number, and only the lengths show it."""
    store = get_typestore(Stores.EMPTY)
    definition = "string a\nuint8 x\nstring b\n"
    store.register(get_types_from_msg(definition, "two_msgs/msg/Two"))
    make = store.types["two_msgs/msg/Two"]
    made = [make("abcd", 1, ""), make("", 2, "abcd"), make("abcd", 3, ""), make("dcba", 4, "")]
    payloads = [bytes(store.serialize_cdr(one, "two_msgs/msg/Two")) for one in made]
    assert len({len(payload) for payload in payloads}) == 1
    monkeypatch.setattr(Typestore, "deserialize_cdr", None)

    rows, read = columns(ros_decoder("two_msgs/msg/Two", definition.encode()), payloads, ["x", "a", "b"])

    assert rows == [0, 1, 2, 3]
    np.testing.assert_array_equal(read["x"], [1, 2, 3, 4])
    np.testing.assert_array_equal(read["a"], ["abcd", "", "abcd", "dcba"])
    np.testing.assert_array_equal(read["b"], ["", "abcd", "", ""])


def test_big_endian_messages_are_left_to_the_slow_decoder() -> None:
    store = STORES[2]
    decoder, payloads, made = messages(2, "sensor_msgs/msg/NavSatFix", 6, 2)
    payloads[3] = bytes(store.serialize_cdr(made[3], "sensor_msgs/msg/NavSatFix", little_endian=False))

    rows, read = columns(decoder, payloads, ["latitude", "header.frame_id"])

    assert rows == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(read["latitude"], [one.latitude for one in made])
    np.testing.assert_array_equal(read["header.frame_id"], [one.header.frame_id for one in made])


@pytest.mark.parametrize("ros_version", [1, 2])
@pytest.mark.parametrize(
    ("type_name", "paths"),
    [
        ("sensor_msgs/msg/NavSatFix", ["latitude", "header.frame_id"]),
        ("sensor_msgs/msg/BatteryState", ["voltage", "header.frame_id", "location", "serial_number"]),
    ],
)
def test_damaged_messages_are_read_if_rosbags_reads_them(ros_version: int, type_name: str, paths: list[str]) -> None:
    decoder, payloads, _ = messages(ros_version, type_name, 300, 2)
    rng = random.Random(3)
    bent = [bytearray(payload) for payload in payloads]
    for payload in bent:
        if rng.random() < 0.7:
            payload[rng.randrange(min(40, len(payload)))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.2:
            del payload[-rng.randint(1, 9) :]
    store = STORES[ros_version]
    decode = store.deserialize_ros1 if ros_version == 1 else store.deserialize_cdr
    fitting: dict[int, Any] = {}
    for row, payload in enumerate(bent):
        try:
            fitting[row] = decode(bytes(payload), type_name)
        except Exception:  # rosbags raises many kinds for bytes that do not match, none documented
            continue

    rows, read = columns(decoder, [bytes(payload) for payload in bent], paths)

    assert rows == list(fitting)
    assert 30 < len(rows) < 290
    for path in paths:
        np.testing.assert_array_equal(read[path], [value(message, path) for message in fitting.values()])
